//! Assembly of packets to rows, and writing of a recording whose folder is valid from its creation, even if the process
//! is killed.

use crate::board_topics::BoardTopics;
use crate::csv_writer::PagedWriter;
use crate::format::degrees;
use crate::state::BoardClock;
use anyhow::{Context, Result, bail};
pub use coverage::{Coverage, CoveredRange, ForceEstimates};
use device_run::channel_map::covariate_values;
use firmware::compensation::covariates::Covariates;
use firmware::config::constants::TICK_US;
use firmware::fixed_point::Force;
use firmware::protocol::messages::{HallRaw, Message};
use firmware::protocol::serial::Packet;
use firmware::sensors::hall::{HallReading, SENSORS};
use model_export::output::{StagingDir, check_vacant};
use model_export::recordings::columns::COVARIATES;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::mcap::{EstimatedForce, McapWriter, RecordingMcap};
use sim::campaign::recording::{force_columns, sensor_columns};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

mod coverage;

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

/// Readings of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorRow {
    /// Board time in microseconds.
    pub time_us: u64,
    pub readings: [Option<HallReading>; SENSORS],
    /// Lateral and longitudinal force in newtons that the board estimated; none where invalid and over a CAN bus.
    pub force_n: [Option<[f64; 2]>; SENSORS],
    /// Covariates; none over a CAN bus.
    pub covariates: Covariates,
}

/// The board restarted: its clock is not continuous.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Restarted;

/// Assembles rows from packets.
#[derive(Clone, Debug)]
pub struct SensorRowAssembler {
    clock: BoardClock,
    sets: Option<Sets>,
    /// True after the first row.
    begun: bool,
}

/// Steps of the heartbeats' counter of a board that did not restart.
const STEPS: std::ops::RangeInclusive<u8> = 1..=3;

impl SensorRowAssembler {
    /// For a serial line: one packet per tick.
    pub fn of_ticks() -> Self {
        Self { clock: BoardClock::default(), sets: None, begun: false }
    }

    /// For a CAN bus: one frame per sensor follows the forces, which come every `period_us`.
    pub fn of_sets(period_us: u64) -> Self {
        let sets = Sets {
            period_us,
            counted: None,
            readings: [None; SENSORS],
            beat: None,
            has_version: false,
        };
        Self { sets: Some(sets), ..Self::of_ticks() }
    }

    /// Period of the rows in microseconds.
    pub fn period_us(&self) -> u64 {
        self.sets.as_ref().map_or(TICK_US, |sets| sets.period_us)
    }

    /// Returns the row that a packet completes, received `at_s` seconds after the start.
    ///
    /// # Errors
    /// The board restarted since the last row.
    pub fn take(&mut self, at_s: f64, packet: &Packet) -> Result<Option<SensorRow>, Restarted> {
        let row = match (packet, &mut self.sets) {
            // The ticks of a serial line show a restart by their time.
            (Packet::Message { message: Message::Version(_), .. }, Some(sets)) => {
                sets.has_version = self.begun;
                None
            }
            (Packet::Message { message: Message::Heartbeat(beat), .. }, Some(sets)) => {
                if !sets.continues(beat.counter) {
                    return Err(Restarted);
                }
                None
            }
            (Packet::Tick(tick), None) => Some(SensorRow {
                time_us: self.clock.extend(tick.time_us, at_s).ok_or(Restarted)?,
                readings: tick.sensors.map(|sensor| sensor.reading()),
                force_n: tick.sensors.map(|sensor| {
                    let is_valid = sensor.validity().is_in_range();
                    is_valid.then(|| sensor.force.map(|counts| Force(counts).newtons()))
                }),
                covariates: tick.covariates,
            }),
            (Packet::Message { message, .. }, Some(sets)) => sets.take(at_s, message),
            _ => None,
        };
        self.begun |= row.is_some();
        Ok(row)
    }
}

/// Raw frames between two force messages.
#[derive(Clone, Debug)]
struct Sets {
    period_us: u64,
    /// Counter of the forces, number of the set since the first, reception time.
    counted: Option<(u8, u64, f64)>,
    readings: [Option<HallReading>; SENSORS],
    /// Counter of the latest heartbeat.
    beat: Option<u8>,
    /// A version came after it: a board sends one at its start, and to whoever asks for it.
    has_version: bool,
}

impl Sets {
    /// Whether the heartbeat with this counter is of a board that did not restart.
    fn continues(&mut self, counter: u8) -> bool {
        let step = self.beat.replace(counter).map(|last| counter.wrapping_sub(last));
        let is_suspect = std::mem::take(&mut self.has_version);
        !is_suspect || step.is_none_or(|step| STEPS.contains(&step))
    }

    fn take(&mut self, at_s: f64, message: &Message) -> Option<SensorRow> {
        match message {
            Message::Force(force) => match self.counted {
                Some((counter, _, _)) if counter == force.counter => None,
                Some(_) | None => self.next(at_s, force.counter),
            },
            Message::HallRaw(raw) => {
                self.read(raw);
                None
            }
            _ => None,
        }
    }

    fn read(&mut self, raw: &HallRaw) {
        // Without preceding forces the time is unknown; a second frame of a sensor means that the
        // forces in between were lost.
        let place = self.readings.get_mut(usize::from(raw.sensor));
        if let (Some(place @ None), Some(_)) = (place, self.counted) {
            *place =
                Some(HallReading { field: [raw.x, raw.y, raw.z], temperature: raw.temperature });
        }
    }

    /// Forces with a new counter: the previous set is complete.
    fn next(&mut self, at_s: f64, counter: u8) -> Option<SensorRow> {
        let Some((before, set, before_s)) = self.counted else {
            self.counted = Some((counter, 0, at_s));
            return None;
        };
        let step = u64::from(counter.wrapping_sub(before));
        // Lost counter overflows follow from the elapsed time.
        let passed = 1e6 * (at_s - before_s) / self.period_us as f64;
        let turns = ((passed - step as f64) / 256.0).round().max(0.0) as u64;
        self.counted = Some((counter, set + step + 256 * turns, at_s));
        let readings = std::mem::take(&mut self.readings);
        readings.iter().any(Option::is_some).then_some(SensorRow {
            time_us: set * self.period_us,
            readings,
            force_n: [None; SENSORS],
            covariates: Covariates::default(),
        })
    }
}

#[cfg(test)]
mod unit_tests {
    use firmware::protocol::messages::{Force, Heartbeat, Version};
    use firmware::protocol::serial::{SensorTick, Tick};

    use super::*;

    fn force(counter: u8) -> Packet {
        let force = Force { counter, ..Force::default() };
        Packet::Message { copy: 0, message: Message::Force(force) }
    }

    fn raw(sensor: u8, x: i16) -> Packet {
        let raw = HallRaw { sensor, x, ..HallRaw::default() };
        Packet::Message { copy: 0, message: Message::HallRaw(raw) }
    }

    fn tick(time_us: u32) -> Packet {
        let silent = SensorTick { field: [0; 3], temperature: 0, force: [0; 2], validity: 3 };
        let covariates = Covariates::default();
        Packet::Tick(Tick { time_us, sensors: [silent; SENSORS], covariates })
    }

    fn xs(row: &SensorRow) -> [Option<i16>; SENSORS] {
        row.readings.map(|reading| reading.map(|reading| reading.field[0]))
    }

    #[test]
    fn frames_after_the_forces_form_a_row_at_their_time() {
        let mut rows = SensorRowAssembler::of_sets(10_000);
        let packets = [
            raw(3, 1),
            force(7),
            raw(0, 10),
            raw(2, 12),
            force(8),
            force(8),
            raw(0, 20),
            force(11),
        ];
        let assembled: Vec<SensorRow> =
            packets.iter().filter_map(|packet| rows.take(0.0, packet).unwrap()).collect();
        assert_eq!(assembled.iter().map(|row| row.time_us).collect::<Vec<_>>(), [0, 10_000]);
        assert_eq!(xs(&assembled[0]), [Some(10), None, Some(12), None]);
        assert_eq!(xs(&assembled[1]), [Some(20), None, None, None]);
        // The set of counter 11 is the fourth.
        rows.take(0.04, &raw(1, 40)).unwrap();
        let last = rows.take(0.05, &force(12)).unwrap().unwrap();
        assert_eq!((last.time_us, xs(&last)[1]), (40_000, Some(40)));
    }

    #[test]
    fn lost_counter_overflows_count_as_elapsed_time() {
        let mut rows = SensorRowAssembler::of_sets(2_000);
        rows.take(0.0, &force(0)).unwrap();
        // 2 s and 10 ms later: 1005 sets, of which the counter shows 237.
        rows.take(2.01, &force(237)).unwrap();
        rows.take(2.01, &raw(0, 1)).unwrap();
        let row = rows.take(2.012, &force(238)).unwrap().unwrap();
        assert_eq!(row.time_us, 2_010_000);
    }

    #[test]
    fn a_decreasing_clock_is_a_restart_and_a_version_is_none() {
        let version = Packet::Message { copy: 0, message: Message::Version(Version::default()) };
        let mut rows = SensorRowAssembler::of_ticks();
        assert_eq!(rows.take(0.0, &version), Ok(None));
        assert_eq!(rows.take(0.0, &tick(9_000)).unwrap().unwrap().time_us, 9_000);
        assert_eq!(rows.take(0.1, &version), Ok(None));
        assert_eq!(rows.take(0.1, &tick(10_000)).unwrap().unwrap().time_us, 10_000);
        assert_eq!(rows.take(0.1, &tick(2_000)), Err(Restarted));
    }

    /// Whoever asks a board for its version gets it on the bus of all.
    #[test]
    fn a_version_and_new_heartbeats_are_a_restart_on_a_bus() {
        let message = |message| Packet::Message { copy: 0, message };
        let beat =
            |counter| message(Message::Heartbeat(Heartbeat { counter, ..Heartbeat::default() }));
        let version = message(Message::Version(Version::default()));
        let mut rows = SensorRowAssembler::of_sets(10_000);
        for packet in [force(7), raw(0, 1), force(8), beat(254), version, beat(255), beat(0)] {
            assert!(rows.take(0.0, &packet).is_ok(), "{packet:?}");
        }
        assert!(rows.take(0.1, &version).is_ok());
        assert_eq!(rows.take(0.2, &beat(0)), Err(Restarted));
    }
}
