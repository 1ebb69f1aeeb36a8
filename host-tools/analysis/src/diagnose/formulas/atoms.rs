//! Functions of one covariate from which formulas are made, as text and as values. The values are those of the text,
//! by the evaluator of user-defined effects.

use model_export::effects::expression::ParameterRange;
use model_export::effects::{ExcitationSeries, Expression};
use model_export::recordings::columns::{Axis, ForceColumn, force_column};
use model_export::recordings::units::round_significant;

use crate::diagnose::formulas::harmonics::{TURN, USUAL};

/// Highest number of periods within the travel of the opening, and the step of the search.
const PERIODS: (f64, f64) = (40.0, 0.5);
/// Covariates whose past matters: warming, relaxation. With a lag, and without what the lag follows.
const LAGGED: [&str; 5] = ["temp_c", "motor_iq_a", "fx_n", "fz_n", "opening_mm"];
/// Times: drift and relaxation only.
const TIMES: [&str; 2] = ["time_s", "session_s"];
/// Time constants in seconds at which the search for that of a lag starts.
const TIME_CONSTANTS: [f64; 5] = [0.3, 1.2, 5.0, 20.0, 80.0];
/// Shortest period in mm.
const MIN_PERIOD: f64 = 0.8;

/// A function of one covariate.
#[derive(Clone, Debug, PartialEq)]
pub struct Atom {
    pub covariate: String,
    /// Text, with `p` and `q` for the nonlinear parameters.
    text: String,
    /// Nonlinear parameters with their bounds.
    pub parameters: Vec<Nonlinear>,
    /// Complexity: one for the covariate itself.
    pub complexity: f64,
    /// The other phase of a harmonic, by its text.
    partner: Option<String>,
    /// Whether it is multiplied with functions of other covariates.
    pub is_factor: bool,
}

/// A nonlinear parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nonlinear {
    pub value: f64,
    /// Lower bound.
    pub from: f64,
    /// Upper bound.
    pub to: f64,
}

/// Names of nonlinear parameters in the text of an atom.
const PARAMETER_NAMES: [&str; 2] = ["p", "q"];

impl Atom {
    fn new(covariate: &str, text: &str, complexity: f64) -> Self {
        Self {
            covariate: covariate.to_owned(),
            text: replace_name(text, "x", covariate),
            parameters: Vec::new(),
            complexity,
            partner: None,
            is_factor: false,
        }
    }

    fn with(mut self, parameters: &[(f64, f64, f64)]) -> Self {
        let parameter = |&(value, from, to): &(f64, f64, f64)| Nonlinear { value, from, to };
        self.parameters = parameters.iter().map(parameter).collect();
        self
    }

    fn factor(mut self) -> Self {
        self.is_factor = true;
        self
    }

    /// With the other phase of a harmonic.
    fn phase(mut self, other: &str) -> Self {
        self.partner = Some(replace_name(other, "x", &self.covariate));
        self
    }

    /// The other phase of a harmonic, with the same parameters.
    pub fn partner(&self) -> Option<Self> {
        let text = self.partner.clone()?;
        Some(Self { partner: Some(self.text.clone()), text, ..self.clone() })
    }

    /// Powers of the covariate that are polynomials together; none of a time or of an angle.
    pub fn polynomials(&self) -> Vec<Vec<Self>> {
        if TIMES.contains(&self.covariate.as_str()) || self.covariate.ends_with("_rad") {
            return Vec::new();
        }
        let [linear, square, cube] = powers(&self.covariate);
        vec![
            vec![square.clone(), linear.clone()],
            vec![cube.clone(), linear.clone()],
            vec![cube, square, linear],
        ]
    }

    /// Text with the parameters as numbers, or with names: those of `names` in their order.
    pub fn text(&self, names: &mut dyn Iterator<Item = String>) -> String {
        let mut text = self.text.clone();
        for (own, parameter) in PARAMETER_NAMES.iter().zip(&self.parameters) {
            let value = names
                .next()
                .unwrap_or_else(|| format!("{}", round_significant(parameter.value, 6)));
            text = replace_name(&text, own, &value);
        }
        // Of negative parameters.
        text.replace("--", "+").replace("+-", "-")
    }

    /// Values over the rows of a series; `None` where the covariate was not recorded or a value is not finite.
    pub fn values(&self, series: &ExcitationSeries) -> Option<Vec<f64>> {
        let ranges: Vec<ParameterRange> = PARAMETER_NAMES
            .iter()
            .zip(&self.parameters)
            .map(|(name, parameter)| ParameterRange {
                name: (*name).to_owned(),
                from: parameter.from,
                to: parameter.to,
            })
            .collect();
        let text = format!("atom: by_g = a*({})", self.text);
        let expression =
            Expression::parse(&text, &ranges, &Expression::covariate_names(&text)).ok()?;
        let mut values = vec![1.0];
        values.extend(self.parameters.iter().map(|parameter| parameter.value));
        let all = expression.series(&values, series)?;
        all.iter().all(|value| value.is_finite()).then_some(all)
    }
}

/// Replaces a whole name in a formula.
fn replace_name(text: &str, name: &str, value: &str) -> String {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let mut replaced = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(name) {
        let (before, after) = (&rest[..at], &rest[at + name.len()..]);
        let is_whole = !before.ends_with(is_name) && !after.starts_with(is_name);
        replaced.push_str(before);
        replaced.push_str(if is_whole { value } else { name });
        rest = after;
    }
    replaced + rest
}

/// Range of a covariate over all recordings: 2nd and 98th percentile.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Span {
    /// Of values in any order.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        let quantile =
            |q: f64| values.get((q * (values.len().max(1) - 1) as f64) as usize).copied();
        let span = Self { low: quantile(0.02)?, high: quantile(0.98)? };
        (span.high > span.low).then_some(span)
    }

    fn width(self) -> f64 {
        self.high - self.low
    }

    /// Whether zero is well within.
    fn is_signed(self) -> bool {
        -self.low > 0.1 * self.width() && self.high > 0.1 * self.width()
    }

    /// Whether the values differ little, relative to their distance from zero.
    fn is_far_from_zero(self) -> bool {
        self.low.abs().min(self.high.abs()) > 1.5 * self.width() && self.low * self.high > 0.0
    }

    fn at(self, fraction: f64) -> f64 {
        self.low + fraction * self.width()
    }
}

/// All functions of a covariate; those of [`TURN`] are its `harmonics`, and [`USUAL`] are multiplied with other covariates.
pub fn atoms_of(covariate: &str, span: Span, harmonics: &[u32], longest_s: f64) -> Vec<Atom> {
    if covariate == TURN {
        let mut atoms = angle_atoms(covariate, &USUAL, true);
        let further = harmonics.iter().copied().filter(|one| !USUAL.contains(one));
        atoms.extend(angle_atoms(covariate, &further.collect::<Vec<u32>>(), false));
        return atoms;
    }
    let atom = |text: &str, complexity: f64| Atom::new(covariate, text, complexity);
    if force_of_another(covariate).is_some() {
        // What it bends or displaces here is small, and so in proportion.
        return vec![atom("x", 1.0)];
    }
    if TIMES.contains(&covariate) {
        // Drift and relaxation only: any other function of time imitates what nobody recorded.
        let relaxations = [0.3, 0.8, 2.0, 5.0, 12.0];
        let relaxations =
            relaxations.map(|tau| atom("exp(-x/p)", 1.5).with(&[(tau, 0.4 * tau, 2.5 * tau)]));
        let mut atoms = vec![atom("x", 1.0).factor(), atom("x^2", 1.2)];
        atoms.extend(relaxations);
        return atoms;
    }
    let middle = round_significant(span.at(0.5), 2);
    let [linear, square, cube] = powers(covariate);
    let linear = if span.is_far_from_zero() {
        // The product with a force would be a stiffness for the most part, which the model has.
        atom(&format!("(x-{middle})"), linear.complexity)
    } else {
        linear
    };
    let mut atoms = vec![linear.factor(), square.factor(), cube];
    let scale = span.high.max(-span.low);
    if span.is_signed() {
        atoms.push(atom("abs(x)", 1.2).factor());
        atoms.push(if covariate.contains("rate") {
            atom("signum(x)", 1.3).factor()
        } else {
            atom("signum(x)", 1.3)
        });
        atoms.push(atom("signum(x)*sqrt(abs(x))", 1.4));
        atoms.push(atom("sqrt(abs(x))", 1.5));
        atoms.push(atom("x*abs(x)", 1.4));
        for fraction in [0.15, 0.3, 0.6] {
            let p = fraction * scale;
            atoms.push(atom("tanh(x/p)", 1.5).with(&[(p, 0.02 * scale, 2.0 * scale)]));
        }
        for fraction in [0.15, 0.3, 0.45, 0.6] {
            let p = fraction * scale;
            let text = "(x-0.5*(abs(x+p)-abs(x-p)))";
            atoms.push(atom(text, 1.6).with(&[(p, 0.05 * scale, 0.85 * scale)]));
        }
    } else if !span.is_far_from_zero() {
        atoms.push(atom(&format!("(x-{middle})"), 1.1).factor());
    }
    for fraction in [0.1, 0.25, 0.4, 0.55, 0.7, 0.85] {
        let (p, half) = (span.at(fraction), 0.15 * span.width());
        let within = [(p, p - half, p + half)];
        atoms.push(atom("(x-p+abs(x-p))", 1.6).with(&within));
        atoms.push(atom("(p-x+abs(x-p))", 1.6).with(&within));
        atoms.push(atom("signum(x-p)", 1.6).with(&within));
    }
    for fraction in [0.15, 0.325, 0.5, 0.675, 0.85] {
        let w = span.width();
        let (m, b) = (span.at(fraction), 0.2 * w);
        let bounds = [(m, span.low, span.high), (b, 0.03 * w, 0.5 * w)];
        atoms.push(atom("exp(-(((x-p)/q)^2))", 1.8).with(&bounds));
        let bounds = [(m, span.low, span.high), (0.08 * w, 0.01 * w, 0.3 * w)];
        atoms.push(atom("tanh((x-p)/q)", 1.8).with(&bounds));
    }
    if covariate.ends_with("_rad") {
        let is_factor = covariate == "yaw_rad";
        atoms.extend(angle_atoms(covariate, &[1, 2], is_factor));
        for twice in 5..=16 {
            let per_turn = 0.5 * f64::from(twice);
            let bounds = [(per_turn, per_turn - 0.5, per_turn + 0.5)];
            for (text, other) in [("sin(p*x)", "cos(p*x)"), ("cos(p*x)", "sin(p*x)")] {
                atoms.push(atom(text, 1.6).with(&bounds).phase(other));
            }
        }
    }
    if LAGGED.contains(&covariate) {
        // A longer time constant is not seen within a recording.
        for tau in TIME_CONSTANTS.into_iter().filter(|tau| *tau < longest_s) {
            let bounds = [(tau, 0.5 * tau, (2.0 * tau).min(longest_s))];
            atoms.push(atom("lag(x, p)", 1.7).with(&bounds));
            atoms.push(atom("(x-lag(x, p))", 1.7).with(&bounds));
        }
    }
    if covariate == "opening_mm" {
        atoms.extend(periodic_atoms(covariate, span));
    }
    atoms
}

/// Axis of a covariate that is the force on a certain sensor, and so acts on the others.
pub fn force_of_another(covariate: &str) -> Option<Axis> {
    match force_column(covariate) {
        Ok(ForceColumn::Force { axis, .. }) => Some(axis),
        _ => None,
    }
}

/// First, second and third power of a covariate.
fn powers(covariate: &str) -> [Atom; 3] {
    [("x", 1.0), ("x^2", 1.2), ("x^3", 1.4)]
        .map(|(text, complexity)| Atom::new(covariate, text, complexity))
}

/// Higher harmonics are no more complex than this one.
const HARMONIC_COMPLEXITY: u32 = 10;

fn angle_atoms(covariate: &str, harmonics: &[u32], is_factor: bool) -> Vec<Atom> {
    let mut atoms = Vec::new();
    for harmonic in harmonics {
        let argument = if *harmonic == 1 { "x".to_owned() } else { format!("{harmonic}*x") };
        let [sin, cos] = ["sin", "cos"].map(|function| format!("{function}({argument})"));
        let complexity = 1.2 + 0.02 * f64::from(*harmonic.min(&HARMONIC_COMPLEXITY));
        for (text, other) in [(&sin, &cos), (&cos, &sin)] {
            let mut atom = Atom::new(covariate, text, complexity).phase(other);
            atom.is_factor = is_factor;
            atoms.push(atom);
        }
    }
    atoms
}

/// Sines and cosines of a length, of periods in even steps of the frequency.
fn periodic_atoms(covariate: &str, span: Span) -> Vec<Atom> {
    let (most, step) = PERIODS;
    let most = most.min(span.width() / MIN_PERIOD);
    let mut atoms = Vec::new();
    let mut periods = 1.5;
    while periods <= most {
        let period = span.width() / periods;
        let bounds =
            [(period, span.width() / (periods + step), span.width() / (periods - step).max(0.5))];
        let [sin, cos] = ["sin(2*pi*x/p)", "cos(2*pi*x/p)"];
        for (text, other) in [(sin, cos), (cos, sin)] {
            atoms.push(Atom::new(covariate, text, 1.6).with(&bounds).phase(other));
        }
        periods += step;
    }
    atoms
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn opening() -> ExcitationSeries {
        let time_s: Vec<f64> = (0..200).map(|i| 0.05 * f64::from(i)).collect();
        ExcitationSeries {
            covariates: [
                ("opening_mm".to_owned(), time_s.iter().map(|t| 30.0 + 20.0 * t.sin()).collect()),
                (
                    "motor_angle_rad".to_owned(),
                    time_s.iter().map(|t| (9.0 * t) % std::f64::consts::TAU).collect(),
                ),
            ]
            .into(),
            force_n: time_s.iter().map(|t| [40.0 * (1.3 * t).cos(), 0.0]).collect(),
            time_s,
            ..ExcitationSeries::default()
        }
    }

    /// All functions of a covariate over its own range.
    fn atoms(covariate: &str) -> Vec<Atom> {
        let values = opening().covariate(covariate).unwrap();
        atoms_of(covariate, Span::of(values).unwrap(), &USUAL, 100.0)
    }

    #[test]
    fn text_with_numbers_has_the_values_of_the_atom() {
        for covariate in ["opening_mm", "motor_angle_rad", "fx_n", "time_s"] {
            for atom in atoms(covariate) {
                let text = atom.text(&mut std::iter::empty());
                let formula = format!("own: by_g = a*({text})");
                let names = [covariate.to_owned()];
                let expression = Expression::parse(&formula, &[], &names).unwrap();
                let expected = expression.series(&[1.0], &opening()).unwrap();
                let values = atom.values(&opening()).unwrap();
                // Numbers have six digits.
                for (value, expected) in values.iter().zip(&expected) {
                    assert!((value - expected).abs() < 2e-3 * (1.0 + expected.abs()), "{text}");
                }
            }
        }
    }

    #[test]
    fn texts_are_unique_and_bounds_contain_the_values() {
        for covariate in ["opening_mm", "motor_angle_rad", "fx_n", "time_s"] {
            let all = atoms(covariate);
            let texts: BTreeSet<String> =
                all.iter().map(|atom| atom.text(&mut std::iter::empty())).collect();
            assert_eq!(texts.len(), all.len(), "{covariate}");
            for parameter in all.iter().flat_map(|atom| &atom.parameters) {
                assert!(parameter.from <= parameter.value && parameter.value <= parameter.to);
            }
        }
    }

    #[test]
    fn partner_of_a_harmonic_is_its_other_phase() {
        for atom in atoms("opening_mm").iter().chain(&atoms("motor_angle_rad")) {
            let Some(partner) = atom.partner() else { continue };
            let (one, other) =
                (atom.values(&opening()).unwrap(), partner.values(&opening()).unwrap());
            for (one, other) in one.iter().zip(other) {
                assert!((one * one + other * other - 1.0).abs() < 1e-9);
            }
            assert_eq!(partner.partner().unwrap(), *atom);
        }
        assert!(atoms("fx_n").iter().all(|atom| atom.partner().is_none()));
    }

    #[test]
    fn names_are_replaced_as_a_whole() {
        assert_eq!(replace_name("exp(-x/p)*x", "x", "fx_n"), "exp(-fx_n/p)*fx_n");
        assert_eq!(replace_name("p + pi + opening_mm/p", "p", "2.5"), "2.5 + pi + opening_mm/2.5");
    }
}
