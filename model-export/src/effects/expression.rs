//! A user's own effect, written as a formula over the covariates:
//! `ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)`.
//!
//! Names that end in a unit are covariates, names with a range are nonlinear parameters, all others
//! are coefficients, which must enter linearly. Every sensor gets its own values.

mod syntax;
mod target;

use std::borrow::Cow;

use exmex::{Express, FlatEx};
use nalgebra::Vector3;

use super::parameter::{Kind, Parameter, Size};
use super::series::{Series, Stage};
use super::track::{OWN, Track};
use crate::quantity::column_unit;
use crate::recordings::problem::closest;

pub use syntax::ExpressionError;
use syntax::{Names, check};
use target::{TARGETS, Target};

/// Steps of the search over a parameter's range: fine enough for the phase of a ripple.
const SEARCH: usize = 60;

/// What a name in a formula stands for.
#[derive(Clone, Debug, PartialEq)]
enum Role {
    Pi,
    Coefficient(usize),
    Shape(usize),
    Covariate(usize),
}

/// A nonlinear parameter and the range in which it is searched.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Range {
    /// Name in the formula.
    pub name: String,
    /// Least value.
    pub from: f64,
    /// Greatest value.
    pub to: f64,
}

/// A user's own effect.
#[derive(Clone, Debug)]
pub struct Expression {
    /// Name, before the colon.
    pub name: String,
    /// The whole formula as it was written.
    pub text: String,
    /// Nonlinear parameters.
    pub ranges: Vec<Range>,
    /// Covariates that it uses.
    pub covariates: Vec<String>,
    coefficients: Vec<String>,
    target: Target,
    formula: FlatEx<f64>,
    roles: Vec<Role>,
}

impl Expression {
    /// Reads `NAME: TARGET = FORMULA`; `columns` are the covariates of the recordings.
    pub fn parse(
        text: &str,
        ranges: &[Range],
        columns: &[String],
    ) -> Result<Self, ExpressionError> {
        let parts = syntax::split(text)?;
        let known = TARGETS
            .iter()
            .find(|target| target.name == parts.target.text);
        let target = *known.ok_or_else(|| {
            let names = TARGETS.map(|target| target.name);
            let hint = closest(parts.target.text, names).map_or_else(
                || format!("write one of {}", names.join(", ")),
                |name| format!("did you mean {name}?"),
            );
            parts.target.error(
                text,
                format!("{:?} cannot be set; {hint}", parts.target.text),
            )
        })?;
        let names = check(text, &parts.formula)?;
        let formula: FlatEx<f64> = exmex::parse(parts.formula.text).map_err(|error| {
            parts
                .formula
                .error(text, format!("this is no formula ({error})"))
        })?;
        let mut expression = Self {
            name: parts.name.text.to_owned(),
            text: text.trim().to_owned(),
            ranges: ranges.to_vec(),
            covariates: Vec::new(),
            coefficients: Vec::new(),
            target,
            formula,
            roles: Vec::new(),
        };
        expression.assign(text, &names, columns)?;
        expression.check_ranges(text)?;
        expression.check_linear(text, &names)?;
        Ok(expression)
    }

    /// Every name in a formula that ends in a unit: its covariates, where it was checked before.
    pub fn names(text: &str) -> Vec<String> {
        let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        let names = text.split(word).filter(|name| column_unit(name).is_some());
        names.map(str::to_owned).collect()
    }

    fn assign(
        &mut self,
        text: &str,
        names: &Names,
        columns: &[String],
    ) -> Result<(), ExpressionError> {
        for name in self.formula.var_names().to_vec() {
            let place = names.place(&name);
            let range = self.ranges.iter().position(|range| range.name == name);
            let known = || OWN.into_iter().chain(columns.iter().map(String::as_str));
            let role = if name == "pi" {
                Role::Pi
            } else if let Some(range) = range {
                Role::Shape(range)
            } else if known().any(|column| column == name) {
                self.covariates.push(name);
                Role::Covariate(self.covariates.len() - 1)
            } else if let Some(meant) = closest(&name, known()).filter(|_| name.len() > 3) {
                return Err(place.error(
                    text,
                    format!("{name:?} is no covariate of these recordings; did you mean {meant}?"),
                ));
            } else if column_unit(&name).is_some() {
                let all: Vec<&str> = known().collect();
                return Err(place.error(
                    text,
                    format!(
                        "{name:?} is no covariate of these recordings, which have {}",
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
                "there is no coefficient to fit: multiply a term by a name of your own, such as a";
            return Err(ExpressionError::at(text, names.start, advice.to_owned()));
        }
        Ok(())
    }

    fn check_ranges(&self, text: &str) -> Result<(), ExpressionError> {
        for (i, range) in self.ranges.iter().enumerate() {
            let message = if !self.roles.contains(&Role::Shape(i)) {
                format!("--range {}: the formula has no such name", range.name)
            } else if !(range.from < range.to && range.from.is_finite() && range.to.is_finite()) {
                format!(
                    "--range {}: from {} to {} is no range",
                    range.name, range.from, range.to
                )
            } else {
                continue;
            };
            return Err(ExpressionError::at(text, 0, message));
        }
        Ok(())
    }

    /// Each coefficient must enter linearly, whatever the others are; no coefficient, no effect.
    fn check_linear(&self, text: &str, names: &Names) -> Result<(), ExpressionError> {
        let shapes: Vec<f64> = self
            .ranges
            .iter()
            .map(|r| 0.37 * r.from + 0.63 * r.to)
            .collect();
        let covariates: Vec<f64> = (0..self.covariates.len())
            .map(|i| 0.71 + 0.13 * i as f64)
            .collect();
        let value = |coefficients: &[f64]| self.evaluate(coefficients, &shapes, &covariates);
        let all: Vec<f64> = (0..self.coefficients.len())
            .map(|i| 1.0 + 0.5 * i as f64)
            .collect();
        let differs = |a: f64, b: f64, scale: f64| {
            a.is_finite() && b.is_finite() && (a - b).abs() > 1e-9 * scale
        };
        let (none, mut alone) = (vec![0.0; all.len()], 0.0);
        for (i, name) in self.coefficients.iter().enumerate() {
            let at = |from: &[f64], to: f64| {
                let mut moved = from.to_vec();
                moved[i] = to;
                value(&moved)
            };
            // Not at zero: what divides by it would be no number there.
            let [low, middle, high] = [1.0, 2.0, 3.0].map(|to| at(&all, to));
            if differs(
                high - middle,
                middle - low,
                high.abs() + middle.abs() + low.abs(),
            ) {
                let advice = format!(
                    "{name:?} does not enter linearly: give it a range, as in --range {name}=1..10"
                );
                return Err(names.place(name).error(text, advice));
            }
            alone += at(&none, all[i]);
        }
        let (whole, nothing) = (value(&all), value(&none));
        let scale = whole.abs() + alone.abs() + 1e-300;
        if differs(nothing, 0.0, scale) || differs(whole, alone, scale) {
            let advice = "every term must be multiplied by one coefficient and no other".to_owned();
            return Err(ExpressionError::at(text, names.start, advice));
        }
        Ok(())
    }

    fn evaluate(&self, coefficients: &[f64], shapes: &[f64], covariates: &[f64]) -> f64 {
        let values: Vec<f64> = self
            .roles
            .iter()
            .map(|role| match role {
                Role::Pi => std::f64::consts::PI,
                Role::Coefficient(i) => coefficients[*i],
                Role::Shape(i) => shapes[*i],
                Role::Covariate(i) => covariates[*i],
            })
            .collect();
        self.formula.eval(&values).unwrap_or(f64::NAN)
    }

    /// Where it acts.
    pub fn stage(&self) -> Stage {
        self.target.stage
    }

    /// Coefficients, then nonlinear parameters.
    pub fn parameters(&self) -> Vec<Parameter> {
        let coefficient = |name: &String| Parameter {
            name: Cow::Owned(name.clone()),
            // How large it may be follows from the recordings.
            ..Parameter::coefficient("", self.target.unit, f64::NAN)
        };
        let shape = |range: &Range| {
            let step = (range.to - range.from) / SEARCH as f64;
            let grid = (0..=SEARCH).map(|i| range.from + step * i as f64).collect();
            Parameter {
                name: Cow::Owned(range.name.clone()),
                kind: Kind::Shape {
                    grid: Cow::Owned(grid),
                },
                ..Parameter::coefficient("", "", 0.0)
            }
        };
        self.coefficients
            .iter()
            .map(coefficient)
            .chain(self.ranges.iter().map(shape))
            .collect()
    }

    /// Its coefficients together.
    pub fn size(&self) -> Size {
        Size::unexpected("coefficients, root of the sum of squares", self.target.unit)
    }

    /// The formula at one set of covariates, in the order of [`Expression::covariates`], and the axis
    /// of the gripper that it acts along.
    pub fn value(&self, values: &[f64], covariates: &[f64]) -> (f64, usize) {
        let (coefficients, shapes) = values.split_at(self.coefficients.len().min(values.len()));
        (
            self.evaluate(coefficients, shapes, covariates),
            self.target.axis,
        )
    }

    /// The first row in which the formula is no number, at the ends and the middle of its ranges, in
    /// words; `None` where it is one everywhere.
    pub fn no_number(&self, track: &Track) -> Option<String> {
        let columns: Vec<Vec<f64>> = self
            .covariates
            .iter()
            .map(|name| track.covariate(name))
            .collect::<Option<_>>()?;
        for share in [0.0, 0.5, 1.0] {
            let shapes: Vec<f64> = self
                .ranges
                .iter()
                .map(|r| r.from + share * (r.to - r.from))
                .collect();
            for row in 0..track.len() {
                let at: Vec<f64> = columns.iter().map(|column| column[row]).collect();
                if !self
                    .evaluate(&vec![1.0; self.coefficients.len()], &shapes, &at)
                    .is_finite()
                {
                    let named = self.covariates.iter().zip(&at);
                    let ranged = self.ranges.iter().map(|range| &range.name).zip(&shapes);
                    let places: Vec<String> = named
                        .chain(ranged)
                        .map(|(name, value)| format!("{name} = {value}"))
                        .collect();
                    return Some(places.join(", "));
                }
            }
        }
        None
    }

    /// Adds the formula's value to every row.
    pub fn apply(&self, values: &[f64], track: &Track, series: &mut Series) {
        let columns: Option<Vec<Vec<f64>>> = self
            .covariates
            .iter()
            .map(|name| track.covariate(name))
            .collect();
        let Some(columns) = columns else { return };
        let mut at = vec![0.0; columns.len()];
        for row in 0..track.len() {
            at.iter_mut()
                .zip(&columns)
                .for_each(|(at, column)| *at = column[row]);
            let (value, axis) = self.value(values, &at);
            let value = if value.is_finite() { value } else { 0.0 };
            let mut along = Vector3::zeros();
            along[axis] = value;
            match self.target.stage {
                Stage::Load => series.force_n[row][axis / 2] += value,
                Stage::Displacement => series.states[row].displacement_mm += 1e-3 * along,
                _ => series.states[row].outside_g += along,
            }
        }
    }
}

#[cfg(test)]
mod tests;
