//! Output files: written atomically, never over files of another origin.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::recordings::error::ErrorKind;
use crate::recordings::{DataError, Location};

/// Bytes that identify a file of this tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileSignature<'a> {
    /// Offset of the signature in bytes; some formats begin with a length.
    pub offset: usize,
    /// The signature.
    pub text: &'a str,
}

impl<'a> From<&'a str> for FileSignature<'a> {
    /// At offset zero.
    fn from(text: &'a str) -> Self {
        Self { offset: 0, text }
    }
}

/// Writes `bytes` to a temporary file in the folder of `path` and renames it. An existing file is replaced
/// only if it is empty or has the signature; symbolic links are followed.
///
/// # Errors
/// The path holds a file of another origin, or the file system refuses.
pub fn write_output<'a>(
    path: &Path,
    bytes: &[u8],
    signature: impl Into<FileSignature<'a>>,
) -> Result<(), DataError> {
    let target = check_output(path, signature)?;
    let failed = |error| unwritable(path, error);
    let mut draft = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        draft.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut draft = draft.tempfile_in(folder_of(&target)).map_err(failed)?;
    draft.write_all(bytes).map_err(failed)?;
    draft.as_file().sync_all().map_err(failed)?;
    draft.persist(&target).map_err(|error| failed(error.error))?;
    Ok(())
}

/// Checks that [`write_output`] may write `path` (call it before long computations); returns the resolved
/// path.
pub fn check_output<'a>(
    path: &Path,
    signature: impl Into<FileSignature<'a>>,
) -> Result<PathBuf, DataError> {
    let target = match path.symlink_metadata() {
        Ok(_) => path.canonicalize().map_err(|error| unwritable(path, error))?,
        Err(_) => path.to_path_buf(),
    };
    if target.exists() && !is_replaceable(&target, signature.into()) {
        return Err(ErrorKind::OutputExists.at(Location::file(path)));
    }
    let folder = folder_of(&target);
    if !folder.exists() {
        return Err(ErrorKind::NoSuchFolder.at(Location::file(folder)));
    }
    folder.metadata().map_err(|error| unwritable(path, error))?;
    Ok(target)
}

/// A temporary folder next to `target`, to be renamed to it when complete.
///
/// # Errors
/// The parent folder cannot be written.
pub fn staging_dir(target: &Path, prefix: &str) -> Result<TempDir, DataError> {
    let parent = folder_of(target);
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o777));
    }
    std::fs::create_dir_all(parent)
        .and_then(|()| builder.tempdir_in(parent))
        .map_err(|error| unwritable(target, error))
}

/// Checks that `target` does not exist or is an empty folder.
///
/// # Errors
/// It exists.
pub fn check_vacant(target: &Path) -> Result<(), DataError> {
    match std::fs::read_dir(target).map(|mut entries| entries.next()) {
        Ok(None) => Ok(()),
        _ => check_absent(target),
    }
}

/// Checks that nothing has this path.
///
/// # Errors
/// It exists.
pub fn check_absent(target: &Path) -> Result<(), DataError> {
    match target.symlink_metadata() {
        Ok(_) => Err(ErrorKind::PathExists.at(Location::file(target))),
        Err(_) => Ok(()),
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn unwritable(path: &Path, error: std::io::Error) -> DataError {
    // Only the kind: the message would name the temporary file.
    ErrorKind::Unwritable(std::io::Error::from(error.kind())).at(Location::file(path))
}

/// An empty file, or one with the signature.
fn is_replaceable(path: &Path, signature: FileSignature) -> bool {
    let Ok(metadata) = path.metadata() else {
        return false;
    };
    let mut start = vec![0; signature.offset + signature.text.len()];
    let mut has_signature = || {
        std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok()
            && start[signature.offset..] == *signature.text.as_bytes()
    };
    metadata.is_file() && (metadata.len() == 0 || has_signature())
}
