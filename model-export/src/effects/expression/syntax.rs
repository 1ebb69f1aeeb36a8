//! Syntax check of formulas with error positions, which the expression parser does not provide.

use crate::effects::CATALOGUE;
use crate::input::{
    MAX_FORMULA_BYTES, MAX_FORMULA_DEPTH, MAX_FORMULA_OPERATORS, MAX_FORMULA_PARAMETERS,
};

/// An invalid formula with the position of the error.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}\n  {text}\n  {caret}", caret = caret(text, *at))]
pub struct ExpressionError {
    text: String,
    /// Byte offset in the text.
    at: usize,
    message: String,
}

impl ExpressionError {
    pub(super) fn at(text: &str, at: usize, message: String) -> Self {
        Self { text: text.to_owned(), at, message }
    }
}

fn caret(text: &str, at: usize) -> String {
    let before = text.get(..at).unwrap_or(text).chars().count();
    " ".repeat(before) + "^"
}

/// A section of the text.
#[derive(Clone, Copy, Debug)]
pub(super) struct Section<'a> {
    pub(super) text: &'a str,
    start: usize,
}

impl<'a> Section<'a> {
    /// Another text of the same length.
    pub(super) fn with_text<'b>(&self, text: &'b str) -> Section<'b>
    where
        'a: 'b,
    {
        Section { text, start: self.start }
    }

    pub(super) fn error(&self, text: &str, message: String) -> ExpressionError {
        ExpressionError::at(text, self.start, message)
    }
}

fn trimmed(text: &str, start: usize) -> Section<'_> {
    let lead = text.len() - text.trim_start().len();
    Section { text: text.trim(), start: start + lead }
}

pub(super) struct Parts<'a> {
    pub(super) name: Section<'a>,
    pub(super) target: Section<'a>,
    pub(super) formula: Section<'a>,
}

/// `NAME: TARGET = FORMULA`.
pub(super) fn split(text: &str) -> Result<Parts<'_>, ExpressionError> {
    if text.len() > MAX_FORMULA_BYTES {
        let found = text.len();
        // Only the part that fits in a terminal.
        let start: String = text.chars().take(60).collect();
        let advice = format!(
            "the formula has {found} characters, and the limit is {MAX_FORMULA_BYTES}; divide it into several effects"
        );
        return Err(ExpressionError::at(&format!("{start}..."), 0, advice));
    }
    let shape = |at| {
        let advice =
            "write NAME: TARGET = FORMULA, for example 'ripple: dz_um = a*sin(2*pi*opening_mm/p)'";
        ExpressionError::at(text, at, advice.to_owned())
    };
    let colon = text.find(':').ok_or_else(|| shape(0))?;
    let equals = text.find('=').filter(|equals| *equals > colon).ok_or_else(|| shape(colon))?;
    let parts = Parts {
        name: trimmed(&text[..colon], 0),
        target: trimmed(&text[colon + 1..equals], colon + 1),
        formula: trimmed(&text[equals + 1..], equals + 1),
    };
    let is_name_char = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if parts.name.text.is_empty() || !parts.name.text.chars().all(is_name_char) {
        return Err(parts.name.error(text, "names consist of letters, digits and _".to_owned()));
    }
    if CATALOGUE.iter().any(|effect| effect.id == parts.name.text) {
        let advice = "the catalogue contains an effect of this name: choose another".to_owned();
        return Err(parts.name.error(text, advice));
    }
    Ok(parts)
}

/// Names in a formula with the byte offset of their first occurrence.
pub(super) struct NamePositions {
    found: Vec<(String, usize)>,
    /// Byte offset of the formula.
    pub(super) start: usize,
}

impl NamePositions {
    pub(super) fn position(&self, name: &str) -> Section<'_> {
        let at = self.found.iter().find(|(found, _)| found == name);
        Section { text: "", start: at.map_or(self.start, |(_, at)| *at) }
    }
}

/// A function of one argument.
pub(super) type Function = fn(f64) -> f64;

/// Supported functions; not those of the platform, so that results are the same bytes everywhere.
pub(super) const FUNCTIONS: [(&str, Function); 16] = [
    ("sin", libm::sin),
    ("cos", libm::cos),
    ("tan", libm::tan),
    ("asin", libm::asin),
    ("acos", libm::acos),
    ("atan", libm::atan),
    ("sinh", libm::sinh),
    ("cosh", libm::cosh),
    ("tanh", libm::tanh),
    ("exp", libm::exp),
    ("ln", libm::log),
    ("log2", libm::log2),
    ("log10", libm::log10),
    ("sqrt", libm::sqrt),
    ("abs", libm::fabs),
    ("signum", f64::signum),
];

/// Signs and powers of the operand that is read.
#[derive(Clone, Copy, Default)]
struct Operand {
    /// It has a sign.
    is_signed: bool,
    /// It is the exponent of a power.
    is_exponent: bool,
}

/// Checks operators, values and brackets; returns the names. A power of a signed value and a power of a power need brackets,
/// because tools differ in `-x^2` and `x^2^3`.
pub(super) fn check_syntax(
    text: &str,
    formula: &Section,
) -> Result<NamePositions, ExpressionError> {
    let fail = |at: usize, message: String| Err(ExpressionError::at(text, at, message));
    let mut names = NamePositions { found: Vec::new(), start: formula.start };
    let (mut open, mut expects_value, mut at) = (Vec::new(), true, 0);
    let bytes = formula.text.as_bytes();
    let mut operators = 0;
    let mut operand = Operand::default();
    while let Some(&byte) = bytes.get(at) {
        let here = formula.start + at;
        let rest = &formula.text[at..];
        if operators > MAX_FORMULA_OPERATORS {
            return fail(
                here,
                format!(
                    "the formula has more than {MAX_FORMULA_OPERATORS} operators and functions; divide it into several effects"
                ),
            );
        }
        if open.len() > MAX_FORMULA_DEPTH {
            return fail(
                here,
                format!(
                    "more than {MAX_FORMULA_DEPTH} brackets are open here; simplify the formula"
                ),
            );
        }
        match byte {
            b' ' | b'\t' => at += 1,
            b'0'..=b'9' | b'.' | b'a'..=b'z' | b'A'..=b'Z' | b'_' if !expects_value => {
                return fail(here, "an operator is missing before this".to_owned());
            }
            b'0'..=b'9' | b'.' => {
                at += number_length(rest);
                expects_value = false;
            }
            b'a'..=b'z' | b'A'..=b'Z' | b'_' => {
                let length = name_length(rest);
                let name = &rest[..length];
                let is_call = rest[length..].trim_start().starts_with('(');
                match (is_call, FUNCTIONS.iter().any(|(own, _)| *own == name)) {
                    (true, true) => operators += 1,
                    (true, false) => {
                        return fail(
                            here,
                            format!(
                                "there is no function {name}; available: {}",
                                FUNCTIONS.map(|(name, _)| name).join(", ")
                            ),
                        );
                    }
                    (false, true) => {
                        return fail(here, format!("{name} needs its argument in brackets"));
                    }
                    (false, false) => {
                        names.found.push((name.to_owned(), here));
                        expects_value = false;
                    }
                }
                at += length;
            }
            b'+' | b'-' if expects_value => {
                operand.is_signed = true;
                operators += 1;
                at += 1;
            }
            b'^' if !expects_value && operand.is_exponent => {
                return fail(here, "write brackets: (x^a)^b or x^(a^b)".to_owned());
            }
            b'^' if !expects_value && operand.is_signed => {
                return fail(here, "write brackets: -(x^a) or (-x)^a".to_owned());
            }
            b'+' | b'-' | b'*' | b'/' | b'^' if !expects_value => {
                operand = Operand { is_signed: false, is_exponent: byte == b'^' };
                operators += 1;
                expects_value = true;
                at += 1;
            }
            b'+' | b'-' | b'*' | b'/' | b'^' => {
                return fail(here, "a value is missing before this".to_owned());
            }
            b'(' if expects_value => {
                open.push((here, operand));
                operand = Operand::default();
                at += 1;
            }
            b'(' => return fail(here, "an operator is missing before this".to_owned()),
            b')' if open.is_empty() => return fail(here, "this bracket was not opened".to_owned()),
            b')' if expects_value => {
                return fail(here, "a value is missing before this".to_owned());
            }
            b')' => {
                operand = open.pop().map_or(operand, |(_, outside)| outside);
                at += 1;
            }
            _ => return fail(here, "this character is not allowed here".to_owned()),
        }
    }
    if let Some((bracket, _)) = open.pop() {
        return fail(bracket, "this bracket is not closed".to_owned());
    }
    if expects_value {
        return fail(
            formula.start + formula.text.len(),
            "a value is missing at the end".to_owned(),
        );
    }
    Ok(names)
}

/// Checks the number of coefficients and nonlinear parameters.
pub(super) fn check_parameter_count(
    text: &str,
    names: &NamePositions,
    count: usize,
) -> Result<(), ExpressionError> {
    if count > MAX_FORMULA_PARAMETERS {
        let advice = format!(
            "the formula has {count} coefficients and ranges, and the limit is {MAX_FORMULA_PARAMETERS}; divide it into several effects"
        );
        return Err(ExpressionError::at(text, names.start, advice));
    }
    Ok(())
}

/// `lag(COVARIATE, SECONDS)` in a formula.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lag {
    /// Name that replaces it.
    pub(super) name: String,
    pub(super) covariate: String,
    /// Number, or name of a nonlinear parameter.
    pub(super) seconds: String,
}

/// The formula with every lag replaced by a name of the same length, and the lags.
pub(super) fn name_lags(
    text: &str,
    formula: &Section,
) -> Result<(String, Vec<Lag>), ExpressionError> {
    const CALL: &str = "lag(";
    let (mut named, mut lags, mut at) = (String::new(), Vec::new(), 0);
    while let Some(found) = formula.text[at..].find(CALL) {
        let start = at + found;
        let is_whole =
            !formula.text[..start].ends_with(|c: char| c.is_ascii_alphanumeric() || c == '_');
        let arguments = &formula.text[start + CALL.len()..];
        if !is_whole {
            named.push_str(&formula.text[at..start + CALL.len()]);
            at = start + CALL.len();
            continue;
        }
        let fail = || {
            let advice = "write lag(COVARIATE, SECONDS), for example lag(temp_c, 5)".to_owned();
            ExpressionError::at(text, formula.start + start, advice)
        };
        let end = arguments.find(')').ok_or_else(fail)?;
        let (covariate, seconds) = arguments[..end].split_once(',').ok_or_else(fail)?;
        let (covariate, seconds) = (covariate.trim(), seconds.trim());
        let is_name = |name: &str| !name.is_empty() && name_length(name) == name.len();
        let is_number = !seconds.is_empty() && number_length(seconds) == seconds.len();
        if !is_name(covariate) || !(is_name(seconds) || is_number) {
            return Err(fail());
        }
        let whole = &formula.text[start..start + CALL.len() + end + 1];
        let name: String = whole
            .bytes()
            .map(|b| if b.is_ascii_alphanumeric() { char::from(b) } else { '_' })
            .collect();
        named.push_str(&formula.text[at..start]);
        named.push_str(&name);
        at = start + whole.len();
        if name_length(&formula.text[at..]) > 0 {
            // It would be part of the name.
            let advice = format!("an operator is missing after {whole}");
            return Err(ExpressionError::at(text, formula.start + at, advice));
        }
        lags.push(Lag { name, covariate: covariate.to_owned(), seconds: seconds.to_owned() });
    }
    named.push_str(&formula.text[at..]);
    Ok((named, lags))
}

/// Length of the name at the start of `text`.
pub(super) fn name_length(text: &str) -> usize {
    text.bytes().take_while(|b| b.is_ascii_alphanumeric() || *b == b'_').count()
}

/// Length of the number at the start of `text`.
pub(super) fn number_length(text: &str) -> usize {
    let digits =
        |from: usize| text[from..].bytes().take_while(|b| b.is_ascii_digit() || *b == b'.').count();
    let mantissa = digits(0);
    let exponent = text[mantissa..].strip_prefix(['e', 'E']).map(|rest| {
        let sign = usize::from(rest.starts_with(['+', '-']));
        1 + sign + digits(mantissa + 1 + sign)
    });
    mantissa + exponent.filter(|length| *length > 1).unwrap_or(0)
}
