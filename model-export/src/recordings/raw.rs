//! One recording row by row at the board's own rate: what the device saw, and the reference beside
//! it. Memory does not grow with length.

use std::path::Path;

use super::align::Alignment;
use super::description::Description;
use super::force_reader::ForceReader;
use super::hall_reader::HallReader;
use super::layout::Layout;
use super::noise::WhiteNoise;
use super::problem::Problem;
use super::table::{Row, Table};

/// One row of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct RawRow {
    /// The board's clock in seconds.
    pub time_s: f64,
    /// Board channels in the order of [`Layout::hall`]: fields in gauss, exact multiples of the
    /// count where they were recorded as counts.
    pub hall: Vec<f64>,
    /// Reference forces in newtons in the order of [`Layout::forces`], on a straight line between
    /// the reference's rows; NaN outside them, in a gap, or where not measured.
    pub forces: Vec<f64>,
}

/// A recording's two tables, read side by side at the board's rate.
pub struct RawStream {
    layout: Layout,
    delay_us: f64,
    gap_us: f64,
    hall: HallReader,
    force: ForceReader,
    before: Option<Row>,
    after: Option<Row>,
    met_us: f64,
    meets: bool,
}

impl RawStream {
    /// Opens both tables and reads their headers and clocks.
    pub fn open(
        folder: &Path,
        description: &Description,
        alignment: Alignment,
    ) -> Result<Self, Problem> {
        let hall = HallReader::open(Table::open(folder, "hall.csv")?, description, folder)?;
        let mut force = ForceReader::open(Table::open(folder, "force.csv")?)?;
        Ok(Self {
            layout: Layout {
                hall: hall.columns.clone(),
                forces: force.columns.clone(),
            },
            delay_us: alignment.delay_us,
            gap_us: super::clock::GAP_STEPS * force.period_us,
            before: None,
            after: force.next_row()?,
            met_us: f64::NEG_INFINITY,
            meets: false,
            hall,
            force,
        })
    }

    /// What the channels are.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// White noise of a reference row so far, in newtons, for each force.
    pub fn force_noise(&self) -> Vec<Option<f64>> {
        self.force.noise.iter().map(WhiteNoise::estimate).collect()
    }

    /// Whether the row that was read last is the first at or after a row of the reference: one row
    /// for each row of the reference, less than a step of the board from it.
    pub fn meets_reference(&self) -> bool {
        self.meets
    }

    /// The next row, or `None` at the end of the board's table.
    pub fn next_row(&mut self) -> Result<Option<RawRow>, Problem> {
        let Some(sample) = self.hall.next_row()? else {
            return Ok(None);
        };
        let on_reference_us = sample.t_us - self.delay_us;
        let clock = self.force.time_column;
        while self
            .after
            .as_ref()
            .is_some_and(|after| after.cells[clock] < on_reference_us)
        {
            self.before = self.after.take();
            self.after = self.force.next_row()?;
        }
        let met = [&self.before, &self.after].into_iter().flatten();
        let met = met.map(|row| row.cells[clock]);
        let met_us = met
            .filter(|t| *t <= on_reference_us)
            .fold(self.met_us, f64::max);
        self.meets = met_us > self.met_us;
        self.met_us = met_us;
        Ok(Some(RawRow {
            time_s: sample.t_us * 1e-6,
            forces: self.forces_at(on_reference_us),
            hall: sample.values,
        }))
    }

    fn forces_at(&self, time_us: f64) -> Vec<f64> {
        let time = |row: &Row| row.cells[self.force.time_column];
        match (&self.before, &self.after) {
            (_, Some(after)) if time(after) == time_us => self.force.forces(after),
            (Some(before), Some(after)) if time(after) - time(before) <= self.gap_us => {
                let share = (time_us - time(before)) / (time(after) - time(before));
                self.force.between(before, after, share)
            }
            _ => vec![f64::NAN; self.layout.forces.len()],
        }
    }
}
