//! From a model file to the device's tables.

use std::path::Path;

use sha2::{Digest, Sha256};

use super::at_rest::AtRest;
use super::compensation::{NotUndone, OwnedCompensation};
use super::quantise::Overflow;
use super::search::{Chosen, choose};
use crate::effects::{Addition, Effect, Undone};
use crate::model_file::ModelFile;
use crate::physics::ForwardModel;
use crate::recordings::campaign::hex;
use crate::recordings::problem::Fault;
use crate::recordings::{Place, Problem};

/// What is inverted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// The fitted parameters of each sensor.
    Fitted,
    /// The nominal design alone, the same for each sensor: the paper's ideal model.
    Nominal,
}

/// A model that cannot be inverted.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum BuildError {
    #[error(transparent)]
    File(#[from] Problem),
    #[error(
        "{place}: a polynomial of the forces has no unique inverse here; the device needs a model with the cylinder base (`magpie fit CAMPAIGN -o model.toml`)"
    )]
    Polynomial { place: Place },
    #[error(transparent)]
    NotUndone(#[from] NotUndone),
    #[error("{place}: the tables cannot be built: {overflow}")]
    Overflow {
        place: Place,
        overflow: Box<Overflow>,
    },
}

/// What the file of tables says in its head beyond the tables themselves.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// SHA-256 of the model file that the tables come from.
    pub inputs_sha256: String,
    /// What was inverted: the fitted model, or the nominal design alone.
    pub variant: &'static str,
    /// Name of the campaign.
    pub campaign: String,
    /// Dates of the recordings, where they state any.
    pub recorded: Vec<String>,
    /// Names of the model's effects.
    pub effects: Vec<String>,
    /// Numbers of the sensors, in the order of the tables.
    pub sensors: Vec<u32>,
}

/// Everything that the device needs of a model.
pub struct Built {
    /// The model.
    pub model: ModelFile,
    /// The ideal model of every sensor.
    pub chosen: Chosen,
    /// What is undone around it.
    pub compensations: Vec<OwnedCompensation>,
    /// Effects of the model that the device leaves as they are, each with the reason.
    pub left: Vec<(String, &'static str)>,
    /// For the file of tables.
    pub header: Header,
}

/// Reads the model at `path` and builds the tables of all its sensors.
pub fn build(path: &Path, variant: Variant) -> Result<Built, BuildError> {
    let model = ModelFile::read(path)?;
    let bytes =
        std::fs::read(path).map_err(|error| Fault::Unreadable(error).at(Place::file(path)))?;
    build_model(model, path, &bytes, variant)
}

/// Builds the tables of a model in memory; `place` stands for it in messages, `bytes` identify it.
pub fn build_model(
    model: ModelFile,
    place: &Path,
    bytes: &[u8],
    variant: Variant,
) -> Result<Built, BuildError> {
    let recordings = model.provenance.recordings.len();
    let additions = match variant {
        Variant::Fitted => model.additions(place)?,
        Variant::Nominal => Vec::new(),
    };
    let nominal = model.design.as_ref().map(ForwardModel::nominal);
    let scale = model.sensor_scale;
    let numbers: Vec<u32> = model.sensors.iter().map(|sensor| sensor.number).collect();
    let (mut at_rest, mut compensations) = (Vec::new(), Vec::new());
    for &number in &numbers {
        let forward = match variant {
            Variant::Fitted => model.forward(number),
            Variant::Nominal => nominal,
        };
        let forward = forward.ok_or_else(|| BuildError::Polynomial {
            place: Place::file(place),
        })?;
        let effects = values(&model, &additions, number, recordings, place)?;
        let rest = AtRest::new(forward, &effects, recordings);
        compensations.extend(OwnedCompensation::build(
            number,
            &rest,
            &effects,
            scale.gauss_per_lsb,
        )?);
        at_rest.push(rest);
    }
    let digest = Sha256::digest(bytes);
    let id = u16::from_be_bytes([digest[0], digest[1]]);
    let mut chosen = choose(
        &at_rest,
        &numbers,
        id,
        scale.gauss_per_lsb,
        scale.range_gauss,
    )
    .map_err(|overflow| BuildError::Overflow {
        place: Place::file(place),
        overflow: Box::new(overflow),
    })?;
    let surfaces = chosen.surfaces.iter().zip(&numbers);
    for (table, (surface, &number)) in chosen.tables.sensors.iter_mut().zip(surfaces) {
        let spread_g = model.spread_beside(number, surface.axis);
        table.parity = surface
            .table(number, spread_g, scale.gauss_per_lsb)
            .map_err(|overflow| BuildError::Overflow {
                place: Place::file(place),
                overflow: Box::new(overflow),
            })?;
    }
    let header = Header {
        inputs_sha256: hex(&digest),
        variant: match variant {
            Variant::Fitted => "fitted parameters",
            Variant::Nominal => "nominal design",
        },
        campaign: model.provenance.campaign.clone(),
        recorded: model
            .provenance
            .recordings
            .iter()
            .filter_map(|r| r.recorded.clone())
            .collect(),
        effects: additions
            .iter()
            .map(|effect| effect.name().to_owned())
            .collect(),
        sensors: numbers,
    };
    let left = additions.iter().filter_map(|effect| match effect {
        Addition::Catalogue(Effect {
            undone: Undone::Never(why),
            id,
            ..
        }) => Some(((*id).to_owned(), *why)),
        _ => None,
    });
    Ok(Built {
        left: left.collect(),
        model,
        chosen,
        compensations,
        header,
    })
}

/// Each effect with its values at one sensor.
fn values(
    model: &ModelFile,
    additions: &[Addition],
    number: u32,
    recordings: usize,
    place: &Path,
) -> Result<Vec<(Addition, Vec<f64>)>, BuildError> {
    let pairs = additions.iter().filter_map(|effect| {
        let entry = model
            .effects
            .iter()
            .find(|entry| entry.name == effect.name())?;
        Some((effect, entry))
    });
    pairs
        .map(
            |(effect, entry)| match entry.values(effect, number, recordings) {
                Some(values) => Ok((effect.clone(), values)),
                None => {
                    let found = format!("{} of sensor {number}", entry.name);
                    let advice = "a parameter is missing: add the effect again".to_owned();
                    Err(Fault::BadValue { found, advice }
                        .at(Place::file(place).column("effect"))
                        .into())
                }
            },
        )
        .collect()
}
