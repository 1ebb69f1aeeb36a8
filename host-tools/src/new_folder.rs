//! Folders that commands make: complete or not at all, and never over somebody else's.

use std::path::Path;

use anyhow::{Context, Result, bail};
use tempfile::TempDir;

/// A folder beside `target` that is given its name when it is complete; `prefix` is how it is called until
/// then.
pub fn draft(target: &Path, prefix: &str) -> Result<TempDir> {
    let parent = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut draft = tempfile::Builder::new();
    draft.prefix(prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        draft.permissions(std::fs::Permissions::from_mode(0o777));
    }
    std::fs::create_dir_all(parent)
        .and_then(|()| draft.tempdir_in(parent))
        .with_context(|| format!("{} cannot be written", target.display()))
}

/// Refuses a file, and a folder that is not empty.
pub fn check_free(target: &Path) -> Result<()> {
    if target.symlink_metadata().is_err() {
        return Ok(());
    }
    let first = std::fs::read_dir(target).map(|mut entries| entries.next());
    match first {
        Ok(None) => Ok(()),
        Err(error) if target.is_dir() => {
            Err(error).with_context(|| format!("{} cannot be read", target.display()))
        }
        Ok(Some(_)) | Err(_) => occupied(target),
    }
}

/// Says that something stands there.
pub fn occupied(path: &Path) -> Result<()> {
    bail!(
        "{}: something else stands there; choose another name: it is not overwritten",
        path.display()
    )
}
