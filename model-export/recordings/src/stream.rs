//! One recording as a stream of rows: on the reference clock ([`AlignedStream`]) or at the board's own rate
//! ([`RawStream`]). Memory use is independent of the length.

use std::path::Path;

use crate::align::{Aligner, Alignment, Window, WindowMotion};
use crate::columns::ChannelLayout;
use crate::csv_table::{CsvRow, CsvTable, GAP_STEPS};
use crate::description::RecordingDescription;
use crate::error::{DataError, ErrorKind, Location, Notice};
use crate::input::check_window_values;
use crate::readers::{ForceReader, HallReader};

/// One row on the reference clock.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedRow {
    /// Time on the reference clock in seconds.
    pub time_s: f64,
    /// Averaged board channels in the order of [`ChannelLayout::hall`]; NaN where the sensor was saturated.
    pub hall: Vec<f64>,
    /// Reference forces in newtons in the order of [`ChannelLayout::forces`]; NaN where not measured.
    pub forces: Vec<f64>,
    /// Ratio of the white noise after averaging to that of a single board row.
    pub noise_gain: f64,
    /// How the board channels move within the window.
    pub motion: Option<WindowMotion>,
}

/// Statistics of a stream after its last row.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamSummary {
    /// White noise of one board row, each channel in its unit.
    pub hall_noise: Vec<Option<f64>>,
    /// White noise of one reference row in newtons, each force.
    pub force_noise: Vec<Option<f64>>,
    /// Number of board rows.
    pub hall_rows: u64,
    /// Number of reference rows.
    pub force_rows: u64,
    /// Gaps, saturation, skipped rows.
    pub notices: Vec<Notice>,
}

/// Difference of two clocks in periods, up to which both tables are of one logger.
const ONE_CLOCK: f64 = 0.01;

/// Whether both tables begin with rows at the same times.
fn is_one_clock(hall: &HallReader, force: &ForceReader) -> bool {
    let mut pairs = hall.table.buffered_times().zip(force.table.buffered_times());
    hall.period_us > 0.0 && pairs.all(|(a, b)| (a - b).abs() <= ONE_CLOCK * hall.period_us)
}

/// A recording resampled onto the reference clock.
pub struct AlignedStream {
    layout: ChannelLayout,
    alignment: Alignment,
    half_width_us: f64,
    min_step_us: f64,
    hall: HallReader,
    hall_done: bool,
    force: ForceReader,
    aligner: Aligner,
    pending: Option<CsvRow>,
    last_used_us: f64,
    aligned: u64,
    uncovered: u64,
    too_close: u64,
}

impl AlignedStream {
    /// Opens both tables and reads their headers and clocks. The field is averaged over `width` periods of the slower table.
    pub fn open(
        folder: &Path,
        description: &RecordingDescription,
        alignment: Alignment,
        width: f64,
    ) -> Result<Self, DataError> {
        let (hall, force, layout) = open_readers(folder, description)?;
        let half_width_us = match is_one_clock(&hall, &force) {
            // Its rows are pairs already; an average would mix neighbours.
            true => 0.0,
            false => 0.5 * width * force.period_us.max(hall.period_us),
        };
        // With a slower board, no board row may enter two aligned rows.
        let board_is_slower = hall.period_us > 1.05 * force.period_us;
        let min_step_us = if board_is_slower { 0.95 * hall.period_us } else { 0.0 };
        Ok(Self {
            layout,
            alignment,
            half_width_us,
            min_step_us,
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

    /// Channels of the rows.
    pub fn layout(&self) -> &ChannelLayout {
        &self.layout
    }

    /// Half the averaging window in seconds.
    pub fn half_width_s(&self) -> f64 {
        self.half_width_us * 1e-6
    }

    /// The next aligned row, or `None` at the end of either table.
    pub fn next_row(&mut self) -> Result<Option<AlignedRow>, DataError> {
        loop {
            let row = match self.pending.take() {
                Some(row) => row,
                None => match self.force.next_row()? {
                    Some(row) => row,
                    None => return self.drain(),
                },
            };
            let t_us = row.cells[self.force.time_column];
            if t_us - self.last_used_us < self.min_step_us {
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
                        motion: mean.motion,
                    }));
                }
                Window::Uncovered => self.uncovered += 1,
                Window::NeedsMore if self.hall_done => self.uncovered += 1,
                Window::NeedsMore => {
                    check_window_values(self.aligner.stored_values()).map_err(|kind| {
                        kind.at(self.force.table.cell_location(row.line, self.force.time_column))
                    })?;
                    self.pending = Some(row);
                    match self.hall.next_sample()? {
                        Some(sample) => self.aligner.push(sample),
                        None => self.hall_done = true,
                    }
                }
            }
        }
    }

    /// Reads the rest of the board's table, so that all of it is validated.
    fn drain(&mut self) -> Result<Option<AlignedRow>, DataError> {
        while !self.hall_done {
            self.hall_done = self.hall.next_sample()?.is_none();
        }
        if self.hall.clock.rows == 0 {
            return Err(ErrorKind::NoRows.at(Location::file(self.hall.table.path())));
        }
        if self.aligned == 0 {
            let (hall, force) = (&self.hall.clock, &self.force.clock);
            let overlap_us = hall.last_us.min(force.last_us) - hall.first_us.max(force.first_us);
            if hall.gaps > 0 && overlap_us > self.half_width_us {
                let packets = ErrorKind::Packets {
                    within_ms: 1e-3 * self.hall.period_us,
                    between_ms: 1e-3 * hall.longest_us,
                };
                return Err(packets.at(Location::file(self.hall.table.path()).column("t_us")));
            }
            let kind = ErrorKind::NoOverlap {
                hall_from: hall.first_us * 1e-6,
                hall_to: hall.last_us * 1e-6,
                force_from: force.first_us * 1e-6,
                force_to: force.last_us * 1e-6,
            };
            return Err(kind.at(Location::file(self.force.table.path()).column("t_us")));
        }
        Ok(None)
    }

    /// Statistics of the rows read so far; complete after the last row.
    pub fn summary(&self) -> StreamSummary {
        let mut notices = Vec::new();
        for (clock, table) in
            [(&self.hall.clock, &self.hall.table), (&self.force.clock, &self.force.table)]
        {
            notices.extend(clock.gap_notice(table));
            notices.extend(table.cut_notice());
        }
        notices.extend(self.hall.saturation_notices());
        notices.extend(self.hall.rate_notice());
        notices.extend(self.hall.unit_notice());
        if self.too_close > 0 {
            notices.push(Notice {
                location: Location::file(self.force.table.path()),
                message: format!(
                    "the board is slower than the reference: {} of {} reference rows were skipped so that no board row is used twice",
                    self.too_close, self.force.clock.rows
                ),
            });
        }
        StreamSummary {
            hall_noise: self.hall.noise(),
            force_noise: self.force.noise(),
            hall_rows: self.hall.clock.rows,
            force_rows: self.force.clock.rows,
            notices,
        }
    }
}

fn open_readers(
    folder: &Path,
    description: &RecordingDescription,
) -> Result<(HallReader, ForceReader, ChannelLayout), DataError> {
    let hall = HallReader::open(CsvTable::open(folder, "hall.csv")?, description, folder)?;
    let force = ForceReader::open(CsvTable::open(folder, "force.csv")?, description)?;
    let layout = ChannelLayout { hall: hall.columns.clone(), forces: force.columns.clone() };
    Ok((hall, force, layout))
}

/// One board row with interpolated forces.
#[derive(Clone, Debug, PartialEq)]
pub struct RawRow {
    /// Time on the board's clock in seconds.
    pub time_s: f64,
    /// Board channels in the order of [`ChannelLayout::hall`]: fields in gauss, exact multiples of the
    /// scale where counts were recorded.
    pub hall: Vec<f64>,
    /// Reference forces in newtons in the order of [`ChannelLayout::forces`], linearly interpolated; NaN
    /// outside the reference's rows, in a gap, or where not measured.
    pub forces: Vec<f64>,
}

/// A recording at the board's rate.
pub struct RawStream {
    layout: ChannelLayout,
    delay_us: f64,
    gap_us: f64,
    hall: HallReader,
    force: ForceReader,
    before: Option<CsvRow>,
    after: Option<CsvRow>,
    /// Time of the last reference row at or before the board row.
    reference_us: f64,
    at_reference_row: bool,
}

impl RawStream {
    /// Opens both tables and reads their headers and clocks.
    pub fn open(
        folder: &Path,
        description: &RecordingDescription,
        alignment: Alignment,
    ) -> Result<Self, DataError> {
        let (hall, mut force, layout) = open_readers(folder, description)?;
        Ok(Self {
            layout,
            delay_us: alignment.delay_us,
            gap_us: GAP_STEPS * force.period_us,
            before: None,
            after: force.next_row()?,
            reference_us: f64::NEG_INFINITY,
            at_reference_row: false,
            hall,
            force,
        })
    }

    /// Opens a recording with the description in its folder.
    pub fn open_folder(folder: &Path, alignment: Alignment) -> Result<Self, DataError> {
        let (description, _) = RecordingDescription::read(folder)?;
        Self::open(folder, &description, alignment)
    }

    /// Channels of the rows.
    pub fn layout(&self) -> &ChannelLayout {
        &self.layout
    }

    /// Median time between board rows in microseconds.
    pub fn period_us(&self) -> f64 {
        self.hall.period_us
    }

    /// A notice where the rows are not at the device's rate.
    pub fn rate_notice(&self) -> Option<Notice> {
        self.hall.rate_notice()
    }

    /// White noise of one reference row in newtons, each force, from the rows read so far.
    pub fn force_noise(&self) -> Vec<Option<f64>> {
        self.force.noise()
    }

    /// True if the last row is the first at or after a reference row: selects one board row for each
    /// reference row.
    pub fn at_reference_row(&self) -> bool {
        self.at_reference_row
    }

    /// The next row, or `None` at the end of the board's table.
    pub fn next_row(&mut self) -> Result<Option<RawRow>, DataError> {
        let Some(sample) = self.hall.next_row()? else {
            return Ok(None);
        };
        let on_reference_us = sample.t_us - self.delay_us;
        let clock = self.force.time_column;
        while self.after.as_ref().is_some_and(|after| after.cells[clock] < on_reference_us) {
            self.before = self.after.take();
            self.after = self.force.next_row()?;
        }
        let reference_us = [&self.before, &self.after]
            .into_iter()
            .flatten()
            .map(|row| row.cells[clock])
            .filter(|t| *t <= on_reference_us)
            .fold(self.reference_us, f64::max);
        self.at_reference_row = reference_us > self.reference_us;
        self.reference_us = reference_us;
        Ok(Some(RawRow {
            time_s: sample.t_us * 1e-6,
            forces: self.forces_at(on_reference_us),
            hall: sample.values,
        }))
    }

    fn forces_at(&self, time_us: f64) -> Vec<f64> {
        let time = |row: &CsvRow| row.cells[self.force.time_column];
        match (&self.before, &self.after) {
            (_, Some(after)) if time(after) == time_us => self.force.forces(after),
            (Some(before), Some(after)) if time(after) - time(before) <= self.gap_us => {
                let fraction = (time_us - time(before)) / (time(after) - time(before));
                self.force.interpolate(before, after, fraction)
            }
            _ => vec![f64::NAN; self.layout.forces.len()],
        }
    }
}
