//! A campaign written anew, with what is unambiguous mended.
//!
//! - `table`: one table, row by row. `number`: a number converted as it is written.
//! - `description`: what was done, added to `recording.toml`.

mod description;
mod number;
mod table;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::FILE;

use super::repair::{Change, Repair};
use crate::compare::Finding;

/// Writes the campaign as `to`, which must not exist yet, with everything mended that carries a
/// [`Fix`](super::repair::Fix); what is not touched is copied byte for byte. All or nothing: a failure
/// leaves no folder behind. The sentences say what was done.
pub fn write(campaign: &Path, findings: &[Finding], to: &Path) -> Result<Vec<String>> {
    if to.exists() {
        bail!(
            "{}: something stands there; choose another name: it is not overwritten",
            to.display()
        );
    }
    let repairs: Vec<&Repair> = findings
        .iter()
        .filter_map(|finding| finding.fix.as_ref())
        .flat_map(|fix| &fix.repairs)
        .collect();
    if repairs.is_empty() {
        bail!("nothing that was found can be mended without doubt, so nothing is written");
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
    // A folder made meanwhile would be replaced if it is empty; nothing else would.
    fs::rename(draft.path(), to).with_context(unwritable)?;
    Ok(said)
}

/// Writes one recording; what was done to it.
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
    if !said.is_empty() && folder.join(FILE).is_file() {
        description::extend(&target.join(FILE), &said)?;
    }
    let recording = folder
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    Ok(said
        .into_iter()
        .map(|done| format!("recording {recording}, {done}"))
        .collect())
}

fn copy_files(from: &Path, to: &Path) -> Result<()> {
    for path in files_of(from)? {
        let name = path.file_name().unwrap_or_default();
        fs::copy(&path, to.join(name)).with_context(|| format!("{}", path.display()))?;
    }
    Ok(())
}

/// The plain files in a folder, in order of their names.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("{}", folder.display()))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    Ok(files)
}

/// Drafts are made for their owner alone; a campaign is for everybody whom the folder above admits.
#[cfg(unix)]
fn open_to_others(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(folder, fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn open_to_others(_: &Path) -> std::io::Result<()> {
    Ok(())
}
