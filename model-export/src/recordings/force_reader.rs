//! The reference's table. It may hold nothing but its clock: then rows are where a sensor that nothing
//! pushes is to be looked at.

use super::clock::{ClockWatch, no_clock, period_us};
use super::columns::{ForceColumn, force_column};
use super::noise::WhiteNoise;
use super::problem::Problem;
use super::table::{Cells, Row, Table};

/// Reads `force.csv`; a force may be empty.
pub(super) struct ForceReader {
    pub(super) table: Table,
    pub(super) time_column: usize,
    picks: Vec<usize>,
    pub(super) columns: Vec<ForceColumn>,
    pub(super) period_us: f64,
    pub(super) clock: ClockWatch,
    pub(super) noise: Vec<WhiteNoise>,
}

impl ForceReader {
    pub(super) fn open(mut table: Table) -> Result<Self, Problem> {
        if !table.header().iter().any(|name| name == "t_us") {
            return Err(no_clock(&table));
        }
        let mut time_column = None;
        let (mut picks, mut columns) = (Vec::new(), Vec::new());
        for (i, name) in table.header().iter().enumerate() {
            match force_column(name) {
                Ok(ForceColumn::Time) => time_column = Some(i),
                Ok(column) => {
                    picks.push(i);
                    columns.push(column);
                }
                Err(fault) => return Err(fault.at(table.header_place(name))),
            }
        }
        let time_column = time_column.ok_or_else(|| no_clock(&table))?;
        let mut cells = vec![Cells::MayBeEmpty; table.header().len()];
        cells[time_column] = Cells::Number;
        table.rules(time_column, cells);
        let period_us = period_us(&mut table, time_column)?;
        Ok(Self {
            time_column,
            noise: vec![WhiteNoise::default(); columns.len()],
            clock: ClockWatch::new(period_us),
            table,
            picks,
            columns,
            period_us,
        })
    }

    pub(super) fn next_row(&mut self) -> Result<Option<Row>, Problem> {
        let row = self.table.next_row()?;
        if let Some(row) = &row {
            self.clock.tick(row, row.cells[self.time_column]);
            for (noise, &pick) in self.noise.iter_mut().zip(&self.picks) {
                noise.push(row.cells[pick]);
            }
        }
        Ok(row)
    }

    pub(super) fn forces(&self, row: &Row) -> Vec<f64> {
        self.picks.iter().map(|&pick| row.cells[pick]).collect()
    }

    /// The forces on the straight line between two rows.
    pub(super) fn between(&self, before: &Row, after: &Row, share: f64) -> Vec<f64> {
        let line =
            |&pick: &usize| before.cells[pick] + share * (after.cells[pick] - before.cells[pick]);
        self.picks.iter().map(line).collect()
    }
}
