//! Tables of a source, with what their values show.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::columns::Axis;
use crate::csv_table::{CsvReader, CsvTable, number};
use crate::error::{DataError, ErrorKind, Location};
use crate::guess::names::{ColumnName, Group, Quantity};
use crate::mcap::{self, Join, Topic, Undecodable};
use crate::units::find_unit;

/// Rows of each table that are examined.
pub const MAX_ROWS: u64 = 100_000;
/// Rows from which the step of a clock is taken.
const STEP_ROWS: usize = 1000;
/// Values that loggers write where nothing was measured.
const MISSING_MARKERS: [f64; 5] = [-1.0, -99.0, -999.0, -9999.0, -32768.0];
/// Share of the rows from which such a value is proposed as a marker.
const MISSING_SHARE: f64 = 0.01;

/// Stretches of rows that a [`Trace`] has at most.
const MAX_STRETCHES: usize = 240;

/// Minimum and maximum of stretches of equally many values, for a plot.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// In the order of the rows.
    pub stretches: Vec<(f64, f64)>,
    /// Each stretch but the last holds two to this power of values.
    doublings: u32,
    in_last: u64,
}

impl Trace {
    fn add(&mut self, value: f64) {
        let whole = 1 << self.doublings;
        match self.stretches.last_mut() {
            Some((min, max)) if self.in_last < whole => {
                *min = min.min(value);
                *max = max.max(value);
                self.in_last += 1;
                return;
            }
            _ => {}
        }
        if self.stretches.len() == MAX_STRETCHES {
            let pairs = self.stretches.chunks(2);
            let merged = pairs.map(|pair| {
                let ends = |a: (f64, f64), b: &(f64, f64)| (a.0.min(b.0), a.1.max(b.1));
                pair.iter().fold((f64::INFINITY, f64::NEG_INFINITY), ends)
            });
            self.stretches = merged.collect();
            self.doublings += 1;
        }
        self.stretches.push((value, value));
        self.in_last = 1;
    }
}

/// A column of a source with its values.
#[derive(Clone, Debug)]
pub struct SourceColumn {
    /// Name in the header, or topic and path in a bag.
    pub name: String,
    pub(crate) stated: ColumnName,
    pub(crate) quantity: Quantity,
    /// Cells with a number, and with text.
    numbers: u64,
    texts: u64,
    /// Line and content of the first cell with text.
    first_text: Option<(u64, String)>,
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) first: f64,
    pub(crate) last: f64,
    pub(crate) is_whole: bool,
    pub(crate) is_ascending: bool,
    /// Steps of the first rows.
    pub(crate) steps: Vec<f64>,
    /// Values of the examined rows.
    pub trace: Trace,
    /// Number of rows with each of [`MISSING_MARKERS`], and the minimum of all other values.
    markers: [u64; MISSING_MARKERS.len()],
    min_unmarked: f64,
}

/// A table of a source.
#[derive(Clone, Debug)]
pub struct SourceTable {
    /// Path of the file.
    pub path: PathBuf,
    /// Whether it is one of the tables of a folder.
    pub is_in_folder: bool,
    /// How the table is read, where it has another format than those of this project.
    pub(crate) notes: Vec<String>,
    /// Examined rows.
    pub rows: u64,
    /// In the order of the table.
    pub columns: Vec<SourceColumn>,
}

/// Tables of a file, or of a folder; those of a bag with the clocks of the `first` one, where there is one.
pub(crate) fn read_source(
    source: &Path,
    first: &[SourceTable],
) -> Result<Vec<SourceTable>, DataError> {
    if mcap::is_bag(source) {
        return read_bag(source, first);
    }
    if !source.is_dir() {
        return Ok(vec![read_table(source, false)?]);
    }
    let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(source));
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(source).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        if name.ends_with(".csv") || name.ends_with(".csv.gz") {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        let advice = "give the folder that holds the tables of one recording, or the files";
        return Err(
            ErrorKind::bad_value("a folder without .csv files", advice).at(Location::file(source))
        );
    }
    paths.sort();
    paths.iter().map(|path| read_table(path, true)).collect()
}

/// Share of the messages of the fastest topic from which a topic is as fast: bags begin and end between messages.
const AS_FAST: f64 = 0.9;

/// Tables of a bag: of the topics with a force, and of the others. Each has the clock of a table of the `first` bag, or of the
/// fastest topic, the first of these by name.
fn read_bag(path: &Path, first: &[SourceTable]) -> Result<Vec<SourceTable>, DataError> {
    let mut topics = mcap::read_topics(path, |_| true, Undecodable::Skip)?.topics;
    topics.sort_by(|a, b| a.name.cmp(&b.name));
    let has = |topic: &Topic, quantity: Quantity| {
        let mut names = topic.columns.iter().map(|column| topic.column_name(&column.path));
        names.any(|name| ColumnName::of(&name).quantity == quantity)
    };
    let (force, other): (Vec<Topic>, Vec<Topic>) =
        topics.into_iter().partition(|topic| has(topic, Quantity::Force));
    let mut tables = Vec::new();
    for (topics, quantity, join) in
        [(other, Quantity::Field, Join::EveryRow), (force, Quantity::Force, Join::Once)]
    {
        let clock = mcap::common_clock(&topics);
        let of_quantity = || topics.iter().filter(|topic| has(topic, quantity));
        let is_known = |topic: &&Topic| {
            let mut clocks = first.iter().filter_map(|table| table.columns.first());
            clocks.any(|column| column.name == topic.column_name(clock))
        };
        let most = of_quantity().map(Topic::messages).max().unwrap_or(0);
        let is_fast = |topic: &&Topic| topic.messages() as f64 >= AS_FAST * most as f64;
        let Some(timed) = of_quantity().find(is_known).or_else(|| of_quantity().find(is_fast))
        else {
            continue;
        };
        let clock_name = timed.column_name(clock);
        let fields = topics.iter().flat_map(|topic| {
            let wanted = topic.fields().filter(|column| !column.path.contains("covariance"));
            wanted.map(|column| (topic.column_name(&column.path), topic.unit(&column.path)))
        });
        let fields: Vec<(String, Option<String>)> =
            [(clock_name.clone(), timed.unit(clock))].into_iter().chain(fields).collect();
        let names: Vec<_> = fields.iter().map(|(name, _)| (name.as_str(), None)).collect();
        let text = mcap::join_topics(path, &topics, &clock_name, &names, join)?.text;
        let header = CsvTable::from_text(path, text.clone())?.header().to_vec();
        let mut table = read_rows(path, false, header, CsvReader::from_text(path, text))?;
        for (column, (_, unit)) in table.columns.iter_mut().zip(&fields) {
            if let Some(unit) = unit.as_deref().and_then(find_unit) {
                column.stated.unit = Some(unit);
                column.quantity = Quantity::of_unit(unit);
            }
        }
        tables.push(table);
    }
    if tables.is_empty() {
        let advice = "import the tables of its topics as CSV, or write the mapping yourself (`cargo magpie import --help`)";
        return Err(ErrorKind::bad_value("a bag without numbers that were recognised", advice)
            .at(Location::file(path)));
    }
    Ok(tables)
}

fn read_table(path: &Path, is_in_folder: bool) -> Result<SourceTable, DataError> {
    let table = CsvTable::open_foreign(path)?;
    let notes = table.format().notes();
    let header = table.header().to_vec();
    let table = read_rows(path, is_in_folder, header, CsvReader::open_foreign(path)?)?;
    Ok(SourceTable { notes, ..table })
}

fn read_rows(
    path: &Path,
    is_in_folder: bool,
    header: Vec<String>,
    mut reader: CsvReader,
) -> Result<SourceTable, DataError> {
    let mut record = csv::ByteRecord::new();
    reader.read(&mut record)?;
    let mut columns: Vec<SourceColumn> = header.into_iter().map(SourceColumn::new).collect();
    let (mut rows, mut last, mut line) = (0, 0, reader.line());
    while rows < MAX_ROWS && reader.read(&mut record)? {
        rows += 1;
        for (column, cell) in columns.iter_mut().zip(&record) {
            column.add(line, cell);
        }
        (last, line) = (line, reader.line());
    }
    // A killed logger ends within a cell; the import decides whether it did.
    let is_in_last =
        |column: &SourceColumn| column.first_text.as_ref().is_some_and(|of| of.0 == last);
    columns.iter_mut().filter(|column| is_in_last(column)).for_each(|column| column.texts = 0);
    if rows == 0 {
        return Err(ErrorKind::NoRows.at(Location::file(path)));
    }
    // A torque of a force sensor is called mx like a field.
    let has_other_field = columns.iter().any(|column| {
        column.quantity == Quantity::Field
            && !column.stated.words.iter().any(|word| is_moment(word))
    });
    let has_forces = columns.iter().filter(|column| column.quantity == Quantity::Force).count() > 1;
    for column in &mut columns {
        // A clock increases; the same letter is a temperature.
        if column.quantity == Quantity::Time && column.stated.words == ["t"] && !column.is_ascending
        {
            column.quantity = Quantity::Temperature;
        }
        let is_moment =
            column.stated.unit.is_none() && column.stated.words.iter().any(|word| is_moment(word));
        if has_other_field && has_forces && is_moment && column.quantity == Quantity::Field {
            column.quantity = Quantity::Unsupported;
        }
    }
    check_cells(path, &columns)?;
    Ok(SourceTable { path: path.to_path_buf(), is_in_folder, notes: Vec::new(), rows, columns })
}

/// Refuses text among the numbers of a column that an import reads: without it, the whole column would be missing.
fn check_cells(path: &Path, columns: &[SourceColumn]) -> Result<(), DataError> {
    for column in columns {
        let is_read = !matches!(column.quantity, Quantity::Unknown | Quantity::Unsupported);
        if let Some((line, text)) = column.first_text.as_ref().filter(|_| is_read)
            && (1..column.numbers).contains(&column.texts)
        {
            let place = Location::file(path).line(*line).column(&column.name);
            return Err(ErrorKind::NotANumber { text: text.clone() }.at(place));
        }
    }
    Ok(())
}

fn is_moment(word: &str) -> bool {
    matches!(word, "mx" | "my" | "mz")
}

impl SourceColumn {
    fn new(name: String) -> Self {
        let stated = ColumnName::of(&name);
        Self {
            quantity: stated.quantity,
            name,
            stated,
            numbers: 0,
            texts: 0,
            first_text: None,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            first: f64::NAN,
            last: f64::NAN,
            is_whole: true,
            is_ascending: true,
            steps: Vec::new(),
            trace: Trace::default(),
            markers: [0; MISSING_MARKERS.len()],
            min_unmarked: f64::INFINITY,
        }
    }

    fn add(&mut self, line: u64, cell: &[u8]) {
        let Some(value) = number(cell) else {
            if !cell.trim_ascii().is_empty() {
                self.texts += 1;
                self.first_text
                    .get_or_insert_with(|| (line, String::from_utf8_lossy(cell).into_owned()));
            }
            return;
        };
        if !value.is_finite() {
            return;
        }
        self.numbers += 1;
        if self.numbers == 1 {
            self.first = value;
        } else {
            self.is_ascending &= value > self.last;
            if self.steps.len() < STEP_ROWS {
                self.steps.push(value - self.last);
            }
        }
        self.last = value;
        self.trace.add(value);
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.is_whole &= value.fract() == 0.0;
        match MISSING_MARKERS.iter().position(|marker| *marker == value) {
            Some(index) => self.markers[index] += 1,
            None => self.min_unmarked = self.min_unmarked.min(value),
        }
    }

    /// Unit that the name states.
    pub fn unit(&self) -> Option<&'static str> {
        self.stated.unit.map(|unit| unit.name)
    }

    /// True if every cell is a number, empty, or not finite.
    pub fn is_numeric(&self) -> bool {
        self.numbers > 0 && self.texts == 0
    }

    /// Why a column without numbers, or with text among them, is not imported.
    pub fn text_reason(&self) -> Cow<'static, str> {
        match &self.first_text {
            Some((line, _)) => format!("text in line {line}").into(),
            None => "empty".into(),
        }
    }

    pub(crate) fn is_constant(&self) -> bool {
        self.min == self.max
    }

    /// Marker of missing measurements: a lone value below all others.
    pub(crate) fn missing(&self) -> Option<f64> {
        let is_marker = |(marker, count): (&f64, &u64)| {
            *count as f64 >= MISSING_SHARE * self.numbers as f64
                && *marker < self.min_unmarked
                && self.min_unmarked.is_finite()
        };
        let counted = MISSING_MARKERS.iter().zip(&self.markers);
        counted
            .filter(|(_, count)| **count > 0)
            .find(|pair| is_marker(*pair))
            .map(|(marker, _)| *marker)
    }

    /// Minimum and maximum without markers of missing measurements.
    pub fn range(&self) -> (f64, f64) {
        (if self.missing().is_some() { self.min_unmarked } else { self.min }, self.max)
    }

    pub(crate) fn magnitude(&self) -> f64 {
        let (min, max) = self.range();
        min.abs().max(max.abs())
    }
}

/// The table with the most columns of a quantity.
pub(crate) fn table_with(tables: &[SourceTable], quantity: Quantity) -> Option<&SourceTable> {
    let count = |table: &SourceTable| {
        table
            .columns
            .iter()
            .filter(|column| column.quantity == quantity && column.is_numeric())
            .count()
    };
    let most = tables.iter().rev().max_by_key(|table| count(table))?;
    (count(most) > 0).then_some(most)
}

pub fn numeric(table: &SourceTable, quantity: Quantity) -> impl Iterator<Item = &SourceColumn> {
    table.columns.iter().filter(move |column| column.quantity == quantity && column.is_numeric())
}

/// Groups of the columns: by number where all else is equal, in the order of the table otherwise.
pub(crate) fn column_groups<'a>(columns: impl Iterator<Item = &'a SourceColumn>) -> Vec<&'a Group> {
    let mut groups = Vec::new();
    for column in columns {
        if !groups.contains(&&column.stated.group) {
            groups.push(&column.stated.group);
        }
    }
    if groups.windows(2).all(|pair| pair[0].0 == pair[1].0) {
        groups.sort_by_key(|group| group.1);
    }
    groups
}

pub(crate) fn axis_of(column: &SourceColumn) -> Option<Axis> {
    match column.stated.axis? {
        'x' => Some(Axis::X),
        'y' => Some(Axis::Y),
        'z' => Some(Axis::Z),
        _ => None,
    }
}
