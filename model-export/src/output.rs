//! Files that the tool writes: complete or not at all, and never over somebody else's.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use crate::recordings::problem::Fault;
use crate::recordings::{Place, Problem};

/// What tells the tool's files from others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mark<'a> {
    /// Bytes before it: some formats begin with a length.
    pub after: usize,
    /// The mark itself.
    pub text: &'a str,
}

impl<'a> From<&'a str> for Mark<'a> {
    /// At the very start.
    fn from(text: &'a str) -> Self {
        Self { after: 0, text }
    }
}

/// Writes `bytes` to a new file beside `path` and renames it. What stands at `path` is replaced only
/// if it is empty or begins with `mark`, as everything does that the tool has written there before; a
/// link is followed.
///
/// # Errors
/// Something else stands there, or the file system refuses.
pub fn write_output<'a>(
    path: &Path,
    bytes: &[u8],
    mark: impl Into<Mark<'a>>,
) -> Result<(), Problem> {
    let target = check_output(path, mark)?;
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
    draft
        .persist(&target)
        .map_err(|error| failed(error.error))?;
    Ok(())
}

/// Whether [`write_output`] may write there, to be asked before long work; the file that it means.
pub fn check_output<'a>(path: &Path, mark: impl Into<Mark<'a>>) -> Result<PathBuf, Problem> {
    let target = match path.symlink_metadata() {
        Ok(_) => path
            .canonicalize()
            .map_err(|error| unwritable(path, error))?,
        Err(_) => path.to_path_buf(),
    };
    if target.exists() && !is_ours(&target, mark.into()) {
        return Err(Fault::Occupied.at(Place::file(path)));
    }
    let folder = folder_of(&target);
    if !folder.exists() {
        return Err(Fault::NoSuchFolder.at(Place::file(folder)));
    }
    folder.metadata().map_err(|error| unwritable(path, error))?;
    Ok(target)
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn unwritable(path: &Path, error: std::io::Error) -> Problem {
    // The kind alone: the draft's name would only confuse.
    Fault::Unwritable(std::io::Error::from(error.kind())).at(Place::file(path))
}

/// An empty file, or one that begins with the mark.
fn is_ours(path: &Path, mark: Mark) -> bool {
    let Ok(metadata) = path.metadata() else {
        return false;
    };
    let mut start = vec![0; mark.after + mark.text.len()];
    let mut marked = || {
        std::fs::File::open(path)
            .and_then(|mut file| file.read_exact(&mut start))
            .is_ok()
            && start[mark.after..] == *mark.text.as_bytes()
    };
    metadata.is_file() && (metadata.len() == 0 || marked())
}
