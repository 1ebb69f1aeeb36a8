//! `model.toml`: a fitted model in a form that people read, with where it comes from.
//!
//! The device never sees this file. Values are stored beside their error
//! bars and the nominal design they depart from.

mod effects;
mod predictor;
mod provenance;
mod sensor;

use std::path::Path;

use firmware::params::FORCE_RANGE;
use serde::{Deserialize, Serialize};

use crate::effects::Addition;
use crate::fit::Fits;
use crate::fit::campaign::Prepared;
use crate::fit::joint::{JointFit, SensorFit};
use crate::fit::parameters::{self, PARAMETERS};
use crate::output::write_output;
use crate::physics::ForwardModel;
use crate::quantity::rounded;
use crate::recordings::description::{Design, parse_toml};
use crate::recordings::problem::Fault;
use crate::recordings::{Campaign, Place, Problem};

pub use effects::{EffectModel, EffectOfSensor};
pub use predictor::{Predicted, Predictor};
pub use provenance::{Fitted, Provenance, SensorScale};
pub use sensor::{Held, HeldOut, PolynomialTable, SensorModel, Value};

/// Version of the file.
pub const FORMAT: i64 = 1;

/// First line of every model file.
pub const MARK: &str = "# A magpie model, written by `magpie fit`.";

/// A fitted model of one gripper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFile {
    /// Version, [`FORMAT`].
    pub format: i64,
    /// What the field is computed from.
    pub base: Base,
    /// Where the numbers come from.
    pub provenance: Provenance,
    /// Scale and range of the sensors.
    pub sensor_scale: SensorScale,
    /// The nominal design; absent with the polynomial base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<Design>,
    /// One entry for each sensor.
    #[serde(rename = "sensor")]
    pub sensors: Vec<SensorModel>,
    /// Effects beside the base.
    #[serde(default, rename = "effect", skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<EffectModel>,
}

/// What the field is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Base {
    /// Exact cylinder magnet on two flexures.
    Cylinder,
    /// Polynomial of the forces.
    Polynomial,
}

impl ModelFile {
    /// Force that each axis is designed for, either way, in newtons; MAGPIE's where no design is told.
    pub fn force_range_n(&self) -> f64 {
        let design = self.design.as_ref();
        design.map_or(FORCE_RANGE.value, Design::force_range_n)
    }

    /// The file of a fit of the base alone.
    pub fn of(campaign: &Campaign, fits: &Fits, provenance: Provenance) -> Self {
        let (base, design, sensors) = match fits {
            Fits::Cylinder(design, fit) => (
                Base::Cylinder,
                Some(design.clone()),
                fit.sensors
                    .iter()
                    .map(|fit| SensorModel::of_cylinder(fit, &fit.values))
                    .collect(),
            ),
            Fits::Polynomial(fits) => (
                Base::Polynomial,
                None,
                fits.iter().map(SensorModel::of_polynomial).collect(),
            ),
        };
        Self {
            format: FORMAT,
            base,
            provenance,
            sensor_scale: SensorScale::of(campaign),
            design,
            sensors,
            effects: Vec::new(),
        }
    }

    /// The file of a fit with effects.
    pub fn with_effects(
        campaign: &Campaign,
        prepared: &Prepared,
        fit: &JointFit,
        effects: &[Addition],
        provenance: Provenance,
    ) -> Self {
        let sensor = |(i, fit): (usize, &SensorFit)| match prepared.polynomials.get(i) {
            None => SensorModel::of_cylinder(fit, &fit.values),
            Some(start) => SensorModel::of_polynomial_with_effects(start, fit),
        };
        Self {
            format: FORMAT,
            base: if prepared.design.is_some() {
                Base::Cylinder
            } else {
                Base::Polynomial
            },
            provenance,
            sensor_scale: SensorScale::of(campaign),
            design: prepared.design.clone(),
            sensors: fit.sensors.iter().enumerate().map(sensor).collect(),
            effects: EffectModel::all_of(fit, effects, campaign.recordings.len()),
        }
    }

    /// Degree of the polynomials; `None` with the cylinder base.
    pub fn degree(&self) -> Option<usize> {
        Some(self.sensors.first()?.polynomial.as_ref()?.degree)
    }

    /// Whether any sensor's polynomial takes a lateral and a longitudinal force; `None` with the
    /// cylinder base. Effects beside a polynomial need to know.
    pub fn force_axes(&self) -> Option<[bool; 2]> {
        let forces = self.sensors.iter().filter_map(|s| s.polynomial.as_ref());
        let forces: Vec<&String> = forces.flat_map(|table| &table.forces).collect();
        let any = |end: &str| forces.iter().any(|name| name.ends_with(end));
        (self.base == Base::Polynomial).then(|| [any("_x_n"), any("_z_n")])
    }

    /// The effects, each checked.
    pub fn additions(&self, path: &Path) -> Result<Vec<Addition>, Problem> {
        let axes = self.force_axes();
        let addition = |effect: &EffectModel| {
            effect.addition(axes).map_err(|advice| {
                let found = effect.name.clone();
                Fault::BadValue { found, advice }.at(Place::file(path).column("effect"))
            })
        };
        self.effects.iter().map(addition).collect()
    }

    /// Reads and checks a model file.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        if path.is_dir() {
            return Err(Fault::NoModel.at(Place::file(path)));
        }
        let text = std::fs::read_to_string(path)
            .map_err(|error| Fault::Unreadable(error).at(Place::file(path)))?;
        let looks_like =
            |table: &toml::Table| table.contains_key("base") && table.contains_key("sensor");
        if text
            .parse::<toml::Table>()
            .is_ok_and(|table| !looks_like(&table))
        {
            return Err(Fault::ForeignModel.at(Place::file(path)));
        }
        let model: Self = parse_toml(path, &text)?;
        if model.format != FORMAT {
            let advice = format!("this tool reads format = {FORMAT}: fit the model again");
            let found = model.format.to_string();
            return Err(Fault::BadValue { found, advice }.at(Place::file(path).column("format")));
        }
        model.check(path)?;
        Ok(model)
    }

    fn check(&self, path: &Path) -> Result<(), Problem> {
        let place = |key: String| Place::file(path).column(key);
        let bad = |key: String, found: String, advice: &str| {
            let advice = advice.to_owned();
            Err(Fault::BadValue { found, advice }.at(place(key)))
        };
        if self.base == Base::Cylinder && self.design.is_none() {
            let example = "the [design] table of the recordings";
            return Err(Fault::MissingKey { example }.at(place("design".to_owned())));
        }
        let scale = [
            (
                "sensor_scale.gauss_per_lsb",
                self.sensor_scale.gauss_per_lsb,
            ),
            ("sensor_scale.range_gauss", self.sensor_scale.range_gauss),
        ];
        let design = self.design.as_ref().map_or_else(Vec::new, Design::sizes);
        for (key, value) in scale.into_iter().chain(design) {
            if !(value.is_finite() && value > 0.0) {
                return bad(
                    key.to_owned(),
                    value.to_string(),
                    "give a number above zero, or fit again",
                );
            }
        }
        for (i, sensor) in self.sensors.iter().enumerate() {
            let key = |name: &str| format!("{name} of sensor {}", sensor.number);
            if self
                .sensors
                .iter()
                .take(i)
                .any(|other| other.number == sensor.number)
            {
                return bad(
                    key("number"),
                    sensor.number.to_string(),
                    "it stands twice: number the sensors as in the recordings",
                );
            }
            if self.base == Base::Polynomial {
                if sensor.polynomial().is_none() {
                    return bad(
                        key("polynomial"),
                        "a table that does not fit its degree".to_owned(),
                        "fit again",
                    );
                }
                continue;
            }
            for parameter in &PARAMETERS {
                let Some(value) = sensor
                    .parameters
                    .get(parameter.name)
                    .map(|value| value.value)
                else {
                    let example = "it as a fit writes it, or fit again";
                    return Err(Fault::MissingKey { example }.at(place(key(parameter.name))));
                };
                let above_zero = parameter.name == "gap" || parameter.name.starts_with("stiffness");
                let nothing = parameter.name == "remanence" && value == 0.0;
                if !value.is_finite() || (above_zero && value <= 0.0) || nothing {
                    return bad(
                        key(parameter.name),
                        value.to_string(),
                        "correct it, or fit again",
                    );
                }
            }
        }
        Ok(())
    }

    /// Writes the file; see [`write_output`].
    pub fn write(&self, path: &Path) -> Result<(), Problem> {
        let text = toml::to_string(self)
            .map(|text| format!("{MARK}\n{text}"))
            .map_err(|error| Fault::Toml(error.to_string()).at(Place::file(path)))?;
        write_output(path, text.as_bytes(), MARK)
    }

    /// What a fit leaves of a sensor's field that no forces explain, in gauss: where the file does not
    /// say, what it leaves of that axis.
    pub fn spread_beside(&self, number: u32, axis: usize) -> f64 {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number);
        let of_axis = |sensor: &SensorModel| sensor.held_out.get(axis).map(|score| score.rms_g);
        let found = sensor.and_then(|sensor| sensor.beside_forces_g.or_else(|| of_axis(sensor)));
        found.filter(|spread| spread.is_finite()).unwrap_or(0.0)
    }

    /// The forward model of one sensor; `None` for a polynomial or an unknown sensor.
    pub fn forward(&self, number: u32) -> Option<ForwardModel> {
        let nominal = ForwardModel::nominal(self.design.as_ref()?);
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let mut values = parameters::values(&nominal);
        for (value, parameter) in values.iter_mut().zip(&PARAMETERS) {
            *value = sensor.parameters.get(parameter.name)?.value;
        }
        Some(parameters::with_values(&nominal, &values))
    }
}

/// Ten digits are far below any error bar, and the last bits, in which two kinds of processor may
/// differ, do not reach the file.
fn digits(value: f64) -> f64 {
    rounded(value, 10)
}
