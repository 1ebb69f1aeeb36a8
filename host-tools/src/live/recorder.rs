//! Rows into a recording, whose folder appears when it can be read and can be read whenever the recorder is
//! killed.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use firmware::frame::SENSORS;
use model_export::recordings::description::Description;

use super::json::degrees;
use super::paged::Paged;
use super::rows::Row;
use crate::bench::record::{force_columns, sensor_columns};
use crate::new_folder::{check_free, draft};

/// Which sensors there are is seen in the first of this time.
const LOOK_US: u64 = 200_000;
/// Rows wait this long at the most before they are written.
const FLUSH_US: u64 = 500_000;
/// Time between two rows of the reference's table.
const REFERENCE_US: u64 = 10_000;

/// What was recorded and what was not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Sensors in the recording.
    pub sensors: Vec<usize>,
    /// Rows that were written.
    pub rows: u64,
    /// Rows that did not arrive.
    pub lost: u64,
    /// Interruptions, and the longest with its beginning, in microseconds.
    pub gaps: u64,
    /// See `gaps`.
    pub longest_us: (u64, u64),
    /// Rows that were left out because a sensor had not answered.
    pub left_out: u64,
    /// How often each sensor had not.
    pub silent: [u64; SENSORS],
    /// From the first row that came to the last.
    pub span_us: u64,
}

/// Writes a recording.
pub struct Recorder {
    target: PathBuf,
    description: Description,
    period_us: u64,
    /// Rows until it is seen which sensors there are.
    waiting: Vec<Row>,
    tables: Option<Tables>,
    first_us: Option<u64>,
    last_us: u64,
    flushed_us: u64,
    reference_us: u64,
    tally: Tally,
}

impl Recorder {
    /// A recording in a new folder, of rows that come every `period_us`.
    ///
    /// # Errors
    /// Something stands there.
    pub fn new(target: &Path, description: Description, period_us: u64) -> Result<Self> {
        check_free(target)?;
        Ok(Self {
            target: target.to_path_buf(),
            description,
            period_us,
            waiting: Vec::new(),
            tables: None,
            first_us: None,
            last_us: 0,
            flushed_us: 0,
            reference_us: 0,
            tally: Tally::default(),
        })
    }

    /// Adds a row; its time is after that of the one before.
    ///
    /// # Errors
    /// The file system's; what was written before stays whole.
    pub fn take(&mut self, row: Row) -> Result<()> {
        let first_us = *self.first_us.get_or_insert(row.time_us);
        let time_us = row.time_us.saturating_sub(first_us);
        self.note_gap(time_us);
        let row = Row { time_us, ..row };
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

    /// Writes what waits, but for the last row.
    ///
    /// # Errors
    /// The file system's.
    pub fn flush(&mut self) -> Result<()> {
        let Some(tables) = &mut self.tables else {
            return Ok(());
        };
        let flushed = tables.both(|table| {
            table.flush()?;
            table.out().sync_data()
        });
        self.or_cut(flushed)
    }

    /// Writes everything.
    ///
    /// # Errors
    /// No reading came, or the file system's.
    pub fn finish(mut self) -> Result<Tally> {
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

    /// Makes the folder, with the rows so far.
    fn begin(&mut self) -> Result<()> {
        let answers = |sensor: &usize| {
            let mut rows = self.waiting.iter();
            rows.any(|row| row.readings.get(*sensor).is_some_and(Option::is_some))
        };
        let sensors: Vec<usize> = (0..SENSORS).filter(answers).collect();
        if sensors.is_empty() {
            bail!(
                "no sensor gave a reading, so nothing is recorded: `magpie monitor` shows what is wrong with them"
            );
        }
        let unwritable = || format!("{} cannot be written", self.target.display());
        let draft = draft(&self.target, ".magpie-record-")?;
        self.description.write(draft.path())?;
        let tables = Tables::create(draft.path(), &sensors).with_context(unwritable)?;
        self.tables = Some(tables);
        self.tally.sensors = sensors;
        for row in std::mem::take(&mut self.waiting) {
            self.write(&row)?;
        }
        self.flush()?;
        check_free(&self.target)?;
        fs::rename(draft.keep(), &self.target)
            .with_context(|| format!("{} cannot be written", self.target.display()))
    }

    fn write(&mut self, row: &Row) -> Result<()> {
        let Some(tables) = &mut self.tables else {
            return Ok(());
        };
        let mut text = row.time_us.to_string();
        let mut whole = true;
        for &sensor in &self.tally.sensors {
            match row.readings.get(sensor).copied().flatten() {
                Some(reading) => {
                    let [x, y, z] = reading.field;
                    text += &format!(",{x},{y},{z},{}", degrees(reading.temperature));
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
        self.tally.rows += 1;
        let mut written = tables.hall.line(&text);
        if row.time_us >= self.reference_us {
            self.reference_us = row.time_us - row.time_us % REFERENCE_US + REFERENCE_US;
            let empty = ",".repeat(2 * self.tally.sensors.len());
            written = written.and_then(|()| tables.force.line(&format!("{}{empty}", row.time_us)));
        }
        self.or_cut(written)
    }

    /// Where a write fails half-way, a part of a line is cut off again.
    fn or_cut(&mut self, result: io::Result<()>) -> Result<()> {
        if result.is_err()
            && let Some(tables) = &mut self.tables
        {
            for table in [&mut tables.hall, &mut tables.force] {
                let whole = table.written();
                // The first error is the one to tell.
                let _ = table.out().set_len(whole);
            }
        }
        result.with_context(|| {
            format!(
                "{} cannot be written on; what was written before is whole",
                self.target.display()
            )
        })
    }
}

/// The two tables of a recording.
struct Tables {
    hall: Paged<File>,
    force: Paged<File>,
}

impl Tables {
    fn create(folder: &Path, sensors: &[usize]) -> io::Result<Self> {
        let numbers = || sensors.iter().map(|sensor| *sensor as u32);
        let table = |name: &str, columns: Vec<String>| -> io::Result<_> {
            let mut table = Paged::new(File::create_new(folder.join(name))?);
            table.line(&columns.join(","))?;
            Ok(table)
        };
        let mut columns = vec!["t_us".to_owned()];
        columns.extend(numbers().flat_map(sensor_columns));
        Ok(Self {
            hall: table("hall.csv", columns)?,
            force: table("force.csv", force_columns(numbers()))?,
        })
    }

    fn both(&mut self, mut act: impl FnMut(&mut Paged<File>) -> io::Result<()>) -> io::Result<()> {
        act(&mut self.hall)?;
        act(&mut self.force)
    }
}

#[cfg(test)]
mod tests;
