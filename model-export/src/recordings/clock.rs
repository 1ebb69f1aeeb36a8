//! A clock watched for gaps.

use super::problem::{Fault, Notice, Place, Problem};
use super::table::{Row, Table};

/// A clock's step above this many typical steps is a gap.
pub const GAP_STEPS: f64 = 5.0;

/// Watches a clock for gaps.
#[derive(Clone, Debug)]
pub(super) struct ClockWatch {
    period_us: f64,
    pub(super) rows: u64,
    pub(super) first_us: f64,
    pub(super) last_us: f64,
    /// Line of the last row.
    pub(super) line: u64,
    gaps: u64,
    longest_us: f64,
    longest_line: u64,
}

impl ClockWatch {
    pub(super) fn new(period_us: f64) -> Self {
        Self {
            period_us,
            rows: 0,
            first_us: f64::NAN,
            last_us: f64::NAN,
            line: 0,
            gaps: 0,
            longest_us: 0.0,
            longest_line: 0,
        }
    }

    pub(super) fn tick(&mut self, row: &Row, t_us: f64) {
        if self.rows == 0 {
            self.first_us = t_us;
        } else {
            let step = t_us - self.last_us;
            self.gaps += u64::from(step > GAP_STEPS * self.period_us);
            if step > self.longest_us {
                (self.longest_us, self.longest_line) = (step, row.line);
            }
        }
        self.last_us = t_us;
        self.line = row.line;
        self.rows += 1;
    }

    pub(super) fn gap_notice(&self, table: &Table) -> Option<Notice> {
        let ms = |us: f64| us * 1e-3;
        (self.gaps > 0).then(|| Notice {
            place: Place::file(table.path()).line(self.longest_line).column("t_us"),
            message: format!(
                "{} in the clock, the longest here: {:.1} ms where rows are {:.1} ms apart; rows that lean on a gap were left out: look for lost transfers or a blocked logger",
                match self.gaps { 1 => "1 gap".to_owned(), n => format!("{n} gaps") },
                ms(self.longest_us),
                ms(self.period_us),
            ),
        })
    }
}

/// Rows closer together than this are no sensor's: the clock is in another unit.
const SHORTEST_PERIOD_US: f64 = 20.0;

/// The typical step of a table's clock, if it can be microseconds.
pub(super) fn period_us(table: &mut Table, time_column: usize) -> Result<f64, Problem> {
    let period_us = table.typical_period()?;
    if period_us > 0.0 && period_us < SHORTEST_PERIOD_US {
        return Err(Fault::ClockUnit { period_us }.at(table.cell_place(2, time_column)));
    }
    Ok(period_us)
}

/// A table without `t_us`.
pub(super) fn no_clock(table: &Table) -> Problem {
    let advice =
        "every table starts with its clock in microseconds: name that column t_us".to_owned();
    Fault::MissingColumn { advice }.at(table.header_place("t_us"))
}
