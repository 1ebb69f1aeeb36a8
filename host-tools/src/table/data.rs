//! What is learned from, and what is judged.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use firmware::params;
use model_export::effects::Addition;
use model_export::model_file::{Base, ModelFile};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, name_of, recording_folders};
use model_export::recordings::description::Design;

use crate::commands::fit::read_campaign;
use crate::commands::replay::same_scale;
use crate::commands::train::campaign::held_out;

/// How the bench's recordings describe themselves.
const SIMULATED: &str = "simulated";

/// A campaign of which one recording is put aside.
pub struct Data {
    /// What is learned from, on the reference's clock.
    pub campaign: Campaign,
    /// The recording that is judged.
    pub held_out: PathBuf,
    /// How the clocks belong together.
    pub alignment: Alignment,
    /// The model's effects.
    pub effects: Vec<Addition>,
    /// Whether a recording says that it is simulated.
    pub simulated: bool,
    /// Seed of networks and fits.
    pub seed: u64,
    /// Whether shorter trainings are wanted beside that on everything.
    pub curve: bool,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Data {
    /// Force that each axis is designed for, either way, in newtons; MAGPIE's where no recording tells it.
    pub fn force_range_n(&self) -> f64 {
        let recordings = self.campaign.recordings.iter();
        let mut designs = recordings.filter_map(|recording| recording.description.design.as_ref());
        designs
            .next()
            .map_or(params::FORCE_RANGE.value, Design::force_range_n)
    }

    /// Reads the campaign; of the model only its effects are taken, everything is fitted anew.
    pub fn read(
        model_path: &Path,
        folder: &Path,
        hold_out: Option<usize>,
        alignment: Alignment,
        seed: u64,
        curve: bool,
    ) -> Result<Self> {
        let model = ModelFile::read(model_path)?;
        if model.base == Base::Polynomial {
            bail!(
                "{}: the table begins with the ideal model, which a polynomial has not; give a model with the cylinder base",
                model_path.display()
            );
        }
        let folders = recording_folders(folder)?;
        let place = held_out(folder, folders.len(), hold_out)?;
        let mut campaign = read_campaign(folder, alignment)?;
        let held_out = folders[place].clone();
        refuse_copies(&campaign, &held_out)?;
        for recording in &campaign.recordings {
            same_scale(&recording.folder, &recording.description, &model)?;
        }
        let simulated = campaign
            .recordings
            .iter()
            .any(|r| r.description.description.starts_with(SIMULATED));
        campaign
            .recordings
            .retain(|recording| recording.folder != held_out);
        let effects = model.additions(model_path)?;
        let notes = notes(&model, &effects, &held_out)?;
        Ok(Self {
            campaign,
            held_out,
            alignment,
            effects,
            simulated,
            seed,
            curve,
            notes,
        })
    }

    /// Seconds that can be learned from.
    pub fn training_s(&self) -> f64 {
        self.campaign.duration_s()
    }

    /// Names of the recordings that are learned from.
    pub fn names(&self) -> Vec<String> {
        let recordings = &self.campaign.recordings;
        recordings.iter().map(|r| r.name.clone()).collect()
    }

    /// Name of the one that is not.
    pub fn held_out_name(&self) -> String {
        name_of(&self.held_out)
    }

    /// Seconds of each recording that the first `seconds` of all hold; those with none are left out.
    pub fn shares_s(&self, seconds: f64) -> Vec<f64> {
        let mut left = seconds;
        let share = |recording: &model_export::recordings::recording::Recording| {
            let share = recording.span_s().min(left);
            left -= share;
            share
        };
        let shares = self.campaign.recordings.iter().map(share);
        shares.filter(|share| *share > 0.0).collect()
    }
}

/// A recording that is learned from and judged as well would not be held out.
fn refuse_copies(campaign: &Campaign, held_out: &Path) -> Result<()> {
    let judged = fingerprint(held_out)?;
    for recording in &campaign.recordings {
        if recording.folder != held_out && fingerprint(&recording.folder)? == judged {
            bail!(
                "{}: recordings {} and {} are the same data; remove one, or the held-out error would not be held out",
                campaign.folder.display(),
                recording.name,
                name_of(held_out)
            );
        }
    }
    Ok(())
}

fn notes(model: &ModelFile, effects: &[Addition], held_out: &Path) -> Result<Vec<String>> {
    let mut notes = Vec::new();
    if effects.is_empty() {
        notes.push(
            "the model has no effects, so the rows of physics with effects are left out: `magpie diagnose` names what is missing, `magpie add` adds it"
                .to_owned(),
        );
        return Ok(notes);
    }
    let judged = fingerprint(held_out)?;
    if model
        .provenance
        .recordings
        .iter()
        .any(|r| r.sha256 == judged)
    {
        notes.push(format!(
            "the model was fitted to recording {} as well: its values are fitted anew without it, but which effects it has may have been chosen with it",
            name_of(held_out)
        ));
    }
    Ok(notes)
}
