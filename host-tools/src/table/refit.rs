//! The physics fitted anew to what is learned from, so that the held-out recording stays unseen.

use std::path::Path;

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::inverse::build::{Built, Variant as Inverted, build_model};
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::Campaign;

use super::data::Data;
use super::variant::Behind;

/// Resamples behind the error bars: nothing here reads them.
const DRAWS: usize = 20;

/// What stands for the model in messages.
const PLACE: &str = "the model fitted anew";

/// The physics of each kind, built for the device.
pub struct Refitted {
    /// The nominal design.
    nominal: Built,
    /// The ideal model, fitted.
    fitted: Built,
    /// With the effects, where there are any that can be fitted here.
    with_effects: Option<Built>,
    /// Names of these effects.
    pub effects: Vec<String>,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Refitted {
    /// The physics of a kind.
    pub fn behind(&self, behind: Behind) -> Option<&Built> {
        match behind {
            Behind::Nominal => Some(&self.nominal),
            Behind::Fitted => Some(&self.fitted),
            Behind::Effects => self.with_effects.as_ref(),
        }
    }
}

/// Fits everything to the first `seconds`.
pub fn refit(data: &Data, seconds: f64) -> Result<Refitted> {
    let campaign = first(data, seconds);
    let prepared = Prepared::cylinder(&campaign)?;
    let options = Options {
        seed: data.seed,
        draws: DRAWS,
    };
    let provenance = Provenance::of(&campaign, data.alignment.delay_us, options)?;
    let model = |effects: &[Addition]| -> Result<ModelFile> {
        let fit = prepared.fit(effects, prepared.split(effects), options, |_| ())?;
        let provenance = provenance.clone();
        Ok(ModelFile::with_effects(
            &campaign, &prepared, &fit, effects, provenance,
        ))
    };
    let ideal = model(&[])?;
    let mut notes: Vec<String> = prepared.notices.iter().map(ToString::to_string).collect();
    let with_effects = match data.effects.is_empty() {
        true => None,
        false => match model(&data.effects).and_then(|model| built(model, Inverted::Fitted)) {
            Ok(built) => Some(built),
            Err(error) => {
                notes.push(format!(
                    "with {seconds:.0} s the physics with effects is left out: {error:#}"
                ));
                None
            }
        },
    };
    let undone = with_effects.iter().flat_map(|built| &built.left);
    notes.extend(undone.map(|(effect, why)| format!("{effect} is not undone: {why}")));
    Ok(Refitted {
        nominal: built(ideal.clone(), Inverted::Nominal)?,
        fitted: built(ideal, Inverted::Fitted)?,
        effects: with_effects
            .as_ref()
            .map_or_else(Vec::new, |built| built.header.effects.clone()),
        with_effects,
        notes,
    })
}

fn built(model: ModelFile, inverted: Inverted) -> Result<Built> {
    let bytes = toml::to_string(&model)?;
    Ok(build_model(
        model,
        Path::new(PLACE),
        bytes.as_bytes(),
        inverted,
    )?)
}

/// The first `seconds` of all recordings that are learned from.
fn first(data: &Data, seconds: f64) -> Campaign {
    let shares = data.shares_s(seconds).into_iter();
    let recordings = data.campaign.recordings.iter().zip(shares);
    Campaign {
        folder: data.campaign.folder.clone(),
        recordings: recordings
            .map(|(recording, share)| match share < recording.span_s() {
                true => recording.first(share),
                false => recording.clone(),
            })
            .collect(),
    }
}
