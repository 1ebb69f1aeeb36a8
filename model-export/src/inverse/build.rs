//! From a model file to the device's tables.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::effects::{DeviceForm, Effect, EffectTerm, ErrorOrigin};
use crate::input;
use crate::inverse::compensation::{NotCompensable, OwnedCompensation, board_conditions};
use crate::inverse::model_selection::{SelectedModels, select_models};
use crate::inverse::quantise::TableOverflow;
use crate::inverse::static_model::StaticModel;
use crate::model_file::ModelFile;
use crate::recordings::error::ErrorKind;
use crate::recordings::recording::hex;
use crate::recordings::{DataError, Location};

/// Parameters of the forward model to invert.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelVariant {
    /// The fitted parameters of each sensor.
    Fitted,
    /// The nominal design, the same for each sensor: the paper's ideal model.
    Nominal,
}

/// A model that cannot be inverted.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum BuildError {
    #[error(transparent)]
    File(#[from] DataError),
    #[error(
        "{place}: a polynomial of the forces has no unique inverse, so a board cannot run it; add [design] to every recording.toml of the campaign (gap, stiffnesses, magnet: `cargo magpie import --help` shows one) and fit again without --base"
    )]
    Polynomial { place: Location },
    #[error(transparent)]
    NotCompensable(#[from] NotCompensable),
    #[error("{place}: the tables cannot be built: {overflow}")]
    TableOverflow { place: Location, overflow: Box<TableOverflow> },
}

/// Header of the generated file of tables.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportHeader {
    /// SHA-256 of the model file.
    pub inputs_sha256: String,
    /// Inverted parameters: fitted or nominal.
    pub variant: &'static str,
    /// Name of the campaign.
    pub campaign: String,
    /// Dates of the recordings where stated.
    pub recorded: Vec<String>,
    /// Names of the model's effects.
    pub effects: Vec<String>,
    /// Where effects change the gripper permanently: those effects, and the time of the state that the tables hold.
    pub valid_from: Option<String>,
    /// Numbers of the sensors, in the order of the tables.
    pub sensors: Vec<u32>,
}

/// All tables of a model for the device.
pub struct DeviceModel {
    /// The model.
    pub model: ModelFile,
    /// Inverse models of all sensors.
    pub chosen: SelectedModels,
    /// Compensations around the inverse.
    pub compensations: Vec<OwnedCompensation>,
    /// Effects of the gripper that the device never compensates, each with the reason.
    pub uncompensated: Vec<(String, &'static str)>,
    /// Effects that need covariates, each with the conditions under which the board compensates it.
    pub conditions: Vec<(String, Vec<&'static str>)>,
    /// Header of the file of tables.
    pub header: ExportHeader,
}

/// Reads the model at `path` and builds the tables of all sensors.
pub fn build(path: &Path, variant: ModelVariant) -> Result<DeviceModel, BuildError> {
    let model = ModelFile::read(path)?;
    let bytes = input::read_bytes(path, input::MAX_DOCUMENT_BYTES)?;
    build_model(model, path, &bytes, variant)
}

/// Builds the tables of a model in memory; `place` is its path for messages, `bytes` its content for the hash.
/// The shape of the inverse is selected unless the model has one that the device can represent.
pub fn build_model(
    model: ModelFile,
    place: &Path,
    bytes: &[u8],
    variant: ModelVariant,
) -> Result<DeviceModel, BuildError> {
    let recordings = model.provenance.recordings.len();
    let additions = match variant {
        ModelVariant::Fitted => model.effect_terms(place)?,
        ModelVariant::Nominal => Vec::new(),
    };
    let scale = model.sensor_scale;
    let numbers: Vec<u32> = model.sensors.iter().map(|sensor| sensor.number).collect();
    let (mut static_models, mut compensations) = (Vec::new(), Vec::new());
    for &number in &numbers {
        let forward = match variant {
            ModelVariant::Fitted => model.forward(number),
            ModelVariant::Nominal => model.nominal(number),
        };
        let forward =
            forward.ok_or_else(|| BuildError::Polynomial { place: Location::file(place) })?;
        let effects = effect_values(&model, &additions, number, recordings, place)?;
        let rest = StaticModel::new(forward, &effects, recordings, model.table_state(number));
        compensations.extend(OwnedCompensation::build(
            number,
            &rest,
            &effects,
            scale.gauss_per_lsb,
        )?);
        static_models.push(rest);
    }
    let digest = Sha256::digest(bytes);
    let id = u16::from_be_bytes([digest[0], digest[1]]);
    // Both variants of a model file have tables of their own.
    let id = match variant {
        ModelVariant::Fitted => id,
        ModelVariant::Nominal => !id,
    };
    // The shape of the file is that of the fitted parameters.
    let shape = model.inverse.filter(|_| variant == ModelVariant::Fitted);
    let mut chosen =
        select_models(&static_models, &numbers, id, scale.gauss_per_lsb, scale.range_gauss, shape)
            .map_err(|overflow| BuildError::TableOverflow {
                place: Location::file(place),
                overflow: Box::new(overflow),
            })?;
    let surfaces = chosen.surfaces.iter().zip(&numbers);
    for (table, (surface, &number)) in chosen.tables.sensors.iter_mut().zip(surfaces) {
        let spread_g = model.residual_sigma(number, surface.axis);
        table.parity =
            surface.table(number, spread_g, scale.gauss_per_lsb).map_err(|overflow| {
                BuildError::TableOverflow {
                    place: Location::file(place),
                    overflow: Box::new(overflow),
                }
            })?;
        if let Some(mounting) = model.mounting(number) {
            table.axes = mounting.orientation.axis_map();
        }
        if variant == ModelVariant::Nominal {
            // The residual of a gripper that was not calibrated is unknown: it must not be taken for a magnet.
            table.parity.sigma = 0;
        }
    }
    let valid_from = valid_from(&model, &additions);
    let header = ExportHeader {
        valid_from,
        inputs_sha256: hex(&digest),
        variant: match variant {
            ModelVariant::Fitted => "fitted parameters",
            ModelVariant::Nominal => "nominal design",
        },
        campaign: model.provenance.campaign.clone(),
        recorded: model.provenance.recordings.iter().filter_map(|r| r.recorded.clone()).collect(),
        effects: additions.iter().map(|effect| effect.name().to_owned()).collect(),
        sensors: numbers,
    };
    let uncompensated = additions.iter().filter_map(|effect| match effect {
        EffectTerm::Catalogue(Effect { device: DeviceForm::Never(why), id, .. }) => {
            Some(((*id).to_owned(), *why))
        }
        _ => None,
    });
    let conditions = additions.iter().filter_map(|effect| {
        let is_on_device = match effect {
            EffectTerm::Catalogue(known) => {
                matches!(known.device, DeviceForm::Field(_) | DeviceForm::Force(_))
            }
            EffectTerm::Expression(_) => true,
        };
        let conditions = board_conditions(&effect.needs());
        (is_on_device && !conditions.is_empty()).then(|| (effect.name().to_owned(), conditions))
    });
    Ok(DeviceModel {
        uncompensated: uncompensated.collect(),
        conditions: conditions.collect(),
        model,
        chosen,
        compensations,
        header,
    })
}

/// "softening, as at the end of recording 3 (2026-03-02)".
fn valid_from(model: &ModelFile, effects: &[EffectTerm]) -> Option<String> {
    let lasting = effects.iter().filter(|of| of.error_origin() == ErrorOrigin::History);
    let names: Vec<&str> = lasting.map(EffectTerm::name).collect();
    let last = model.provenance.recordings.last().filter(|_| !names.is_empty())?;
    let date = last.recorded.as_ref().map_or_else(String::new, |date| format!(" ({date})"));
    Some(format!("{}, as at the end of recording {}{date}", names.join(", "), last.name))
}

/// Effects with their values at one sensor.
pub(super) fn effect_values(
    model: &ModelFile,
    additions: &[EffectTerm],
    number: u32,
    recordings: usize,
    place: &Path,
) -> Result<Vec<(EffectTerm, Vec<f64>)>, BuildError> {
    let pairs = additions.iter().filter_map(|effect| {
        let entry = model.effects.iter().find(|entry| entry.name == effect.name())?;
        Some((effect, entry))
    });
    pairs
        .map(|(effect, entry)| match entry.values(effect, number, recordings) {
            Some(values) => Ok((effect.clone(), values)),
            None => {
                let found = format!("{} of sensor {number}", entry.name);
                let advice = "a parameter is missing: add the effect again".to_owned();
                Err(ErrorKind::BadValue { found, advice }
                    .at(Location::file(place).column("effect"))
                    .into())
            }
        })
        .collect()
}
