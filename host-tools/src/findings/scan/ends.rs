//! The extreme values of a column, and how often each occurs.

/// Distinct values that are kept at an end.
const KEPT: usize = 9;
/// A cut-off value occurs at least this often.
const LEAST_ROWS: u64 = 20;
/// ... and this many times as often as the values beside it on the mean: noise makes values rarer
/// towards an end, not more frequent.
const PILE: f64 = 10.0;
/// The values beside it are reached from it within this share of the span; else it is a value of its
/// own, such as the zero of a sensor that lost its supply.
const NEAR: f64 = 0.05;

/// One end of a column.
#[derive(Clone, Debug)]
pub struct End {
    /// 1 for the upper end, -1 for the lower.
    sign: f64,
    /// Values times `sign`, the greatest first, and rows of each.
    values: Vec<(f64, u64)>,
}

impl End {
    /// The upper end.
    pub fn upper() -> Self {
        Self {
            sign: 1.0,
            values: Vec::with_capacity(KEPT + 1),
        }
    }

    /// The lower end.
    pub fn lower() -> Self {
        Self {
            sign: -1.0,
            ..Self::upper()
        }
    }

    /// Takes the next value.
    pub fn push(&mut self, value: f64) {
        let value = self.sign * value;
        if self.values.len() == KEPT && self.values.last().is_some_and(|(v, _)| *v > value) {
            return;
        }
        match self.values.iter().position(|(v, _)| *v <= value) {
            Some(i) if self.values[i].0 == value => self.values[i].1 += 1,
            Some(i) => self.values.insert(i, (value, 1)),
            None => self.values.push((value, 1)),
        }
        self.values.truncate(KEPT);
    }

    /// The extreme value and its rows, where the column is cut off there; `span` is its extent.
    pub fn cut_off(&self, span: f64) -> Option<(f64, u64)> {
        let ((value, rows), beside) = self.values.split_first()?;
        let farthest = beside.last()?.0;
        let mean = beside.iter().map(|(_, rows)| *rows as f64).sum::<f64>() / beside.len() as f64;
        let piled = *rows >= LEAST_ROWS && *rows as f64 > PILE * mean;
        (piled && value - farthest <= NEAR * span).then_some((self.sign * value, *rows))
    }
}
