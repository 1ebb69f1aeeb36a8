//! `model.toml`: a fitted model in a form that people read, with where it comes from.
//!
//! The device never sees this file. Values are stored beside their error
//! bars and the nominal design they depart from.

mod effects;
mod provenance;

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::effects::Addition;
use crate::fit::campaign::Prepared;
use crate::fit::joint::{JointFit, SensorFit};
use crate::fit::parameters::{self, PARAMETERS};
use crate::fit::polynomial::{Polynomial, PolynomialFit};
use crate::fit::{AxisScore, Fits};
use crate::output::write_output;
use crate::physics::ForwardModel;
use crate::quantity::rounded;
use crate::recordings::columns::{Axis, ForceColumn, force_column};
use crate::recordings::description::{Design, parse_toml};
use crate::recordings::problem::Fault;
use crate::recordings::{Campaign, Place, Problem};

pub use effects::{EffectModel, EffectOfSensor};
pub use provenance::{Fitted, Provenance, SensorScale};

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

/// The model of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorModel {
    /// Number of the sensor.
    pub number: u32,
    /// Held-out error beside the floor, each axis.
    pub held_out: Vec<HeldOut>,
    /// With the cylinder base: every parameter.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, Value>,
    /// With the cylinder base: combinations held at nominal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held: Vec<Held>,
    /// With the polynomial base: the polynomial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<PolynomialTable>,
}

/// Held-out error of one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// `x`, `y` or `z`.
    pub axis: String,
    /// Root mean square of measured minus modelled field on recordings kept out of the fit.
    pub rms_g: f64,
    /// The same on the recordings that were fitted.
    pub fitted_rms_g: f64,
    /// What a perfect model would leave.
    pub floor_g: f64,
    /// Peak-to-peak field in the campaign.
    pub span_g: f64,
}

/// A fitted number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// The number.
    pub value: f64,
    /// One standard deviation.
    pub std_error: f64,
    /// Unit.
    pub unit: String,
    /// Whether the data tell it, to half a manufacturing tolerance.
    pub identifiable: bool,
}

/// A combination of parameters held at nominal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Held {
    /// Shares of the parameters in it, in tolerances.
    pub shares: BTreeMap<String, f64>,
    /// How well the data alone know it, in tolerances.
    pub known_within: f64,
}

/// A polynomial of the forces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolynomialTable {
    /// Total degree.
    pub degree: usize,
    /// Columns of `force.csv` that it takes.
    pub forces: Vec<String>,
    /// Range of each force in newtons that is scaled to -1 to 1.
    pub spans_n: Vec<(f64, f64)>,
    /// Degrees of the Legendre polynomials of each term.
    pub terms: Vec<Vec<usize>>,
    /// Coefficients of each term in gauss: x, y, z.
    pub coefficients_g: Vec<[f64; 3]>,
    /// Their standard deviations in gauss.
    pub std_errors_g: Vec<[f64; 3]>,
}

impl ModelFile {
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

impl SensorModel {
    /// The entry of one sensor with these values, its error bars those of the fit.
    fn of_cylinder(fit: &SensorFit, values: &[f64]) -> Self {
        let value = |i: usize| Value {
            value: digits(values[i]),
            std_error: digits(fit.std_error(i)),
            unit: fit.slots[i].unit.clone(),
            identifiable: fit.identifiable[i],
        };
        let held = |held: &crate::fit::space::Held| Held {
            shares: held
                .shares
                .iter()
                .map(|(name, share)| (name.clone(), digits(*share)))
                .collect(),
            known_within: digits(held.known_within),
        };
        Self {
            number: fit.sensor,
            held_out: fit.scores.iter().map(HeldOut::of).collect(),
            parameters: (0..fit.base_count)
                .map(|i| (fit.slots[i].name.clone(), value(i)))
                .collect(),
            held: fit.held.iter().map(held).collect(),
            polynomial: None,
        }
    }

    fn of_polynomial_with_effects(start: &PolynomialFit, fit: &SensorFit) -> Self {
        let mut entry = Self::of_polynomial(start);
        entry.held_out = fit.scores.iter().map(HeldOut::of).collect();
        if let Some(table) = &mut entry.polynomial {
            let row = |i: usize, of: &dyn Fn(usize) -> f64| {
                [0, 1, 2].map(|axis| digits(of(3 * i + axis)))
            };
            let terms = table.terms.len();
            table.coefficients_g = (0..terms)
                .map(|i| row(i, &|slot| fit.values[slot]))
                .collect();
            table.std_errors_g = (0..terms)
                .map(|i| row(i, &|slot| fit.std_error(slot)))
                .collect();
        }
        entry
    }

    fn of_polynomial(fit: &PolynomialFit) -> Self {
        let rows = |matrix: &DMatrix<f64>| {
            matrix
                .row_iter()
                .map(|row| [digits(row[0]), digits(row[1]), digits(row[2])])
                .collect::<Vec<_>>()
        };
        let model = &fit.model;
        Self {
            number: fit.sensor,
            held_out: fit.scores.iter().map(HeldOut::of).collect(),
            parameters: BTreeMap::new(),
            held: Vec::new(),
            polynomial: Some(PolynomialTable {
                degree: model.degree,
                forces: model
                    .forces
                    .iter()
                    .map(|(place, axis)| format!("f{place}_{}_n", axis.letter()))
                    .collect(),
                spans_n: model.spans_n.clone(),
                terms: Polynomial::terms(model.forces.len(), model.degree),
                coefficients_g: rows(&model.coefficients_g),
                std_errors_g: rows(&fit.std_error_g),
            }),
        }
    }

    /// The polynomial; `None` where there is none or the table does not fit its degree.
    pub fn polynomial(&self) -> Option<Polynomial> {
        let table = self.polynomial.as_ref()?;
        let force = |name: &String| match force_column(name) {
            Ok(ForceColumn::Force { place, axis }) => Some((place, axis)),
            _ => None,
        };
        let forces: Vec<(u32, Axis)> = table.forces.iter().map(force).collect::<Option<_>>()?;
        let terms = Polynomial::terms(forces.len(), table.degree);
        let finite = table
            .coefficients_g
            .iter()
            .flatten()
            .all(|value| value.is_finite());
        let fits = terms == table.terms
            && table.coefficients_g.len() == terms.len()
            && table.spans_n.len() == forces.len();
        (finite && fits).then(|| Polynomial {
            degree: table.degree,
            forces,
            spans_n: table.spans_n.clone(),
            coefficients_g: DMatrix::from_fn(terms.len(), 3, |i, j| table.coefficients_g[i][j]),
        })
    }
}

impl HeldOut {
    /// The part of the error that a better model could remove, in gauss.
    pub fn explainable_g(&self) -> f64 {
        (self.rms_g.powi(2) - self.floor_g.powi(2)).max(0.0).sqrt()
    }

    fn of(score: &AxisScore) -> Self {
        Self {
            axis: score.axis.letter().to_owned(),
            rms_g: digits(score.held_out_rms_g),
            fitted_rms_g: digits(score.fitted_rms_g),
            floor_g: digits(score.floor_g),
            span_g: digits(score.span_g),
        }
    }
}
