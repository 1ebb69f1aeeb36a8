//! One recording as a stream of rows on the reference's clock. Memory does not grow with length.

use std::path::Path;

use super::align::{Aligner, Alignment, Window};
use super::clock::GAP_STEPS;
use super::description::Description;
use super::force_reader::ForceReader;
use super::hall_reader::HallReader;
use super::layout::Layout;
use super::noise::WhiteNoise;
use super::problem::{Fault, Notice, Place, Problem};
use super::table::{Row, Table};

/// One row on the reference's clock; the layout is that of [`Layout`].
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedRow {
    /// The reference's clock, in seconds.
    pub time_s: f64,
    /// Averaged board channels, in the order of [`Layout::hall`]; NaN where the sensor saturated.
    pub hall: Vec<f64>,
    /// Reference forces in newtons, in the order of [`Layout::forces`]; NaN where not measured.
    pub forces: Vec<f64>,
    /// Factor by which the averaging multiplies the standard deviation of the sensor's white noise.
    pub noise_gain: f64,
}

/// What a stream has seen when it has ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// White noise of one raw row, for each board channel, in its own unit.
    pub hall_noise: Vec<Option<f64>>,
    /// White noise of one reference row, in newtons, for each force.
    pub force_noise: Vec<Option<f64>>,
    /// Rows of the board.
    pub hall_rows: u64,
    /// Rows of the reference.
    pub force_rows: u64,
    /// What a person should know.
    pub notices: Vec<Notice>,
}

/// A recording's two tables, read side by side.
pub struct RecordingStream {
    layout: Layout,
    alignment: Alignment,
    half_width_us: f64,
    least_step_us: f64,
    hall: HallReader,
    hall_done: bool,
    force: ForceReader,
    aligner: Aligner,
    pending: Option<Row>,
    last_used_us: f64,
    aligned: u64,
    uncovered: u64,
    too_close: u64,
}

impl RecordingStream {
    /// Opens both tables and reads their headers and clocks.
    pub fn open(
        folder: &Path,
        description: &Description,
        alignment: Alignment,
    ) -> Result<Self, Problem> {
        let hall = HallReader::open(Table::open(folder, "hall.csv")?, description, folder)?;
        let force = ForceReader::open(Table::open(folder, "force.csv")?)?;
        let half_width_us = 0.5 * force.period_us.max(hall.period_us);
        // Where the board is the slower clock, its rows must not be used twice.
        let board_is_slower = hall.period_us > 1.05 * force.period_us;
        let least_step_us = if board_is_slower {
            0.95 * hall.period_us
        } else {
            0.0
        };
        Ok(Self {
            layout: Layout {
                hall: hall.columns.clone(),
                forces: force.columns.clone(),
            },
            alignment,
            half_width_us,
            least_step_us,
            aligner: Aligner::new(half_width_us, GAP_STEPS * hall.period_us),
            hall,
            hall_done: false,
            force,
            pending: None,
            last_used_us: f64::NEG_INFINITY,
            aligned: 0,
            uncovered: 0,
            too_close: 0,
        })
    }

    /// What the channels are.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Half the averaging window, in seconds.
    pub fn half_width_s(&self) -> f64 {
        self.half_width_us * 1e-6
    }

    /// The next aligned row, or `None` at the end of either table.
    pub fn next_row(&mut self) -> Result<Option<AlignedRow>, Problem> {
        loop {
            let row = match self.pending.take() {
                Some(row) => row,
                None => match self.force.next_row()? {
                    Some(row) => row,
                    None => return self.drain(),
                },
            };
            let t_us = row.cells[self.force.time_column];
            if t_us - self.last_used_us < self.least_step_us {
                self.too_close += 1;
                continue;
            }
            match self.aligner.mean_around(t_us + self.alignment.delay_us) {
                Window::Ready(mean) => {
                    self.last_used_us = t_us;
                    self.aligned += 1;
                    return Ok(Some(AlignedRow {
                        time_s: t_us * 1e-6,
                        hall: mean.values,
                        forces: self.force.forces(&row),
                        noise_gain: mean.noise_gain,
                    }));
                }
                Window::Uncovered => self.uncovered += 1,
                Window::NeedsMore if self.hall_done => self.uncovered += 1,
                Window::NeedsMore => {
                    self.pending = Some(row);
                    match self.hall.next_sample()? {
                        Some(sample) => self.aligner.push(sample),
                        None => self.hall_done = true,
                    }
                }
            }
        }
    }

    /// Reads what is left of the board's table, so that its faults are found as well.
    fn drain(&mut self) -> Result<Option<AlignedRow>, Problem> {
        while !self.hall_done {
            self.hall_done = self.hall.next_sample()?.is_none();
        }
        if self.hall.clock.rows == 0 {
            return Err(Fault::NoRows.at(Place::file(self.hall.table.path())));
        }
        if self.aligned == 0 {
            let (hall, force) = (&self.hall.clock, &self.force.clock);
            let fault = Fault::NoOverlap {
                hall_from: hall.first_us * 1e-6,
                hall_to: hall.last_us * 1e-6,
                force_from: force.first_us * 1e-6,
                force_to: force.last_us * 1e-6,
            };
            return Err(fault.at(Place::file(self.force.table.path()).column("t_us")));
        }
        Ok(None)
    }

    /// What was seen on the way; call it after the last row.
    pub fn summary(&self) -> Summary {
        let mut notices = Vec::new();
        for (clock, table) in [
            (&self.hall.clock, &self.hall.table),
            (&self.force.clock, &self.force.table),
        ] {
            notices.extend(clock.gap_notice(table));
        }
        notices.extend(self.hall.saturation_notices());
        if self.too_close > 0 {
            notices.push(Notice {
                place: Place::file(self.force.table.path()),
                message: format!(
                    "the board's rows are slower than the reference's: {} of {} reference rows were skipped so that no field row counts twice",
                    self.too_close, self.force.clock.rows
                ),
            });
        }
        Summary {
            hall_noise: self.hall.noise.iter().map(WhiteNoise::estimate).collect(),
            force_noise: self.force.noise.iter().map(WhiteNoise::estimate).collect(),
            hall_rows: self.hall.clock.rows,
            force_rows: self.force.clock.rows,
            notices,
        }
    }
}
