//! The fitted parameters of a model: values with errors, distances from the design, correlations, and what the recordings do not
//! identify, with the recording that would.
//!
//! All errors are those of the model file: block bootstrap in the directions that the data determine, the prior in the others.

use std::collections::BTreeMap;
use std::fmt;

use model_export::effects::{EffectTerm, ParameterKind};
use model_export::fit::identifiability::MAX_UNCERTAINTY;
use model_export::fit::parameters::{self, COUNT, Derivatives, PARAMETERS, tolerances};
use model_export::model_file::{CorrelationTable, FittedValue, ModelFile, SensorModel};
use model_export::physics::{ForwardModel, PhysicalState};
use model_export::recordings::columns::Axis;
use nalgebra::{DMatrix, DVector};
use serde::{Serialize, Serializer};

/// Variance inflation from which the residual, not the excitation, limits what is identified.
const STRUCTURED: f64 = 2.0;
/// Loads of a further recording along one axis, either sign.
const LOADS: i32 = 4;

/// All parameters of a model.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ParameterTable {
    /// By sensor, in the order of the base and of its effects. Without initial states, which do not describe the gripper.
    pub estimates: Vec<ParameterEstimate>,
    pub correlations: Vec<SensorCorrelation>,
    pub unidentified: Vec<Unidentified>,
}

/// A fitted parameter of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterEstimate {
    pub sensor: u32,
    /// Its effect; `None` for the base.
    pub effect: Option<String>,
    pub name: String,
    pub value: f64,
    pub std_error: f64,
    pub unit: String,
    /// Whether the standard error is at most half the prior width.
    pub identifiable: bool,
    /// Value by design; zero for a coefficient of an effect; `None` for a shape.
    pub nominal: Option<f64>,
    /// Standard deviation of the prior in `unit`.
    pub prior_width: Option<f64>,
    pub prior: Prior,
    /// Distance from `nominal` in standard deviations: of a base parameter, those of tolerance and standard error added in
    /// quadrature; of a coefficient, standard errors.
    pub deviation: Option<f64>,
}

/// What the prior of a parameter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Prior {
    /// Scatter between grippers of one design.
    ManufacturingTolerance,
    /// Regularisation: about ten typical magnitudes of the effect.
    Regularisation,
}

/// Correlations of the estimates of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorCorrelation {
    pub sensor: u32,
    #[serde(flatten)]
    pub table: CorrelationTable,
}

/// A parameter or a combination that the prior decides.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unidentified {
    pub sensor: u32,
    /// Weights of the parameters in prior widths.
    pub shares: BTreeMap<String, f64>,
    /// Standard error by the data alone in prior widths; `None` where it is not known.
    pub known_within: Option<f64>,
    /// The recording that would identify it.
    pub remedy: Remedy,
    /// Standard error with that remedy, or with the best load, in prior widths; `None` where it is not computed.
    pub known_within_then: Option<f64>,
}

/// What would identify a combination.
#[derive(Clone, Debug, PartialEq)]
pub enum Remedy {
    /// A recording of a force that was not recorded or did not vary.
    Force(Axis),
    /// No recording: a residual at the noise floor.
    MissingEffect,
    /// One more recording with these peak loads of both signs, and with the missing effect in the model, if one is.
    Load { peak_n: [f64; 2], after_effect: bool },
    /// The recording that the catalogue states for an effect.
    Effect(&'static str, &'static str),
    /// One in which the columns of a formula vary more.
    Formula(String),
    /// No recording within the range of the design.
    None,
    /// The model file has no variance inflation.
    Unknown,
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Force(Axis::X) => f.write_str("a recording with a lateral load of both signs"),
            Self::Force(_) => f.write_str("a recording with a longitudinal load of both signs"),
            Self::MissingEffect => f.write_str(
                "these recordings, when the missing effect is in the model (`magpie diagnose`): now the residual, not the load, limits \
                 the errors",
            ),
            Self::Load { peak_n: [x, z], after_effect } => {
                let load = match (*x > 0.0, *z > 0.0) {
                    (true, false) => format!("a lateral load to ±{x:.0} N"),
                    (false, true) => format!("a longitudinal load to ±{z:.0} N"),
                    _ => format!("lateral loads to ±{x:.0} N, each with longitudinal loads to ±{z:.0} N"),
                };
                let effect = if *after_effect { ", and the missing effect in the model" } else { "" };
                write!(f, "one more recording with {load}{effect}")
            }
            Self::Effect(effect, record) => write!(f, "{effect}: {}", record.trim_end_matches('.')),
            Self::Formula(name) => {
                write!(f, "a recording in which the columns of the formula {name} vary more")
            }
            Self::None => f.write_str(
                "measure one of the parameters by other means (gap: gauge; bias: reading without the magnet); no load within the range \
                 of the design does, and the forces hardly depend on it",
            ),
            Self::Unknown => {
                f.write_str("repeat the fit: the model file is of an earlier version")
            }
        }
    }
}

impl Serialize for Remedy {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl ParameterTable {
    /// The parameters of a model.
    pub fn of(model: &ModelFile) -> Self {
        let effects = effects(model);
        let mut table = Self::default();
        for sensor in &model.sensors {
            let of_base = base_estimates(model, sensor);
            let of_effects = effects.iter().flat_map(|one| one.estimates(sensor.number));
            let estimates: Vec<ParameterEstimate> = of_base.into_iter().chain(of_effects).collect();
            table.unidentified.extend(unidentified(model, sensor, &effects, &estimates));
            table.estimates.extend(estimates);
            let correlation = sensor.correlation.clone();
            let with_sensor = |table| SensorCorrelation { sensor: sensor.number, table };
            table.correlations.extend(correlation.map(with_sensor));
        }
        table
    }

    /// Numbers of the sensors, each once.
    pub fn sensors(&self) -> Vec<u32> {
        let mut sensors: Vec<u32> = self.estimates.iter().map(|one| one.sensor).collect();
        sensors.dedup();
        sensors
    }
}

impl ParameterEstimate {
    /// Name as in the correlations: with the effect, if it is of one.
    pub fn full_name(&self) -> String {
        self.effect.as_ref().map_or_else(|| self.name.clone(), |of| format!("{of}.{}", self.name))
    }

    /// Standard error in prior widths: near 1 the prior decides.
    pub fn of_prior(&self) -> Option<f64> {
        self.prior_width.map(|width| self.std_error / width)
    }

    fn new(sensor: u32, name: &str, value: &FittedValue) -> Self {
        Self {
            sensor,
            effect: None,
            name: name.to_owned(),
            value: value.value,
            std_error: value.std_error,
            unit: value.unit.clone(),
            identifiable: value.identifiable,
            nominal: None,
            prior_width: value.prior_width,
            prior: Prior::Regularisation,
            deviation: None,
        }
    }
}

/// Distance in standard deviations of independent errors; `None` without an error.
fn deviation(difference: f64, errors: [f64; 2]) -> Option<f64> {
    let sigma = errors[0].hypot(errors[1]);
    (sigma > 0.0).then(|| difference / sigma)
}

/// Of the parameters of the cylinder base; none of a polynomial, whose coefficients have no design.
fn base_estimates(model: &ModelFile, sensor: &SensorModel) -> Vec<ParameterEstimate> {
    let Some(nominal) = model.nominal(sensor.number) else {
        return Vec::new();
    };
    let (nominals, widths) = (parameters::values(&nominal), tolerances(&nominal));
    let estimate = |(i, parameter): (usize, &parameters::CylinderParameter)| {
        let value = sensor.parameters.get(parameter.name)?;
        let difference = value.value - nominals[i];
        Some(ParameterEstimate {
            nominal: Some(nominals[i]),
            prior_width: Some(widths[i]),
            prior: Prior::ManufacturingTolerance,
            deviation: deviation(difference, [widths[i], value.std_error]),
            ..ParameterEstimate::new(sensor.number, parameter.name, value)
        })
    };
    PARAMETERS.iter().enumerate().filter_map(estimate).collect()
}

/// An effect of a model, with its parameters but initial states.
struct Effect<'a> {
    term: EffectTerm,
    file: &'a model_export::model_file::EffectModel,
    names: Vec<(String, ParameterKind)>,
}

fn effects(model: &ModelFile) -> Vec<Effect<'_>> {
    let effect = |file| {
        let term: EffectTerm = model_export::model_file::EffectModel::term(file).ok()?;
        let parameters = term.parameters(model.provenance.recordings.len()).into_iter();
        let names = parameters
            .filter(|one| one.kind != ParameterKind::InitialState)
            .map(|one| (one.name.to_string(), one.kind))
            .collect();
        Some(Effect { term, file, names })
    };
    model.effects.iter().filter_map(effect).collect()
}

impl Effect<'_> {
    fn estimates(&self, number: u32) -> Vec<ParameterEstimate> {
        let Some(sensor) = self.file.sensors.iter().find(|sensor| sensor.number == number) else {
            return Vec::new();
        };
        let estimate = |(name, kind): &(String, ParameterKind)| {
            let value = sensor.parameters.get(name)?;
            let is_coefficient = *kind == ParameterKind::Coefficient;
            let of_zero = deviation(value.value, [value.std_error, 0.0]);
            Some(ParameterEstimate {
                effect: Some(self.file.name.clone()),
                nominal: is_coefficient.then_some(0.0),
                deviation: of_zero.filter(|_| is_coefficient),
                ..ParameterEstimate::new(number, name, value)
            })
        };
        self.names.iter().filter_map(estimate).collect()
    }

    fn remedy(&self) -> Remedy {
        match self.term.effect() {
            Some(effect) => Remedy::Effect(effect.id, effect.record),
            None => Remedy::Formula(self.file.name.clone()),
        }
    }
}

/// The combinations that the fit of the cylinder base holds, and parameters of effects that are in none of them.
fn unidentified(
    model: &ModelFile,
    sensor: &SensorModel,
    effects: &[Effect],
    estimates: &[ParameterEstimate],
) -> Vec<Unidentified> {
    let of_effect = |name: &str| {
        let is_of = |effect: &&Effect| {
            name.strip_prefix(effect.file.name.as_str()).is_some_and(|rest| rest.starts_with('.'))
        };
        effects.iter().find(is_of)
    };
    let further = FurtherRecording::of(model, sensor);
    let combinations = sensor.unidentifiable.iter().map(|held| {
        let mut shares: Vec<_> = held.shares.iter().collect();
        shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let largest = shares.first().and_then(|(name, _)| of_effect(name));
        // The base alone tells nothing of a combination with an effect.
        let effect = shares.iter().find_map(|(name, _)| of_effect(name));
        // By data and prior, if the residual were white noise of the floor.
        let structured = sensor.noise_inflation.filter(|inflation| *inflation > STRUCTURED);
        let at_floor = structured
            .map(|inflation| 1.0 / (1.0 + inflation / held.sigma_tolerances.powi(2)).sqrt());
        let unmeasured = sensor.assumed_zero.first();
        let (remedy, known_within_then) = match (largest, unmeasured, effect, at_floor) {
            (None, Some(axis), ..) => (Remedy::Force(*axis), None),
            (.., Some(effect), _) => (effect.remedy(), None),
            (.., Some(sigma)) if sigma <= MAX_UNCERTAINTY => (Remedy::MissingEffect, Some(sigma)),
            _ => match &further {
                Some(further) => further.remedy(&held.shares),
                None => (Remedy::Unknown, None),
            },
        };
        let known_within = held.sigma_tolerances.is_finite().then_some(held.sigma_tolerances);
        let shares = held.shares.clone();
        Unidentified { sensor: sensor.number, shares, known_within, remedy, known_within_then }
    });
    let mut all: Vec<Unidentified> = combinations.collect();
    for one in estimates.iter().filter(|one| one.effect.is_some() && !one.identifiable) {
        if all.iter().any(|known| known.shares.contains_key(&one.full_name())) {
            continue;
        }
        all.push(Unidentified {
            sensor: sensor.number,
            shares: BTreeMap::from([(one.full_name(), 1.0)]),
            known_within: None,
            remedy: of_effect(&one.full_name()).map_or(Remedy::Unknown, Effect::remedy),
            known_within_then: None,
        });
    }
    all
}

/// The base of one sensor linearised at loads that a further recording could have.
struct FurtherRecording {
    forward: ForwardModel,
    /// Prior widths of the base parameters.
    widths: [f64; COUNT],
    floors_g: Vec<f64>,
    /// Rows of a recording of the mean length, divided by the variance inflation where it is not from a missing effect.
    rows: f64,
    is_structured: bool,
}

impl FurtherRecording {
    /// `None` for a polynomial, and for a model file without the variance inflation.
    fn of(model: &ModelFile, sensor: &SensorModel) -> Option<Self> {
        let inflation = sensor.noise_inflation?;
        let is_structured = inflation > STRUCTURED;
        let rows = model.provenance.rows as f64 / model.provenance.recordings.len().max(1) as f64;
        Some(Self {
            forward: model.forward(sensor.number)?,
            widths: tolerances(&model.nominal(sensor.number)?),
            floors_g: sensor.held_out.iter().map(|axis| axis.floor_g).collect(),
            rows: if is_structured { rows } else { rows / inflation },
            is_structured,
        })
    }

    /// Derivatives at loads up to these peaks, in noise floors per prior width.
    fn jacobian(&self, peak_n: [f64; 2]) -> DMatrix<f64> {
        let (frames, derivatives) = (self.forward.frames(), Derivatives::new(&self.forward));
        let along = |peak: f64| if peak > 0.0 { -LOADS..=LOADS } else { 0..=0 };
        let share = |step: i32| f64::from(step) / f64::from(LOADS);
        let loads: Vec<[f64; 2]> = along(peak_n[0])
            .flat_map(|x| {
                along(peak_n[1]).map(move |z| [share(x) * peak_n[0], share(z) * peak_n[1]])
            })
            .collect();
        let weight = (self.rows / loads.len() as f64).sqrt();
        let mut jacobian = DMatrix::zeros(3 * loads.len(), COUNT);
        for (row, load) in loads.iter().enumerate() {
            let state = PhysicalState::displaced(self.forward.displacement(*load));
            let response = self.forward.response_at(&frames, &state);
            let mut columns = derivatives.columns(&state, &response);
            for (axis, per_n) in self.forward.per_newton(&response).into_iter().enumerate() {
                columns[axis] = per_n * (-load[axis] / self.forward.stiffness_n_per_mm[axis]);
            }
            for (i, column) in columns.iter().enumerate() {
                for (axis, floor_g) in self.floors_g.iter().enumerate().take(3) {
                    jacobian[(3 * row + axis, i)] =
                        column[axis] * self.widths[i] * weight / floor_g;
                }
            }
        }
        jacobian
    }

    /// Standard error of a combination in prior widths by the prior and one recording with these loads, without the recordings at
    /// hand: at most smaller with them.
    fn known_within(&self, combination: &DVector<f64>, peak_n: [f64; 2]) -> f64 {
        let jacobian = self.jacobian(peak_n);
        let information = jacobian.tr_mul(&jacobian) + DMatrix::identity(COUNT, COUNT);
        let factor = information.cholesky();
        factor.map_or(1.0, |factor| combination.dot(&factor.solve(combination)).sqrt())
    }

    /// The simplest load that identifies a combination, or none, with the standard error after it.
    fn remedy(&self, shares: &BTreeMap<String, f64>) -> (Remedy, Option<f64>) {
        let share = |i: usize, _| shares.get(PARAMETERS[i].name).copied().unwrap_or(0.0);
        let Some(combination) = DVector::from_fn(COUNT, share).try_normalize(0.0) else {
            return (Remedy::Unknown, None);
        };
        let peak = self.forward.force_range_n;
        let mut least = f64::INFINITY;
        for peak_n in [[peak, 0.0], [0.0, peak], [peak, peak]] {
            let known_within = self.known_within(&combination, peak_n);
            if known_within <= MAX_UNCERTAINTY {
                let after_effect = self.is_structured;
                return (Remedy::Load { peak_n, after_effect }, Some(known_within));
            }
            least = least.min(known_within);
        }
        (Remedy::None, Some(least))
    }
}
