//! Writes a corrected copy of a campaign: unambiguous corrections only.
//!
//! - `table`: correction of one table, row by row.
//! - `description`: note of the corrections in `recording.toml`.

mod description;
pub mod repair;
mod table;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::RECORDING_FILE;

use crate::data_quality::Finding;
use crate::data_quality::fix::repair::{Change, Repair};

/// Writes the campaign to the new folder `to` with every correction that carries a
/// [`Fix`](repair::Fix); everything else is copied byte for byte. On failure no folder is
/// left behind. Returns one sentence for each correction.
pub fn write(campaign: &Path, findings: &[Finding], to: &Path) -> Result<Vec<String>> {
    if to.exists() {
        bail!("{}: output path exists; refusing to overwrite", to.display());
    }
    let repairs: Vec<&Repair> = findings
        .iter()
        .filter_map(|finding| finding.fix.as_ref())
        .flat_map(|fix| &fix.repairs)
        .collect();
    if repairs.is_empty() {
        bail!("no finding has an unambiguous correction, so nothing is written");
    }
    let folders = recording_folders(campaign)?;
    let parent = match to.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let unwritable = || format!("{}: cannot be written", to.display());
    fs::create_dir_all(parent).with_context(unwritable)?;
    let draft = tempfile::Builder::new()
        .prefix(".magpie-fix-")
        .tempdir_in(parent)
        .with_context(unwritable)?;
    let mut said = Vec::new();
    for folder in &folders {
        let inside = folder.strip_prefix(campaign).unwrap_or(Path::new(""));
        let target = draft.path().join(inside);
        fs::create_dir_all(&target).with_context(unwritable)?;
        said.extend(recording(folder, &target, &repairs)?);
    }
    if folders.iter().all(|folder| folder != campaign) {
        copy_files(campaign, draft.path())?;
    }
    open_to_others(draft.path()).with_context(unwritable)?;
    // Renaming would replace an empty folder created in the meantime.
    fs::rename(draft.path(), to).with_context(unwritable)?;
    Ok(said)
}

/// Writes one recording; returns its corrections.
fn recording(folder: &Path, target: &Path, repairs: &[&Repair]) -> Result<Vec<String>> {
    let mut said = Vec::new();
    for path in files_of(folder)? {
        let name = path.file_name().unwrap_or_default();
        let changes: Vec<&Change> = repairs
            .iter()
            .filter(|repair| repair.file == path)
            .map(|repair| &repair.change)
            .collect();
        if changes.is_empty() {
            fs::copy(&path, target.join(name)).with_context(|| format!("{}", path.display()))?;
            continue;
        }
        let done = table::rewrite(&path, &target.join(name), &changes)
            .with_context(|| format!("{}", path.display()))?;
        let name = name.to_string_lossy();
        said.extend(done.into_iter().map(|done| format!("{name}: {done}")));
    }
    if !said.is_empty() && folder.join(RECORDING_FILE).is_file() {
        description::extend(&target.join(RECORDING_FILE), &said)?;
    }
    let recording =
        folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    Ok(said.into_iter().map(|done| format!("recording {recording}, {done}")).collect())
}

fn copy_files(from: &Path, to: &Path) -> Result<()> {
    for path in files_of(from)? {
        let name = path.file_name().unwrap_or_default();
        fs::copy(&path, to.join(name)).with_context(|| format!("{}", path.display()))?;
    }
    Ok(())
}

/// Regular files of a folder, sorted by name.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("{}", folder.display()))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    Ok(files)
}

/// Temporary folders are private; the campaign gets the permissions of a normal folder.
#[cfg(unix)]
fn open_to_others(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(folder, fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn open_to_others(_: &Path) -> std::io::Result<()> {
    Ok(())
}
