//! Notes: remarks on a result, as data. The result is valid; the crate `report` writes their text.

use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::inverse::build::{DeviceModel, NotInvertible};
use model_export::inverse::compensation::NotCompensable;
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;
use model_export::recordings::{Campaign, Notice};
use serde::Serialize;

use crate::data_quality::finding::Finding;

/// A remark on the input of a result, or on what was left out of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Note {
    /// Notice of the reader or of the fit on a recording.
    Recording(Notice),
    /// Setup error in the recordings that does not prevent a fit.
    SetupError(Box<Finding>),
    /// Recordings are read with another delay of the reference than that of the model file.
    OtherDelay {
        model: PathBuf,
        /// Delay of the fit in milliseconds.
        fitted_ms: f64,
        /// Delay with which they are read in milliseconds.
        delay_ms: f64,
    },
    /// The design of a replayed recording differs from that of the model.
    OtherDesign { recording: PathBuf },
    /// The model was fitted to other recordings than those to which its effects are fitted again.
    OtherRecordings {
        /// Campaign of the model.
        campaign: String,
    },
    /// The model's prediction differs from most channels by a constant, as that of another gripper.
    OtherGripper {
        /// Median over the channels of the difference, in multiples of the noise floor.
        floors: f64,
    },
    /// A sensor of the model whose field or forces were not recorded has no replay.
    NotReplayed { sensor: u32 },
    /// Every estimate of a sensor is invalid: the errors are without it.
    NoValidEstimate { sensor: u32 },
    /// A sensor of the model whose field or forces were not recorded is not compared.
    NotRecorded { sensor: u32 },
    /// A recorded sensor that the model does not have is not compared.
    NotInModel { sensor: u32 },
    /// A sensor of the model whose field or forces were not recorded gets no network.
    NoNetwork { sensor: u32 },
    /// An effect of the model that the device does not compensate.
    Uncompensated(UncompensatedEffect),
    /// The parameters of an effect are outside of the device's formats, so the device code was not evaluated.
    NotCompensable(NotCompensable),
    /// The device code was not evaluated, for this reason.
    NoForces(MissingForces),
    /// Estimates without the compensation of an effect, because its covariate was not recorded.
    MissingInputs {
        estimates: u64,
        /// Names of all effects of the model.
        effects: Vec<String>,
    },
    /// No recording has a column of an effect, so the prediction is without the effect.
    EffectWithoutColumn { effect: String, column: String },
    /// A covariate of an effect is constant, so the effect is not identifiable.
    ConstantCovariate {
        column: String,
        effect: String,
        /// What to record instead; `None` for a formula.
        record: Option<&'static str>,
    },
    /// The ideal model was fitted to the held-out recording of a training too.
    IdealModelNotHeldOut { recording: String },
}

impl Note {
    /// That recordings are read with another delay than that of a model, if they are.
    pub fn other_delay(path: &Path, model: &ModelFile, alignment: Alignment) -> Option<Self> {
        let (fitted_ms, delay_ms) = (model.provenance.delay_ms, alignment.delay_us / 1e3);
        let model = path.to_path_buf();
        (fitted_ms != delay_ms).then_some(Self::OtherDelay { model, fitted_ms, delay_ms })
    }

    /// That a model was fitted to none of the recordings with these hashes, to which it is fitted again.
    pub fn other_recordings<'a>(
        model: &ModelFile,
        mut hashes: impl Iterator<Item = &'a str>,
    ) -> Option<Self> {
        let fitted = &model.provenance.recordings;
        let is_known = hashes.any(|hash| fitted.iter().any(|own| own.sha256 == hash));
        (!is_known).then(|| Self::OtherRecordings { campaign: model.provenance.campaign.clone() })
    }

    /// That the design of a campaign, by which a model is fitted again, differs from the model's, if it does.
    pub fn other_design(campaign: &Campaign, model: &ModelFile) -> Option<Self> {
        let is_other = model.design.is_some() && campaign.design() != model.design.as_ref();
        is_other.then(|| Self::OtherDesign { recording: campaign.folder.clone() })
    }
}

/// Why forces are missing.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum MissingForces {
    /// The field does not determine the forces.
    NotInvertible(NotInvertible),
    /// The device cannot compensate an effect, for this reason.
    NotCompensable(NotCompensable),
    /// The device's tables cannot represent them.
    NotRepresentable(String),
    /// No row has both a valid estimate and the reference forces.
    NoValidRow,
}

/// An effect of a model that the device does not compensate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UncompensatedEffect {
    pub effect: String,
    /// Reason, from the catalogue.
    pub reason: &'static str,
}

/// Refuses a model with an effect that the device never compensates.
///
/// # Errors
/// There is one; the error has the reason and this remedy.
pub fn check_compensated(built: &DeviceModel, remedy: &str) -> Result<()> {
    let Some((effect, why)) = built.uncompensated.first() else {
        return Ok(());
    };
    bail!("the device never compensates {effect}: {why}. Its error stays in the forces: {remedy}")
}

impl UncompensatedEffect {
    /// The uncompensated effects of a model.
    pub fn of(model: &DeviceModel) -> impl Iterator<Item = Self> {
        let effects = model.uncompensated.iter();
        effects.map(|(effect, reason)| Self { effect: effect.clone(), reason })
    }
}

/// Error of an analysis with the notes made before it, which may explain it. Displayed as the error alone.
#[derive(Debug)]
pub struct ErrorWithNotes {
    pub notes: Vec<Note>,
    pub error: anyhow::Error,
}

impl fmt::Display for ErrorWithNotes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)
    }
}

impl Error for ErrorWithNotes {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.error.source()
    }
}

/// Runs an analysis that adds notes to a list. If it fails, its error is an [`ErrorWithNotes`].
pub(crate) fn collect<T>(analysis: impl FnOnce(&mut Vec<Note>) -> Result<T>) -> Result<T> {
    let mut notes = Vec::new();
    analysis(&mut notes).map_err(|error| ErrorWithNotes { notes, error }.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::{Context, bail};

    fn note() -> Note {
        Note::IdealModelNotHeldOut { recording: "3".to_owned() }
    }

    #[test]
    fn error_keeps_its_text_and_the_notes_before_it() {
        let failing = |notes: &mut Vec<Note>| -> Result<()> {
            notes.push(note());
            let cause: Result<()> = (|| bail!("cause"))();
            cause.context("context")
        };
        let error = collect(failing).unwrap_err();
        assert_eq!(format!("{error:#}"), "context: cause");
        let with_notes = error.downcast_ref::<ErrorWithNotes>().unwrap();
        assert_eq!(with_notes.notes, [note()]);
    }
}
