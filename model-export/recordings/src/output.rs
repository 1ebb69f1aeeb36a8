//! Output files: written atomically, never over files of another origin.

use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempDir};

use crate::error::{DataError, ErrorKind, Location};

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
    let draft = draft_file(path, &target, bytes, SHARED)?;
    draft.persist(&target).map_err(|error| unwritable(path, error.error))?;
    Ok(())
}

/// Writes `bytes` to a new file, which appears complete.
///
/// # Errors
/// Something has this path, also if it was created in the meantime; or the file system refuses.
pub fn write_new(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    begin_new(path, bytes).map(drop)
}

/// As [`write_new`], for a file that is continued: it appears with `bytes`.
///
/// # Errors
/// As [`write_new`].
pub(crate) fn begin_new(path: &Path, bytes: &[u8]) -> Result<File, DataError> {
    write_new_with(path, bytes, SHARED)
}

/// As [`write_new`], for a secret: others can neither read nor write the file.
///
/// # Errors
/// As [`write_new`].
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<(), DataError> {
    write_new_with(path, bytes, PRIVATE).map(drop)
}

/// Permissions on Unix, reduced by the user's mask.
const SHARED: u32 = 0o666;
const PRIVATE: u32 = 0o600;

fn write_new_with(path: &Path, bytes: &[u8], mode: u32) -> Result<File, DataError> {
    check_absent(path)?;
    let draft = draft_file(path, path, bytes, mode)?;
    draft.persist_noclobber(path).map_err(|error| match error.error.kind() {
        std::io::ErrorKind::AlreadyExists => ErrorKind::PathExists.at(Location::file(path)),
        _ => unwritable(path, error.error),
    })
}

/// A temporary file with this content in the folder of `target`; errors name `path`.
fn draft_file(
    path: &Path,
    target: &Path,
    bytes: &[u8],
    mode: u32,
) -> Result<NamedTempFile, DataError> {
    let failed = |error| unwritable(path, error);
    let prefix = format!("{DRAFT_PREFIX}output-");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(DRAFT_SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = mode;
    remove_abandoned(folder_of(target));
    let mut draft = loop {
        let draft = builder.tempfile_in(folder_of(target)).map_err(failed)?;
        if is_claimed(draft.path(), Some(draft.as_file())) {
            break draft;
        }
    };
    draft.write_all(bytes).map_err(failed)?;
    draft.as_file().sync_all().map_err(failed)?;
    Ok(draft)
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
    // Permissions do not tell whether a file system accepts a file.
    let trial =
        tempfile::Builder::new().prefix(DRAFT_PREFIX).suffix(DRAFT_SUFFIX).tempfile_in(folder);
    trial.map_err(|error| unwritable(path, error))?;
    Ok(target)
}

/// Start of the name of every temporary file and folder.
const DRAFT_PREFIX: &str = ".magpie-";
/// End of the name of every temporary file and folder.
const DRAFT_SUFFIX: &str = ".partial";

/// A temporary folder next to its target, renamed to it when complete and deleted otherwise.
///
/// Its writer holds a lock on it, which ends with the process: the next writer at this place deletes what a killed process
/// has left.
pub struct StagingDir {
    folder: TempDir,
    _lock: Option<File>,
}

impl StagingDir {
    /// A folder next to `target`; `purpose` is part of its name.
    ///
    /// # Errors
    /// The parent folder cannot be written.
    pub fn new(target: &Path, purpose: &str) -> Result<Self, DataError> {
        let parent = folder_of(target);
        let prefix = format!("{DRAFT_PREFIX}{purpose}-");
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(DRAFT_SUFFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o777));
        }
        let failed = |error| unwritable(target, error);
        std::fs::create_dir_all(parent).map_err(failed)?;
        remove_abandoned(parent);
        loop {
            let folder = builder.tempdir_in(parent).map_err(failed)?;
            let lock = File::open(folder.path()).ok();
            if is_claimed(folder.path(), lock.as_ref()) {
                return Ok(Self { folder, _lock: lock });
            }
        }
    }

    /// Path of the temporary folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Renames the folder to `target`, where nothing or an empty folder may be.
    ///
    /// # Errors
    /// Another process has written `target` in the meantime, or the file system refuses; the temporary folder is deleted.
    pub fn commit(self, target: &Path) -> Result<(), DataError> {
        // Replaces nothing but an empty folder.
        match std::fs::rename(self.folder.path(), target) {
            Ok(()) => {
                let _ = self.folder.keep();
                Ok(())
            }
            Err(error) => {
                check_vacant(target)?;
                Err(unwritable(target, error))
            }
        }
    }
}

/// Locks a new draft; false if another process takes it for abandoned, before there was a lock. Where the file system has
/// no locks, nothing is ever taken for abandoned.
fn is_claimed(path: &Path, file: Option<&File>) -> bool {
    match file.map(File::try_lock) {
        Some(Err(TryLockError::WouldBlock)) => false,
        _ => path.exists(),
    }
}

/// Whether this is the name of a temporary file or folder.
pub(crate) fn is_draft(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| name.starts_with(DRAFT_PREFIX) && name.ends_with(DRAFT_SUFFIX))
}

/// Deletes the drafts in `folder` whose writer has died: a process that lives holds its lock.
pub(crate) fn remove_abandoned(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        let Ok(kind) = entry.file_type() else { continue };
        if !is_draft(&path) || !(kind.is_dir() || kind.is_file()) {
            continue;
        }
        let Ok(file) = File::open(&path) else { continue };
        if file.try_lock().is_err() {
            continue;
        }
        // The output does not depend on it.
        let _ = if kind.is_dir() {
            std::fs::remove_dir_all(&path)
        } else {
            std::fs::remove_file(&path)
        };
    }
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

/// Folder of a file.
pub(crate) fn folder_of(path: &Path) -> &Path {
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
        File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok()
            && start[signature.offset..] == *signature.text.as_bytes()
    };
    metadata.is_file() && (metadata.len() == 0 || has_signature())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn loser_of_two_writers_changes_nothing() {
        let folder = TempDir::new().unwrap();
        let target = folder.path().join("campaign");
        let [first, second] = ["first", "second"].map(|text| {
            let draft = StagingDir::new(&target, "test").unwrap();
            fs::write(draft.path().join("file"), text).unwrap();
            draft
        });
        assert_eq!(names(folder.path()).len(), 2);
        first.commit(&target).unwrap();
        let message = second.commit(&target).unwrap_err().to_string();
        assert!(message.contains("refusing to overwrite"), "{message}");
        assert_eq!(names(folder.path()), ["campaign"]);
        assert_eq!(fs::read_to_string(target.join("file")).unwrap(), "first");
        let path = folder.path().join("truth");
        write_new(&path, b"first").unwrap();
        let message = write_new(&path, b"second").unwrap_err().to_string();
        assert!(message.contains("refusing to overwrite"), "{message}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        assert_eq!(names(folder.path()), ["campaign", "truth"]);
    }

    #[test]
    fn campaign_is_read_without_the_recordings_of_killed_and_present_writers() {
        let folder = TempDir::new().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["1", ".magpie-record-dead.partial"] {
            fs::create_dir(path(name)).unwrap();
            fs::write(path(name).join("hall.csv"), "").unwrap();
        }
        let live = StagingDir::new(&path("2"), "record").unwrap();
        fs::write(live.path().join("hall.csv"), "").unwrap();
        assert_eq!(crate::campaign::recording_folders(folder.path()).unwrap(), [path("1")]);
        assert!(live.path().exists());
        drop(live);
        assert_eq!(names(folder.path()), ["1"]);
    }

    #[test]
    fn abandoned_drafts_are_deleted_and_others_stay() {
        let folder = TempDir::new().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir_all(path(".magpie-test-dead.partial/1")).unwrap();
        fs::write(path(".magpie-output-dead.partial"), "").unwrap();
        let others = [".magpie-settings", "data.partial", ".magpie-simulate-old"];
        for name in others {
            fs::create_dir(path(name)).unwrap();
        }
        let live = StagingDir::new(&path("campaign"), "test").unwrap();
        let draft = draft_file(&path("file"), &path("file"), b"", SHARED).unwrap();
        write_output(&path("model"), b"mark", "mark").unwrap();
        assert!(live.path().exists() && draft.path().exists());
        drop((live, draft));
        let mut expected: Vec<&str> = others.into_iter().chain(["model"]).collect();
        expected.sort_unstable();
        assert_eq!(names(folder.path()), expected);
    }
}
