//! Recordings with the estimates of the device's code as MCAP files.

use std::path::{Path, PathBuf};

use anyhow::Result;
use device_run::ReplayModels;
use device_run::mcap::write_recording;
use device_run::networks::NetworkSet;
use model_export::inverse::build::{ModelVariant, build};
use model_export::output::{StagingDir, check_vacant};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::in_order;
use model_export::recordings::recording::recording_name;
use rayon::prelude::*;

use crate::notes::Note;
use crate::progress;

/// Writes each recording of a campaign to a file in the new folder `output`, with the estimates of the model and, if given, of
/// the networks after it; returns their paths, and the note on a delay other than the model's.
///
/// # Errors
/// An input cannot be read, the networks are of another model, or the folder exists.
pub fn write_bags(
    model: &Path,
    network: Option<&Path>,
    campaign: &Path,
    output: &Path,
    delay_ms: Option<f64>,
) -> Result<(Vec<PathBuf>, Option<Note>)> {
    check_vacant(output)?;
    let folders = recording_folders(campaign)?;
    let built = build(model, ModelVariant::Fitted)?;
    let alignment = built.model.alignment(delay_ms);
    let note = Note::other_delay(model, &built.model, alignment);
    let networks = network.map(|path| NetworkSet::read(path, &built)).transpose()?;
    let models = ReplayModels { networks: networks.as_ref(), ..ReplayModels::of(&built) };
    let draft = StagingDir::new(output, "export")?;
    let bar = progress::progress_bar("writing MCAP files", folders.len());
    let file = |folder: &PathBuf| -> Result<PathBuf> {
        let name = format!("{}.mcap", recording_name(folder));
        write_recording(&models, folder, alignment, &draft.path().join(&name))?;
        bar.inc(1);
        Ok(output.join(name))
    };
    let files = in_order(folders.par_iter().map(file))?;
    bar.finish_and_clear();
    draft.commit(output)?;
    Ok((files, note))
}
