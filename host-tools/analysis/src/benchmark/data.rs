//! Training data, the held-out recording, and the physics fitted to the training data alone.

use crate::benchmark::variants::PhysicsLevel;
use crate::compare::campaign_reader::{check_sensor_scale, held_out_index, read_campaign};
use crate::notes::{Note, UncompensatedEffect};
use anyhow::{Result, bail};
use firmware::config::constants;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::inverse::build::{DeviceModel, ModelVariant as Inverted, build_model};
use model_export::model_file::{BaseKind, ModelFile, Provenance};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::NominalDesign;
use model_export::recordings::recording::fingerprint;
use model_export::recordings::recording::recording_name;
use model_export::recordings::{Campaign, Recording};
use std::path::{Path, PathBuf};

/// Prefix of the description of simulated recordings.
const SIMULATED: &str = "simulated";

/// A campaign with one recording held out.
pub struct BenchmarkData {
    /// Training recordings, on the reference's clock.
    pub campaign: Campaign,
    /// Folder of the held-out recording.
    pub held_out: PathBuf,
    /// Alignment of the clocks.
    pub alignment: Alignment,
    /// Effects of the model.
    pub effects: Vec<EffectTerm>,
    /// Whether a recording is simulated.
    pub simulated: bool,
    /// Seed of networks and fits.
    pub seed: u64,
    /// Whether a learning curve is requested.
    pub curve: bool,
    /// Notes on the model's effects.
    pub notes: Vec<Note>,
}

impl BenchmarkData {
    /// Nominal range of each force in newtons; MAGPIE's where no recording states it.
    pub fn force_range_n(&self) -> f64 {
        let recordings = self.campaign.recordings.iter();
        let mut designs = recordings.filter_map(|recording| recording.description.design.as_ref());
        designs.next().map_or(constants::FORCE_RANGE.value, NominalDesign::force_range_n)
    }

    /// Reads the campaign. Only the effects of the model are used; all parameters are fitted again.
    ///
    /// # Errors
    /// A file cannot be read, the model has a polynomial base, or a training recording is a copy of the
    /// held-out one.
    pub fn read(
        model_path: &Path,
        folder: &Path,
        hold_out: Option<usize>,
        alignment: Alignment,
        seed: u64,
        curve: bool,
    ) -> Result<Self> {
        let model = ModelFile::read(model_path)?;
        if model.base == BaseKind::Polynomial {
            bail!(
                "{}: the benchmark requires the ideal model; use a model with the cylinder base",
                model_path.display()
            );
        }
        let folders = recording_folders(folder)?;
        let place = held_out_index(folder, folders.len(), hold_out)?;
        let mut campaign = read_campaign(folder, alignment)?;
        let held_out = folders[place].clone();
        refuse_copies(&campaign, &held_out)?;
        for recording in &campaign.recordings {
            check_sensor_scale(&recording.folder, &recording.description, &model)?;
        }
        let simulated =
            campaign.recordings.iter().any(|r| r.description.description.starts_with(SIMULATED));
        campaign.recordings.retain(|recording| recording.folder != held_out);
        let effects = model.effect_terms(model_path)?;
        let notes = notes(&model, &effects, &held_out)?;
        Ok(Self { campaign, held_out, alignment, effects, simulated, seed, curve, notes })
    }

    /// Duration of the training data in seconds.
    pub fn training_s(&self) -> f64 {
        self.campaign.duration_s()
    }

    /// Names of the training recordings.
    pub fn names(&self) -> Vec<String> {
        let recordings = &self.campaign.recordings;
        recordings.iter().map(|r| r.name.clone()).collect()
    }

    /// Name of the held-out recording.
    pub fn held_out_name(&self) -> String {
        recording_name(&self.held_out)
    }

    /// Duration of each recording within the first `seconds` of the training data; without empty ones.
    pub fn shares_s(&self, seconds: f64) -> Vec<f64> {
        let mut left = seconds;
        let share = |recording: &Recording| {
            let share = recording.span_s().min(left);
            left -= share;
            share
        };
        let shares = self.campaign.recordings.iter().map(share);
        shares.filter(|share| *share > 0.0).collect()
    }
}

/// Refuses a training recording that is a copy of the held-out one.
fn refuse_copies(campaign: &Campaign, held_out: &Path) -> Result<()> {
    let held_out_sha256 = fingerprint(held_out)?;
    for recording in &campaign.recordings {
        if recording.folder != held_out && fingerprint(&recording.folder)? == held_out_sha256 {
            bail!(
                "{}: recordings {} and {} are the same data; remove one, otherwise the error is not held out",
                campaign.folder.display(),
                recording.name,
                recording_name(held_out)
            );
        }
    }
    Ok(())
}

fn notes(model: &ModelFile, effects: &[EffectTerm], held_out: &Path) -> Result<Vec<Note>> {
    let mut notes = Vec::new();
    if effects.is_empty() {
        notes.push(Note::NoEffects);
        return Ok(notes);
    }
    let held_out_sha256 = fingerprint(held_out)?;
    if model.provenance.recordings.iter().any(|r| r.sha256 == held_out_sha256) {
        notes.push(Note::EffectsNotHeldOut { recording: recording_name(held_out) });
    }
    Ok(notes)
}

/// Bootstrap resamples; the standard errors are not used here.
const DRAWS: usize = 20;

/// Name of the model in messages.
const MODEL_NAME: &str = "the refitted model";

/// Every physics model, built for the device.
pub struct FittedPhysics {
    /// Nominal design.
    nominal: DeviceModel,
    /// Fitted ideal model.
    fitted: DeviceModel,
    /// Model with effects, where it has any and they can be fitted.
    with_effects: Option<DeviceModel>,
    /// Names of the effects.
    pub effects: Vec<String>,
    /// Notes on the recordings and on the effects.
    pub notes: Vec<Note>,
}

impl FittedPhysics {
    /// The physics of a level; `None` where it could not be fitted.
    pub fn at(&self, level: PhysicsLevel) -> Option<&DeviceModel> {
        match level {
            PhysicsLevel::Nominal => Some(&self.nominal),
            PhysicsLevel::Fitted => Some(&self.fitted),
            PhysicsLevel::Effects => self.with_effects.as_ref(),
        }
    }
}

/// Fits every physics model to the first `seconds` of the training data.
///
/// # Errors
/// The ideal model cannot be fitted.
pub fn refit(data: &BenchmarkData, seconds: f64) -> Result<FittedPhysics> {
    let campaign = first(data, seconds);
    let prepared = FitSetup::cylinder(&campaign)?;
    let options = FitOptions { seed: data.seed, draws: DRAWS };
    let provenance = Provenance::of(&campaign, data.alignment.delay_us, options)?;
    let model = |effects: &[EffectTerm]| -> Result<ModelFile> {
        let fit = prepared.fit(effects, prepared.split(effects), options, |_| ())?;
        let provenance = provenance.clone();
        Ok(ModelFile::with_effects(&campaign, &prepared, &fit, effects, provenance))
    };
    let ideal = model(&[])?;
    let mut notes: Vec<Note> = prepared.notices.iter().cloned().map(Note::Recording).collect();
    let with_effects = if data.effects.is_empty() {
        None
    } else {
        match model(&data.effects).and_then(|model| built(model, Inverted::Fitted)) {
            Ok(built) => Some(built),
            Err(error) => {
                notes.push(Note::EffectsLeftOut {
                    training_s: seconds,
                    error: format!("{error:#}"),
                });
                None
            }
        }
    };
    let uncompensated = with_effects.iter().flat_map(UncompensatedEffect::of);
    notes.extend(uncompensated.map(Note::Uncompensated));
    Ok(FittedPhysics {
        nominal: built(ideal.clone(), Inverted::Nominal)?,
        fitted: built(ideal, Inverted::Fitted)?,
        effects: with_effects.as_ref().map_or_else(Vec::new, |built| built.header.effects.clone()),
        with_effects,
        notes,
    })
}

fn built(model: ModelFile, inverted: Inverted) -> Result<DeviceModel> {
    let bytes = toml::to_string(&model)?;
    Ok(build_model(model, Path::new(MODEL_NAME), bytes.as_bytes(), inverted)?)
}

/// The first `seconds` of the training recordings.
fn first(data: &BenchmarkData, seconds: f64) -> Campaign {
    let shares = data.shares_s(seconds).into_iter();
    let recordings = data.campaign.recordings.iter().zip(shares);
    Campaign {
        folder: data.campaign.folder.clone(),
        recordings: recordings
            .map(|(recording, share)| {
                if share < recording.span_s() { recording.first(share) } else { recording.clone() }
            })
            .collect(),
    }
}
