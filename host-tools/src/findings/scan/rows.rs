//! A table read tolerantly: what the strict reader refuses with an error is passed over here.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use csv::ByteRecord;
use flate2::read::MultiGzDecoder;

/// The table `name` in `folder`, plain or packed; `None` where there is none, or both.
pub fn table_path(folder: &Path, name: &str) -> Option<PathBuf> {
    let plain = folder.join(name);
    let packed = folder.join(format!("{name}.gz"));
    match (plain.is_file(), packed.is_file()) {
        (true, false) => Some(plain),
        (false, true) => Some(packed),
        _ => None,
    }
}

/// True where the name says that the file is packed.
pub fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "gz")
}

/// A CSV reader over the file, unpacked on the way; the header is its first record.
pub fn reader(path: &Path) -> std::io::Result<csv::Reader<Box<dyn Read + Send>>> {
    let file = File::open(path)?;
    let input: Box<dyn Read + Send> = match is_packed(path) {
        true => Box::new(MultiGzDecoder::new(file)),
        false => Box::new(file),
    };
    Ok(csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .buffer_capacity(1 << 16)
        .from_reader(input))
}

/// Names of a header record as the strict reader takes them.
pub fn names(header: &ByteRecord) -> Vec<String> {
    header
        .iter()
        .map(|cell| {
            let name = String::from_utf8_lossy(cell);
            name.trim_start_matches('\u{feff}').trim().to_owned()
        })
        .collect()
}

/// A cell as a number; NaN where it is none.
pub fn number(cell: &[u8]) -> f64 {
    std::str::from_utf8(cell.trim_ascii())
        .ok()
        .and_then(|text| text.parse::<f64>().ok())
        .filter(|value| value.is_finite())
        .unwrap_or(f64::NAN)
}

/// A row of whole length.
#[derive(Clone, Debug)]
pub struct Row {
    /// Line in the file, the header being line 1.
    pub line: u64,
    /// What stands in it.
    pub record: ByteRecord,
}

/// The rows of a table.
pub struct Rows {
    reader: csv::Reader<Box<dyn Read + Send>>,
    /// Names of the columns.
    pub header: Vec<String>,
}

impl Rows {
    /// Opens the file; `None` where it has no header that can be read.
    pub fn open(path: &Path) -> Option<Self> {
        let mut reader = reader(path).ok()?;
        let mut record = ByteRecord::new();
        reader
            .read_byte_record(&mut record)
            .ok()
            .filter(|found| *found)?;
        Some(Self {
            header: names(&record),
            reader,
        })
    }

    /// The next row with as many cells as the header, into `row`; false at the end, or where the file
    /// can be read no further.
    pub fn next_into(&mut self, row: &mut Row) -> bool {
        loop {
            match self.reader.read_byte_record(&mut row.record) {
                Ok(true) if row.record.len() == self.header.len() => {
                    row.line = row.record.position().map_or(0, csv::Position::line);
                    return true;
                }
                Ok(true) => {}
                Ok(false) | Err(_) => return false,
            }
        }
    }
}
