//! Calibration for an upload: tables and networks as the bytes that the device stores.

use std::collections::BTreeMap;

use firmware::checksum::CRC32;
use firmware::model::calibration::{
    CalibrationMemory, CompensationMemory, Header, MAX_DESCRIPTION_BYTES, POOL_INTEGERS, Payload,
    format,
};
use firmware::model::encoding::{Reader, encode};
use firmware::system::nv_storage::calibration::MAX_BYTES;
use serde::{Deserialize, Serialize};

use crate::gru::file::fingerprint;
use crate::gru::network::Network;
use crate::gru::pack::pack_loadable;
use crate::gru::quantise::QuantiseError;
use crate::inverse::build::DeviceModel;

/// Origin of a calibration, as a board reports it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CalibrationDescription {
    /// SHA-256 of the model file.
    pub model_sha256: String,
    /// Parameters of the model: fitted, or of the nominal design.
    #[serde(default)]
    pub variant: String,
    /// SHA-256 of the weights of the networks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network_sha256: Option<String>,
    /// Name of the campaign that the model was fitted to.
    pub campaign: String,
    /// Dates of its recordings, where stated.
    #[serde(default)]
    pub recorded: Vec<String>,
    /// Time of the upload.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uploaded: Option<String>,
    /// Names of the effects in the model.
    #[serde(default)]
    pub effects: Vec<String>,
    /// Permanent changes of the gripper, and the time of the state that the tables hold.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub valid_from: Option<String>,
    /// For each effect that needs covariates, the conditions under which the board compensates it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: BTreeMap<String, Vec<String>>,
}

impl CalibrationDescription {
    /// Description of a model and its networks.
    pub fn of(built: &DeviceModel, networks: &[Network]) -> Self {
        let header = &built.header;
        let conditions = built.conditions.iter().map(|(effect, conditions)| {
            (effect.clone(), conditions.iter().map(ToString::to_string).collect())
        });
        Self {
            model_sha256: header.inputs_sha256.clone(),
            variant: header.variant.to_owned(),
            network_sha256: (!networks.is_empty()).then(|| fingerprint(networks)),
            campaign: header.campaign.clone(),
            recorded: header.recorded.clone(),
            uploaded: None,
            effects: header.effects.clone(),
            valid_from: header.valid_from.clone(),
            conditions: conditions.collect(),
        }
    }

    /// The description as TOML.
    pub fn to_toml(&self) -> String {
        // Strings and lists of strings always have a TOML form.
        toml::to_string(self).unwrap_or_default()
    }
}

/// Why a model cannot be uploaded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum CalibrationError {
    #[error(transparent)]
    Network(#[from] QuantiseError),
    #[error(
        "the description has {0} bytes, the board has room for {MAX_DESCRIPTION_BYTES}: fit fewer recordings or effects"
    )]
    Description(usize),
    #[error(
        "{0} bytes do not fit the board's {MAX_BYTES}; write them into the image with `cargo magpie dev export` and `cargo flash-image`"
    )]
    Length(usize),
    #[error(
        "the tables of the effects do not fit the board's memory of {POOL_INTEGERS} numbers; remove formulas over two quantities, or write the tables into the image with `cargo magpie dev export` and `cargo flash-image`"
    )]
    Memory,
}

/// Encodes model and networks with a description.
///
/// # Errors
/// They do not fit the device; found by decoding them as the device does.
pub fn encode_calibration(
    built: &DeviceModel,
    networks: &[Network],
    description: &CalibrationDescription,
) -> Result<Vec<u8>, CalibrationError> {
    let description = description.to_toml();
    if description.len() > MAX_DESCRIPTION_BYTES {
        return Err(CalibrationError::Description(description.len()));
    }
    let mut payload = (description.len() as u16).to_le_bytes().to_vec();
    payload.extend_from_slice(description.as_bytes());
    let views: Vec<_> = built.compensations.iter().map(|own| own.view()).collect();
    let tables = built.chosen.tables.tables(&views);
    let start = payload.len();
    let mut append = |bytes: &[u8]| payload.extend_from_slice(bytes);
    let mut pool = vec![0; POOL_INTEGERS];
    let mut compensations = CompensationMemory::EMPTY;
    let mut memory = Box::new(CalibrationMemory::EMPTY);
    let networks = pack_loadable(networks, built.model.sensor_scale.gauss_per_lsb)?;
    let contents = Payload { tables: &tables, networks: &networks };
    encode(&contents, &mut append);
    let mut left = &payload[start..];
    let mut source = |bytes: &mut [u8]| {
        let (next, rest) = left.split_at_checked(bytes.len())?;
        bytes.copy_from_slice(next);
        left = rest;
        Some(())
    };
    let fits = memory.read(&mut Reader::new(&mut source, &mut pool), &mut compensations);
    fits.ok_or(CalibrationError::Memory)?;
    let scale = &built.model.sensor_scale;
    let header = Header { length: payload.len() as u32, crc: CRC32.checksum(&payload) };
    let format = format(scale.gauss_per_lsb, scale.range_gauss);
    let bytes = [&header.to_bytes(format)[..], &payload].concat();
    if bytes.len() > MAX_BYTES as usize {
        return Err(CalibrationError::Length(bytes.len()));
    }
    Ok(bytes)
}
