//! Files that the tool writes: complete or not at all, and never over somebody else's.

use std::io::{Read, Write};
use std::path::Path;

use crate::recordings::problem::Fault;
use crate::recordings::{Place, Problem};

/// Writes `bytes` to a new file beside `path` and renames it. What stands at `path` is replaced only
/// if it begins with `mark`, as everything does that the tool has written there before; a link is
/// followed.
///
/// # Errors
/// Something else stands there, or the file system refuses.
pub fn write_output(path: &Path, bytes: &[u8], mark: &str) -> Result<(), Problem> {
    let failed = |error: std::io::Error| {
        // The kind alone: the draft's name would only confuse.
        Fault::Unwritable(std::io::Error::from(error.kind())).at(Place::file(path))
    };
    let target = match path.symlink_metadata() {
        Ok(_) => path.canonicalize().map_err(failed)?,
        Err(_) => path.to_path_buf(),
    };
    if target.exists() && !begins_with(&target, mark) {
        let found = "a file that magpie has not written".to_owned();
        let advice = "choose another name: it is not overwritten".to_owned();
        return Err(Fault::BadValue { found, advice }.at(Place::file(path)));
    }
    let folder = match target.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut draft = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        draft.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut draft = draft.tempfile_in(folder).map_err(failed)?;
    draft.write_all(bytes).map_err(failed)?;
    draft.as_file().sync_all().map_err(failed)?;
    draft
        .persist(&target)
        .map_err(|error| failed(error.error))?;
    Ok(())
}

fn begins_with(path: &Path, mark: &str) -> bool {
    let is_file = path.metadata().is_ok_and(|metadata| metadata.is_file());
    let mut start = vec![0; mark.len()];
    is_file
        && std::fs::File::open(path)
            .and_then(|mut file| file.read_exact(&mut start))
            .is_ok()
        && start == mark.as_bytes()
}
