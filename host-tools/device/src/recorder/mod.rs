//! Writing of a recording whose folder is valid from its creation, even if the process is killed.
//!
//! - here: the recorder.
//! - `rows`: assembly of packets to rows.
//! - `coverage`: ranges that a recording covers so far.

use crate::board_topics::BoardTopics;
use crate::csv_writer::PagedWriter;
use crate::format::degrees;
use anyhow::{Context, Result, bail};
use device_run::channel_map::covariate_values;
use firmware::protocol::messages::Message;
use firmware::sensors::hall::SENSORS;
use model_export::output::{StagingDir, check_vacant};
use model_export::recordings::columns::COVARIATES;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::mcap::{EstimatedForce, McapWriter, RecordingMcap};
use sim::campaign::recording::{force_columns, sensor_columns};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

mod coverage;
mod rows;

pub use coverage::{Coverage, CoveredRange, ForceEstimates};
pub use rows::{Restarted, SensorRow, SensorRowAssembler};

/// Time in microseconds in which the connected sensors are determined.
const LOOK_US: u64 = 200_000;
/// Maximum delay of writing in microseconds.
const FLUSH_US: u64 = 500_000;
/// Decimals of the covariates: steps finer than those of the serial line.
const COVARIATE_DECIMALS: usize = 5;
/// Covariates that follow from a pose that a host sends.
const POSE_COVARIATES: [&str; 6] =
    ["accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "roll_rad", "pitch_rad", "yaw_rad"];
/// Row period of the reference's table in microseconds.
const REFERENCE_US: u64 = 10_000;

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingCounts {
    /// Sensors in the recording.
    pub sensors: Vec<usize>,
    /// Written rows.
    pub rows: u64,
    /// Lost rows.
    pub lost: u64,
    /// Number of gaps, and the longest with its start, in microseconds.
    pub gaps: u64,
    /// See `gaps`.
    pub longest_us: (u64, u64),
    /// Rows omitted because a sensor did not answer.
    pub left_out: u64,
    /// Missing answers of each sensor.
    pub silent: [u64; SENSORS],
    /// Recorded covariates.
    pub covariates: Vec<&'static str>,
    /// Rows omitted because a recorded covariate was missing.
    pub without_covariates: u64,
    pub reference_rows: u64,
    /// Duration from the first to the last row.
    pub span_us: u64,
}

/// Writer of a recording.
pub struct Recorder {
    target: PathBuf,
    description: RecordingDescription,
    period_us: u64,
    /// Indices of the recorded covariates.
    covariates: Vec<usize>,
    /// A host sends the pose, to have it recorded.
    has_pose: bool,
    /// Columns of the reference.
    reference: Option<Vec<String>>,
    last_reference_us: Option<u64>,
    /// Rows received before the connected sensors are known.
    waiting: Vec<SensorRow>,
    tables: Option<Tables>,
    first_us: Option<u64>,
    last_us: u64,
    flushed_us: u64,
    reference_us: u64,
    tally: RecordingCounts,
    /// MCAP file that is written alongside, created with the first rows.
    mcap_path: Option<PathBuf>,
    mcap: Option<BoardTopics<McapWriter>>,
}

impl Recorder {
    /// Recording in a new folder; rows come every `period_us`. `reference`: columns of the reference that is recorded
    /// alongside; without one the table of forces has times only.
    ///
    /// # Errors
    /// The folder exists.
    pub fn new(
        target: &Path,
        description: RecordingDescription,
        period_us: u64,
        reference: Option<Vec<String>>,
    ) -> Result<Self> {
        check_vacant(target)?;
        Ok(Self {
            target: target.to_path_buf(),
            description,
            period_us,
            covariates: Vec::new(),
            has_pose: false,
            reference,
            last_reference_us: None,
            waiting: Vec::new(),
            tables: None,
            first_us: None,
            last_us: 0,
            flushed_us: 0,
            reference_us: 0,
            tally: RecordingCounts::default(),
            mcap_path: None,
            mcap: None,
        })
    }

    /// Records attitude and acceleration even where most of the first rows are without them: a host sends them for this recording, and
    /// a busy machine sends them late.
    pub fn with_pose(self, has_pose: bool) -> Self {
        Self { has_pose, ..self }
    }

    /// Writes an MCAP file alongside, with the board's estimates and the messages on its state.
    ///
    /// # Errors
    /// The file exists.
    pub fn with_mcap(self, path: &Path) -> Result<Self> {
        if path.exists() {
            bail!("{} exists; choose another file", path.display());
        }
        Ok(Self { mcap_path: Some(path.to_path_buf()), ..self })
    }

    /// Adds a message on the state of the board to the MCAP file.
    ///
    /// # Errors
    /// Writing failed.
    pub fn take_message(&mut self, message: &Message) -> Result<()> {
        let time_us = self.last_us as f64;
        self.begun_mcap().map_or(Ok(()), |mcap| mcap.message(time_us, message))
    }

    /// Adds a row; times increase.
    ///
    /// # Errors
    /// Writing failed; earlier rows remain valid.
    pub fn take(&mut self, row: SensorRow) -> Result<()> {
        let first_us = *self.first_us.get_or_insert(row.time_us);
        let time_us = row.time_us.saturating_sub(first_us);
        self.note_gap(time_us);
        let row = SensorRow { time_us, ..row };
        if self.tables.is_some() {
            self.write(&row)?;
        } else {
            self.waiting.push(row);
            if time_us >= LOOK_US {
                self.begin()?;
            }
        }
        if time_us >= self.flushed_us + FLUSH_US {
            self.flushed_us = time_us;
            self.flush()?;
        }
        Ok(())
    }

    /// Adds a row of the reference at a board time in microseconds. Rows before the first of the board, or not after the
    /// last of the reference, are left out.
    ///
    /// # Errors
    /// Writing failed.
    pub fn take_reference(&mut self, board_us: f64, force_n: &[f64]) -> Result<()> {
        let (Some(tables), Some(first_us)) = (&mut self.tables, self.first_us) else {
            return Ok(());
        };
        let time_us = (board_us - first_us as f64).round();
        if time_us < 0.0 || self.last_reference_us.is_some_and(|last| time_us <= last as f64) {
            return Ok(());
        }
        self.last_reference_us = Some(time_us as u64);
        self.tally.reference_rows += 1;
        let mut text = format!("{time_us:.0}");
        for newtons in force_n {
            text += &format!(",{newtons:.4}");
        }
        let written = tables.force.line(&text);
        self.or_cut(written)?;
        self.begun_mcap().map_or(Ok(()), |mcap| mcap.reference(time_us, force_n))
    }

    /// The MCAP file with a row: its first message is of the topic that states the mapping.
    fn begun_mcap(&mut self) -> Option<&mut BoardTopics<McapWriter>> {
        self.mcap.as_mut().filter(|_| self.tally.rows > 0)
    }

    /// Time of the last row in microseconds.
    pub fn elapsed_us(&self) -> u64 {
        self.last_us
    }

    /// Writes what is buffered; call it also while no rows arrive. Messages of less than a second stay in the chunk of the MCAP file,
    /// except the first ones.
    ///
    /// # Errors
    /// Writing failed.
    pub fn flush(&mut self) -> Result<()> {
        let Some(tables) = &mut self.tables else {
            return Ok(());
        };
        if let Some(mcap) = &mut self.mcap {
            mcap.flush_due()?;
        }
        let flushed = tables.both(|table| {
            table.flush()?;
            table.out().sync_data()
        });
        self.or_cut(flushed)
    }

    /// Writes all rows.
    ///
    /// # Errors
    /// There were no readings, or writing failed.
    pub fn finish(mut self) -> Result<RecordingCounts> {
        if self.tables.is_none() {
            self.begin()?;
        }
        if let Some(tables) = &mut self.tables {
            let finished = tables.both(|table| {
                table.finish()?;
                table.out().sync_all()
            });
            self.or_cut(finished)?;
        }
        if let Some(mcap) = self.mcap {
            mcap.finish()?;
        }
        self.tally.span_us = self.last_us;
        Ok(self.tally)
    }

    fn note_gap(&mut self, time_us: u64) {
        let step_us = time_us.saturating_sub(self.last_us);
        let steps = (step_us + self.period_us / 2) / self.period_us.max(1);
        if steps > 1 {
            self.tally.lost += steps - 1;
            self.tally.gaps += 1;
            if step_us > self.tally.longest_us.0 {
                self.tally.longest_us = (step_us, self.last_us);
            }
        }
        self.last_us = time_us;
    }

    /// Creates the folder with the rows so far.
    fn begin(&mut self) -> Result<()> {
        let answers = |sensor: &usize| {
            let mut rows = self.waiting.iter();
            rows.any(|row| row.readings.get(*sensor).is_some_and(Option::is_some))
        };
        let sensors: Vec<usize> = (0..SENSORS).filter(answers).collect();
        if sensors.is_empty() {
            bail!(
                "no sensor gave a reading, so nothing is recorded: `cargo magpie monitor` shows the faults"
            );
        }
        // A column needs a value in every row: rows without it are omitted. One late message of a host must not omit the
        // column instead.
        let rows = self.waiting.len();
        let covariates: Vec<usize> = (0..COVARIATES.len())
            .filter(|&place| {
                let has_value =
                    |row: &&SensorRow| covariate_values(&row.covariates)[place].is_some();
                let found = self.waiting.iter().filter(has_value).count();
                let is_sent = self.has_pose && POSE_COVARIATES.contains(&COVARIATES[place]);
                if is_sent { found > 0 } else { 2 * found > rows }
            })
            .collect();
        let unwritable = || format!("{} cannot be written", self.target.display());
        let draft = StagingDir::new(&self.target, "record")?;
        self.description.write(draft.path())?;
        let names = covariates.iter().map(|&place| COVARIATES[place]);
        self.tally.covariates = names.collect();
        let tables = Tables::create(
            draft.path(),
            &sensors,
            &self.tally.covariates,
            self.reference.as_deref(),
        )
        .with_context(unwritable)?;
        self.tables = Some(tables);
        if let Some(path) = &self.mcap_path {
            let numbers = || sensors.iter().map(|sensor| *sensor as u32);
            let covariates = self.tally.covariates.iter().map(|name| (*name).to_owned());
            let hall: Vec<String> = numbers().flat_map(sensor_columns).chain(covariates).collect();
            let force = self.reference.clone();
            let force = force.unwrap_or_else(|| force_columns(numbers()).split_off(1));
            let topics = BoardTopics::new(&hall, &force, &sensors, |columns| {
                Ok(RecordingMcap::create(path, &self.description, columns)?)
            });
            self.mcap = Some(topics?);
        }
        self.tally.sensors = sensors;
        self.covariates = covariates;
        for row in std::mem::take(&mut self.waiting) {
            self.write(&row)?;
        }
        if let Some(mcap) = &mut self.mcap {
            // The file appears, as the folder does: a killed process leaves nothing, or rows.
            mcap.flush()?;
        }
        self.flush()?;
        draft.commit(&self.target)?;
        Ok(())
    }

    fn write(&mut self, row: &SensorRow) -> Result<()> {
        let Some(tables) = &mut self.tables else {
            return Ok(());
        };
        let mut text = row.time_us.to_string();
        let mut numbers = Vec::new();
        let mut whole = true;
        for &sensor in &self.tally.sensors {
            match row.readings.get(sensor).copied().flatten() {
                Some(reading) => {
                    let [x, y, z] = reading.field;
                    let degrees = degrees(reading.temperature);
                    text += &format!(",{x},{y},{z},{degrees}");
                    numbers.extend([x, y, z].map(f64::from));
                    numbers.push(degrees);
                }
                None => {
                    whole = false;
                    if let Some(count) = self.tally.silent.get_mut(sensor) {
                        *count += 1;
                    }
                }
            }
        }
        if !whole {
            self.tally.left_out += 1;
            return Ok(());
        }
        let values = covariate_values(&row.covariates);
        for &place in &self.covariates {
            let Some(value) = values.get(place).copied().flatten() else {
                self.tally.left_out += 1;
                self.tally.without_covariates += 1;
                return Ok(());
            };
            text += &format!(",{value:.COVARIATE_DECIMALS$}");
            numbers.push(value);
        }
        self.tally.rows += 1;
        let mut written = tables.hall.line(&text);
        let without_force = self.reference.is_none() && row.time_us >= self.reference_us;
        if without_force {
            self.reference_us = row.time_us - row.time_us % REFERENCE_US + REFERENCE_US;
            let empty = ",".repeat(2 * self.tally.sensors.len());
            written = written.and_then(|()| tables.force.line(&format!("{}{empty}", row.time_us)));
        }
        self.or_cut(written)?;
        let Some(mcap) = &mut self.mcap else { return Ok(()) };
        let time_us = row.time_us as f64;
        mcap.row(time_us, &numbers)?;
        if without_force || self.tally.rows == 1 {
            // An import needs a row of the reference: its first one may come late, or never.
            let columns = self.reference.as_ref().map_or(2 * self.tally.sensors.len(), Vec::len);
            mcap.reference(time_us, &vec![f64::NAN; columns])?;
        }
        if row.force_n.iter().any(Option::is_some) {
            let estimates = row.force_n.map(|force_n| EstimatedForce { force_n, sigma_n: None });
            mcap.estimates(time_us, &estimates)?;
        }
        Ok(())
    }

    /// Removes a partial line after a failed write.
    fn or_cut(&mut self, result: io::Result<()>) -> Result<()> {
        if result.is_err()
            && let Some(tables) = &mut self.tables
        {
            for table in [&mut tables.hall, &mut tables.force] {
                let whole = table.written();
                // Report the first error.
                let _ = table.out().set_len(whole);
            }
        }
        result.with_context(|| {
            format!("{} cannot be written; earlier rows are valid", self.target.display())
        })
    }
}

/// The two tables of a recording.
struct Tables {
    hall: PagedWriter<File>,
    force: PagedWriter<File>,
}

impl Tables {
    fn create(
        folder: &Path,
        sensors: &[usize],
        covariates: &[&str],
        reference: Option<&[String]>,
    ) -> io::Result<Self> {
        let numbers = || sensors.iter().map(|sensor| *sensor as u32);
        let table = |name: &str, columns: Vec<String>| -> io::Result<_> {
            let mut table = PagedWriter::new(File::create_new(folder.join(name))?);
            table.line(&columns.join(","))?;
            table.flush()?;
            Ok(table)
        };
        let mut columns = vec!["t_us".to_owned()];
        columns.extend(numbers().flat_map(sensor_columns));
        columns.extend(covariates.iter().map(|name| (*name).to_owned()));
        Ok(Self {
            hall: table("hall.csv", columns)?,
            force: table(
                "force.csv",
                match reference {
                    None => force_columns(numbers()),
                    Some(columns) => {
                        std::iter::once("t_us".to_owned()).chain(columns.iter().cloned()).collect()
                    }
                },
            )?,
        })
    }

    fn both(
        &mut self,
        mut act: impl FnMut(&mut PagedWriter<File>) -> io::Result<()>,
    ) -> io::Result<()> {
        act(&mut self.hall)?;
        act(&mut self.force)
    }
}

#[cfg(test)]
mod tests;
