//! Limits of bags, in addition to those of all inputs ([`crate::input`]). Work and memory are bounded by the length of the file: a small one
//! cannot take many times its size.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::error::ErrorKind;
use crate::input::{MAX_COLUMNS, MAX_RECORDING_VALUES, RATIO_FREE_BYTES};

/// Maximum length of a record or chunk in bytes; recorders write chunks of about 1 MB.
pub(crate) const MAX_RECORD_BYTES: u64 = 256 << 20;
/// Maximum length in bytes of a message in JSON or Protobuf, and of a message definition. Messages of measurements have some
/// hundred bytes; decoded, a byte takes up to some hundred.
pub(crate) const MAX_MESSAGE_BYTES: usize = 1 << 20;
/// Maximum length of the message definitions of all topics together; in memory they take up to twenty times as much.
const MAX_DEFINITIONS_BYTES: usize = 16 << 20;
/// Maximum number of topics of a bag. Bags of whole robots have some hundred.
pub const MAX_TOPICS: usize = 1024;
/// Maximum number of columns of all topics together.
const MAX_TOTAL_COLUMNS: usize = 16 * MAX_COLUMNS;
/// Maximum length of the path of a field in bytes.
pub(crate) const MAX_PATH_BYTES: usize = 1024;
/// Values in memory for each byte of the file beyond [`RATIO_FREE_BYTES`]. A measured value takes some bytes also compressed.
const VALUES_PER_BYTE: u64 = 8;
/// Time to read a bag: a fixed part, and for each MiB; a debug build reads more than 10 MiB in a second.
const BASE_TIME: Duration = Duration::from_secs(20);
const TIME_PER_MIB: Duration = Duration::from_secs(1);

/// Checks a number of topics against [`MAX_TOPICS`].
pub(crate) fn check_topics(count: usize) -> Result<(), ErrorKind> {
    if count > MAX_TOPICS {
        return Err(ErrorKind::TooManyTopics { max: MAX_TOPICS });
    }
    Ok(())
}

/// Total length of files in bytes, without those that cannot be read.
pub(crate) fn total_bytes<'a>(files: impl IntoIterator<Item = &'a Path>) -> u64 {
    files.into_iter().filter_map(|file| file.metadata().ok()).map(|metadata| metadata.len()).sum()
}

/// Maximum number of values in memory of a bag with files of this length together.
pub(crate) fn max_values(bytes: u64) -> usize {
    let max = RATIO_FREE_BYTES.saturating_add(VALUES_PER_BYTE.saturating_mul(bytes));
    usize::try_from(max).map_or(MAX_RECORDING_VALUES, |max| max.min(MAX_RECORDING_VALUES))
}

/// Checks a table of `rows` and `columns` against the maximum number of values.
pub(crate) fn check_values(rows: usize, columns: usize, max: usize) -> Result<(), ErrorKind> {
    if rows.saturating_mul(columns) > max {
        return Err(ErrorKind::TooManyBagValues { max });
    }
    Ok(())
}

/// Columns of the topics of a bag and their values.
pub struct Contents {
    max_values: usize,
    values: usize,
    columns: usize,
    definition_bytes: usize,
}

impl Contents {
    /// Those of a bag with files of this length together.
    pub fn new(bytes: u64) -> Self {
        Self { max_values: max_values(bytes), values: 0, columns: 0, definition_bytes: 0 }
    }

    /// Adds the message definition of a topic.
    pub(crate) fn add_definition(&mut self, bytes: usize) -> Result<(), ErrorKind> {
        self.definition_bytes = self.definition_bytes.saturating_add(bytes);
        if self.definition_bytes > MAX_DEFINITIONS_BYTES {
            let max_mib = MAX_DEFINITIONS_BYTES >> 20;
            return Err(ErrorKind::DefinitionsTooLong { max_mib });
        }
        Ok(())
    }

    /// Adds a column to the `columns` of a topic with `rows`.
    pub(crate) fn add_column(
        &mut self,
        path: &str,
        columns: usize,
        rows: usize,
    ) -> Result<(), ErrorKind> {
        if path.len() > MAX_PATH_BYTES {
            return Err(ErrorKind::PathTooLong { max: MAX_PATH_BYTES });
        }
        self.columns += 1;
        if columns >= MAX_COLUMNS || self.columns > MAX_TOTAL_COLUMNS {
            let max = if columns >= MAX_COLUMNS { MAX_COLUMNS } else { MAX_TOTAL_COLUMNS };
            return Err(ErrorKind::TooManyColumns { found: max + 1, max });
        }
        self.add_values(rows)
    }

    /// Adds values of a row, or the empty ones above a new column.
    pub(crate) fn add_values(&mut self, count: usize) -> Result<(), ErrorKind> {
        self.values = self.values.saturating_add(count);
        check_values(self.values, 1, self.max_values)
    }
}

/// End of the time in which a bag is read.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    end: Instant,
    seconds: u64,
}

impl Deadline {
    /// From now, for files of this length together.
    pub fn new(bytes: u64) -> Self {
        let mib = u32::try_from(bytes >> 20).unwrap_or(u32::MAX);
        let limit = BASE_TIME + TIME_PER_MIB * mib;
        Self { end: Instant::now() + limit, seconds: limit.as_secs() }
    }

    /// Whether it has passed.
    pub fn is_over(&self) -> bool {
        Instant::now() > self.end
    }

    /// The error once it has passed.
    pub fn check(&self) -> Result<(), ErrorKind> {
        if self.is_over() { Err(ErrorKind::TooSlow { seconds: self.seconds }) } else { Ok(()) }
    }
}
