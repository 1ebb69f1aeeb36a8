//! Input files: only regular files are read, each within limits.
//!
//! The limits follow from the largest recording that must be readable, ten hours of the board at 1 kHz and of the reference
//! at 100 Hz: 36 million rows of 150 bytes, 5.4 GB of text or 1.9 GB compressed. A file beyond a limit is refused with one
//! sentence instead of exhausting memory or time.

use std::fs::{File, FileType, Metadata};
use std::io::{self, Read};
use std::path::Path;

use crate::error::{DataError, ErrorKind, Location};

const KIB: u64 = 1 << 10;
const MIB: u64 = 1 << 20;
const GIB: u64 = 1 << 30;

/// Maximum length of one row of a table in bytes. A row of eight sensors has 300; a reader holds at most a thousand rows.
pub const MAX_ROW_BYTES: u64 = 64 * KIB;
/// Maximum number of columns of a table. A recording of four sensors has 26; loggers of robots write some hundreds.
pub(crate) const MAX_COLUMNS: usize = 1024;
/// Maximum length of a table in bytes after decompression: ten hours at 1 kHz with six times the columns of four sensors.
pub const MAX_TABLE_BYTES: u64 = 32 * GIB;
/// Maximum length of a table after decompression relative to the file. Measurements reach 3, a constant reference without
/// noise 20, constants in every column 40, and gzip itself 1032.
pub const MAX_RATIO: u64 = 100;
/// Length in bytes up to which the ratio is not limited.
pub const RATIO_FREE_BYTES: u64 = 16 * MIB;
/// Maximum number of values of one recording in memory, after alignment to the reference: 1.3 GB. Ten hours at 100 Hz with
/// four sensors and all covariates have 130 million.
pub const MAX_RECORDING_VALUES: usize = 160_000_000;
/// Maximum number of values in the window of one reference row: 128 MB. A reference at 0.1 Hz next to a board at 1 kHz
/// needs 0.4 million.
pub const MAX_WINDOW_VALUES: usize = 16_000_000;
/// Maximum magnitude of a measured value in its unit. No gripper reaches it, also not with a unit that is wrong by a factor of
/// a million, and sums of its squares stay finite.
pub const MAX_MAGNITUDE: f64 = 1e12;
/// Maximum magnitude of a time stamp in microseconds: integers up to it are exact (285 years).
pub const MAX_TIME_US: f64 = (1_u64 << 53) as f64;
/// Maximum magnitude of a start time in seconds: time stamps since 1970 are far below it and exact to a microsecond.
pub const MAX_START_S: f64 = 1e10;
/// Maximum length of a text document (TOML) in bytes. A model of four sensors has 50 kB; in memory it takes some hundred
/// bytes for each value.
pub const MAX_DOCUMENT_BYTES: u64 = 8 * MIB;
/// Maximum length of a file of networks or of a checkpoint in bytes. Networks of four sensors with 32 units have 0.2 MB, a
/// checkpoint four times as much.
pub const MAX_TENSORS_BYTES: u64 = 64 * MIB;
/// Maximum length of an image (ELF) in bytes. That of the project has 6 MB with debug information, for 256 kB of flash.
pub const MAX_IMAGE_BYTES: u64 = 64 * MIB;
/// Maximum number of sensors of a model or design. The board reads four; lattices of sensors have up to sixteen.
pub const MAX_SENSORS: usize = 64;
/// Maximum number of effects of a model. The catalogue has 22; the time of a fit grows with the cube of the parameters.
pub const MAX_EFFECTS: usize = 64;
/// Maximum number of terms of a polynomial: three forces of degree 9 have 220, eight of degree 4 have 495. The memory of a fit
/// grows with their square, its time with their cube.
pub const MAX_POLYNOMIAL_TERMS: usize = 1000;
/// Maximum number of units of a layer of a network; networks on the device have at most 32.
pub const MAX_HIDDEN: usize = 1024;
/// Maximum length of a user-defined effect in bytes: ten lines of a terminal.
pub const MAX_FORMULA_BYTES: usize = 1000;
/// Maximum number of operators and functions of a formula, which is evaluated for every row and parameter.
pub const MAX_FORMULA_OPERATORS: usize = 64;
/// Maximum number of nested brackets of a formula.
pub const MAX_FORMULA_DEPTH: usize = 16;
/// Maximum number of coefficients and nonlinear parameters of a formula. The time of a fit grows with their cube: 20 take 5 s
/// on a campaign of 36 s, 80 take 50 s.
pub const MAX_FORMULA_PARAMETERS: usize = 16;

/// Plausible values of positive quantities by the end of their key, most specific first: a factor of a thousand or more
/// around anything that can be built.
const PLAUSIBLE: [(&str, f64, f64); 15] = [
    ("_n_per_mm", 1e-3, 1e7),
    ("gauss_per_lsb", 1e-9, 1e6),
    ("range_gauss", 1e-3, 1e9),
    ("_mm", 1e-4, 1e4),
    ("_t", 1e-4, 1e2),
    ("_n", 1e-3, 1e6),
    ("_gpa", 1e-6, 1e5),
    ("_mpa", 1e-3, 1e7),
    ("_cycles", 1.0, 1e15),
    ("_gauss", 1e-9, 1e6),
    ("_deg", 1e-6, 180.0),
    ("remanence", 1e-6, 10.0),
    ("safety", 1e-2, 1e3),
    ("sensors", 1.0, MAX_SENSORS as f64),
    ("", 1e-12, MAX_MAGNITUDE),
];

/// Plausible range of the positive quantity with this key, see the unit at its end.
pub fn plausible_range(key: &str) -> (f64, f64) {
    let known = PLAUSIBLE.iter().find(|(end, ..)| key.ends_with(end));
    known.map_or((0.0, MAX_MAGNITUDE), |(_, min, max)| (*min, *max))
}

/// Checks a positive quantity; the error has the range.
pub fn check_plausible(key: &str, value: f64) -> Result<(), ErrorKind> {
    let (min, max) = plausible_range(key);
    if (min..=max).contains(&value) {
        return Ok(());
    }
    let advice = format!("give {min:e} to {max:e} in the unit of the key");
    Err(ErrorKind::bad_value(format!("{value:?}"), advice))
}

/// Checks that one more row of `per_row` values keeps a recording of `rows` rows within [`MAX_RECORDING_VALUES`].
pub(crate) fn check_recording_values(rows: usize, per_row: usize) -> Result<(), ErrorKind> {
    if (rows + 1).saturating_mul(per_row) > MAX_RECORDING_VALUES {
        return Err(ErrorKind::TooManyValues { max: MAX_RECORDING_VALUES });
    }
    Ok(())
}

/// Checks the number of values in the window of a reference row against [`MAX_WINDOW_VALUES`].
pub(crate) fn check_window_values(values: usize) -> Result<(), ErrorKind> {
    if values > MAX_WINDOW_VALUES {
        return Err(ErrorKind::WindowTooLong { max: MAX_WINDOW_VALUES });
    }
    Ok(())
}

/// Opens a regular file for reading; symbolic links are followed.
///
/// # Errors
/// The path is a device, pipe, socket or folder, or cannot be opened.
pub fn open(path: &Path) -> Result<File, DataError> {
    let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(path));
    let check = |metadata: &Metadata| {
        if metadata.is_dir() {
            return Err(unreadable(io::ErrorKind::IsADirectory.into()));
        }
        if !metadata.is_file() {
            let found = special_file(metadata.file_type());
            return Err(ErrorKind::NotRegular { found }.at(Location::file(path)));
        }
        Ok(())
    };
    // Opening a pipe would wait for a writer.
    check(&path.metadata().map_err(unreadable)?)?;
    let file = File::open(path).map_err(unreadable)?;
    check(&file.metadata().map_err(unreadable)?)?;
    Ok(file)
}

#[cfg(unix)]
fn special_file(kind: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    if kind.is_fifo() {
        "a named pipe"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

#[cfg(not(unix))]
fn special_file(_: FileType) -> &'static str {
    "a device"
}

/// Reads a regular file of at most `max` bytes.
///
/// # Errors
/// See [`open`]; the file is longer.
pub fn read_bytes(path: &Path, max: u64) -> Result<Vec<u8>, DataError> {
    let mut bytes = Vec::new();
    let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(path));
    open(path)?.take(max + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > max {
        return Err(ErrorKind::FileTooLong { max_mib: max / MIB }.at(Location::file(path)));
    }
    Ok(bytes)
}

/// Reads a text document of at most [`MAX_DOCUMENT_BYTES`].
///
/// # Errors
/// See [`read_bytes`]; the file is not UTF-8.
pub fn read_text(path: &Path) -> Result<String, DataError> {
    String::from_utf8(read_bytes(path, MAX_DOCUMENT_BYTES)?).map_err(|_| {
        let error = io::Error::new(io::ErrorKind::InvalidData, "it is not UTF-8 text");
        ErrorKind::Unreadable(error).at(Location::file(path))
    })
}

/// Maximum length after decompression of a file of this length, both in bytes.
pub(crate) fn max_decompressed(compressed: u64) -> u64 {
    compressed.saturating_mul(MAX_RATIO).saturating_add(RATIO_FREE_BYTES)
}

/// Exceeded limit of a [`BoundedReader`], inside of its [`io::Error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TableLimit {
    /// [`MAX_ROW_BYTES`].
    #[error("a row is too long")]
    Row,
    /// [`MAX_TABLE_BYTES`].
    #[error("the table is too long")]
    Table,
    /// [`MAX_RATIO`].
    #[error("the table is compressed too much")]
    Ratio,
}

/// Reader of a table that fails beyond the limits of its rows and of its length.
pub struct BoundedReader {
    inner: Box<dyn Read + Send>,
    row_left: u64,
    table_left: u64,
    /// Limit that `table_left` stands for.
    table_limit: TableLimit,
    /// Whether the first line ends in a carriage return and a line feed; `None` before its end.
    is_crlf: Option<bool>,
    last: u8,
}

impl BoundedReader {
    /// `compressed`: length in bytes of the compressed file that `inner` decompresses.
    pub fn new(inner: Box<dyn Read + Send>, compressed: Option<u64>) -> Self {
        let by_ratio = compressed.map_or(u64::MAX, max_decompressed);
        let (table_left, table_limit) = if by_ratio < MAX_TABLE_BYTES {
            (by_ratio, TableLimit::Ratio)
        } else {
            (MAX_TABLE_BYTES, TableLimit::Table)
        };
        Self { inner, row_left: MAX_ROW_BYTES, table_left, table_limit, is_crlf: None, last: 0 }
    }

    /// Whether lines end in a carriage return and a line feed, as far as they were read.
    pub(crate) fn is_crlf(&self) -> bool {
        self.is_crlf == Some(true)
    }

    /// Whether the bytes that were read end with a line.
    pub(crate) fn is_at_line_end(&self) -> bool {
        self.last == b'\n'
    }

    fn note_line_end(&mut self, bytes: &[u8]) {
        if self.is_crlf.is_none()
            && let Some(end) = bytes.iter().position(|byte| *byte == b'\n')
        {
            let before = end.checked_sub(1).and_then(|place| bytes.get(place).copied());
            self.is_crlf = Some(before.unwrap_or(self.last) == b'\r');
        }
        self.last = bytes.last().copied().unwrap_or(self.last);
    }

    /// Begins a row; up to `buffered` bytes may be read ahead.
    pub(crate) fn start_row(&mut self, buffered: u64) {
        self.row_left = MAX_ROW_BYTES + buffered;
    }
}

impl Read for BoundedReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let left = self.row_left.min(self.table_left);
        if left == 0 && !bytes.is_empty() {
            // The end of the file may be here.
            return match self.inner.read(&mut bytes[..1])? {
                0 => Ok(0),
                _ if self.table_left == 0 => Err(io::Error::other(self.table_limit)),
                _ => Err(io::Error::other(TableLimit::Row)),
            };
        }
        let length = usize::try_from(left).unwrap_or(usize::MAX).min(bytes.len());
        let count = self.inner.read(&mut bytes[..length])?;
        self.row_left -= count as u64;
        self.table_left -= count as u64;
        self.note_line_end(&bytes[..count]);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;
    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;
    use crate::csv_table::CsvReader;

    /// Number of records of a table, or the error without the path of the folder.
    fn records(name: &str, content: &[u8]) -> Result<u64, String> {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        let mut count = 0;
        let mut record = csv::ByteRecord::new();
        let mut reader = CsvReader::open(&path).map_err(|error| error.to_string())?;
        loop {
            match reader.read(&mut record) {
                Ok(true) => count += 1,
                Ok(false) => return Ok(count),
                Err(error) => {
                    return Err(error.to_string().replace(&path.display().to_string(), name));
                }
            }
        }
    }

    fn compressed(pieces: impl IntoIterator<Item = Vec<u8>>) -> Vec<u8> {
        let mut packer = GzEncoder::new(Vec::new(), Compression::best());
        for piece in pieces {
            packer.write_all(&piece).unwrap();
        }
        packer.finish().unwrap()
    }

    #[test]
    fn row_is_limited_to_its_length_with_separators() {
        let table = |length: u64| format!("a\n{}\nb\n", "1".repeat(length as usize));
        assert_eq!(records("t.csv", table(MAX_ROW_BYTES - 1).as_bytes()), Ok(3));
        let message = records("t.csv", table(MAX_ROW_BYTES).as_bytes()).unwrap_err();
        assert!(
            message.starts_with("t.csv, line 2: the row is longer than 65536 bytes"),
            "{message}"
        );
    }

    #[test]
    fn endless_row_is_refused_after_a_bounded_part() {
        let row = std::iter::repeat_n(vec![b'1'; 1 << 20], 8);
        let message = records("t.csv.gz", &compressed(row)).unwrap_err();
        assert!(message.starts_with("t.csv.gz, line 1: the row is longer than"), "{message}");
        // A quotation mark that is not closed joins all following lines.
        let quoted = format!("a\n\"{}", "1,2\n".repeat(100_000));
        let message = records("t.csv", quoted.as_bytes()).unwrap_err();
        assert!(message.contains("line 2: the row is longer than"), "{message}");
    }

    #[test]
    fn number_of_columns_is_limited() {
        let table = |columns: usize| ",".repeat(columns - 1) + "\n";
        assert_eq!(records("t.csv", table(MAX_COLUMNS).as_bytes()), Ok(1));
        let message = records("t.csv", table(MAX_COLUMNS + 1).as_bytes()).unwrap_err();
        assert!(
            message.contains("line 1: there are 1025 columns, and the limit is 1024"),
            "{message}"
        );
    }

    #[test]
    fn compressed_table_is_limited_by_its_ratio() {
        let row = format!("{}\n", "0".repeat(8191)).into_bytes();
        let rows = |count: usize| compressed(std::iter::repeat_n(row.clone(), count));
        let free = (RATIO_FREE_BYTES / 8192) as usize;
        assert_eq!(records("t.csv.gz", &rows(free)), Ok(free as u64));
        let long = rows(3 * free);
        assert!(MAX_RATIO * (long.len() as u64) < RATIO_FREE_BYTES);
        let message = records("t.csv.gz", &long).unwrap_err();
        assert!(
            message.contains("more than 100 times as long as its compressed file"),
            "{message}"
        );
    }

    #[test]
    fn readable_length_follows_from_the_compressed_length() {
        let length = |compressed| BoundedReader::new(Box::new(io::empty()), compressed).table_left;
        assert_eq!(length(None), MAX_TABLE_BYTES);
        assert_eq!(length(Some(0)), RATIO_FREE_BYTES);
        // Ten hours at 1 kHz, 150 bytes in a row, compressed to a third.
        assert!(length(Some(1_900_000_000)) > 36_000_000 * 150);
        assert_eq!(length(Some(u64::MAX)), MAX_TABLE_BYTES);
    }

    #[test]
    fn table_at_its_limit_ends_and_one_beyond_fails() {
        for (length, is_read) in [(10, true), (11, false)] {
            let inner = Box::new(io::repeat(b'1').take(length));
            let mut reader = BoundedReader::new(inner, None);
            reader.table_left = 10;
            let result = reader.read_to_end(&mut Vec::new());
            assert_eq!(result.is_ok(), is_read, "{length}");
            assert!(is_read || result.unwrap_err().to_string() == TableLimit::Table.to_string());
        }
    }

    #[test]
    fn values_in_memory_are_limited() {
        // Ten hours at 100 Hz: time, 16 channels of four sensors, 8 forces, 11 covariates.
        assert!(check_recording_values(3_600_000, 36).is_ok());
        let rows = MAX_RECORDING_VALUES / 40;
        assert!(check_recording_values(rows - 1, 40).is_ok());
        assert!(check_recording_values(rows, 40).is_err());
        assert!(check_window_values(MAX_WINDOW_VALUES).is_ok());
        assert!(check_window_values(MAX_WINDOW_VALUES + 1).is_err());
    }

    #[test]
    fn document_is_limited_to_its_length() {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("model.toml");
        for (length, is_read) in [(MAX_DOCUMENT_BYTES, true), (MAX_DOCUMENT_BYTES + 1, false)] {
            fs::write(&path, vec![b' '; length as usize]).unwrap();
            assert_eq!(read_text(&path).is_ok(), is_read, "{length}");
        }
        let message = read_text(&path).unwrap_err().to_string();
        assert!(message.contains("longer than 8 MiB"), "{message}");
        fs::write(&path, [0xFF]).unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("not UTF-8"));
    }

    #[cfg(unix)]
    #[test]
    fn only_regular_files_are_opened() {
        let folder = TempDir::new().unwrap();
        let link = folder.path().join("link");
        for (target, found) in [("/dev/zero", "a device"), ("/dev/null", "a device")] {
            let _ = fs::remove_file(&link);
            std::os::unix::fs::symlink(target, &link).unwrap();
            let message = open(&link).unwrap_err().to_string();
            assert!(message.contains(&format!("this is {found}, not a regular file")), "{message}");
        }
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert!(open(&socket).unwrap_err().to_string().contains("this is a socket"));
        assert!(open(folder.path()).unwrap_err().to_string().contains("cannot be read"));
        let file = folder.path().join("file");
        fs::write(&file, "text").unwrap();
        fs::remove_file(&link).unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert_eq!(read_text(&link).unwrap(), "text");
    }

    #[test]
    fn plausible_range_follows_from_the_unit() {
        for (key, inside, outside) in [
            ("design.gap_mm", 1.5, 1e-320),
            ("design.stiffness_x_n_per_mm", 500.0, 1e308),
            ("design.force_range_n", 250.0, 1e7),
            ("design.magnet.remanence_t", 1.2, 1e-5),
            ("sensor_scale.gauss_per_lsb", 0.125, 1e-10),
            ("sensor.range_gauss", 2000.0, 1e-4),
            ("limits.life_cycles", 1e7, 0.5),
            ("limits.safety", 1.5, f64::INFINITY),
            ("tolerances.tilt_deg", 2.0, 181.0),
            ("design.sensors", 16.0, 65.0),
            ("scale", 1.0, f64::NAN),
        ] {
            assert!(check_plausible(key, inside).is_ok(), "{key}");
            assert!(check_plausible(key, outside).is_err(), "{key}");
        }
    }

    proptest! {
        #[test]
        fn bounded_reader_keeps_any_content_within_the_limits(
            rows in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..200), 0..50),
        ) {
            let content = rows.join(&b'\n');
            let mut read = Vec::new();
            BoundedReader::new(Box::new(io::Cursor::new(content.clone())), None).read_to_end(&mut read).unwrap();
            prop_assert_eq!(read, content);
        }
    }
}
