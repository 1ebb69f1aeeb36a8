//! Evaluation of formulas whose syntax was checked: operators in postfix order. exmex 0.21 evaluated `sin(x*2*3)` as `x*sin(6)`;
//! the functions here are those of libm, which give the same bytes on every platform.

use crate::effects::expression::syntax::{FUNCTIONS, Function, name_length, number_length};

/// A formula in postfix order.
#[derive(Clone, Debug)]
pub(super) struct Formula {
    /// Names in alphabetical order.
    names: Vec<String>,
    steps: Vec<Step>,
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Number(f64),
    /// Index of the name.
    Variable(usize),
    Unary(Function),
    Binary(fn(f64, f64) -> f64),
}

/// An operator that waits for its operand.
#[derive(Clone, Copy, Debug)]
enum Pending {
    Bracket,
    Function(Function),
    Sign,
    Binary(u8),
}

impl Pending {
    /// How strongly it binds its operands; brackets and functions end with their bracket.
    fn precedence(self) -> u8 {
        match self {
            Self::Bracket | Self::Function(_) => 0,
            Self::Binary(b'+' | b'-') => 1,
            Self::Binary(b'*' | b'/') => 2,
            Self::Sign => 3,
            Self::Binary(_) => 4,
        }
    }

    fn step(self) -> Option<Step> {
        Some(match self {
            Self::Bracket => return None,
            Self::Function(function) => Step::Unary(function),
            Self::Sign => Step::Unary(|value| -value),
            Self::Binary(b'+') => Step::Binary(|left, right| left + right),
            Self::Binary(b'-') => Step::Binary(|left, right| left - right),
            Self::Binary(b'*') => Step::Binary(|left, right| left * right),
            Self::Binary(b'/') => Step::Binary(|left, right| left / right),
            Self::Binary(_) => Step::Binary(libm::pow),
        })
    }
}

impl Formula {
    /// Converts a checked formula; the error is the text of an invalid number.
    pub(super) fn parse(text: &str) -> Result<Self, &str> {
        let mut found: Vec<&str> = Vec::new();
        let mut steps = Vec::new();
        let mut pending: Vec<Pending> = Vec::new();
        let (mut rest, mut expects_value) = (text, true);
        while let Some(&byte) = rest.as_bytes().first() {
            let mut length = 1;
            match byte {
                b'0'..=b'9' | b'.' => {
                    length = number_length(rest);
                    let number = &rest[..length];
                    steps.push(Step::Number(number.parse().map_err(|_| number)?));
                    expects_value = false;
                }
                b'a'..=b'z' | b'A'..=b'Z' | b'_' => {
                    length = name_length(rest);
                    let name = &rest[..length];
                    if let Some((_, function)) = FUNCTIONS.iter().find(|(own, _)| *own == name) {
                        pending.push(Pending::Function(*function));
                    } else {
                        let index = found.iter().position(|own| *own == name);
                        steps.push(Step::Variable(index.unwrap_or(found.len())));
                        if index.is_none() {
                            found.push(name);
                        }
                        expects_value = false;
                    }
                }
                b'(' => pending.push(Pending::Bracket),
                b')' => {
                    complete(&mut pending, &mut steps, 1);
                    pending.pop();
                    if let Some(Pending::Function(function)) = pending.last() {
                        steps.push(Step::Unary(*function));
                        pending.pop();
                    }
                }
                b'-' if expects_value => pending.push(Pending::Sign),
                b'+' | b'-' | b'*' | b'/' | b'^' if !expects_value => {
                    let operator = Pending::Binary(byte);
                    complete(&mut pending, &mut steps, operator.precedence());
                    pending.push(operator);
                    expects_value = true;
                }
                // White space, and signs without effect.
                _ => {}
            }
            rest = &rest[length..];
        }
        complete(&mut pending, &mut steps, 1);
        let mut names = found.clone();
        names.sort_unstable();
        for step in &mut steps {
            if let Step::Variable(index) = step {
                *index = names.iter().position(|name| *name == found[*index]).unwrap_or(0);
            }
        }
        Ok(Self { names: names.into_iter().map(str::to_owned).collect(), steps })
    }

    /// Names in alphabetical order.
    pub(super) fn names(&self) -> &[String] {
        &self.names
    }

    /// Values for values in the order of the names.
    pub(super) fn evaluate(&self, values: &[Values]) -> Values {
        let mut stack: Vec<Values> = Vec::with_capacity(self.steps.len());
        for step in &self.steps {
            let mut operand = || stack.pop().unwrap_or(Values::Same(f64::NAN));
            let value = match *step {
                Step::Number(number) => Values::Same(number),
                Step::Variable(index) => {
                    values.get(index).cloned().unwrap_or(Values::Same(f64::NAN))
                }
                Step::Unary(function) => operand().map(function),
                Step::Binary(function) => {
                    let right = operand();
                    operand().zip(right, function)
                }
            };
            stack.push(value);
        }
        stack.pop().unwrap_or(Values::Same(f64::NAN))
    }
}

/// The value of a name or of a part of a formula over some rows.
#[derive(Clone, Debug)]
pub(super) enum Values {
    /// The same in every row.
    Same(f64),
    /// One for each row.
    Each(Vec<f64>),
}

impl Values {
    /// The value in this row.
    pub(super) fn at(&self, row: usize) -> f64 {
        match self {
            Self::Same(value) => *value,
            Self::Each(values) => values.get(row).copied().unwrap_or(f64::NAN),
        }
    }

    fn map(self, function: fn(f64) -> f64) -> Self {
        match self {
            Self::Same(value) => Self::Same(function(value)),
            Self::Each(mut values) => {
                values.iter_mut().for_each(|value| *value = function(*value));
                Self::Each(values)
            }
        }
    }

    fn zip(self, right: Self, function: fn(f64, f64) -> f64) -> Self {
        match (self, right) {
            (Self::Same(left), Self::Same(right)) => Self::Same(function(left, right)),
            (Self::Each(mut left), right) => {
                let rows = left.iter_mut().enumerate();
                rows.for_each(|(row, left)| *left = function(*left, right.at(row)));
                Self::Each(left)
            }
            (Self::Same(left), Self::Each(mut right)) => {
                right.iter_mut().for_each(|right| *right = function(left, *right));
                Self::Each(right)
            }
        }
    }
}

/// Appends the pending operators that bind at least so strongly, up to the last bracket.
fn complete(pending: &mut Vec<Pending>, steps: &mut Vec<Step>, precedence: u8) {
    while let Some(operator) = pending.last().filter(|last| last.precedence() >= precedence) {
        steps.extend(operator.step());
        pending.pop();
    }
}
