//! Input errors and notices: location, cause and remedy in one sentence.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

/// Maximum number of characters of a name in a message, and of a name with a suggestion.
const MAX_NAME: usize = 80;

/// Remedy where a file is in the way that the user may remove.
pub(crate) const REMOVABLE: &str = "choose another path, or remove it";

/// A position in the input.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Location {
    /// The file, or the folder in which a file is missing.
    pub file: PathBuf,
    /// Line in the file, the header being line 1.
    pub line: Option<u64>,
    /// The column's name in the header, or the key in a TOML file.
    pub column: Option<String>,
}

impl Location {
    /// The file as a whole.
    pub fn file(file: &Path) -> Self {
        Self { file: file.to_path_buf(), ..Self::default() }
    }

    /// Adds the line, the header being line 1.
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// Adds the column or key.
    pub fn column(mut self, column: impl Into<String>) -> Self {
        let mut column = column.into();
        if let Some((end, _)) = column.char_indices().nth(MAX_NAME) {
            column.truncate(end);
            column.push_str("...");
        }
        self.column = Some(column);
        self
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, ", line {line}")?;
        }
        if let Some(column) = &self.column {
            write!(f, ", column {column}")?;
        }
        Ok(())
    }
}

/// An input file that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{location}: {kind}")]
pub struct DataError {
    /// Where the error was found.
    pub location: Box<Location>,
    /// Cause and remedy.
    pub kind: Box<ErrorKind>,
}

/// Causes of a [`DataError`]; each displays as one sentence with the remedy.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum ErrorKind {
    #[error(
        "this campaign has no recordings; a recording is a folder that holds recording.toml, hall.csv and force.csv (each csv may be gzipped)"
    )]
    NoRecordings,
    #[error("{name} is missing; {advice}")]
    MissingFile { name: &'static str, advice: &'static str },
    #[error("both {name} and {name}.gz are here; keep only one of them")]
    AmbiguousFile { name: &'static str },
    #[error("cannot be read: {0}; check the path and the permissions")]
    Unreadable(std::io::Error),
    #[error("this is {found}, not a regular file; copy its content to a file and give that path")]
    NotRegular { found: &'static str },
    #[error("the file is longer than {max_mib} MiB, the limit for its kind; check the path")]
    FileTooLong { max_mib: u64 },
    #[error(
        "the row is longer than {max} bytes, the limit of a row; check that each row ends with a line break and each quotation mark is closed"
    )]
    RowTooLong { max: u64 },
    #[error("the table is longer than {max_gib} GiB, the limit of a table; split the recording")]
    TableTooLong { max_gib: u64 },
    #[error(
        "the content is more than {max} times as long as its compressed file, the limit for measurements; check the file, or decompress it"
    )]
    RatioTooHigh { max: u64 },
    #[error("there are {found} columns, and the limit is {max}; remove those that are not needed")]
    TooManyColumns { found: usize, max: usize },
    #[error(
        "the recording has more than {max} values in memory, the limit of one recording; split it, or reduce the rate of force.csv to 100 Hz"
    )]
    TooManyValues { max: usize },
    #[error(
        "a row of the reference spans more than {max} values of the board, the limit of its window; check that t_us is in microseconds in both tables"
    )]
    WindowTooLong { max: usize },
    #[error(
        "{value:?} is implausible, the limit is ±{max:e}; check the column and its unit, or remove the row"
    )]
    Implausible { value: f64, max: f64 },
    #[error(
        "the columns are separated by {separator:?} and not by commas; export the table with commas (and points in its numbers)"
    )]
    WrongSeparator { separator: char },
    #[error("this folder does not exist; create it, or choose another path")]
    NoSuchFolder,
    #[error("cannot be written: {0}; check the path, the permissions and the free disk space")]
    Unwritable(std::io::Error),
    #[error(
        "the gzip stream ends too early or is damaged ({0}); copy the file again from where it was recorded"
    )]
    DamagedGzip(std::io::Error),
    #[error(
        "the MCAP file ends too early or is damaged ({0}); copy it again, or repair it with `mcap recover`"
    )]
    DamagedMcap(String),
    #[error(
        "the file has more than {max} topics, the limit of a bag; take the topics of the gripper to a bag of their own with `ros2 bag convert`"
    )]
    TooManyTopics { max: usize },
    #[error(
        "the message definitions of its topics have more than {max_mib} MiB, the limit of a bag; take the topics of the gripper to a bag of their own with `ros2 bag convert`"
    )]
    DefinitionsTooLong { max_mib: usize },
    #[error(
        "a field has a path of more than {max} bytes, the limit of a field; leave this topic out"
    )]
    PathTooLong { max: usize },
    #[error(
        "the table has more than {max} values with the empty ones, the limit of a bag of this length; leave topics or columns out, or split the bag"
    )]
    TooManyBagValues { max: usize },
    #[error(
        "reading takes longer than {seconds} s, the limit for a file of this length; leave topics out, or split the bag"
    )]
    TooSlow { seconds: u64 },
    #[error(
        "the recorder did not close this bag: some of its messages are in {name}; copy both files to a folder that can be written, and complete the bag there with `sqlite3 {bag} VACUUM`"
    )]
    UnfinishedBag { bag: String, name: String },
    #[error(
        "is not a bag of ROS 2, or damaged ({0}); copy it again, or repair it with `ros2 bag reindex`"
    )]
    DamagedBag(String),
    #[error("its messages cannot be decoded: {reason}; leave this topic out, or convert the file")]
    Undecodable { reason: String },
    #[error("is invalid: {0}; correct it there")]
    Toml(String),
    #[error("the key is missing; add {example}")]
    MissingKey { example: &'static str },
    #[error("{found} is not allowed here; {advice}")]
    BadValue { found: String, advice: String },
    #[error(
        "this is a folder, not a model file of `cargo magpie fit`; the order is MODEL CAMPAIGN"
    )]
    ModelIsFolder,
    #[error("this is not a model file; `cargo magpie fit` writes one")]
    NotAModel,
    #[error(
        "these are tables of `cargo magpie dev export`, not a model file; give the model from which they were written"
    )]
    TablesForModel,
    #[error(
        "this is a network file, not a model file; give the model, and the network with --network"
    )]
    NetworkForModel,
    #[error("this folder holds several campaigns ({campaigns}); give one of them")]
    SeveralCampaigns { campaigns: String },
    #[error("this is not a network file; `cargo magpie train` writes one")]
    NotANetwork,
    #[error("this is not a checkpoint; `cargo magpie train --checkpoint` writes one")]
    NotACheckpoint,
    #[error("the file is damaged ({0}); copy it again, or repeat the training")]
    DamagedArrays(String),
    #[error("{name} is missing; the file is damaged or of another version: repeat the training")]
    MissingArray { name: String },
    #[error(
        "{name} has the shape {found:?} where {expected:?} is expected; the file is damaged or of another version: repeat the training"
    )]
    ArrayShape { name: String, found: Vec<usize>, expected: Vec<usize> },
    #[error("{name} contains a number that is not finite; repeat the training")]
    ArrayNotFinite { name: String },
    #[error(
        "this is a file, not a campaign folder; of a command with both the order is MODEL CAMPAIGN"
    )]
    CampaignIsFile,
    #[error("the output path exists{why}; it is not overwritten: {remedy}")]
    OutputExists { why: &'static str, remedy: &'static str },
    #[error(
        "this is not a text file; if it is compressed, its name must end in .csv.gz, else save it as plain CSV (comma, UTF-8)"
    )]
    NotText,
    #[error("this is not a gzip file; if it is plain text, remove .gz from its name")]
    NotGzip,
    #[error("rows are {period_us:.3} us apart; t_us must be in microseconds: convert the column")]
    ClockUnit { period_us: f64 },
    #[error("the file is empty; add a header line of column names and at least one row")]
    Empty,
    #[error("there are no rows below the header; record at least a few seconds")]
    NoRows,
    #[error("the column is missing from the header; {advice}")]
    MissingColumn { advice: String },
    #[error("the column has no unit; {advice}")]
    MissingUnit { advice: String },
    #[error("unknown column; {advice}")]
    UnknownColumn { advice: String },
    #[error("the header contains this column twice; remove or rename one")]
    DuplicateColumn,
    #[error(
        "the row has {found} cells where the header has {expected}; complete the row or remove it (an interrupted recording usually truncates its last line)"
    )]
    CellCount { found: usize, expected: usize },
    #[error(
        "{text:?} is not a number; correct it or remove the row, or leave the cell empty where a force was not measured"
    )]
    NotANumber { text: String },
    #[error(
        "{text:?} is not finite; remove the row, or leave the cell empty where a force was not measured"
    )]
    NotFinite { text: String },
    #[error(
        "the cell is empty; only forces may be left empty: remove the row, or the whole column if it was not recorded"
    )]
    EmptyCell,
    #[error(
        "{value} is not a whole number within the sensor's {bits} bit range ({low} to {high}); a converted field belongs in a column that ends in _gauss"
    )]
    OutOfRange { value: f64, bits: u32, low: f64, high: f64 },
    #[error(
        "the clock runs backwards, from {before} to {after}; sort the rows by time if they were merged, or split the recording here if the clock was reset"
    )]
    ClockBackwards { before: f64, after: f64 },
    #[error("the row is a duplicate of the previous one; remove it")]
    DuplicateRow,
    #[error(
        "two rows have the same time, {time}, and different values; remove the wrong one, or, where packets of rows have the time of their arrival, import them with the distance of the rows (row_s in a mapping)"
    )]
    DuplicateTime { time: f64 },
    #[error(
        "the two clocks do not overlap: the board has {hall_from:.3} to {hall_to:.3} s, the reference {force_from:.3} to {force_to:.3} s; shift one clock (offset_s in a mapping, or t_us) so that both start from the same event"
    )]
    NoOverlap { hall_from: f64, hall_to: f64, force_from: f64, force_to: f64 },
    #[error(
        "the board's rows come in packets, {within_ms:.3} ms apart and then {between_ms:.3} ms: these are the times of their arrival, not of the samples; import them with the distance of the rows (row_s in a mapping)"
    )]
    Packets { within_ms: f64, between_ms: f64 },
    #[error(
        "all recordings of a campaign must be of one gripper: this one has {found} and {other} has {expected}; move it to a separate campaign"
    )]
    InconsistentCampaign { found: String, expected: String, other: String },
    #[error("no field column; name them s0_x_lsb (raw counts) or s0_x_gauss")]
    NoField,
}

impl DataError {
    /// The error with its path moved from one folder to another.
    pub(crate) fn moved(mut self, from: &Path, to: &Path) -> Self {
        self.location.file = moved_path(&self.location.file, from, to);
        self
    }
}

impl Notice {
    /// The notice with its path moved from one folder to another.
    pub(crate) fn moved(&self, from: &Path, to: &Path) -> Self {
        let mut notice = self.clone();
        notice.location.file = moved_path(&notice.location.file, from, to);
        notice
    }
}

fn moved_path(path: &Path, from: &Path, to: &Path) -> PathBuf {
    path.strip_prefix(from).map_or_else(|_| path.to_path_buf(), |rest| to.join(rest))
}

impl ErrorKind {
    /// A [`ErrorKind::BadValue`].
    pub fn bad_value(found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::BadValue { found: found.into(), advice: advice.into() }
    }

    /// An output path that a command never replaces exists.
    pub fn exists() -> Self {
        Self::OutputExists { why: "", remedy: REMOVABLE }
    }

    /// Whether the values are those of another unit or clock.
    pub fn is_of_unit(&self) -> bool {
        matches!(
            self,
            Self::ClockUnit { .. }
                | Self::Implausible { .. }
                | Self::OutOfRange { .. }
                | Self::WindowTooLong { .. }
        )
    }

    /// Adds the location.
    pub fn at(self, location: Location) -> DataError {
        DataError { location: Box::new(location), kind: Box::new(self) }
    }
}

/// A warning about a recording; processing continues.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Notice {
    /// Where the finding was made.
    pub location: Location,
    /// One sentence: the finding and its consequence.
    pub message: String,
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.location, self.message)
    }
}

/// The candidate most similar to `written` (Damerau-Levenshtein distance of at most a third of its length).
pub fn closest_match<'a>(
    written: &str,
    candidates: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    // The distance takes the product of both lengths.
    let is_short = written.len() <= MAX_NAME;
    candidates
        .into_iter()
        .filter(|candidate| is_short && candidate.len() <= MAX_NAME)
        .map(|candidate| {
            let distance = strsim::damerau_levenshtein(written, candidate);
            (distance, !candidate.eq_ignore_ascii_case(written), candidate)
        })
        .filter(|(distance, _, candidate)| *distance * 3 <= candidate.len().max(3))
        .min()
        .map(|(_, _, candidate)| candidate)
}
