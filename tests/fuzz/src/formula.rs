//! Formulas of user-defined effects, compared with a second parser and evaluator.

use std::collections::BTreeMap;

use model_export::effects::ExcitationSeries;
use model_export::effects::expression::{Expression, ParameterRange};

use super::bytes::{Bytes, change};

/// Limits of formulas, from the documentation.
const MAX_BYTES: usize = 1000;
const MAX_OPERATORS: usize = 64;
const MAX_DEPTH: usize = 16;
const MAX_PARAMETERS: usize = 16;

/// Depth of generated terms.
const DEPTH: u32 = 4;
const TARGETS: [&str; 12] = [
    "fx_n",
    "fz_n",
    "dx_um",
    "dy_um",
    "dz_um",
    "bx_g",
    "by_g",
    "bz_g",
    "gain_y_percent",
    "rotation_x_mrad",
    "tilt_z_mrad",
    "fy_n",
];
const COLUMNS: [&str; 3] = ["opening_mm", "motor_iq_a", "accel_x_mps2"];
/// Variables of terms: covariates, ranges, constants; also names that resemble functions.
const VARIABLES: [&str; 10] = [
    "opening_mm",
    "motor_iq_a",
    "fx_n",
    "time_s",
    "temp_c",
    "p",
    "lnq",
    "pi",
    "lag(opening_mm,2)",
    "lag( temp_c , p)",
];
const COEFFICIENTS: [&str; 12] =
    ["a", "b", "c", "e", "E", "PI", "TAU", "min", "cbrt", "sina", "e1", "_k"];
const FUNCTIONS: [&str; 16] = [
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "ln", "log2",
    "log10", "sqrt", "abs", "signum",
];
const NUMBERS: [&str; 10] = ["2", "0.5", "1e3", "1.5e-2", "3", "0", "10", "1E1", ".25", "7."];

/// Results of a formula.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub accepted: u32,
    pub refused: u32,
    /// Values that were compared.
    pub compared: u32,
    /// Operators and functions of accepted formulas.
    pub operators: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<4> {
        [
            ("accepted", self.accepted),
            ("refused", self.refused),
            ("compared", self.compared),
            ("operators", self.operators),
        ]
    }
}

/// One formula: parsed, printed, parsed again, and evaluated.
pub fn parse(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let mut tally = Tally::default();
    let kind = bytes.byte();
    let text = match kind & 15 {
        0 => String::from_utf8_lossy(bytes.some(2000)).into_owned(),
        _ => formula(kind, &mut bytes),
    };
    let ranges: Vec<ParameterRange> = [("p", 2.0, 5.0), ("lnq", -0.5, 3.0)]
        .into_iter()
        .filter(|(name, ..)| words(&text).any(|word| word == *name))
        .map(|(name, from, to)| ParameterRange { name: name.to_owned(), from, to })
        .collect();
    let columns = COLUMNS.map(str::to_owned);
    let expression = match Expression::parse(&text, &ranges, &columns) {
        Ok(expression) => expression,
        Err(error) => {
            let message = error.to_string();
            assert!(message.lines().count() >= 3, "{message}");
            tally.refused = 1;
            return tally;
        }
    };
    tally.accepted = 1;
    let parsed = Reference::parse(&without_lags(&text))
        .unwrap_or_else(|| panic!("accepted, but not by the second parser: {text}"));
    let parameters = expression.parameters();
    assert!(text.len() <= MAX_BYTES && parsed.depth <= MAX_DEPTH, "{text}");
    assert!(parsed.operators <= MAX_OPERATORS && parameters.len() <= MAX_PARAMETERS, "{text}");
    tally.operators = parsed.operators as u32;

    // As a model file stores and reads it.
    let covariates = Expression::covariate_names(&expression.text);
    let again = Expression::parse(&expression.text, &ranges, &covariates);
    let again = again.unwrap_or_else(|error| panic!("refused when read again: {error}"));
    assert_eq!(
        (&again.text, &again.name, &again.covariates, &again.ranges),
        (&expression.text, &expression.name, &expression.covariates, &expression.ranges)
    );
    let names = |all: &Expression| -> Vec<String> {
        all.parameters().iter().map(|parameter| parameter.name.to_string()).collect()
    };
    assert_eq!(names(&again), names(&expression));

    let names = names(&expression);
    for _ in 0..4 {
        let mut number = |_: &String| f64::from(bytes.word() as i16) / 4096.0;
        let mut values: Vec<f64> = names.iter().map(&mut number).collect();
        // A fit keeps these parameters within their ranges.
        for range in &ranges {
            for (_, value) in names.iter().zip(&mut values).filter(|(name, _)| **name == range.name)
            {
                *value = range.from + (*value / 16.0 + 0.5) * (range.to - range.from);
            }
        }
        let at: Vec<f64> = expression.covariates.iter().map(&mut number).collect();
        let (mut value, axis) = expression.value(&values, &at);
        let (mut repeated, _) = again.value(&values, &at);
        if expression.has_memory() {
            let Some(series) = constant(&expression.covariates, &at) else { continue };
            let last = |formula: &Expression| formula.series(&values, &series).map(|all| all[1]);
            (value, repeated) =
                (last(&expression).unwrap_or(f64::NAN), last(&again).unwrap_or(f64::NAN));
        }
        assert!(value.to_bits() == repeated.to_bits() || (value.is_nan() && repeated.is_nan()));
        assert!(axis < 3);
        let all = names.iter().zip(&values).chain(expression.covariates.iter().zip(&at));
        let all: BTreeMap<&str, f64> = all.map(|(name, value)| (name.as_str(), *value)).collect();
        let expected = parsed.tree.evaluate(&all);
        // Where rounding can change the value by any amount, nothing can be compared.
        if expected.error.is_finite() && expected.value.is_finite() {
            let difference = (value - expected.value).abs();
            assert!(
                difference <= 1e3 * expected.error,
                "{text}: {value} instead of {} +- {} at {all:?}",
                expected.value,
                expected.error
            );
            tally.compared += 1;
        }
    }
    tally
}

/// The text with the covariate in place of each lag, which it equals where nothing changes.
fn without_lags(text: &str) -> String {
    let (mut plain, mut rest) = (String::new(), text);
    while let Some(at) = rest.find("lag(") {
        let (before, call) = rest.split_at(at);
        let is_whole = !before.ends_with(|c: char| c.is_ascii_alphanumeric() || c == '_');
        plain.push_str(before);
        match call[4..].split_once(')').filter(|_| is_whole) {
            Some((arguments, after)) => {
                plain.push_str(arguments.split(',').next().unwrap_or_default().trim());
                rest = after;
            }
            None => {
                plain.push_str("lag(");
                rest = &call[4..];
            }
        }
    }
    plain + rest
}

/// Two rows with these values of the covariates; `None` where one of them cannot be constant.
fn constant(covariates: &[String], values: &[f64]) -> Option<ExcitationSeries> {
    let mut series = ExcitationSeries {
        time_s: vec![0.0, 1.0],
        force_n: vec![[0.0; 2]; 2],
        ..ExcitationSeries::default()
    };
    for (name, value) in covariates.iter().zip(values) {
        match name.as_str() {
            "fx_n" => series.force_n.iter_mut().for_each(|force| force[0] = *value),
            "fz_n" => series.force_n.iter_mut().for_each(|force| force[1] = *value),
            "temp_c" => series.temperature_c = vec![*value; 2],
            own if COLUMNS.contains(&own) => {
                series.covariates.insert(name.clone(), vec![*value; 2]);
            }
            _ => return None,
        }
    }
    Some(series)
}

/// Names and numbers of a text.
fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))
}

/// A formula that is valid in most cases: a sum of coefficients times terms.
fn formula(kind: u8, bytes: &mut Bytes) -> String {
    let name = ["ripple", "r2_mm", "height_mm", "x"][usize::from(kind >> 4 & 3)];
    let target = TARGETS[usize::from(bytes.byte()) % TARGETS.len()];
    let mut text = format!("{name}: {target} = ");
    for number in 0..=bytes.byte() % 3 {
        let choice = bytes.byte();
        let coefficient = COEFFICIENTS[usize::from(choice) % COEFFICIENTS.len()];
        if number > 0 {
            text += if choice & 64 == 0 { " + " } else { "-" };
        }
        text += coefficient;
        text += if choice & 128 == 0 { "*" } else { "/" };
        term(DEPTH, bytes, &mut text);
    }
    // Any change of a few characters.
    if kind & 15 == 1 {
        for _ in 0..=bytes.byte() % 3 {
            change(&mut text, bytes);
        }
    }
    text
}

fn term(depth: u32, bytes: &mut Bytes, text: &mut String) {
    let kind = bytes.byte();
    let choice = usize::from(kind >> 3);
    match kind & 7 {
        0 => *text += NUMBERS[choice % NUMBERS.len()],
        1 | 2 => *text += VARIABLES[choice % VARIABLES.len()],
        _ if depth == 0 => *text += VARIABLES[choice % VARIABLES.len()],
        3 => {
            *text += "(";
            term(depth - 1, bytes, text);
            *text += ")";
        }
        4 => {
            *text += "-";
            term(depth - 1, bytes, text);
        }
        5 => {
            *text += FUNCTIONS[choice % FUNCTIONS.len()];
            *text += "(";
            term(depth - 1, bytes, text);
            *text += ")";
        }
        _ => {
            term(depth - 1, bytes, text);
            *text += ["+", "-", "*", "/", "^", " + ", " * "][choice % 7];
            term(depth - 1, bytes, text);
        }
    }
}

/// A value with a bound of its rounding errors.
#[derive(Clone, Copy)]
struct Rounded {
    value: f64,
    error: f64,
}

#[derive(Debug)]
enum Tree {
    Number(f64),
    Name(String),
    Negative(Box<Tree>),
    Call(String, Box<Tree>),
    Binary(u8, Box<Tree>, Box<Tree>),
}

/// A formula by the usual precedence: powers, from the right; signs; products; sums.
struct Reference {
    tree: Tree,
    operators: usize,
    depth: usize,
}

impl Reference {
    fn parse(text: &str) -> Option<Self> {
        let (_, formula) = text.split_once('=')?;
        let mut parser = Parser { rest: formula, operators: 0, open: 0, depth: 0 };
        let tree = parser.sum()?;
        let Parser { rest, operators, depth, .. } = parser;
        rest.trim().is_empty().then_some(Self { tree, operators, depth })
    }
}

struct Parser<'a> {
    rest: &'a str,
    operators: usize,
    open: usize,
    depth: usize,
}

impl Parser<'_> {
    fn take(&mut self, any_of: &[u8]) -> Option<u8> {
        self.rest = self.rest.trim_start();
        let byte = *self.rest.as_bytes().first()?;
        any_of.contains(&byte).then(|| self.rest = &self.rest[1..])?;
        Some(byte)
    }

    fn sum(&mut self) -> Option<Tree> {
        let mut tree = self.product()?;
        while let Some(operator) = self.take(b"+-") {
            self.operators += 1;
            tree = Tree::Binary(operator, Box::new(tree), Box::new(self.product()?));
        }
        Some(tree)
    }

    fn product(&mut self) -> Option<Tree> {
        let mut tree = self.signed()?;
        while let Some(operator) = self.take(b"*/") {
            self.operators += 1;
            tree = Tree::Binary(operator, Box::new(tree), Box::new(self.signed()?));
        }
        Some(tree)
    }

    fn signed(&mut self) -> Option<Tree> {
        match self.take(b"+-") {
            Some(sign) => {
                self.operators += 1;
                let tree = self.signed()?;
                Some(if sign == b'-' { Tree::Negative(Box::new(tree)) } else { tree })
            }
            None => self.power(),
        }
    }

    fn power(&mut self) -> Option<Tree> {
        let base = self.value()?;
        match self.take(b"^") {
            Some(operator) => {
                self.operators += 1;
                Some(Tree::Binary(operator, Box::new(base), Box::new(self.signed()?)))
            }
            None => Some(base),
        }
    }

    fn value(&mut self) -> Option<Tree> {
        if self.take(b"(").is_some() {
            return self.bracket();
        }
        let word = self.rest.bytes().take_while(|b| b.is_ascii_alphanumeric() || *b == b'_');
        let length = word.count();
        if self.rest.starts_with(|c: char| c.is_ascii_digit() || c == '.') {
            return self.number();
        }
        let (name, rest) = self.rest.split_at(length);
        if name.is_empty() {
            return None;
        }
        self.rest = rest;
        if self.take(b"(").is_some() {
            self.operators += 1;
            return Some(Tree::Call(name.to_owned(), Box::new(self.bracket()?)));
        }
        Some(Tree::Name(name.to_owned()))
    }

    fn bracket(&mut self) -> Option<Tree> {
        self.open += 1;
        self.depth = self.depth.max(self.open);
        let tree = self.sum()?;
        self.take(b")")?;
        self.open -= 1;
        Some(tree)
    }

    fn number(&mut self) -> Option<Tree> {
        // The longest prefix that is a number.
        let is_part = |b: &u8| b.is_ascii_digit() || b".eE+-".contains(b);
        let longest = self.rest.bytes().take_while(|b| is_part(b)).count();
        let parsed = (1..=longest).rev().find_map(|length| {
            let number: f64 = self.rest[..length].parse().ok()?;
            Some((number, length))
        });
        let (number, length) = parsed?;
        self.rest = &self.rest[length..];
        Some(Tree::Number(number))
    }
}

impl Tree {
    fn evaluate(&self, values: &BTreeMap<&str, f64>) -> Rounded {
        match self {
            Self::Number(value) => Rounded { value: *value, error: 0.0 },
            Self::Name(name) if name == "pi" => Rounded { value: std::f64::consts::PI, error: 0.0 },
            Self::Name(name) => {
                let value = values.get(name.as_str());
                Rounded { value: *value.expect("each name has a value"), error: 0.0 }
            }
            Self::Negative(tree) => {
                let Rounded { value, error } = tree.evaluate(values);
                Rounded { value: -value, error }
            }
            Self::Call(name, tree) => {
                let at = tree.evaluate(values);
                bounded(&[at], |at| function(name, at[0]))
            }
            Self::Binary(operator, left, right) => {
                let at = [left.evaluate(values), right.evaluate(values)];
                bounded(&at, |at| match operator {
                    b'+' => at[0] + at[1],
                    b'-' => at[0] - at[1],
                    b'*' => at[0] * at[1],
                    b'/' => at[0] / at[1],
                    _ => at[0].powf(at[1]),
                })
            }
        }
    }
}

/// Value of a function with a bound of its error: the differences at the ends of its arguments' errors, and its own rounding.
fn bounded(at: &[Rounded], function: impl Fn(&[f64]) -> f64) -> Rounded {
    let middle: Vec<f64> = at.iter().map(|at| at.value).collect();
    let value = function(&middle);
    let mut error = 0.0;
    for corner in 0..1 << at.len() {
        let ends: Vec<f64> =
            at.iter()
                .enumerate()
                .map(|(number, at)| {
                    if corner >> number & 1 == 0 {
                        at.value - at.error
                    } else {
                        at.value + at.error
                    }
                })
                .collect();
        let difference = (function(&ends) - value).abs();
        // A maximum would leave out what is not a number.
        error = if difference > error || difference.is_nan() { difference } else { error };
    }
    Rounded { value, error: error + f64::EPSILON * value.abs() + f64::MIN_POSITIVE }
}

fn function(name: &str, at: f64) -> f64 {
    match name {
        "sin" => at.sin(),
        "cos" => at.cos(),
        "tan" => at.tan(),
        "asin" => at.asin(),
        "acos" => at.acos(),
        "atan" => at.atan(),
        "sinh" => at.sinh(),
        "cosh" => at.cosh(),
        "tanh" => at.tanh(),
        "exp" => at.exp(),
        "ln" => at.ln(),
        "log2" => at.log2(),
        "log10" => at.log10(),
        "sqrt" => at.sqrt(),
        "abs" => at.abs(),
        "signum" => at.signum(),
        other => panic!("a function that the documentation does not list: {other}"),
    }
}
