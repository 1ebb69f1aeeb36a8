//! From a model file to the device's tables.

use std::path::Path;

use sha2::{Digest, Sha256};

use super::emit::Header;
use super::quantise::Overflow;
use super::search::{Chosen, choose};
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
    #[error("{place}: the tables cannot be built: {overflow}")]
    Overflow {
        place: Place,
        overflow: Box<Overflow>,
    },
}

/// Reads the model at `path` and builds the tables of all its sensors.
pub fn build(path: &Path, variant: Variant) -> Result<(ModelFile, Chosen, Header), BuildError> {
    let model = ModelFile::read(path)?;
    let bytes =
        std::fs::read(path).map_err(|error| Fault::Unreadable(error).at(Place::file(path)))?;
    let place = || Place::file(path);
    let nominal = model.design.as_ref().map(ForwardModel::nominal);
    let forward: Vec<ForwardModel> = model
        .sensors
        .iter()
        .map(|sensor| match variant {
            Variant::Fitted => model.forward(sensor.number),
            Variant::Nominal => nominal,
        })
        .collect::<Option<_>>()
        .ok_or_else(|| BuildError::Polynomial { place: place() })?;
    let digest = Sha256::digest(&bytes);
    let id = u16::from_be_bytes([digest[0], digest[1]]);
    let scale = model.sensor_scale;
    let numbers: Vec<u32> = model.sensors.iter().map(|sensor| sensor.number).collect();
    let chosen = choose(
        &forward,
        &numbers,
        id,
        scale.gauss_per_lsb,
        scale.range_gauss,
    )
    .map_err(|overflow| BuildError::Overflow {
        place: place(),
        overflow: Box::new(overflow),
    })?;
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
        sensors: numbers,
    };
    Ok((model, chosen, header))
}
