//! From a model file to the device's tables.

use std::path::Path;

use firmware::config::constants;
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::effects::{DeviceForm, Effect, EffectTerm, ErrorOrigin};
use crate::error::ErrorKind;
use crate::fit::rows::ForcePair;
use crate::input;
use crate::inverse::compensation::{NotCompensable, OwnedCompensation, board_conditions};
use crate::inverse::model_selection::{SelectedModels, select_models};
use crate::inverse::quantise::TableOverflow;
use crate::inverse::static_model::{StaticBase, StaticModel};
use crate::model_file::{ModelFile, SensorModel, SensorScale};
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
        "{place}: a polynomial of the forces has no nominal design; add [design] to every recording.toml of the campaign (gap, stiffnesses, magnet: `cargo magpie import --help` shows one) and fit again without --base"
    )]
    NoNominalDesign { place: Location },
    #[error("{place}: {why}")]
    NotInvertible { place: Location, why: Box<NotInvertible> },
    #[error(transparent)]
    NotCompensable(#[from] NotCompensable),
    #[error("{place}: the tables cannot be built: {overflow}")]
    TableOverflow { place: Location, overflow: Box<TableOverflow> },
    #[error(
        "{place}: a count of its sensors is {} G and their range ±{} G, those of the gripper's firmware have {} G and ±{} G: all forces would be wrong; state gauss_per_lsb and range_gauss of the gripper's sensors in every recording.toml, and fit again",
        model.0, model.1, board.0, board.1
    )]
    OtherSensors { place: Location, model: (f64, f64), board: (f64, f64) },
}

/// A model without an inverse from field to forces.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum NotInvertible {
    #[error(
        "the polynomial of sensor {sensor} has {forces} forces, and the device estimates at most one along each of x and z; record a force on each sensor, without further columns, and fit again"
    )]
    ForceCount { sensor: u32, forces: usize },
    #[error(
        "the field of sensor {sensor} does not determine the force in the fitted range, {range}: {} and {} give nearly the same field; record a range in which the field only rises or only falls, use another --degree, or remove the columns of this sensor",
        loads[0],
        loads[1]
    )]
    Ambiguous { sensor: u32, range: String, loads: [String; 2] },
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
    /// Lateral and longitudinal force that each of them was fitted to; `None` where it was not measured.
    pub forces: Vec<ForcePair>,
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

/// Parameters to which the forces are proportional, or nearly so.
const GAINS: [&str; 3] = ["stiffness_x", "stiffness_z", "remanence"];

impl DeviceModel {
    /// Checks that the counts and the range of the model are those of the sensors of the firmware.
    ///
    /// # Errors
    /// They are others; `place` is the path of the model.
    pub fn check_sensors(&self, place: &Path) -> Result<(), BuildError> {
        let SensorScale { gauss_per_lsb, range_gauss, .. } = self.model.sensor_scale;
        let board = (constants::SENSOR_SCALE.value, constants::SENSOR_RANGE.value);
        let is_equal = |own: f64, other: f64| (own / other - 1.0).abs() < 1e-6;
        if is_equal(gauss_per_lsb, board.0) && is_equal(range_gauss, board.1) {
            return Ok(());
        }
        let model = (gauss_per_lsb, range_gauss);
        Err(BuildError::OtherSensors { place: Location::file(place), model, board })
    }

    /// The identifiable gain of the fit that differs most from the model's own design: sensor, parameter, and the ratio to the
    /// design; `None` for polynomials.
    pub fn largest_deviation(&self) -> Option<(u32, &'static str, f64)> {
        let design = self.model.design.as_ref()?;
        let nominal = |name: &str| match name {
            "stiffness_x" => design.stiffness_x_n_per_mm,
            "stiffness_z" => design.stiffness_z_n_per_mm,
            _ => design.magnet.remanence_t,
        };
        let of_sensor = |sensor: &SensorModel| {
            let fitted = |name: &&'static str| {
                let own = sensor.parameters.get(*name).filter(|own| own.identifiable)?;
                Some((sensor.number, *name, own.value / nominal(name)))
            };
            GAINS.iter().filter_map(fitted).collect::<Vec<_>>()
        };
        let size = |ratio: f64| ratio.abs().ln().abs();
        let all = self.model.sensors.iter().flat_map(of_sensor);
        all.max_by(|a, b| size(a.2).total_cmp(&size(b.2)))
    }
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
        let effects = effect_values(&model, &additions, number, recordings, place)?;
        let rest = static_model(&model, &effects, number, variant, place)?;
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
        forces: model.sensors.iter().map(SensorModel::force_pair).collect(),
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

/// The model of one sensor with these effects that the tables invert.
pub(super) fn static_model(
    model: &ModelFile,
    effects: &[(EffectTerm, Vec<f64>)],
    number: u32,
    variant: ModelVariant,
    place: &Path,
) -> Result<StaticModel, BuildError> {
    let base = static_base(model, number, variant, place)?;
    let recordings = model.provenance.recordings.len();
    let rest = StaticModel::new(base, effects, recordings, model.table_state(number));
    check_inverse(&rest, number, place)?;
    Ok(rest)
}

fn static_base(
    model: &ModelFile,
    number: u32,
    variant: ModelVariant,
    place: &Path,
) -> Result<StaticBase, BuildError> {
    let forward = match variant {
        ModelVariant::Fitted => model.forward(number),
        ModelVariant::Nominal => model.nominal(number),
    };
    if let Some(forward) = forward {
        return Ok(forward.into());
    }
    let place = Location::file(place);
    if variant == ModelVariant::Nominal {
        return Err(BuildError::NoNominalDesign { place });
    }
    let sensor = model.sensors.iter().find(|sensor| sensor.number == number);
    let forces = sensor.map_or(0, |sensor| sensor.forces().len());
    let why = Box::new(NotInvertible::ForceCount { sensor: number, forces });
    let polynomial = model.force_polynomial(number);
    polynomial.map(StaticBase::from).ok_or(BuildError::NotInvertible { place, why })
}

/// Refuses a field that does not determine the forces.
fn check_inverse(model: &StaticModel, sensor: u32, place: &Path) -> Result<(), BuildError> {
    let Some(loads) = model.ambiguous_loads() else {
        return Ok(());
    };
    let region = model.region();
    let joined = |text: &dyn Fn(usize) -> String| {
        region.inputs().map(text).collect::<Vec<_>>().join(" and ")
    };
    let name = |axis: usize| ["Fx", "Fz"][axis];
    let range = joined(&|axis| {
        let (centre, half) = (region.centre_n[axis], region.half_n[axis]);
        format!("{} {:.3} to {:.3} N", name(axis), centre - half, centre + half)
    });
    let loads = loads.map(|load| joined(&|axis| format!("{} {:.3} N", name(axis), load[axis])));
    let why = Box::new(NotInvertible::Ambiguous { sensor, range, loads });
    Err(BuildError::NotInvertible { place: Location::file(place), why })
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
