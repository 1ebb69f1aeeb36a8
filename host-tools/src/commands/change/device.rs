//! The fall of the error through the device's own code, on a recording that no fit has seen.

use std::path::{Path, PathBuf};

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::campaign::Prepared;
use model_export::fit::folds::Split;
use model_export::fit::joint::JointFit;
use model_export::inverse::build::{BuildError, Variant, build_model};
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use serde::Serialize;

use crate::commands::replay::replay_all;
use crate::commands::replay::report::rmse_n;
use crate::replay::Models;

/// Root mean square errors over all forces of all sensors in newtons.
#[derive(Clone, Debug, Serialize)]
pub struct Device {
    /// Of the model before.
    pub before_rmse_n: f64,
    /// Of the model after, its effects undone on the device.
    pub after_rmse_n: f64,
    /// Name of the recording.
    pub recording: String,
    /// Whether both models were fitted without it.
    pub held_out: bool,
    /// Effects that the device leaves as they are, each with the reason.
    pub left: Vec<String>,
}

/// What a fit is of.
pub struct Fitted<'a> {
    /// The effects.
    pub effects: &'a [Addition],
    /// The fit.
    pub fit: &'a JointFit,
}

/// Replays the last recording by both models: fitted without it where recordings were left out in
/// turn. `None` with a base that has no inverse, and where an effect cannot be undone on the device:
/// then the reason is added to `notices`.
pub fn judge(
    campaign: &Campaign,
    prepared: &Prepared,
    provenance: &Provenance,
    alignment: Alignment,
    [before, after]: [Fitted; 2],
    notices: &mut Vec<String>,
) -> Result<Option<Device>> {
    let (Some(last), true) = (campaign.recordings.last(), prepared.design.is_some()) else {
        return Ok(None);
    };
    let run = |fitted: &Fitted| -> Result<(f64, Vec<String>)> {
        let fit = match fitted.fit.split {
            Split::Recordings(count) => fitted.fit.without(count - 1),
            Split::Sixths | Split::Comb => fitted.fit.clone(),
        };
        let model =
            ModelFile::with_effects(campaign, prepared, &fit, fitted.effects, provenance.clone());
        replayed(model, &last.folder, alignment)
    };
    let both = run(&before).and_then(|before| Ok((before, run(&after)?)));
    let ((before_rmse_n, _), (after_rmse_n, left)) = match both {
        Ok(both) => both,
        Err(error) => match error.downcast_ref::<BuildError>() {
            Some(BuildError::NotUndone(why)) => {
                notices.push(why.to_string());
                return Ok(None);
            }
            _ => return Err(error),
        },
    };
    Ok(Some(Device {
        before_rmse_n,
        after_rmse_n,
        recording: last.name.clone(),
        held_out: matches!(after.fit.split, Split::Recordings(_)),
        left,
    }))
}

fn replayed(model: ModelFile, folder: &Path, alignment: Alignment) -> Result<(f64, Vec<String>)> {
    let bytes = toml::to_string(&model)?;
    let built = build_model(
        model,
        Path::new("the new model"),
        bytes.as_bytes(),
        Variant::Fitted,
    )?;
    let models = Models::of(&built);
    let replays = replay_all(&[PathBuf::from(folder)], models, alignment)?;
    let left = built
        .left
        .iter()
        .map(|(effect, why)| format!("{effect} is not undone: {why}"));
    Ok((rmse_n(&replays), left.collect()))
}
