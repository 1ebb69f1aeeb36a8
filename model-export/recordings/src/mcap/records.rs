//! Records of an MCAP file (<https://mcap.dev/spec>) as messages with their channels. Every length is checked against the bytes that
//! are there before anything is allocated; attachments, indices and the summary are skipped.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use flate2::Crc;
use mcap::records::op;
use mcap::{Channel, MAGIC, Message, Schema};

use crate::error::{DataError, ErrorKind, Location, Notice};
use crate::input::{self, MAX_RATIO, MAX_ROW_BYTES, max_decompressed};
use crate::mcap::limits::{self, MAX_RECORD_BYTES};

/// Bytes before the content of a record: its kind and its length.
const RECORD_HEADER: u64 = 9;

/// Why a file is not read further.
enum Fault {
    Damaged(String),
    /// The file ends within a record.
    Cut(String),
    Limit(ErrorKind),
}

impl From<&str> for Fault {
    fn from(reason: &str) -> Self {
        Self::Damaged(reason.to_owned())
    }
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// Messages of a file in its order, with the checksums of its chunks verified. Ends after the first error, and where the file was cut
/// off: recorders that are killed write no end.
pub struct McapMessages<'a> {
    path: &'a Path,
    file: BufReader<File>,
    /// Bytes of the file that were not read yet.
    left: u64,
    /// Bytes that may still be decompressed ([`MAX_RATIO`]).
    decompressible: u64,
    /// Records of the current chunk, and where the next one begins.
    chunk: (Vec<u8>, usize),
    schemas: HashMap<u16, Arc<Schema<'static>>>,
    channels: HashMap<u16, Arc<Channel<'static>>>,
    is_begun: bool,
    is_past_data: bool,
    is_ended: bool,
    /// The file has no mark at its end.
    is_cut: bool,
    /// Times in nanoseconds of the first and the last message.
    extent_ns: Option<[u64; 2]>,
    notices: &'a mut Vec<Notice>,
}

impl<'a> McapMessages<'a> {
    /// That a file was cut off is added to `notices`.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub fn open(path: &'a Path, notices: &'a mut Vec<Notice>) -> Result<Self, DataError> {
        let mut file = input::open(path)?;
        let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(path));
        let left = file.metadata().map_err(unreadable)?.len();
        let is_cut = !ends_in_magic(&mut file, left).map_err(unreadable)?;
        Ok(Self {
            path,
            file: BufReader::new(file),
            left,
            decompressible: max_decompressed(left),
            chunk: (Vec::new(), 0),
            schemas: HashMap::new(),
            channels: HashMap::new(),
            is_begun: false,
            is_past_data: false,
            is_ended: false,
            is_cut,
            extent_ns: None,
            notices,
        })
    }

    fn next_message(&mut self) -> Result<Option<Message<'static>>, Fault> {
        if !self.is_begun {
            self.read_magic()?;
            self.is_begun = true;
        }
        loop {
            if let Some((kind, content)) = self.next_in_chunk()? {
                if let Some(message) = self.enter(kind, content)? {
                    return Ok(Some(message));
                }
                continue;
            }
            let (kind, content) = self.next_in_file()?;
            match kind {
                op::FOOTER => {
                    self.read_magic()?;
                    return Ok(None);
                }
                // The summary repeats what was read.
                op::DATA_END => self.is_past_data = true,
                _ if self.is_past_data => {}
                op::CHUNK => self.chunk = (self.decompress(&content)?, 0),
                kind => {
                    if let Some(message) = self.enter(kind, content)? {
                        return Ok(Some(message));
                    }
                }
            }
        }
    }

    fn cut_notice(&self) -> Option<Notice> {
        let [first_ns, last_ns] = self.extent_ns?;
        let message = format!(
            "the file was cut off, as when a recorder is killed: it was read up to its last whole chunk, {:.3} s after its first message",
            1e-9 * last_ns.saturating_sub(first_ns) as f64
        );
        Some(Notice { location: Location::file(self.path), message })
    }

    fn read_magic(&mut self) -> Result<(), Fault> {
        if self.take(MAGIC.len() as u64)? != MAGIC {
            return Err("it does not begin and end with the mark of MCAP".into());
        }
        Ok(())
    }

    /// So many bytes of the file.
    fn take(&mut self, count: u64) -> Result<Vec<u8>, Fault> {
        let left = self.left.checked_sub(count);
        self.left = left.ok_or_else(|| Fault::Cut("a length exceeds the file".to_owned()))?;
        // Allocates as it reads: the file may have become shorter.
        let mut bytes = Vec::new();
        (&mut self.file).take(count).read_to_end(&mut bytes)?;
        if (bytes.len() as u64) < count {
            return Err(Fault::Cut("it ends too early".to_owned()));
        }
        Ok(bytes)
    }

    /// Kind and content of the next record of the file; without the content where nothing in it is needed.
    fn next_in_file(&mut self) -> Result<(u8, Vec<u8>), Fault> {
        let header = self.take(RECORD_HEADER)?;
        let (kind, length) = record_header(&header).ok_or("a record without a length")?;
        if length > self.left {
            return Err(Fault::Cut(format!("a record of {length} bytes exceeds the file")));
        }
        let is_needed = matches!(kind, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK);
        if !is_needed || self.is_past_data {
            self.file.seek_relative(i64::try_from(length).unwrap_or(i64::MAX))?;
            self.left -= length;
            return Ok((kind, Vec::new()));
        }
        check_length(length)?;
        Ok((kind, self.take(length)?))
    }

    /// Kind and content of the next record of the chunk.
    fn next_in_chunk(&mut self) -> Result<Option<(u8, Vec<u8>)>, Fault> {
        let (records, at) = &mut self.chunk;
        let rest = records.get(*at..).unwrap_or_default();
        if rest.is_empty() {
            return Ok(None);
        }
        let (kind, length) = record_header(rest).ok_or("a chunk ends within a record")?;
        let content = rest.get(RECORD_HEADER as usize..).unwrap_or_default();
        let length = usize::try_from(length).ok().filter(|length| *length <= content.len());
        let length = length.ok_or("a record exceeds its chunk")?;
        *at += RECORD_HEADER as usize + length;
        Ok(Some((kind, content[..length].to_vec())))
    }

    /// The records of a chunk.
    fn decompress(&mut self, content: &[u8]) -> Result<Vec<u8>, Fault> {
        let mut fields = Fields(content);
        // The times of its first and last message.
        fields.take(16)?;
        let (length, checksum) = (fields.u64()?, fields.u32()?);
        let compression = fields.text()?;
        let compressed = fields.u64()?;
        let compressed = usize::try_from(compressed).map_err(|_| "a chunk exceeds its record")?;
        let compressed = fields.take(compressed)?;
        check_length(length)?;
        let left = self.decompressible.checked_sub(length);
        let exceeds = || Fault::Limit(ErrorKind::RatioTooHigh { max: MAX_RATIO });
        self.decompressible = left.ok_or_else(exceeds)?;
        let source: Box<dyn Read + '_> = match compression.as_str() {
            "" => Box::new(compressed),
            "zstd" => Box::new(zstd::Decoder::with_buffer(compressed)?),
            "lz4" => Box::new(lz4::Decoder::new(compressed)?),
            other => return Err(format!("a chunk is compressed by {other:?}").as_str().into()),
        };
        let mut records = Vec::new();
        source.take(length).read_to_end(&mut records)?;
        if records.len() as u64 != length {
            return Err("a chunk is shorter than it states".into());
        }
        let mut calculated = Crc::new();
        calculated.update(&records);
        if checksum != 0 && calculated.sum() != checksum {
            return Err("the checksum of a chunk is wrong".into());
        }
        Ok(records)
    }

    /// Keeps a schema or a channel; a message with its channel.
    fn enter(&mut self, kind: u8, content: Vec<u8>) -> Result<Option<Message<'static>>, Fault> {
        let mut fields = Fields(&content);
        match kind {
            op::SCHEMA => {
                let id = fields.u16()?;
                let (name, encoding) = (fields.text()?, fields.text()?);
                let length = fields.u32()? as usize;
                let data = Cow::Owned(fields.take(length)?.to_vec());
                if id == 0 {
                    return Err("a schema has the number 0".into());
                }
                keep(&mut self.schemas, id, Schema { id, name, encoding, data }, "schemas")?;
            }
            op::CHANNEL => {
                let (id, schema) = (fields.u16()?, fields.u16()?);
                let (topic, message_encoding) = (fields.text()?, fields.text()?);
                let metadata = fields.map()?;
                let schema = match schema {
                    0 => None,
                    number => {
                        let known = self.schemas.get(&number).cloned();
                        Some(known.ok_or("a channel refers to a schema that is not there")?)
                    }
                };
                let channel = Channel { id, topic, schema, message_encoding, metadata };
                keep(&mut self.channels, id, channel, "channels")?;
                limits::check_topics(self.channels.len()).map_err(Fault::Limit)?;
            }
            op::MESSAGE => {
                let known = self.channels.get(&fields.u16()?).cloned();
                let channel = known.ok_or("a message refers to a channel that is not there")?;
                let sequence = fields.u32()?;
                let (log_time, publish_time) = (fields.u64()?, fields.u64()?);
                let data = Cow::Owned(fields.0.to_vec());
                return Ok(Some(Message { channel, sequence, log_time, publish_time, data }));
            }
            _ => {}
        }
        Ok(None)
    }
}

impl Iterator for McapMessages<'_> {
    type Item = Result<Message<'static>, DataError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_ended {
            return None;
        }
        let at_file = |kind: ErrorKind| Err(kind.at(Location::file(self.path)));
        let message = match self.next_message() {
            Ok(message) => Ok(message),
            Err(Fault::Cut(_)) if self.is_cut && self.extent_ns.is_some() => {
                self.notices.extend(self.cut_notice());
                Ok(None)
            }
            Err(Fault::Cut(reason) | Fault::Damaged(reason)) => {
                at_file(ErrorKind::DamagedMcap(reason))
            }
            Err(Fault::Limit(kind)) => at_file(kind),
        };
        if let Ok(Some(message)) = &message {
            let time_ns = message.log_time;
            let [first_ns, last_ns] = self.extent_ns.unwrap_or([time_ns; 2]);
            self.extent_ns = Some([first_ns.min(time_ns), last_ns.max(time_ns)]);
        }
        self.is_ended = !matches!(message, Ok(Some(_)));
        message.transpose()
    }
}

/// Whether a file of this length ends as a complete one; it is then at its start again.
fn ends_in_magic(file: &mut File, length: u64) -> io::Result<bool> {
    let Some(start) = length.checked_sub(MAGIC.len() as u64) else { return Ok(false) };
    file.seek(SeekFrom::Start(start))?;
    let mut end = Vec::new();
    file.take(MAGIC.len() as u64).read_to_end(&mut end)?;
    file.rewind()?;
    Ok(end == MAGIC)
}

/// Kind and length of a record.
fn record_header(bytes: &[u8]) -> Option<(u8, u64)> {
    let (kind, rest) = bytes.split_first()?;
    Some((*kind, u64::from_le_bytes(*rest.first_chunk()?)))
}

fn check_length(length: u64) -> Result<(), Fault> {
    if length > MAX_RECORD_BYTES {
        let max_mib = MAX_RECORD_BYTES >> 20;
        return Err(format!("a record is longer than {max_mib} MiB").as_str().into());
    }
    Ok(())
}

/// Keeps what has a number; it may be repeated, and not changed.
fn keep<T: PartialEq>(
    known: &mut HashMap<u16, Arc<T>>,
    number: u16,
    new: T,
    what: &str,
) -> Result<(), Fault> {
    match known.get(&number) {
        Some(old) if **old != new => {
            Err(format!("two {what} have the number {number}").as_str().into())
        }
        Some(_) => Ok(()),
        None => {
            known.insert(number, Arc::new(new));
            Ok(())
        }
    }
}

/// Fields of a record, taken from its front.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("a field exceeds its record")?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        let (taken, rest) = self.0.split_first_chunk().ok_or("a field exceeds its record")?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u16(&mut self) -> Result<u16, Fault> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, Fault> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, Fault> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Result<String, Fault> {
        let length = self.u32()? as usize;
        if length as u64 > MAX_ROW_BYTES && length <= self.0.len() {
            return Err(format!("a name or a text is longer than {MAX_ROW_BYTES} bytes")
                .as_str()
                .into());
        }
        let text = std::str::from_utf8(self.take(length)?).map_err(|_| "a name is not UTF-8")?;
        Ok(text.to_owned())
    }

    fn map(&mut self) -> Result<BTreeMap<String, String>, Fault> {
        let length = self.u32()? as usize;
        let mut pairs = Self(self.take(length)?);
        let mut map = BTreeMap::new();
        while !pairs.0.is_empty() {
            map.insert(pairs.text()?, pairs.text()?);
        }
        Ok(map)
    }
}
