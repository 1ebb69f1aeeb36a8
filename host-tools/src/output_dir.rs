//! Output directories: written completely or not at all, never over existing data.

use std::path::Path;

use anyhow::{Context, Result, bail};
use tempfile::TempDir;

/// A temporary directory next to `target`, to be renamed to it when complete.
pub fn staging_dir(target: &Path, prefix: &str) -> Result<TempDir> {
    let parent = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o777));
    }
    std::fs::create_dir_all(parent)
        .and_then(|()| builder.tempdir_in(parent))
        .with_context(|| format!("{} cannot be written", target.display()))
}

/// Fails unless `target` does not exist or is an empty directory.
pub fn check_vacant(target: &Path) -> Result<()> {
    if target.symlink_metadata().is_err() {
        return Ok(());
    }
    match std::fs::read_dir(target).map(|mut entries| entries.next()) {
        Ok(None) => Ok(()),
        Err(error) if target.is_dir() => {
            Err(error).with_context(|| format!("{} cannot be read", target.display()))
        }
        Ok(Some(_)) | Err(_) => refuse_existing(target),
    }
}

/// The error for an existing output path.
pub fn refuse_existing(path: &Path) -> Result<()> {
    bail!("{}: output path exists; refusing to overwrite", path.display())
}
