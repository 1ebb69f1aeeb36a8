//! Units of a formula's coefficients: the unit of its target per that of the covariates in the coefficient's term.

use super::{Expression, TimeConstant};
use crate::recordings::units::{column_unit, symbol};

/// Values of a covariate at which the power with which a term depends on it is determined: positive, away from zero, in even steps
/// that are no simple fraction of a period.
const AT: [f64; 6] = [1.0, 1.87, 2.74, 3.61, 4.48, 5.35];
/// Relative deviation up to which two numbers are equal.
const EQUAL: f64 = 1e-9;

impl Expression {
    /// Unit of each coefficient. A covariate inside of a function such as `sin` adds none.
    pub(super) fn coefficient_units(&self) -> Vec<String> {
        (0..self.coefficients.len()).map(|coefficient| self.coefficient_unit(coefficient)).collect()
    }

    /// Unit of a nonlinear parameter: of a time constant seconds, of one by which a covariate is divided, such as a period, that of the
    /// covariate; empty for others.
    pub(super) fn shape_unit(&self, shape: usize) -> &'static str {
        if self.inputs.iter().any(|input| input.lag == Some(TimeConstant::Shape(shape))) {
            return "s";
        }
        let coefficients = vec![1.0; self.coefficients.len()];
        // With this parameter, this input, or both scaled.
        let value = |place: usize, at: f64, scale: [f64; 2]| {
            let range = |(i, range): (usize, &super::ParameterRange)| {
                let value = 0.5 * (range.from + range.to);
                if i == shape { scale[0] * value } else { value }
            };
            let shapes: Vec<f64> = self.ranges.iter().enumerate().map(range).collect();
            let input = |i: usize| super::Values::Same(if i == place { scale[1] * at } else { at });
            let inputs: Vec<_> = (0..self.inputs.len()).map(input).collect();
            self.evaluate(&coefficients, &shapes, &inputs).at(0)
        };
        let scales = |place: usize| {
            let is_equal = |at: f64, scale: [f64; 2]| {
                let (one, other) = (value(place, at, [1.0; 2]), value(place, at, scale));
                (one - other).abs() <= EQUAL * one.abs()
            };
            AT.iter().all(|at| is_equal(*at, [1.7, 1.7]))
                && !AT.iter().all(|at| is_equal(*at, [1.7, 1.0]))
        };
        let place = (0..self.inputs.len()).find(|place| scales(*place));
        place.map_or("", |place| unit_of(&self.covariates[self.inputs[place].covariate]))
    }

    fn coefficient_unit(&self, coefficient: usize) -> String {
        let mut powers: Vec<(&str, i32)> = Vec::new();
        for (place, input) in self.inputs.iter().enumerate() {
            let unit = unit_of(&self.covariates[input.covariate]);
            let power = self.power(coefficient, place);
            match powers.iter_mut().find(|(own, _)| *own == unit) {
                Some((_, total)) => *total += power,
                None => powers.push((unit, power)),
            }
        }
        quotient(self.target.unit, &powers)
    }

    /// Power of an input in the term of a coefficient; zero where it is none.
    fn power(&self, coefficient: usize, place: usize) -> i32 {
        let coefficients: Vec<f64> =
            (0..self.coefficients.len()).map(|i| f64::from(u8::from(i == coefficient))).collect();
        let shapes: Vec<f64> =
            self.ranges.iter().map(|range| 0.5 * (range.from + range.to)).collect();
        let term = |at: f64| {
            let values = (0..self.inputs.len()).map(|i| {
                // Irrational, so that no term vanishes.
                super::Values::Same(if i == place { at } else { std::f64::consts::SQRT_2 })
            });
            self.evaluate(&coefficients, &shapes, &values.collect::<Vec<_>>()).at(0)
        };
        let values = AT.map(term);
        let size = values.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
        if !size.is_finite() || size == 0.0 {
            return 0;
        }
        // A polynomial's differences vanish above its degree.
        let mut differences = values.to_vec();
        for degree in 0..4 {
            differences = differences.windows(2).map(|pair| pair[1] - pair[0]).collect();
            if differences.iter().all(|difference| difference.abs() < EQUAL * size) {
                return degree;
            }
        }
        let reciprocal = |power: i32| {
            let scaled = values.iter().zip(AT).map(|(value, at)| value * at.powi(power));
            let scaled: Vec<f64> = scaled.collect();
            scaled.iter().all(|value| (value - scaled[0]).abs() < EQUAL * scaled[0].abs())
        };
        (1..=2).find(|power| reciprocal(*power)).map_or(0, |power| -power)
    }
}

/// Unit of a covariate; a difference of temperatures is in kelvin.
fn unit_of(covariate: &str) -> &'static str {
    if let Some(rest) = covariate.strip_suffix("_per_s") {
        return if rest.ends_with("_n") { "N/s" } else { "mm/s" };
    }
    match column_unit(covariate) {
        Some("c" | "k") => "K",
        Some("us") => "us",
        Some("ratio") | None if !covariate.ends_with("_s") => "",
        None => "s",
        Some(unit) => symbol(unit).unwrap_or(unit),
    }
}

/// A unit over powers of others, as in `um/(N K)`.
fn quotient(unit: &str, powers: &[(&str, i32)]) -> String {
    let with_power = |unit: &str, power: i32| {
        let unit = if unit.contains(['/', ' ']) { format!("({unit})") } else { unit.to_owned() };
        if power == 1 { unit } else { format!("{unit}^{power}") }
    };
    let side = |sign: i32| {
        let own = powers.iter().filter(|(unit, power)| !unit.is_empty() && sign * power > 0);
        own.map(|(unit, power)| with_power(unit, sign * power)).collect::<Vec<_>>()
    };
    let over = [vec![unit.to_owned()], side(-1)].concat().join(" ");
    match side(1).as_slice() {
        [] => over,
        [one] => format!("{over}/{one}"),
        many => format!("{over}/({})", many.join(" ")),
    }
}
