//! A `.csv` or `.csv.gz` of numbers as a stream of checked rows.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use super::problem::{Fault, Place, Problem};

/// One row: its line in the file and its cells; an empty cell is NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line in the file, the header being line 1.
    pub line: u64,
    /// One number for each column of the header.
    pub cells: Vec<f64>,
}

/// First bytes of a gzip file.
const GZIP_MAGIC: [u8; 2] = [0x1F, 0x8B];

/// What the cells of a column may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cells {
    /// A number in every row.
    Number,
    /// A number, or nothing.
    MayBeEmpty,
    /// Anything; read as NaN.
    Ignored,
}

/// A stream of rows. Memory does not grow with the length of the file.
pub struct Table {
    path: PathBuf,
    reader: csv::Reader<Box<dyn Read + Send>>,
    header: Vec<String>,
    record: csv::ByteRecord,
    time_column: usize,
    cells: Vec<Cells>,
    last: Option<Row>,
    ahead: VecDeque<Row>,
}

impl Table {
    /// Opens `folder/name.csv` or `folder/name.csv.gz`.
    ///
    /// # Errors
    /// Neither or both exist, or the header cannot be read.
    pub fn open(folder: &Path, name: &'static str) -> Result<Self, Problem> {
        let plain = folder.join(name);
        let packed = folder.join(format!("{name}.gz"));
        let path = match (plain.exists(), packed.exists()) {
            (true, true) => return Err(Fault::TwoFiles { name }.at(Place::file(folder))),
            (true, false) => plain,
            (false, true) => packed,
            (false, false) => {
                let advice = "a recording has hall.csv from the board and force.csv from the reference (each may be gzipped)";
                return Err(Fault::MissingFile { name, advice }.at(Place::file(folder)));
            }
        };
        Self::open_file(&path)
    }

    /// Opens one file, unpacked on the way where its name ends in `.gz`.
    pub fn open_file(path: &Path) -> Result<Self, Problem> {
        let unreadable = |error| Fault::Unreadable(error).at(Place::file(path));
        let mut file = File::open(path).map_err(unreadable)?;
        let packed = path.extension().is_some_and(|extension| extension == "gz");
        if packed {
            let mut magic = [0; 2];
            let length = file.read(&mut magic).map_err(unreadable)?;
            file.rewind().map_err(unreadable)?;
            if length == 2 && magic != GZIP_MAGIC {
                return Err(Fault::NotGzip.at(Place::file(path)));
            }
        }
        let input: Box<dyn Read + Send> = if packed {
            Box::new(flate2::read::MultiGzDecoder::new(file))
        } else {
            Box::new(file)
        };
        Self::from_reader(path, input)
    }

    /// Reads from any source; `path` is what messages name.
    pub fn from_reader(path: &Path, input: Box<dyn Read + Send>) -> Result<Self, Problem> {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .buffer_capacity(1 << 16)
            .from_reader(input);
        let mut record = csv::ByteRecord::new();
        let found = reader
            .read_byte_record(&mut record)
            .map_err(|error| read_fault(error).at(Place::file(path)))?;
        if !found {
            return Err(Fault::Empty.at(Place::file(path)));
        }
        let text = record.iter().all(|cell| {
            std::str::from_utf8(cell)
                .is_ok_and(|cell| !cell.contains(|c: char| c.is_control() && !c.is_whitespace()))
        });
        if !text {
            return Err(Fault::NotText.at(Place::file(path).line(1)));
        }
        let header: Vec<String> = record
            .iter()
            .map(|cell| {
                let name = String::from_utf8_lossy(cell);
                name.trim_start_matches('\u{feff}').trim().to_owned()
            })
            .collect();
        if let [only] = header.as_slice()
            && let Some(other) = [';', '\t'].into_iter().find(|c| only.contains(*c))
        {
            return Err(Fault::OtherSeparator { other }.at(Place::file(path).line(1)));
        }
        for (i, name) in header.iter().enumerate() {
            if header.get(..i).is_some_and(|before| before.contains(name)) {
                let place = Place::file(path).line(1).column(name.as_str());
                return Err(Fault::RepeatedColumn.at(place));
            }
        }
        Ok(Self {
            path: path.to_path_buf(),
            reader,
            cells: vec![Cells::Number; header.len()],
            header,
            record,
            time_column: 0,
            last: None,
            ahead: VecDeque::new(),
        })
    }

    /// The file's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The names of the columns.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// The place of a column in the header.
    pub fn header_place(&self, column: &str) -> Place {
        Place::file(&self.path).line(1).column(column)
    }

    /// The place of a cell.
    pub fn cell_place(&self, line: u64, column: usize) -> Place {
        let place = Place::file(&self.path).line(line);
        match self.header.get(column) {
            Some(name) => place.column(name.as_str()),
            None => place,
        }
    }

    /// Says which column is the clock, and what each column may hold.
    pub fn rules(&mut self, time_column: usize, cells: Vec<Cells>) {
        self.time_column = time_column;
        self.cells = cells;
    }

    /// The median distance of the first thousand rows in time, in the clock's unit; those rows
    /// are kept and come again from [`Table::next_row`].
    pub fn typical_period(&mut self) -> Result<f64, Problem> {
        while self.ahead.len() < 1000 {
            match self.read_row()? {
                Some(row) => self.ahead.push_back(row),
                None => break,
            }
        }
        if self.ahead.is_empty() {
            return Err(Fault::NoRows.at(Place::file(&self.path)));
        }
        let times = self.ahead.iter().map(|row| row.cells[self.time_column]);
        let mut periods: Vec<f64> = times
            .clone()
            .zip(times.skip(1))
            .map(|(a, b)| b - a)
            .collect();
        periods.sort_by(f64::total_cmp);
        Ok(periods.get(periods.len() / 2).copied().unwrap_or(0.0))
    }

    /// The next row, which comes again from [`Table::next_row`].
    pub fn peek(&mut self) -> Result<Option<&Row>, Problem> {
        if self.ahead.is_empty()
            && let Some(row) = self.read_row()?
        {
            self.ahead.push_back(row);
        }
        Ok(self.ahead.front())
    }

    /// The next row, or `None` at the end.
    pub fn next_row(&mut self) -> Result<Option<Row>, Problem> {
        match self.ahead.pop_front() {
            Some(row) => Ok(Some(row)),
            None => self.read_row(),
        }
    }

    fn read_row(&mut self) -> Result<Option<Row>, Problem> {
        let line = self.reader.position().line();
        let found = self
            .reader
            .read_byte_record(&mut self.record)
            .map_err(|error| read_fault(error).at(Place::file(&self.path).line(line)))?;
        if !found {
            return Ok(None);
        }
        let line = self.record.position().map_or(line, csv::Position::line);
        if self.record.len() != self.header.len() {
            let fault = Fault::CellCount {
                found: self.record.len(),
                expected: self.header.len(),
            };
            return Err(fault.at(Place::file(&self.path).line(line)));
        }
        let mut cells = Vec::with_capacity(self.header.len());
        for (i, cell) in self.record.iter().enumerate() {
            let value =
                parse(cell, self.cells[i]).map_err(|fault| fault.at(self.cell_place(line, i)))?;
            cells.push(value);
        }
        let row = Row { line, cells };
        self.check_clock(&row)?;
        match &mut self.last {
            Some(last) => last.cells.copy_from_slice(&row.cells),
            None => self.last = Some(row.clone()),
        }
        Ok(Some(row))
    }

    fn check_clock(&self, row: &Row) -> Result<(), Problem> {
        let Some(last) = &self.last else {
            return Ok(());
        };
        let (before, after) = (last.cells[self.time_column], row.cells[self.time_column]);
        let place = || self.cell_place(row.line, self.time_column);
        if after < before {
            return Err(Fault::ClockBackwards { before, after }.at(place()));
        }
        if after == before {
            let same = last
                .cells
                .iter()
                .zip(&row.cells)
                .all(|(a, b)| a.to_bits() == b.to_bits());
            return Err(match same {
                true => Fault::RepeatedRow.at(place()),
                false => Fault::RepeatedTime { time: after }.at(place()),
            });
        }
        Ok(())
    }
}

fn parse(cell: &[u8], rule: Cells) -> Result<f64, Fault> {
    let shown = || {
        String::from_utf8_lossy(cell)
            .trim()
            .chars()
            .take(40)
            .collect::<String>()
    };
    let cell_text = cell.trim_ascii();
    match rule {
        Cells::Ignored => return Ok(f64::NAN),
        Cells::MayBeEmpty if cell_text.is_empty() => return Ok(f64::NAN),
        Cells::Number if cell_text.is_empty() => return Err(Fault::EmptyCell),
        Cells::Number | Cells::MayBeEmpty => {}
    }
    let value: Option<f64> = std::str::from_utf8(cell_text)
        .ok()
        .and_then(|text| text.parse().ok());
    match value {
        Some(value) if value.is_finite() => Ok(value),
        Some(_) => Err(Fault::NotFinite { text: shown() }),
        None => Err(Fault::NotANumber { text: shown() }),
    }
}

fn read_fault(error: csv::Error) -> Fault {
    let text = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(io) => match io.kind() {
            std::io::ErrorKind::UnexpectedEof
            | std::io::ErrorKind::InvalidInput
            | std::io::ErrorKind::InvalidData => Fault::DamagedGzip(io),
            _ => Fault::Unreadable(io),
        },
        _ => Fault::NotANumber { text },
    }
}
