//! User-defined effects, written as formulas over the covariates:
//! `ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)`.
//!
//! Names that end in a unit are covariates, names with a range are nonlinear parameters, all others are
//! coefficients, which must enter linearly. `lag(COVARIATE, SECONDS)` is the covariate after a first-order low pass. Each sensor
//! has its own values.

use std::borrow::Cow;

use nalgebra::Vector3;

use crate::effects::excitation::{
    BUILT_IN_COVARIATES, ExcitationSeries, OPENING_RATE, source_column,
};
use crate::effects::operators::low_pass;
use crate::effects::parameter::{EffectParameter, MagnitudeSpec, ParameterKind};
use crate::effects::state_series::{EffectStage, StateSeries};
use crate::error::closest_match;
use crate::input::MAX_MAGNITUDE;
use crate::recordings::units::column_unit;

mod evaluator;
mod syntax;
mod units;

use evaluator::{Formula, Values};
pub use syntax::ExpressionError;
use syntax::{Lag, NamePositions, check_parameter_count, check_syntax};

/// Grid intervals of the search over a range: resolves the phase of a ripple.
const GRID_STEPS: usize = 60;

/// Meaning of a name in a formula.
#[derive(Clone, Debug, PartialEq)]
enum Role {
    Pi,
    Coefficient(usize),
    Shape(usize),
    Input(usize),
}

/// A covariate at a row, or its past.
#[derive(Clone, Debug, PartialEq)]
struct Input {
    /// Index of the covariate.
    covariate: usize,
    lag: Option<TimeConstant>,
}

/// Time constant of a low pass.
#[derive(Clone, Copy, Debug, PartialEq)]
enum TimeConstant {
    Seconds(f64),
    /// Index of a nonlinear parameter.
    Shape(usize),
}

impl TimeConstant {
    /// With these nonlinear parameters.
    fn seconds(self, shapes: &[f64]) -> Option<f64> {
        match self {
            Self::Seconds(seconds) => Some(seconds),
            Self::Shape(index) => shapes.get(index).copied(),
        }
    }
}

/// True for names of covariates, recorded or not: they end in a unit.
fn is_covariate(name: &str) -> bool {
    column_unit(name).is_some() || name == OPENING_RATE
}

/// A nonlinear parameter and its search range.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterRange {
    /// Name in the formula.
    pub name: String,
    /// Lower bound.
    pub from: f64,
    /// Upper bound.
    pub to: f64,
}

/// The search divides the range; bounds that are equal up to rounding have no steps.
fn is_valid(range: &ParameterRange) -> bool {
    let max = range.from.abs().max(range.to.abs());
    max <= MAX_MAGNITUDE && range.to - range.from > 1e-6 * max && max > 1.0 / MAX_MAGNITUDE
}

/// A user-defined effect.
#[derive(Clone, Debug)]
pub struct Expression {
    /// Name before the colon.
    pub name: String,
    /// Complete text, as entered.
    pub text: String,
    /// Nonlinear parameters.
    pub ranges: Vec<ParameterRange>,
    /// Covariates in the formula.
    pub covariates: Vec<String>,
    inputs: Vec<Input>,
    coefficients: Vec<String>,
    target: Target,
    formula: Formula,
    roles: Vec<Role>,
}

impl Expression {
    /// Parses `NAME: TARGET = FORMULA`; `columns`: covariates of the recordings.
    pub fn parse(
        text: &str,
        ranges: &[ParameterRange],
        columns: &[String],
    ) -> Result<Self, ExpressionError> {
        let parts = syntax::split(text)?;
        let found = TARGETS.iter().find(|target| target.name == parts.target.text);
        let target = *found.ok_or_else(|| {
            let names = TARGETS.map(|target| target.name);
            let hint = closest_match(parts.target.text, names).map_or_else(
                || format!("write one of {}", names.join(", ")),
                |name| format!("did you mean {name}?"),
            );
            parts.target.error(text, format!("{:?} is not a target; {hint}", parts.target.text))
        })?;
        // Lags become names of the same length, so that positions stay.
        let (named, lags) = syntax::name_lags(text, &parts.formula)?;
        let section = parts.formula.with_text(&named);
        let names = check_syntax(text, &section)?;
        let formula = Formula::parse(section.text)
            .map_err(|number| section.error(text, format!("{number:?} is not a number")))?;
        let mut expression = Self {
            name: parts.name.text.to_owned(),
            text: text.trim().to_owned(),
            ranges: ranges.to_vec(),
            covariates: Vec::new(),
            inputs: Vec::new(),
            coefficients: Vec::new(),
            target,
            formula,
            roles: Vec::new(),
        };
        expression.assign_roles(text, &names, &lags, columns)?;
        expression.check_ranges(text)?;
        let parameters = expression.coefficients.len() + ranges.len();
        check_parameter_count(text, &names, parameters)?;
        expression.check_linear(text, &names)?;
        Ok(expression)
    }

    /// Names of the targets.
    pub fn target_names() -> Vec<&'static str> {
        TARGETS.iter().map(|target| target.name).collect()
    }

    /// Names of the functions.
    pub fn function_names() -> Vec<&'static str> {
        syntax::FUNCTIONS.iter().map(|(name, _)| *name).collect()
    }

    /// All names of a validated formula that end in a unit: its covariates.
    pub fn covariate_names(text: &str) -> Vec<String> {
        let separator = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        text.split(separator).filter(|name| is_covariate(name)).map(str::to_owned).collect()
    }

    /// Columns that its covariates need.
    pub fn recorded_columns(&self) -> Vec<String> {
        let source = |name: &String| source_column(name).to_owned();
        let mut columns: Vec<String> = self.covariates.iter().map(source).collect();
        columns.dedup();
        columns
    }

    /// Assigns a role to each name of the formula.
    fn assign_roles(
        &mut self,
        text: &str,
        names: &NamePositions,
        lags: &[Lag],
        columns: &[String],
    ) -> Result<(), ExpressionError> {
        for name in self.formula.names().to_vec() {
            let position = names.position(&name);
            let shape = |name: &str| self.ranges.iter().position(|range| range.name == name);
            let range = shape(&name);
            let has_opening = columns.iter().any(|column| column == "opening_mm");
            let rate = has_opening.then_some(OPENING_RATE);
            let available = || {
                let recorded = columns.iter().map(String::as_str);
                BUILT_IN_COVARIATES.into_iter().chain(recorded).chain(rate)
            };
            let lag = lags.iter().find(|lag| lag.name == name);
            let time_constant = match lag.map(|lag| (lag, lag.seconds.parse().ok())) {
                None => None,
                Some((_, Some(seconds))) if seconds > 0.0 && f64::is_finite(seconds) => {
                    Some(TimeConstant::Seconds(seconds))
                }
                Some((lag, _)) => {
                    let index = shape(&lag.seconds).ok_or_else(|| {
                        let advice = format!(
                            "the time constant {:?} is neither a positive number of seconds nor a name with a range: --range {}=1..10, or after a semicolon in the workbench",
                            lag.seconds, lag.seconds
                        );
                        position.error(text, advice)
                    })?;
                    Some(TimeConstant::Shape(index))
                }
            };
            let name = lag.map_or(name, |lag| lag.covariate.clone());
            let role = if name == "pi" {
                Role::Pi
            } else if let Some(range) = range {
                Role::Shape(range)
            } else if available().any(|column| column == name) {
                let known = self.covariates.iter().position(|covariate| *covariate == name);
                let covariate = known.unwrap_or(self.covariates.len());
                if known.is_none() {
                    self.covariates.push(name);
                }
                self.inputs.push(Input { covariate, lag: time_constant });
                Role::Input(self.inputs.len() - 1)
            } else if let Some(candidate) =
                closest_match(&name, available()).filter(|_| name.len() > 3)
            {
                return Err(position.error(
                    text,
                    format!(
                        "{name:?} is not a covariate of these recordings; did you mean {candidate}?"
                    ),
                ));
            } else if lag.is_some() || is_covariate(&name) {
                let all: Vec<&str> = available().collect();
                return Err(position.error(
                    text,
                    format!(
                        "{name:?} is not a covariate of these recordings; available: {}",
                        all.join(", ")
                    ),
                ));
            } else {
                self.coefficients.push(name);
                Role::Coefficient(self.coefficients.len() - 1)
            };
            self.roles.push(role);
        }
        if self.coefficients.is_empty() {
            let advice =
                "there is no coefficient to fit: multiply a term by a free name, such as a";
            return Err(ExpressionError::at(text, names.start, advice.to_owned()));
        }
        Ok(())
    }

    fn check_ranges(&self, text: &str) -> Result<(), ExpressionError> {
        for (i, range) in self.ranges.iter().enumerate() {
            let of_lag = Some(TimeConstant::Shape(i));
            let is_time_constant = self.inputs.iter().any(|input| input.lag == of_lag);
            let is_used = is_time_constant || self.roles.contains(&Role::Shape(i));
            let message = if !is_used {
                format!("range {}: the formula has no such name", range.name)
            } else if !is_valid(range) {
                format!(
                    "range {}: {:e} to {:e} is not a valid range; give finite bounds, the lower first, of at most {MAX_MAGNITUDE:e}",
                    range.name, range.from, range.to
                )
            } else if is_time_constant && range.from <= 0.0 {
                format!(
                    "range {}: {:e} to {:e} is not a range of a time constant; give positive bounds in seconds",
                    range.name, range.from, range.to
                )
            } else {
                continue;
            };
            return Err(ExpressionError::at(text, 0, message));
        }
        Ok(())
    }

    /// Checks that each coefficient enters linearly for any value of the others, and that the formula vanishes
    /// with all coefficients zero.
    fn check_linear(&self, text: &str, names: &NamePositions) -> Result<(), ExpressionError> {
        let shapes: Vec<f64> = self.ranges.iter().map(|r| 0.37 * r.from + 0.63 * r.to).collect();
        let inputs: Vec<Values> =
            (0..self.inputs.len()).map(|i| Values::Same(0.71 + 0.13 * i as f64)).collect();
        let value = |coefficients: &[f64]| self.evaluate(coefficients, &shapes, &inputs).at(0);
        let all: Vec<f64> = (0..self.coefficients.len()).map(|i| 1.0 + 0.5 * i as f64).collect();
        let differs = |a: f64, b: f64, scale: f64| {
            a.is_finite() && b.is_finite() && (a - b).abs() > 1e-9 * scale
        };
        let (none, mut sum_of_terms) = (vec![0.0; all.len()], 0.0);
        for (i, name) in self.coefficients.iter().enumerate() {
            let at = |from: &[f64], to: f64| {
                let mut moved = from.to_vec();
                moved[i] = to;
                value(&moved)
            };
            // Not at zero, where a division would be undefined.
            let [low, middle, high] = [1.0, 2.0, 3.0].map(|to| at(&all, to));
            if differs(high - middle, middle - low, high.abs() + middle.abs() + low.abs()) {
                let advice = format!(
                    "{name:?} does not enter linearly: give it a range, --range {name}=1..10, or after a semicolon in the workbench"
                );
                return Err(names.position(name).error(text, advice));
            }
            sum_of_terms += at(&none, all[i]);
        }
        let (whole, nothing) = (value(&all), value(&none));
        let scale = whole.abs() + sum_of_terms.abs() + 1e-300;
        if differs(nothing, 0.0, scale) || differs(whole, sum_of_terms, scale) {
            let advice = "every term must be multiplied by exactly one coefficient".to_owned();
            return Err(ExpressionError::at(text, names.start, advice));
        }
        Ok(())
    }

    fn evaluate(&self, coefficients: &[f64], shapes: &[f64], inputs: &[Values]) -> Values {
        let same = |values: &[f64], index: usize| {
            Values::Same(values.get(index).copied().unwrap_or(f64::NAN))
        };
        let values: Vec<Values> = self
            .roles
            .iter()
            .map(|role| match role {
                Role::Pi => Values::Same(std::f64::consts::PI),
                Role::Coefficient(i) => same(coefficients, *i),
                Role::Shape(i) => same(shapes, *i),
                Role::Input(i) => inputs.get(*i).cloned().unwrap_or(Values::Same(f64::NAN)),
            })
            .collect();
        self.formula.evaluate(&values)
    }

    /// Whether it depends on the times of the rows.
    pub fn depends_on_time(&self) -> bool {
        let is_of_time =
            |name: &String| name.ends_with("_per_s") || matches!(&**name, "time_s" | "session_s");
        self.inputs.iter().any(|input| input.lag.is_some())
            || self.covariates.iter().any(is_of_time)
    }

    /// Position in the chain from force to field.
    pub fn stage(&self) -> EffectStage {
        self.target.stage()
    }

    /// Coefficients, followed by nonlinear parameters.
    pub fn parameters(&self) -> Vec<EffectParameter> {
        let coefficient = |(name, unit): (&String, String)| EffectParameter {
            name: Cow::Owned(name.clone()),
            unit: Cow::Owned(unit),
            // The magnitude follows from the recordings.
            ..EffectParameter::coefficient("", self.target.unit, f64::NAN)
        };
        let shape = |(place, range): (usize, &ParameterRange)| {
            let step = (range.to - range.from) / GRID_STEPS as f64;
            let grid = (0..=GRID_STEPS).map(|i| range.from + step * i as f64).collect();
            EffectParameter {
                name: Cow::Owned(range.name.clone()),
                kind: ParameterKind::Shape { grid: Cow::Owned(grid) },
                ..EffectParameter::coefficient("", self.shape_unit(place), 0.0)
            }
        };
        let coefficients = self.coefficients.iter().zip(self.coefficient_units());
        coefficients.map(coefficient).chain(self.ranges.iter().enumerate().map(shape)).collect()
    }

    /// Unit of the coefficients if they have one in common, else that of the target.
    pub fn size_unit(&self) -> String {
        let units = self.coefficient_units();
        let is_common = units.iter().all(|unit| *unit == units[0]);
        let common = units.into_iter().next().filter(|_| is_common);
        common.unwrap_or_else(|| self.target.unit.to_owned())
    }

    /// Euclidean norm of the coefficients.
    pub fn size(&self) -> MagnitudeSpec {
        MagnitudeSpec::norm_without_prior("norm of the coefficients", self.target.unit)
    }

    /// What it depends on, with these values of its parameters: covariates, each with the time constant of its low pass in seconds.
    pub fn inputs(&self, values: &[f64]) -> Vec<(&str, Option<f64>)> {
        let (_, shapes) = values.split_at(self.coefficients.len().min(values.len()));
        let input = |input: &Input| {
            let seconds = input.lag.map(|lag| lag.seconds(shapes).unwrap_or(f64::NAN));
            (self.covariates[input.covariate].as_str(), seconds)
        };
        self.inputs.iter().map(input).collect()
    }

    /// Values at the rows of columns in the order of [`Expression::inputs`].
    pub(crate) fn values_at(&self, values: &[f64], columns: Vec<Vec<f64>>) -> Vec<f64> {
        let (coefficients, shapes) = values.split_at(self.coefficients.len().min(values.len()));
        let rows = columns.first().map_or(0, Vec::len);
        let inputs: Vec<Values> = columns.into_iter().map(Values::Each).collect();
        let found = self.evaluate(coefficients, shapes, &inputs);
        (0..rows).map(|row| found.at(row)).collect()
    }

    /// Quantity that it changes, and index of its axis: the gripper's; of a gain or rotation, the sensor's.
    pub fn target(&self) -> (Quantity, usize) {
        (self.target.quantity, self.target.axis)
    }

    /// Value of a formula without lags (`covariates` in the order of [`Expression::covariates`]) and axis of the gripper.
    pub fn value(&self, values: &[f64], covariates: &[f64]) -> (f64, usize) {
        let (coefficients, shapes) = values.split_at(self.coefficients.len().min(values.len()));
        let inputs: Vec<Values> = covariates.iter().copied().map(Values::Same).collect();
        (self.evaluate(coefficients, shapes, &inputs).at(0), self.target.axis)
    }

    /// The first row with a non-finite value at the ends or the middle of the ranges, as text; `None` if all are
    /// finite.
    pub fn first_undefined(&self, excitation: &ExcitationSeries) -> Option<String> {
        for fraction in [0.0, 0.5, 1.0] {
            let shapes: Vec<f64> =
                self.ranges.iter().map(|r| r.from + fraction * (r.to - r.from)).collect();
            let columns = self.columns(&shapes, excitation)?;
            let values = self.evaluate(&vec![1.0; self.coefficients.len()], &shapes, &columns);
            if let Some(row) = (0..excitation.len()).find(|row| !values.at(*row).is_finite()) {
                let named = self.inputs.iter().zip(&columns);
                let named = named
                    .map(|(input, column)| (&self.covariates[input.covariate], column.at(row)));
                let ranged = self.ranges.iter().map(|range| &range.name).zip(shapes.clone());
                let assignments: Vec<String> =
                    named.chain(ranged).map(|(name, value)| format!("{name} = {value}")).collect();
                return Some(assignments.join(", "));
            }
        }
        None
    }

    /// True where it is a function of the present forces alone, so that the tables of the inverse model contain it.
    pub(crate) fn depends_on_forces_alone(&self) -> bool {
        let mut names = self.covariates.iter();
        !self.has_memory() && names.all(|name| matches!(name.as_str(), "fx_n" | "fz_n"))
    }

    /// True where it depends on the past: by a lag, or by a rate that rows on both sides determine.
    pub fn has_memory(&self) -> bool {
        self.inputs.iter().any(|input| input.lag.is_some())
            || self.covariates.iter().any(|covariate| covariate == OPENING_RATE)
    }

    /// Columns of the inputs; `None` where one was not recorded.
    fn columns(&self, shapes: &[f64], excitation: &ExcitationSeries) -> Option<Vec<Values>> {
        let column = |input: &Input| {
            let values = excitation.covariate(&self.covariates[input.covariate])?;
            let Some(lag) = input.lag else {
                return Some(Values::Each(values));
            };
            Some(Values::Each(low_pass(&excitation.time_s, &values, lag.seconds(shapes)?)))
        };
        self.inputs.iter().map(column).collect()
    }

    /// Value of the formula at every row; `None` where a covariate was not recorded.
    pub fn series(&self, values: &[f64], excitation: &ExcitationSeries) -> Option<Vec<f64>> {
        let (coefficients, shapes) = values.split_at(self.coefficients.len().min(values.len()));
        let columns = self.columns(shapes, excitation)?;
        let found = self.evaluate(coefficients, shapes, &columns);
        Some((0..excitation.len()).map(|row| found.at(row)).collect())
    }

    /// Adds the value of the formula to every row.
    pub fn apply(&self, values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
        let Some(all) = self.series(values, excitation) else { return };
        let axis = self.target.axis;
        for (row, value) in all.into_iter().enumerate() {
            let value = if value.is_finite() { value } else { 0.0 };
            let mut along = Vector3::zeros();
            along[axis] = value;
            let state = series.states.get_mut(row);
            match (self.target.quantity, state) {
                (Quantity::Force, _) => {
                    if let Some(force) = series.force_n.get_mut(row) {
                        force[axis / 2] += value;
                    }
                }
                (Quantity::Displacement, Some(state)) => state.displacement_mm += 1e-3 * along,
                (Quantity::Tilt, Some(state)) => state.extra_tilt_rad[axis / 2] += 1e-3 * value,
                (Quantity::Field, Some(state)) => state.external_g += along,
                (Quantity::Gain, Some(state)) => state.gain += Vector3::repeat(0.01 * value),
                (Quantity::AxisGain, Some(state)) => state.gain += 0.01 * along,
                (Quantity::Rotation, Some(state)) => state.rotation_rad += 1e-3 * along,
                (_, None) => {}
            }
        }
    }
}

/// Quantity that a formula changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Force on a flexure.
    Force,
    /// Displacement of the magnet.
    Displacement,
    /// Tilt of the magnet.
    Tilt,
    /// External field.
    Field,
    /// Gain of all axes of the sensor.
    Gain,
    /// Gain of one axis.
    AxisGain,
    /// Rotation of the Hall element.
    Rotation,
}

/// Output of a formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Target {
    name: &'static str,
    unit: &'static str,
    quantity: Quantity,
    /// Index of the gripper's axis; of a gain or rotation, the sensor's.
    axis: usize,
}

impl Target {
    fn stage(self) -> EffectStage {
        match self.quantity {
            Quantity::Force => EffectStage::Load,
            Quantity::Displacement => EffectStage::Displacement,
            Quantity::Tilt => EffectStage::Magnet,
            Quantity::Field => EffectStage::Outside,
            Quantity::Gain | Quantity::AxisGain | Quantity::Rotation => EffectStage::Sensor,
        }
    }
}

const fn target(name: &'static str, unit: &'static str, quantity: Quantity, axis: usize) -> Target {
    Target { name, unit, quantity, axis }
}

/// Targets of formulas.
const TARGETS: [Target; 17] = [
    target("fx_n", "N", Quantity::Force, 0),
    target("fz_n", "N", Quantity::Force, 2),
    target("dx_um", "um", Quantity::Displacement, 0),
    target("dy_um", "um", Quantity::Displacement, 1),
    target("dz_um", "um", Quantity::Displacement, 2),
    target("tilt_x_mrad", "mrad", Quantity::Tilt, 0),
    target("tilt_z_mrad", "mrad", Quantity::Tilt, 2),
    target("bx_g", "G", Quantity::Field, 0),
    target("by_g", "G", Quantity::Field, 1),
    target("bz_g", "G", Quantity::Field, 2),
    target("gain_percent", "%", Quantity::Gain, 0),
    target("gain_x_percent", "%", Quantity::AxisGain, 0),
    target("gain_y_percent", "%", Quantity::AxisGain, 1),
    target("gain_z_percent", "%", Quantity::AxisGain, 2),
    target("rotation_x_mrad", "mrad", Quantity::Rotation, 0),
    target("rotation_y_mrad", "mrad", Quantity::Rotation, 1),
    target("rotation_z_mrad", "mrad", Quantity::Rotation, 2),
];

#[cfg(test)]
mod tests;
