//! Topics of numbers as ROS 2 messages of 64-bit floating-point fields, with the unit of each, and the writer of MCAP files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mcap::records::MessageHeader;

use crate::recordings::error::{DataError, ErrorKind, Location};

/// Key of a channel's metadata: `name=unit` of each number, separated by commas.
pub const UNITS_KEY: &str = "units";
/// Key of a channel's metadata: the mapping with which `import` reads the file.
pub const MAPPING_KEY: &str = "magpie.mapping";

/// Header of a message in plain CDR, little-endian; its fields of 8 bytes need no padding.
const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// Encoding of the messages, and of their schemas.
pub const MESSAGE_ENCODING: &str = "cdr";
/// See [`MESSAGE_ENCODING`].
pub const SCHEMA_ENCODING: &str = "ros2msg";

/// A topic of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct NumberTopic {
    /// Name.
    pub topic: String,
    /// Name of its message type.
    pub message: String,
    /// Definition of its message type, with the units as comments.
    pub schema: String,
    /// Units, and the mapping with which a file is imported.
    pub metadata: BTreeMap<String, String>,
}

impl NumberTopic {
    /// A topic of numbers with these names and units; `message` is the name of its type.
    pub fn new(
        topic: &str,
        message: &str,
        numbers: &[(&str, &str)],
        mapping: Option<&str>,
    ) -> Self {
        let field = |(name, unit): &(&str, &str)| match *unit {
            "" => format!("float64 {name}\n"),
            unit => format!("float64 {name} # {unit}\n"),
        };
        let units = numbers.iter().filter(|(_, unit)| !unit.is_empty());
        let units = units.map(|(name, unit)| format!("{name}={unit}"));
        let mut metadata =
            BTreeMap::from([(UNITS_KEY.to_owned(), units.collect::<Vec<_>>().join(","))]);
        metadata.extend(mapping.map(|mapping| (MAPPING_KEY.to_owned(), mapping.to_owned())));
        Self {
            topic: topic.to_owned(),
            message: format!("magpie_msgs/msg/{message}"),
            schema: numbers.iter().map(field).collect(),
            metadata,
        }
    }

    /// Content of a message.
    pub fn encode(values: &[f64]) -> Vec<u8> {
        let values = values.iter().flat_map(|value| value.to_le_bytes());
        CDR_LITTLE_ENDIAN.into_iter().chain(values).collect()
    }
}

/// Where messages of topics go: a file, or a server.
pub trait TopicSink {
    /// Handle of a topic.
    type Id;

    /// Adds a topic.
    ///
    /// # Errors
    /// The sink cannot be written.
    fn add_topic(&mut self, topic: NumberTopic) -> Result<Self::Id, DataError>;

    /// Writes a message with the numbers of its topic.
    ///
    /// # Errors
    /// The sink cannot be written.
    fn write(
        &mut self,
        topic: &mut Self::Id,
        time_us: f64,
        values: &[f64],
    ) -> Result<(), DataError>;
}

/// A topic of an [`McapWriter`].
#[derive(Clone, Debug)]
pub struct TopicId {
    channel: u16,
    sequence: u32,
}

/// Duration of a chunk: what a killed program loses.
const CHUNK: Duration = Duration::from_secs(1);

/// A file being written. A chunk reaches the file as a whole, when it is complete.
pub struct McapWriter {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<File>>,
    /// Time of the first message of the chunk, and when it was written; `None` in an empty one.
    chunk: Option<(u64, Instant)>,
}

impl McapWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// It exists or cannot be created.
    pub fn create(path: &Path) -> Result<Self, DataError> {
        let file = File::create_new(path)
            .map_err(|error| ErrorKind::Unwritable(error).at(Location::file(path)))?;
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            .library(format!("magpie {}", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            // The header of a chunk is not written before its content.
            .disable_seeking(true);
        let writer =
            options.create(BufWriter::new(file)).map_err(|error| unwritable(path, error))?;
        Ok(Self { path: path.to_path_buf(), writer, chunk: None })
    }

    /// Ends a chunk that was begun a second ago, also if no message follows.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush_due(&mut self) -> Result<(), DataError> {
        let is_due = self.chunk.is_some_and(|(_, begun)| begun.elapsed() >= CHUNK);
        if is_due { self.flush() } else { Ok(()) }
    }

    /// Ends the chunk, so that its messages, schemas and channels are in the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), DataError> {
        self.chunk = None;
        self.writer.flush().map_err(|error| unwritable(&self.path, error))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<(), DataError> {
        self.writer.finish().map(drop).map_err(|error| unwritable(&self.path, error))
    }
}

impl TopicSink for McapWriter {
    type Id = TopicId;

    fn add_topic(&mut self, topic: NumberTopic) -> Result<TopicId, DataError> {
        let NumberTopic { topic, message, schema, metadata } = topic;
        let failed = |error| unwritable(&self.path, error);
        let schema =
            self.writer.add_schema(&message, SCHEMA_ENCODING, schema.as_bytes()).map_err(failed)?;
        let channel = self.writer.add_channel(schema, &topic, MESSAGE_ENCODING, &metadata);
        Ok(TopicId { channel: channel.map_err(failed)?, sequence: 0 })
    }

    fn write(
        &mut self,
        topic: &mut TopicId,
        time_us: f64,
        values: &[f64],
    ) -> Result<(), DataError> {
        let time_ns = (1e3 * time_us).round().max(0.0) as u64;
        let header = MessageHeader {
            channel_id: topic.channel,
            sequence: topic.sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        topic.sequence = topic.sequence.wrapping_add(1);
        let is_long =
            |first_ns: u64| u128::from(time_ns.saturating_sub(first_ns)) >= CHUNK.as_nanos();
        if self.chunk.is_some_and(|(first_ns, _)| is_long(first_ns)) {
            self.flush()?;
        }
        self.chunk.get_or_insert_with(|| (time_ns, Instant::now()));
        self.writer
            .write_to_known_channel(&header, &NumberTopic::encode(values))
            .map_err(|error| unwritable(&self.path, error))
    }
}

fn unwritable(path: &Path, error: mcap::McapError) -> DataError {
    let error = match error {
        mcap::McapError::Io(error) => error,
        other => std::io::Error::other(other),
    };
    ErrorKind::Unwritable(error).at(Location::file(path))
}
