//! The topics of a recording: the board's readings and covariates, the reference, and what the device estimates; in an MCAP file,
//! or live.

use std::io;
use std::path::Path;

use crate::description::RecordingDescription;
use crate::error::{DataError, ErrorKind, Location};
use crate::mapping::{ClockMapping, ColumnMapping, Mapping, TableMapping};
use crate::mcap::LOG_TIME;
use crate::mcap::writer::{McapWriter, NumberTopic, TopicSink};
use crate::units::{self, column_unit};

/// Topic of the board's rows, with the columns of `hall.csv`.
const BOARD: &str = "/board";
/// Topic of the reference's rows, with the columns of `force.csv`.
const REFERENCE: &str = "/reference";
/// Topic of the device's estimates.
const ESTIMATE: &str = "/estimate";
/// Prefix of the topics of the device's state.
const STATE: &str = "/state";

/// A topic of the device's state.
#[derive(Clone, Debug)]
pub struct StateTopic<'a> {
    /// Name, without its prefix.
    pub name: &'a str,
    /// Names and units of its numbers.
    pub signals: Vec<(&'a str, &'a str)>,
}

/// The device's estimate of the force on one sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct EstimatedForce {
    /// Lateral and longitudinal force in newtons; none where it is not valid.
    pub force_n: Option<[f64; 2]>,
    /// Their standard deviations by a network.
    pub sigma_n: Option<[f64; 2]>,
}

/// The topics of one recording, and where they are written.
pub struct RecordingTopics<S: TopicSink> {
    sink: S,
    board: S::Id,
    reference: Option<S::Id>,
    estimate: S::Id,
    state: Vec<S::Id>,
    /// Start of the recording on the clock of the messages.
    start_us: f64,
}

/// A recording as an MCAP file.
pub type RecordingMcap = RecordingTopics<McapWriter>;

/// What the topics of a recording hold.
#[derive(Clone, Copy, Debug)]
pub struct TopicColumns<'a> {
    /// Columns of the board's table, without `t_us`.
    pub hall: &'a [String],
    /// Columns of the reference's table, without `t_us`; empty without a reference.
    pub force: &'a [String],
    /// Sensors with an estimate.
    pub sensors: &'a [u32],
    /// Topics of the device's state.
    pub state: &'a [StateTopic<'a>],
}

impl RecordingMcap {
    /// A new file, which appears with its topics and first messages.
    ///
    /// # Errors
    /// It exists, or its folder cannot be written.
    pub fn create(
        path: &Path,
        description: &RecordingDescription,
        columns: TopicColumns,
    ) -> Result<Self, DataError> {
        let mapping = mapping(path, description, columns.hall, columns.force)?;
        let writer = McapWriter::create(path)?;
        Self::new(writer, columns, Some(&mapping), 1e6 * description.start_s)
    }

    /// Writes the messages so far to the file if the first of them is a second old.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush_due(&mut self) -> Result<(), DataError> {
        self.sink.flush_due()
    }

    /// Writes the messages so far to the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), DataError> {
        self.sink.flush()
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(self) -> Result<(), DataError> {
        self.sink.finish()
    }
}

impl<S: TopicSink> RecordingTopics<S> {
    /// Adds the topics to `sink`; a file states the `mapping` with which it is imported.
    ///
    /// # Errors
    /// The sink cannot be written; so for the methods.
    pub fn new(
        mut sink: S,
        columns: TopicColumns,
        mapping: Option<&str>,
        start_us: f64,
    ) -> Result<Self, DataError> {
        let TopicColumns { hall, force, sensors, state } = columns;
        let board = sink.add_topic(NumberTopic::new(BOARD, "Board", &with_units(hall), mapping))?;
        let reference = match force {
            [] => None,
            _ => {
                let topic = NumberTopic::new(REFERENCE, "Reference", &with_units(force), None);
                Some(sink.add_topic(topic)?)
            }
        };
        let of_sensor = |number: &u32| {
            ["x_n", "z_n", "x_sigma_n", "z_sigma_n"].map(|part| format!("f{number}_{part}"))
        };
        let estimates: Vec<String> = sensors.iter().flat_map(of_sensor).collect();
        let estimates = NumberTopic::new(ESTIMATE, "Estimate", &with_units(&estimates), None);
        let estimate = sink.add_topic(estimates)?;
        let topic = |topic: &StateTopic| {
            let name = format!("{STATE}/{}", topic.name);
            sink.add_topic(NumberTopic::new(&name, topic.name, &topic.signals, None))
        };
        let state = state.iter().map(topic).collect::<Result<_, _>>()?;
        Ok(Self { sink, board, reference, estimate, state, start_us })
    }

    /// Writes a row of the board; times are those of the recording.
    ///
    /// # Errors
    /// The sink cannot be written.
    pub fn board(&mut self, time_us: f64, values: &[f64]) -> Result<(), DataError> {
        self.sink.write(&mut self.board, self.start_us + time_us, values)
    }

    /// Writes a row of the reference; NaN for a force that was not measured.
    pub fn reference(&mut self, time_us: f64, force_n: &[f64]) -> Result<(), DataError> {
        match &mut self.reference {
            Some(topic) => self.sink.write(topic, self.start_us + time_us, force_n),
            None => Ok(()),
        }
    }

    /// Writes the estimates of the sensors of the file.
    pub fn estimate(
        &mut self,
        time_us: f64,
        estimates: impl Iterator<Item = EstimatedForce>,
    ) -> Result<(), DataError> {
        let values = estimates.flat_map(|estimate| {
            let [x, z] = estimate.force_n.unwrap_or([f64::NAN; 2]);
            let [sigma_x, sigma_z] = estimate.sigma_n.unwrap_or([f64::NAN; 2]);
            [x, z, sigma_x, sigma_z]
        });
        let values: Vec<f64> = values.collect();
        self.sink.write(&mut self.estimate, self.start_us + time_us, &values)
    }

    /// Writes a message of the state topic with this index.
    pub fn state(&mut self, topic: usize, time_us: f64, values: &[f64]) -> Result<(), DataError> {
        match self.state.get_mut(topic) {
            Some(topic) => self.sink.write(topic, self.start_us + time_us, values),
            None => Ok(()),
        }
    }
}

/// Columns of a recording with the units that their names end in.
fn with_units(columns: &[String]) -> Vec<(&str, &'static str)> {
    let unit = |column: &str| units::symbol(column_unit(column)?);
    columns.iter().map(|column| (column.as_str(), unit(column).unwrap_or_default())).collect()
}

/// The mapping with which `import` reads the file.
fn mapping(
    path: &Path,
    description: &RecordingDescription,
    hall: &[String],
    force: &[String],
) -> Result<String, DataError> {
    let table = |topic: &str, names: &[String]| {
        let column = |(name, unit): (&str, &str)| ColumnMapping {
            from: format!("{topic}.{name}"),
            unit: unit.to_owned(),
            to: name.to_owned(),
            scale: 1.0,
            missing: None,
        };
        TableMapping {
            file: None,
            clock: ClockMapping {
                from: format!("{topic}.{LOG_TIME}"),
                unit: "ns".to_owned(),
                row_s: None,
                offset_s: 0.0,
                from_first_row: false,
            },
            columns: with_units(names).into_iter().map(column).collect(),
            attitude: None,
        }
    };
    let mapping = Mapping {
        description: description.description.clone(),
        one_clock: true,
        starts_s: Vec::new(),
        range_gauss: description.range_gauss,
        gauss_per_lsb: description.gauss_per_lsb,
        design: description.design.clone(),
        hall: table(BOARD, hall),
        force: table(REFERENCE, force),
    };
    toml::to_string(&mapping)
        .map_err(|error| ErrorKind::Unwritable(io::Error::other(error)).at(Location::file(path)))
}
