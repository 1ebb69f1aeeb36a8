//! A candidate formula: terms at points of the chain, as columns of a regression and as user-defined effects.

use std::sync::Arc;

use anyhow::{Context, Result};
use model_export::effects::expression::ParameterRange;
use model_export::effects::{EffectTerm, Expression};
use model_export::fit::campaign::FitSetup;
use model_export::recordings::units::round_significant;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::diagnose::formulas::atoms::{Atom, Nonlinear};
use crate::diagnose::formulas::chain_points::ChainPoint;
use crate::diagnose::formulas::rows::{SensorRows, Windows, averaged, excitations};
use crate::diagnose::formulas::scan::{Columns, Scan};

/// Complexity of each column after the first.
const COLUMN_COMPLEXITY: f64 = 0.2;
/// Complexity of nonlinear parameters that differ between sensors.
const OWN_COMPLEXITY: f64 = 0.4;
/// Width of the range in which a nonlinear parameter of a discovered formula is fitted, relative to its bounds.
const RANGE: f64 = 0.1;
/// Names of coefficients, of as many terms at most, and of nonlinear parameters.
pub const COEFFICIENTS: [&str; 6] = ["a", "b", "c", "d", "f", "g"];
const NONLINEAR: [&str; 6] = ["p", "q", "r", "s", "t", "u"];

/// Terms at points of the chain: each term has a coefficient at each point.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Factors of each term.
    pub terms: Vec<Vec<Atom>>,
    pub points: Vec<ChainPoint>,
    /// Nonlinear parameters of each sensor, where they differ; empty where all sensors have the same.
    pub own: Vec<Vec<f64>>,
}

impl Candidate {
    /// Complexity of its functions, and of their number of coefficients.
    pub fn complexity(&self) -> f64 {
        let of_term = |term: &Vec<Atom>| term.iter().map(|atom| atom.complexity).sum::<f64>();
        let functions = self.terms.iter().map(of_term).fold(0.0, f64::max);
        let columns = self.terms.len() * self.points.len();
        let compliance = self.points.iter().any(|point| point.target().1.is_some());
        functions
            + COLUMN_COMPLEXITY * (columns.max(1) - 1) as f64
            + if self.own.is_empty() { 0.0 } else { OWN_COMPLEXITY }
            + if compliance { 0.5 } else { 0.0 }
    }

    /// Covariates, each once, in the order of their names.
    pub fn covariates(&self) -> Vec<String> {
        let factors = self.terms.iter().flatten().map(|atom| atom.covariate.clone());
        let loads = self.points.iter().filter_map(|point| point.target().1.map(str::to_owned));
        let mut names: Vec<String> = factors.chain(loads).collect();
        names.sort();
        names.dedup();
        names
    }

    /// Quantities that it changes.
    pub fn targets(&self) -> Vec<&'static str> {
        self.points.iter().map(|point| point.target().0).collect()
    }

    /// Nonlinear parameters. The phases of a harmonic share theirs, so those of the first term count.
    pub fn nonlinear(&self) -> Vec<Nonlinear> {
        let first = self.terms.first().into_iter().flatten();
        first.flat_map(|atom| atom.parameters.iter().copied()).collect()
    }

    /// With another value of a nonlinear parameter, in all terms with the same function.
    pub fn with_nonlinear(&self, index: usize, value: f64) -> Self {
        let mut changed = self.clone();
        let mut at = 0;
        let mut place = None;
        for (factor, atom) in self.terms.first().into_iter().flatten().enumerate() {
            if index < at + atom.parameters.len() {
                place = Some((factor, index - at));
                break;
            }
            at += atom.parameters.len();
        }
        let Some((factor, parameter)) = place else {
            return changed;
        };
        let covariate = self.terms[0][factor].covariate.clone();
        for atom in changed.terms.iter_mut().flatten() {
            if atom.covariate == covariate
                && let Some(own) = atom.parameters.get_mut(parameter)
            {
                own.value = value;
            }
        }
        changed
    }

    /// The candidate, if it is a product of two, with one of the factors as another term; if it is a function of one covariate,
    /// polynomials of that instead, in which the zero of the covariate does not matter.
    pub fn extensions(&self) -> Vec<Self> {
        let with = |terms: Vec<Vec<Atom>>| Self { terms, own: Vec::new(), ..self.clone() };
        match &self.terms[..] {
            [term] if term.len() == 2 => {
                term.iter().map(|factor| with(vec![term.clone(), vec![factor.clone()]])).collect()
            }
            [term] if term.len() == 1 => {
                let polynomials = term[0].polynomials().into_iter();
                polynomials
                    .map(|powers| with(powers.into_iter().map(|one| vec![one]).collect()))
                    .collect()
            }
            _ => Vec::new(),
        }
    }

    /// Columns at each sensor.
    pub fn columns(
        &self,
        setup: &FitSetup,
        scan: &Scan,
        points: &[ChainPoint],
        windows: &[Vec<Windows>],
    ) -> Columns {
        let sensors = (0..scan.rows.len()).into_par_iter();
        sensors.map(|sensor| self.columns_of(sensor, setup, scan, points, windows)).collect()
    }

    /// Columns at one sensor.
    pub fn columns_of(
        &self,
        sensor: usize,
        setup: &FitSetup,
        scan: &Scan,
        points: &[ChainPoint],
        windows: &[Vec<Windows>],
    ) -> DMatrix<f64> {
        let own = self.own.get(sensor).into_iter().flatten().enumerate();
        let at = own.fold(self.clone(), |at, (index, value)| at.with_nonlinear(index, *value));
        let of_term = |term: &Vec<Atom>| {
            let mut values = Vec::with_capacity(scan.rows[sensor].count());
            for (series, windows) in excitations(setup, sensor).zip(&windows[sensor]) {
                let mut product = vec![1.0; series.len()];
                for atom in term {
                    let Some(own) = atom.values(series) else { continue };
                    product.iter_mut().zip(own).for_each(|(product, value)| *product *= value);
                }
                values.extend(averaged(&product, windows));
            }
            values
        };
        let terms: Vec<Vec<f64>> = at.terms.iter().map(of_term).collect();
        columns_at(&scan.rows[sensor], &terms, &self.points, points)
    }

    /// As user-defined effects, one for each point of the chain: with the nonlinear parameters as numbers, or with a range to
    /// be fitted, as always where they differ between sensors.
    ///
    /// # Errors
    /// The text exceeds the limits of formulas.
    pub fn effects(&self, name: &str, has_ranges: bool) -> Result<Vec<EffectTerm>> {
        let has_ranges = has_ranges || !self.own.is_empty();
        self.points.iter().map(|point| self.effect(*point, name, has_ranges)).collect()
    }

    fn effect(&self, point: ChainPoint, name: &str, has_ranges: bool) -> Result<EffectTerm> {
        let mut ranges = Vec::new();
        let mut terms = Vec::new();
        // Of the values at all sensors, or the one that they share.
        let span = |index: usize, value: f64| {
            let own = || self.own.iter().filter_map(|own| own.get(index).copied());
            (own().fold(value, f64::min), own().fold(value, f64::max))
        };
        let (target, load) = point.target();
        // A command has one range for each name: those of the second formula are p2, q2 and so on.
        let number = name.rsplit('_').next().filter(|number| number.parse::<u32>().is_ok());
        let suffix = number.filter(|number| *number != "1").unwrap_or_default();
        for (term, coefficient) in self.terms.iter().zip(COEFFICIENTS) {
            let mut factors = vec![coefficient.to_owned()];
            factors.extend(load.map(str::to_owned));
            let mut used = 0;
            for atom in term {
                let own: Vec<String> = if has_ranges {
                    let names = NONLINEAR.iter().skip(used).take(atom.parameters.len());
                    names.map(|name| format!("{name}{suffix}")).collect()
                } else {
                    Vec::new()
                };
                for (index, (name, parameter)) in own.iter().zip(&atom.parameters).enumerate() {
                    if ranges.iter().all(|range: &ParameterRange| range.name != *name) {
                        let values = span(used + index, parameter.value);
                        ranges.push(range_of(name, *parameter, values));
                    }
                }
                used += own.len();
                factors.push(atom.text(&mut own.into_iter()));
            }
            terms.push(factors.join("*"));
        }
        let name = match self.points.len() {
            1 => name.to_owned(),
            _ => format!("{name}_{target}"),
        };
        let text = format!("{name}: {target} = {}", terms.join(" + "));
        let covariates = Expression::covariate_names(&text);
        let expression = Expression::parse(&text, &ranges, &covariates)
            .map_err(|error| anyhow::anyhow!("{error}"))
            .context("a discovered formula is not valid")?;
        Ok(EffectTerm::Expression(Arc::new(expression)))
    }
}

/// Columns of these terms at `own` points of the chain, scaled to terms of unit mean square.
pub fn columns_at(
    rows: &SensorRows,
    terms: &[Vec<f64>],
    own: &[ChainPoint],
    points: &[ChainPoint],
) -> DMatrix<f64> {
    let places: Vec<usize> =
        own.iter().filter_map(|point| points.iter().position(|other| other == point)).collect();
    let mut columns = Vec::with_capacity(3 * rows.count() * terms.len() * places.len());
    for values in terms {
        let squares: f64 = values.iter().map(|value| value * value).sum();
        let scale = (squares / values.len().max(1) as f64).sqrt().max(f64::MIN_POSITIVE);
        for place in &places {
            let pattern = rows.patterns[*place].as_slice().chunks_exact(3);
            for (pattern, value) in pattern.zip(values) {
                columns.extend(pattern.iter().map(|entry| entry * value / scale));
            }
        }
    }
    DMatrix::from_vec(3 * rows.count(), terms.len() * places.len(), columns)
}

/// Range around the values of a nonlinear parameter.
fn range_of(name: &str, parameter: Nonlinear, (least, most): (f64, f64)) -> ParameterRange {
    let half = 0.5 * RANGE * (parameter.to - parameter.from);
    // Positive parameters stay positive.
    let from =
        (least - half).max(if parameter.from > 0.0 { 0.5 * least } else { f64::NEG_INFINITY });
    ParameterRange {
        name: name.to_owned(),
        from: round_significant(from, 4),
        to: round_significant(most + half, 4),
    }
}
