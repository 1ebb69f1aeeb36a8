//! Topics of numbers as ROS 2 messages of 64-bit floating-point fields, with the unit of each, and the writer of MCAP files
//! (<https://mcap.dev/spec>). The writer of the crate `mcap` keeps the index of all chunks in memory, and its file begins without a
//! message.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flate2::Crc;
use mcap::MAGIC;
use mcap::records::op;

use crate::error::{DataError, ErrorKind, Location};
use crate::output;

/// Key of a channel's metadata: `name=unit` of each number, separated by commas.
pub(crate) const UNITS_KEY: &str = "units";
/// Key of a channel's metadata: the mapping with which `import` reads the file.
pub(crate) const MAPPING_KEY: &str = "magpie.mapping";

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
/// Length of the messages of a chunk at which it ends earlier.
const CHUNK_BYTES: usize = 1 << 20;
/// Compression of the chunks.
const COMPRESSION: &str = "zstd";
/// Checksum that is not available.
const NO_CHECKSUM: [u8; 4] = [0; 4];

/// A file being written. It appears with its first messages, and each chunk reaches it as a whole, so that what a killed program leaves
/// can be read. Memory does not grow with the file.
pub struct McapWriter {
    path: PathBuf,
    /// None before the first chunk.
    file: Option<File>,
    /// Checksum and number of the bytes before the end of the data.
    checksum: Crc,
    length: u64,
    chunk: Chunk,
    /// Schemas and channels, which the end of the file repeats.
    schemas: Vec<u8>,
    channels: Vec<u8>,
    /// Index of the chunks, for the end of the file: a file without a name.
    indices: File,
    chunks: u32,
    /// Number of messages of each channel.
    messages: BTreeMap<u16, u64>,
    /// Times in nanoseconds of the first and the last message.
    extent_ns: Option<[u64; 2]>,
    /// The file is complete, or writing has failed, after which no end makes it look complete.
    is_ended: bool,
}

/// Messages that are not in the file yet.
#[derive(Default)]
struct Chunk {
    records: Vec<u8>,
    /// Time and place of the messages of each channel.
    index: BTreeMap<u16, Vec<[u64; 2]>>,
    extent_ns: Option<[u64; 2]>,
    /// Time of the first message, and when it was written.
    begun: Option<(u64, Instant)>,
}

impl McapWriter {
    /// A file with this path, where nothing may be.
    ///
    /// # Errors
    /// Something is there, or its folder cannot be written.
    pub fn create(path: &Path) -> Result<Self, DataError> {
        output::check_absent(path)?;
        let indices = tempfile::tempfile_in(output::folder_of(path));
        Ok(Self {
            path: path.to_path_buf(),
            file: None,
            checksum: Crc::new(),
            length: 0,
            chunk: Chunk::default(),
            schemas: Vec::new(),
            channels: Vec::new(),
            indices: indices.map_err(|error| unwritable(path, error))?,
            chunks: 0,
            messages: BTreeMap::new(),
            extent_ns: None,
            is_ended: false,
        })
    }

    /// Ends a chunk that was begun a second ago, also if no message follows.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush_due(&mut self) -> Result<(), DataError> {
        let is_due = self.chunk.begun.is_some_and(|(_, begun)| begun.elapsed() >= CHUNK);
        if is_due { self.flush() } else { Ok(()) }
    }

    /// Ends the chunk, so that its messages are in the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), DataError> {
        let chunk = std::mem::take(&mut self.chunk);
        if chunk.records.is_empty() {
            return Ok(());
        }
        let mut bytes = Vec::new();
        if self.file.is_none() {
            bytes.extend(MAGIC);
            let library = format!("magpie {}", env!("CARGO_PKG_VERSION"));
            push_record(&mut bytes, op::HEADER, &[&text("ros2"), &text(&library)]);
        }
        let start = self.length + bytes.len() as u64;
        let compressed = zstd::encode_all(&chunk.records[..], 0);
        let compressed = compressed.map_err(|error| unwritable(&self.path, error))?;
        let mut checksum = Crc::new();
        checksum.update(&chunk.records);
        let [first_ns, last_ns] = chunk.extent_ns.unwrap_or_default();
        let [first_ns, last_ns] = [first_ns, last_ns].map(u64::to_le_bytes);
        let [size, compressed_size] =
            [&chunk.records, &compressed].map(|records| (records.len() as u64).to_le_bytes());
        let compression = text(COMPRESSION);
        push_record(
            &mut bytes,
            op::CHUNK,
            &[
                &first_ns,
                &last_ns,
                &size,
                &checksum.sum().to_le_bytes(),
                &compression,
                &compressed_size,
                &compressed,
            ],
        );
        let end = self.length + bytes.len() as u64;
        let mut places = Vec::new();
        for (channel, messages) in &chunk.index {
            let place = self.length + bytes.len() as u64;
            places.extend(channel.to_le_bytes().into_iter().chain(place.to_le_bytes()));
            let entries = messages.iter().flatten().flat_map(|number| number.to_le_bytes());
            let entries = sized(&entries.collect::<Vec<u8>>());
            push_record(&mut bytes, op::MESSAGE_INDEX, &[&channel.to_le_bytes(), &entries]);
        }
        let indices_length = self.length + bytes.len() as u64 - end;
        let mut index = Vec::new();
        push_record(
            &mut index,
            op::CHUNK_INDEX,
            &[
                &first_ns,
                &last_ns,
                &start.to_le_bytes(),
                &(end - start).to_le_bytes(),
                &sized(&places),
                &indices_length.to_le_bytes(),
                &compression,
                &compressed_size,
                &size,
            ],
        );
        self.write_bytes(&bytes)?;
        self.chunks += 1;
        self.indices.write_all(&index).map_err(|error| unwritable(&self.path, error))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<(), DataError> {
        self.complete()
    }

    fn complete(&mut self) -> Result<(), DataError> {
        self.is_ended = true;
        self.flush()?;
        let mut end = Vec::new();
        push_record(&mut end, op::DATA_END, &[&self.checksum.sum().to_le_bytes()]);
        let summary = self.length + end.len() as u64;
        end.extend(self.schemas.iter().chain(&self.channels));
        let [first_ns, last_ns] = self.extent_ns.unwrap_or_default();
        let channels = self.messages.len();
        let counts = self.messages.iter().flat_map(|(channel, count)| {
            channel.to_le_bytes().into_iter().chain(count.to_le_bytes())
        });
        push_record(
            &mut end,
            op::STATISTICS,
            &[
                &self.messages.values().sum::<u64>().to_le_bytes(),
                &(channels as u16).to_le_bytes(),
                &(channels as u32).to_le_bytes(),
                // Attachments and metadata.
                &[0; 8],
                &self.chunks.to_le_bytes(),
                &first_ns.to_le_bytes(),
                &last_ns.to_le_bytes(),
                &sized(&counts.collect::<Vec<u8>>()),
            ],
        );
        self.write_bytes(&end)?;
        let mut footer = Vec::new();
        // Without an index of the summary itself.
        let fields: [&[u8]; 3] = [&summary.to_le_bytes(), &[0; 8], &NO_CHECKSUM];
        push_record(&mut footer, op::FOOTER, &fields);
        footer.extend(MAGIC);
        let Self { file: Some(file), indices, .. } = self else { return Ok(()) };
        let written = indices.rewind().and_then(|()| io::copy(indices, file));
        let written = written.and_then(|_| file.write_all(&footer));
        written.map_err(|error| unwritable(&self.path, error))
    }

    /// Adds bytes to the file, which appears with the first of them.
    fn write_bytes(&mut self, bytes: &[u8]) -> Result<(), DataError> {
        let written = match &mut self.file {
            Some(file) => file.write_all(bytes).map_err(|error| unwritable(&self.path, error)),
            none => output::begin_new(&self.path, bytes).map(|file| *none = Some(file)),
        };
        self.is_ended |= written.is_err();
        written?;
        self.checksum.update(bytes);
        self.length += bytes.len() as u64;
        Ok(())
    }
}

/// After an error elsewhere; what has no message yet does not appear.
impl Drop for McapWriter {
    fn drop(&mut self) {
        if !self.is_ended && (self.file.is_some() || self.chunk.begun.is_some()) {
            let _ = self.complete();
        }
    }
}

impl TopicSink for McapWriter {
    type Id = TopicId;

    fn add_topic(&mut self, topic: NumberTopic) -> Result<TopicId, DataError> {
        let NumberTopic { topic, message, schema, metadata } = topic;
        // Its schema has the number of the channel; zero is none.
        let channel = self.messages.len() as u16 + 1;
        self.messages.insert(channel, 0);
        let id = channel.to_le_bytes();
        let old = [self.schemas.len(), self.channels.len()];
        let fields: [&[u8]; 4] = [&id, &text(&message), &text(SCHEMA_ENCODING), &text(&schema)];
        push_record(&mut self.schemas, op::SCHEMA, &fields);
        let pairs = metadata.iter().flat_map(|(key, value)| [text(key), text(value)].concat());
        let pairs = sized(&pairs.collect::<Vec<u8>>());
        let encoding = text(MESSAGE_ENCODING);
        let fields: [&[u8]; 5] = [&id, &id, &text(&topic), &encoding, &pairs];
        push_record(&mut self.channels, op::CHANNEL, &fields);
        let records = &mut self.chunk.records;
        records.extend(&self.schemas[old[0]..]);
        records.extend(&self.channels[old[1]..]);
        Ok(TopicId { channel, sequence: 0 })
    }

    fn write(
        &mut self,
        topic: &mut TopicId,
        time_us: f64,
        values: &[f64],
    ) -> Result<(), DataError> {
        let time_ns = (1e3 * time_us).round().max(0.0) as u64;
        let is_long =
            |first_ns: u64| u128::from(time_ns.saturating_sub(first_ns)) >= CHUNK.as_nanos();
        if self.chunk.begun.is_some_and(|(first_ns, _)| is_long(first_ns))
            || self.chunk.records.len() >= CHUNK_BYTES
        {
            self.flush()?;
        }
        let chunk = &mut self.chunk;
        chunk.begun.get_or_insert_with(|| (time_ns, Instant::now()));
        let place = chunk.records.len() as u64;
        chunk.index.entry(topic.channel).or_default().push([time_ns, place]);
        let time = time_ns.to_le_bytes();
        let data = NumberTopic::encode(values);
        let (id, sequence) = (topic.channel.to_le_bytes(), topic.sequence.to_le_bytes());
        push_record(&mut chunk.records, op::MESSAGE, &[&id, &sequence, &time, &time, &data]);
        topic.sequence = topic.sequence.wrapping_add(1);
        *self.messages.entry(topic.channel).or_default() += 1;
        for extent_ns in [&mut chunk.extent_ns, &mut self.extent_ns] {
            let [first_ns, last_ns] = extent_ns.unwrap_or([time_ns; 2]);
            *extent_ns = Some([first_ns.min(time_ns), last_ns.max(time_ns)]);
        }
        Ok(())
    }
}

/// Adds a record with these fields.
fn push_record(bytes: &mut Vec<u8>, kind: u8, fields: &[&[u8]]) {
    let length: usize = fields.iter().map(|field| field.len()).sum();
    bytes.push(kind);
    bytes.extend((length as u64).to_le_bytes());
    fields.iter().for_each(|field| bytes.extend(*field));
}

/// Bytes after their number.
fn sized(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes(), bytes].concat()
}

fn text(text: &str) -> Vec<u8> {
    sized(text.as_bytes())
}

fn unwritable(path: &Path, error: io::Error) -> DataError {
    ErrorKind::Unwritable(error).at(Location::file(path))
}
