//! Streaming reader of numeric `.csv` and `.csv.gz` tables: cells, row lengths and the clock are validated.

use std::collections::{BTreeSet, VecDeque};
use std::io::{Cursor, Read, Seek};
use std::path::{Path, PathBuf};

use crate::error::{DataError, ErrorKind, Location, Notice};
use crate::input::{
    self, BoundedReader, MAX_COLUMNS, MAX_MAGNITUDE, MAX_RATIO, MAX_ROW_BYTES, MAX_TABLE_BYTES,
    MAX_TIME_US, TableLimit,
};
use crate::table_format::{EXAMINED_BYTES, SEPARATORS, TableFormat, text_of};

/// A row of numbers; an empty cell is NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct CsvRow {
    /// Line in the file, the header being line 1.
    pub line: u64,
    /// Values in the order of the header.
    pub cells: Vec<f64>,
}

/// First two bytes of every gzip file (RFC 1952).
const GZIP_MAGIC: [u8; 2] = [0x1F, 0x8B];

/// Admissible contents of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellRule {
    /// A number in every row.
    Number,
    /// A number, or empty (NaN).
    Optional,
    /// Not parsed; NaN.
    Ignored,
}

/// Length of the reader's buffer in bytes.
const BUFFER_BYTES: usize = 1 << 16;

/// Reader of the records of a table, the header being the first; refuses tables beyond the limits of [`input`].
pub struct CsvReader {
    path: PathBuf,
    reader: csv::Reader<BoundedReader>,
    format: TableFormat,
    is_at_header: bool,
}

/// Number of rows from which the typical period of a clock is estimated.
pub const PERIOD_ROWS: usize = 1000;

/// Path of `folder/name` or `folder/name.gz`.
///
/// # Errors
/// Neither or both exist.
pub fn table_path(folder: &Path, name: &'static str) -> Result<PathBuf, DataError> {
    let plain = folder.join(name);
    let compressed = folder.join(format!("{name}.gz"));
    match (plain.exists(), compressed.exists()) {
        (true, true) => Err(ErrorKind::AmbiguousFile { name }.at(Location::file(folder))),
        (true, false) => Ok(plain),
        (false, true) => Ok(compressed),
        (false, false) => {
            let advice = "a recording consists of hall.csv from the board and force.csv from the reference (each may be gzipped)";
            Err(ErrorKind::MissingFile { name, advice }.at(Location::file(folder)))
        }
    }
}

/// True for the name of a compressed file.
pub fn is_compressed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "gz")
}

impl CsvReader {
    /// Opens a regular file, decompressing it where its name ends in `.gz`.
    ///
    /// # Errors
    /// It cannot be opened, or is not compressed although its name says so.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        Ok(Self::new(path, bytes(path)?, TableFormat::default()))
    }

    /// The same for a foreign table, which may have other separators and number formats.
    ///
    /// # Errors
    /// As [`CsvReader::open`].
    pub fn open_foreign(path: &Path) -> Result<Self, DataError> {
        let mut start = Vec::new();
        if let Err(error) = bytes(path)?.take(EXAMINED_BYTES).read_to_end(&mut start) {
            return Err(read_error(error.into()).at(Location::file(path).line(1)));
        }
        let is_whole = (start.len() as u64) < EXAMINED_BYTES;
        let mut reader = Self::new(path, bytes(path)?, TableFormat::of(&start, is_whole));
        let mut record = csv::ByteRecord::new();
        for _ in 0..reader.format.preamble {
            reader.read_record(&mut record)?;
        }
        Ok(reader)
    }

    /// Reads a table from its text; `path` is that of its source.
    pub(crate) fn from_text(path: &Path, text: Vec<u8>) -> Self {
        let bytes = BoundedReader::new(Box::new(Cursor::new(text)), None);
        Self::new(path, bytes, TableFormat::default())
    }

    fn new(path: &Path, input: BoundedReader, format: TableFormat) -> Self {
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            // Loggers write about themselves before the header.
            .comment(Some(b'#'))
            .delimiter(format.separator)
            .buffer_capacity(BUFFER_BYTES)
            .from_reader(input);
        Self { path: path.to_path_buf(), reader, format, is_at_header: true }
    }

    /// How the table writes its values.
    pub fn format(&self) -> &TableFormat {
        &self.format
    }

    /// Line of the next record.
    pub fn line(&self) -> u64 {
        // The parser takes the line feed after a carriage return with the next record.
        self.reader.position().line() + u64::from(self.reader.get_ref().is_crlf())
    }

    /// Reads the next record; false at the end.
    ///
    /// # Errors
    /// The file cannot be read, or exceeds a limit; the error has the line.
    pub fn read(&mut self, record: &mut csv::ByteRecord) -> Result<bool, DataError> {
        let found = self.read_record(record)?;
        if std::mem::take(&mut self.is_at_header) {
            if self.format.has_units {
                let mut units = csv::ByteRecord::new();
                self.read_record(&mut units)?;
                *record = TableFormat::with_units(record, &units);
            }
        } else if !self.format.is_plain() {
            *record = record.iter().map(|cell| self.format.plain(cell)).collect();
        }
        Ok(found)
    }

    fn read_record(&mut self, record: &mut csv::ByteRecord) -> Result<bool, DataError> {
        let place = Location::file(&self.path).line(self.line());
        self.reader.get_mut().start_row(BUFFER_BYTES as u64);
        let found = match self.reader.read_byte_record(record) {
            Ok(found) => found,
            Err(error) => return Err(read_error(error).at(place)),
        };
        // With its separators.
        if (record.as_slice().len() + record.len()) as u64 > MAX_ROW_BYTES {
            return Err(ErrorKind::RowTooLong { max: MAX_ROW_BYTES }.at(place));
        }
        if record.len() > MAX_COLUMNS {
            let kind = ErrorKind::TooManyColumns { found: record.len(), max: MAX_COLUMNS };
            return Err(kind.at(place));
        }
        Ok(found)
    }
}

/// Bytes of a regular file, decompressed where its name ends in `.gz`.
fn bytes(path: &Path) -> Result<BoundedReader, DataError> {
    let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(path));
    let mut file = input::open(path)?;
    if !is_compressed(path) {
        return Ok(BoundedReader::new(Box::new(file), None));
    }
    let mut magic = [0; 2];
    let length = file.read(&mut magic).map_err(unreadable)?;
    file.rewind().map_err(unreadable)?;
    if length == 2 && magic != GZIP_MAGIC {
        return Err(ErrorKind::NotGzip.at(Location::file(path)));
    }
    let compressed = file.metadata().map_err(unreadable)?.len();
    let decoder = Box::new(flate2::read::MultiGzDecoder::new(file));
    Ok(BoundedReader::new(decoder, Some(compressed)))
}

/// Names of the columns in a header record.
pub fn column_names(header: &csv::ByteRecord) -> Vec<String> {
    let name = |cell| text_of(cell).trim_start_matches('\u{feff}').trim().to_owned();
    header.iter().map(name).collect()
}

/// Number in a cell, finite or not; `None` for text.
pub fn number(cell: &[u8]) -> Option<f64> {
    plain_decimal(cell).or_else(|| std::str::from_utf8(cell.trim_ascii()).ok()?.parse().ok())
}

/// Digits of which every number is exact.
const EXACT_DIGITS: usize = 15;
/// Exact powers of ten.
const POWERS: [f64; EXACT_DIGITS + 1] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// Value of a few digits with or without a point, as nearly all cells are; `None` for all else. Digits and power of ten are
/// exact, so that their quotient is the nearest number, which `parse` finds too.
fn plain_decimal(cell: &[u8]) -> Option<f64> {
    let (is_negative, digits) = match cell {
        [b'-', rest @ ..] => (true, rest),
        all => (false, all),
    };
    let (mut value, mut count, mut point) = (0_u64, 0, None);
    for byte in digits {
        match byte {
            b'0'..=b'9' => {
                value = 10 * value + u64::from(byte - b'0');
                count += 1;
                if count > EXACT_DIGITS {
                    return None;
                }
            }
            b'.' if point.is_none() => point = Some(count),
            _ => return None,
        }
    }
    if count == 0 {
        return None;
    }
    let size = value as f64 / POWERS[count - point.unwrap_or(count)];
    Some(if is_negative { -size } else { size })
}

/// An open table. Memory use is independent of the length of the file.
pub struct CsvTable {
    path: PathBuf,
    reader: CsvReader,
    header: Vec<String>,
    header_line: u64,
    record: csv::ByteRecord,
    /// `None` where rows have no time.
    time_column: Option<usize>,
    rules: Vec<CellRule>,
    has_limits: bool,
    previous: Option<CsvRow>,
    /// Rows that were read ahead of [`CsvTable::next_row`].
    buffered: VecDeque<CsvRow>,
    /// Line that was cut off.
    cut_line: Option<u64>,
}

impl CsvTable {
    /// Opens the table `name` of a recording, see [`table_path`].
    ///
    /// # Errors
    /// Neither or both files exist, or the header is invalid.
    pub fn open(folder: &Path, name: &'static str) -> Result<Self, DataError> {
        Self::open_file(&table_path(folder, name)?)
    }

    /// Opens one file, decompressing it where its name ends in `.gz`.
    pub(crate) fn open_file(path: &Path) -> Result<Self, DataError> {
        Self::new(path, CsvReader::open(path)?)
    }

    /// Opens a foreign table, see [`CsvReader::open_foreign`].
    pub fn open_foreign(path: &Path) -> Result<Self, DataError> {
        Self::new(path, CsvReader::open_foreign(path)?)
    }

    /// Reads a table from its text; `path` is that of its source.
    pub(crate) fn from_text(path: &Path, text: Vec<u8>) -> Result<Self, DataError> {
        Self::new(path, CsvReader::from_text(path, text))
    }

    fn new(path: &Path, mut reader: CsvReader) -> Result<Self, DataError> {
        let mut record = csv::ByteRecord::new();
        let header_line = reader.line();
        let place = Location::file(path).line(header_line);
        if !reader.read(&mut record)? {
            return Err(ErrorKind::Empty.at(Location::file(path)));
        }
        let is_binary = |cell: &[u8]| {
            cell.iter().any(|byte| byte.is_ascii_control() && !byte.is_ascii_whitespace())
        };
        if record.iter().any(is_binary) {
            return Err(ErrorKind::NotText.at(place));
        }
        let header = column_names(&record);
        // The first one is that of the project.
        let mut separators = SEPARATORS.map(char::from).into_iter().skip(1);
        if let [only] = header.as_slice()
            && let Some(separator) = separators.find(|other| only.contains(*other))
        {
            return Err(ErrorKind::WrongSeparator { separator }.at(place));
        }
        let mut before = BTreeSet::new();
        for name in &header {
            if !before.insert(name) {
                let place = place.column(name.as_str());
                return Err(ErrorKind::DuplicateColumn.at(place));
            }
        }
        Ok(Self {
            path: path.to_path_buf(),
            reader,
            rules: vec![CellRule::Number; header.len()],
            has_limits: false,
            header,
            header_line,
            record,
            time_column: Some(0),
            previous: None,
            buffered: VecDeque::new(),
            cut_line: None,
        })
    }

    /// Path of the file, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the table writes its values.
    pub fn format(&self) -> &TableFormat {
        self.reader.format()
    }

    /// Names of the columns.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Location of a column in the header.
    pub(crate) fn header_location(&self, column: &str) -> Location {
        Location::file(&self.path).line(self.header_line).column(column)
    }

    /// Location of a cell.
    pub(crate) fn cell_location(&self, line: u64, column: usize) -> Location {
        let place = Location::file(&self.path).line(line);
        match self.header.get(column) {
            Some(name) => place.column(name.as_str()),
            None => place,
        }
    }

    /// Sets the index of the clock column, and the rule of each column.
    pub fn set_rules(&mut self, time_column: usize, rules: Vec<CellRule>) {
        self.time_column = Some(time_column);
        self.rules = rules;
    }

    /// Sets the rule of each column of a table without a clock.
    pub(crate) fn set_untimed_rules(&mut self, rules: Vec<CellRule>) {
        self.time_column = None;
        self.rules = rules;
    }

    /// Checks every number against [`MAX_MAGNITUDE`] and the clock against [`MAX_TIME_US`]; without it the units of the columns
    /// are unknown.
    pub(crate) fn limit_magnitudes(&mut self) {
        self.has_limits = true;
    }

    /// Median period of the first [`PERIOD_ROWS`] rows, in the unit of the clock; the rows are buffered for
    /// [`CsvTable::next_row`].
    pub fn median_period(&mut self) -> Result<f64, DataError> {
        while self.buffered.len() < PERIOD_ROWS {
            match self.read_row()? {
                Some(row) => self.buffered.push_back(row),
                None => break,
            }
        }
        if self.buffered.is_empty() {
            return Err(ErrorKind::NoRows.at(Location::file(&self.path)));
        }
        let Some(time_column) = self.time_column else { return Ok(0.0) };
        let times = self.buffered.iter().map(|row| row.cells[time_column]);
        let mut periods: Vec<f64> = times.clone().zip(times.skip(1)).map(|(a, b)| b - a).collect();
        periods.sort_by(f64::total_cmp);
        Ok(periods.get(periods.len() / 2).copied().unwrap_or(0.0))
    }

    /// Times of the rows that [`CsvTable::median_period`] has buffered; none of a table without a clock.
    pub(crate) fn buffered_times(&self) -> impl Iterator<Item = f64> {
        let column = self.time_column;
        self.buffered.iter().filter_map(move |row| row.cells.get(column?).copied())
    }

    /// The next row, without consuming it.
    pub fn peek(&mut self) -> Result<Option<&CsvRow>, DataError> {
        if self.buffered.is_empty()
            && let Some(row) = self.read_row()?
        {
            self.buffered.push_back(row);
        }
        Ok(self.buffered.front())
    }

    /// The next row, or `None` at the end.
    pub fn next_row(&mut self) -> Result<Option<CsvRow>, DataError> {
        match self.buffered.pop_front() {
            Some(row) => Ok(Some(row)),
            None => self.read_row(),
        }
    }

    /// The next row of the file; one without a time is left out where the clock is optional.
    fn read_row(&mut self) -> Result<Option<CsvRow>, DataError> {
        loop {
            match self.read_any_row()? {
                Some(row) if self.is_without_time(&row) => {}
                Some(row) => return self.accepted(row).map(Some),
                None => return Ok(None),
            }
        }
    }

    fn is_without_time(&self, row: &CsvRow) -> bool {
        let is_optional = |column: usize| self.rules[column] == CellRule::Optional;
        self.time_column.is_some_and(|column| row.cells[column].is_nan() && is_optional(column))
    }

    /// That the last line was cut off, once the table was read.
    pub(crate) fn cut_notice(&self) -> Option<Notice> {
        self.cut_line.map(|line| Notice {
            location: Location::file(&self.path).line(line),
            message: "the last line was cut off, as when a logger is killed: the table was read up to the line before".to_owned(),
        })
    }

    fn read_any_row(&mut self) -> Result<Option<CsvRow>, DataError> {
        let line = self.reader.line();
        if self.cut_line.is_some() || !self.reader.read(&mut self.record)? {
            return Ok(None);
        }
        match self.parse_record(line) {
            Err(_) if self.is_cut()? => {
                self.cut_line = Some(line);
                Ok(None)
            }
            row => row.map(Some),
        }
    }

    /// Whether the record is incomplete because the file ends within its line; consumes the next one.
    fn is_cut(&mut self) -> Result<bool, DataError> {
        let cells = self.record.len();
        let is_whole = |cell: &[u8]| parse_cell(cell, CellRule::Number).is_ok();
        let before_last = self.record.iter().take(cells.saturating_sub(1)).zip(&self.rules);
        let are_valid =
            before_last.map(|(cell, rule)| parse_cell(cell, *rule)).all(|cell| cell.is_ok());
        let is_short = cells < self.header.len();
        let ends_within =
            cells == self.header.len() && !self.record.iter().next_back().is_some_and(is_whole);
        let is_candidate = are_valid && (is_short || ends_within);
        if !is_candidate || self.reader.reader.get_ref().is_at_line_end() {
            return Ok(false);
        }
        // Bytes are read ahead: other records may follow.
        Ok(!self.reader.read(&mut self.record)?)
    }

    /// Numbers of the record at `line`.
    fn parse_record(&self, line: u64) -> Result<CsvRow, DataError> {
        if self.record.len() != self.header.len() {
            let kind =
                ErrorKind::CellCount { found: self.record.len(), expected: self.header.len() };
            return Err(kind.at(Location::file(&self.path).line(line)));
        }
        let mut cells = Vec::with_capacity(self.header.len());
        for (i, cell) in self.record.iter().enumerate() {
            let value = parse_cell(cell, self.rules[i])
                .map_err(|kind| kind.at(self.cell_location(line, i)))?;
            let max = if Some(i) == self.time_column { MAX_TIME_US } else { MAX_MAGNITUDE };
            if self.has_limits && value.abs() > max {
                return Err(ErrorKind::Implausible { value, max }.at(self.cell_location(line, i)));
            }
            cells.push(value);
        }
        Ok(CsvRow { line, cells })
    }

    /// Checks the clock of a row and remembers it.
    fn accepted(&mut self, row: CsvRow) -> Result<CsvRow, DataError> {
        self.check_clock(&row)?;
        match &mut self.previous {
            Some(previous) => previous.cells.copy_from_slice(&row.cells),
            None => self.previous = Some(row.clone()),
        }
        Ok(row)
    }

    fn check_clock(&self, row: &CsvRow) -> Result<(), DataError> {
        let (Some(previous), Some(time_column)) = (&self.previous, self.time_column) else {
            return Ok(());
        };
        let (before, after) = (previous.cells[time_column], row.cells[time_column]);
        let location = || self.cell_location(row.line, time_column);
        if after < before {
            return Err(ErrorKind::ClockBackwards { before, after }.at(location()));
        }
        if after == before {
            let is_equal =
                previous.cells.iter().zip(&row.cells).all(|(a, b)| a.to_bits() == b.to_bits());
            let kind = if is_equal {
                ErrorKind::DuplicateRow
            } else {
                ErrorKind::DuplicateTime { time: after }
            };
            return Err(kind.at(location()));
        }
        Ok(())
    }
}

fn parse_cell(cell: &[u8], rule: CellRule) -> Result<f64, ErrorKind> {
    let quoted = || String::from_utf8_lossy(cell).trim().chars().take(40).collect::<String>();
    let trimmed = cell.trim_ascii();
    match rule {
        CellRule::Ignored => return Ok(f64::NAN),
        CellRule::Optional if trimmed.is_empty() => return Ok(f64::NAN),
        CellRule::Number if trimmed.is_empty() => return Err(ErrorKind::EmptyCell),
        CellRule::Number | CellRule::Optional => {}
    }
    match number(trimmed) {
        Some(value) if value.is_finite() => Ok(value),
        Some(_) => Err(ErrorKind::NotFinite { text: quoted() }),
        None => Err(ErrorKind::NotANumber { text: quoted() }),
    }
}

fn read_error(error: csv::Error) -> ErrorKind {
    let text = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(io) => match io.kind() {
            _ if let Some(limit) = io.get_ref().and_then(|inner| inner.downcast_ref()) => {
                match limit {
                    TableLimit::Row => ErrorKind::RowTooLong { max: MAX_ROW_BYTES },
                    TableLimit::Table => ErrorKind::TableTooLong { max_gib: MAX_TABLE_BYTES >> 30 },
                    TableLimit::Ratio => ErrorKind::RatioTooHigh { max: MAX_RATIO },
                }
            }
            std::io::ErrorKind::UnexpectedEof
            | std::io::ErrorKind::InvalidInput
            | std::io::ErrorKind::InvalidData => ErrorKind::DamagedGzip(io),
            _ => ErrorKind::Unreadable(io),
        },
        _ => ErrorKind::NotANumber { text },
    }
}

/// A step of the clock of more than this many median periods is a gap.
pub const GAP_STEPS: f64 = 5.0;

/// Gap detection and extent of a clock.
#[derive(Clone, Debug)]
pub(super) struct ClockMonitor {
    period_us: f64,
    pub(super) rows: u64,
    pub(super) first_us: f64,
    pub(super) last_us: f64,
    /// Line of the last row in the file.
    pub(super) line: u64,
    pub(super) gaps: u64,
    pub(super) longest_us: f64,
    /// Line of the row after the longest gap.
    longest_line: u64,
}

impl ClockMonitor {
    pub(super) fn new(period_us: f64) -> Self {
        Self {
            period_us,
            rows: 0,
            first_us: f64::NAN,
            last_us: f64::NAN,
            line: 0,
            gaps: 0,
            longest_us: 0.0,
            longest_line: 0,
        }
    }

    pub(super) fn update(&mut self, row: &CsvRow, t_us: f64) {
        if self.rows == 0 {
            self.first_us = t_us;
        } else {
            let step = t_us - self.last_us;
            self.gaps += u64::from(step > GAP_STEPS * self.period_us);
            if step > self.longest_us {
                (self.longest_us, self.longest_line) = (step, row.line);
            }
        }
        self.last_us = t_us;
        self.line = row.line;
        self.rows += 1;
    }

    pub(super) fn gap_notice(&self, table: &CsvTable) -> Option<Notice> {
        let ms = |us: f64| us * 1e-3;
        (self.gaps > 0).then(|| Notice {
            location: Location::file(table.path()).line(self.longest_line).column("t_us"),
            message: format!(
                "{} in the clock, the longest here: {:.1} ms at a period of {:.1} ms; rows at a gap were excluded: check for lost transfers or a blocked logger",
                if self.gaps == 1 { "1 gap".to_owned() } else { format!("{} gaps", self.gaps) },
                ms(self.longest_us),
                ms(self.period_us),
            ),
        })
    }
}

/// Below every sensor's period: the clock is in another unit.
const MIN_PERIOD_US: f64 = 20.0;
/// Above the period of a logger that measures by hand, one hour: the clock is in another unit too.
const MAX_PERIOD_US: f64 = 3.6e9;

/// Median period of a table's clock.
///
/// # Errors
/// The clock is not in microseconds, or the table has no rows.
pub(super) fn period_us(table: &mut CsvTable, time_column: usize) -> Result<f64, DataError> {
    let period_us = table.median_period()?;
    let times: Vec<f64> = table.buffered_times().collect();
    let steps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let mean_us = steps.clone().sum::<f64>() / steps.len().max(1) as f64;
    if period_us > 0.0 && period_us < MIN_PERIOD_US && mean_us >= MIN_PERIOD_US {
        let longest_us = steps.fold(0.0, f64::max);
        let packets =
            ErrorKind::Packets { within_ms: 1e-3 * period_us, between_ms: 1e-3 * longest_us };
        return Err(packets.at(table.cell_location(2, time_column)));
    }
    if period_us > 0.0 && !(MIN_PERIOD_US..=MAX_PERIOD_US).contains(&period_us) {
        return Err(ErrorKind::ClockUnit { period_us }.at(table.cell_location(2, time_column)));
    }
    Ok(period_us)
}

/// The error of a table without `t_us`.
pub(super) fn missing_clock(table: &CsvTable) -> DataError {
    let advice = "every table needs its clock in microseconds: name that column t_us".to_owned();
    ErrorKind::MissingColumn { advice }.at(table.header_location("t_us"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cells_are_the_numbers_that_the_standard_library_reads(
            text in "-?[0-9]{0,17}[.]?[0-9]{0,17}|[-+0-9.eEna ]{0,8}",
        ) {
            let expected = text.trim().parse::<f64>().ok().map(f64::to_bits);
            prop_assert_eq!(number(text.as_bytes()).map(f64::to_bits), expected, "{}", text);
        }
    }

    #[test]
    fn errors_have_the_line_of_the_file_whatever_ends_it() {
        for end in ["\n", "\r\n"] {
            for comments in [0, 2] {
                let mut lines = vec!["# a logger"; comments];
                lines.extend(["t_us,a", "0,1", "1,2", "2,x", "3,4"]);
                let text = lines.join(end) + end;
                let mut table = CsvTable::from_text(Path::new("a.csv"), text.into_bytes()).unwrap();
                let error = loop {
                    match table.next_row() {
                        Ok(row) => assert!(row.is_some()),
                        Err(error) => break error,
                    }
                };
                assert_eq!(error.location.line, Some(4 + comments as u64), "{end:?}");
            }
        }
    }
}
