//! What can be wrong with a recording, each with its place and one sentence that says what to do.

use std::fmt;
use std::path::{Path, PathBuf};

/// Where in the input something was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// The file, or the folder where a file is missing.
    pub file: PathBuf,
    /// Line in the file, the header being line 1.
    pub line: Option<u64>,
    /// The column's name in the header, or the key in a TOML file.
    pub column: Option<String>,
}

impl Place {
    /// A whole file.
    pub fn file(file: &Path) -> Self {
        Self {
            file: file.to_path_buf(),
            ..Self::default()
        }
    }

    /// The same place, narrowed to a line.
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// The same place, narrowed to a column or key.
    pub fn column(mut self, column: impl Into<String>) -> Self {
        self.column = Some(column.into());
        self
    }
}

impl fmt::Display for Place {
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

/// A recording that cannot be used as it is.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct Problem {
    /// Where.
    pub place: Box<Place>,
    /// What, and what to do about it.
    pub fault: Box<Fault>,
}

/// The kinds of [`Problem`]; each displays as one sentence.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum Fault {
    #[error(
        "this campaign has no recordings; a recording is a folder that holds recording.toml, hall.csv and force.csv (each csv may be gzipped)"
    )]
    NoRecordings,
    #[error("{name} is missing; {advice}")]
    MissingFile {
        name: &'static str,
        advice: &'static str,
    },
    #[error("both {name} and {name}.gz are here; keep the one that counts")]
    TwoFiles { name: &'static str },
    #[error("cannot be read: {0}; check the path and the permissions")]
    Unreadable(std::io::Error),
    #[error(
        "the columns are separated by {other:?} and not by commas; export the table with commas (and points in its numbers)"
    )]
    OtherSeparator { other: char },
    #[error("this folder does not exist; create it, or write elsewhere")]
    NoSuchFolder,
    #[error("cannot be written: {0}; check the path, the permissions and the space left")]
    Unwritable(std::io::Error),
    #[error(
        "the gzip stream ends too early or is damaged ({0}); copy the file again from where it was recorded"
    )]
    DamagedGzip(std::io::Error),
    #[error("cannot be understood: {0}; correct it there")]
    Toml(String),
    #[error("the key is missing; add {example}")]
    MissingKey { example: &'static str },
    #[error("{found} is not possible here; {advice}")]
    BadValue { found: String, advice: String },
    #[error(
        "this is a folder, and a model is a file that `magpie fit` writes; the order is MODEL CAMPAIGN"
    )]
    NoModel,
    #[error("this is not a model; a model is a file that `magpie fit` writes")]
    ForeignModel,
    #[error("this is not a network; a network is a file that `magpie train` writes")]
    ForeignNetwork,
    #[error("this is not a training to go on with; `magpie train --checkpoint` writes one")]
    ForeignCheckpoint,
    #[error("the file is damaged ({0}); copy it again, or train again")]
    DamagedArrays(String),
    #[error("{name} is missing; the file is damaged or of another version: train again")]
    MissingArray { name: String },
    #[error(
        "{name} has the shape {found:?} where {expected:?} is expected; the file is damaged or of another version: train again"
    )]
    ArrayShape {
        name: String,
        found: Vec<usize>,
        expected: Vec<usize>,
    },
    #[error("{name} holds a number that is not finite; train again")]
    ArrayNotFinite { name: String },
    #[error(
        "this is a file, and a campaign is a folder of recordings; the order is MODEL CAMPAIGN"
    )]
    NoFolder,
    #[error("something else stands there; choose another name: it is not overwritten")]
    Occupied,
    #[error(
        "this is no text; if it is packed, its name must end in .csv.gz, else save it as plain CSV (comma, UTF-8)"
    )]
    NotText,
    #[error("this is not a gzip file; if it is plain text, take the .gz off its name")]
    NotGzip,
    #[error(
        "rows are {period_us:.3} us apart; is t_us really in microseconds? Multiply the column accordingly"
    )]
    ClockUnit { period_us: f64 },
    #[error("the file is empty; it needs a header line of column names and at least one row")]
    Empty,
    #[error("there are no rows under the header; record at least a few seconds")]
    NoRows,
    #[error("the column is missing from the header; {advice}")]
    MissingColumn { advice: String },
    #[error("the column has no unit; {advice}")]
    UnitlessColumn { advice: String },
    #[error("this column is not known; {advice}")]
    UnknownColumn { advice: String },
    #[error("the column stands twice in the header; remove or rename one")]
    RepeatedColumn,
    #[error(
        "the row has {found} cells where the header has {expected}; complete the row or remove it (a recording cut short usually breaks its last line)"
    )]
    CellCount { found: usize, expected: usize },
    #[error("{text:?} is not a number; correct it or remove the row")]
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
        "{value} does not fit the sensor's {bits} bit word ({low} to {high}); is this column really raw counts? A converted field belongs in a column that ends in _gauss"
    )]
    OutsideWord {
        value: f64,
        bits: u32,
        low: f64,
        high: f64,
    },
    #[error(
        "the clock runs backwards, from {before} to {after}; sort the rows by time if they were merged, or split the recording here if the clock was reset"
    )]
    ClockBackwards { before: f64, after: f64 },
    #[error("the row repeats the one before it; remove it")]
    RepeatedRow,
    #[error("two rows have the same time, {time}, and different values; remove the wrong one")]
    RepeatedTime { time: f64 },
    #[error(
        "the two clocks do not overlap: the board has {hall_from:.3} to {hall_to:.3} s, the reference {force_from:.3} to {force_to:.3} s; shift one t_us column so that both start from the same event"
    )]
    NoOverlap {
        hall_from: f64,
        hall_to: f64,
        force_from: f64,
        force_to: f64,
    },
    #[error(
        "recordings of one campaign come from one gripper, but this one has {found} where {other} has {expected}; move it to a campaign of its own"
    )]
    DifferentGripper {
        found: String,
        expected: String,
        other: String,
    },
    #[error("no field column was found; name them s0_x_lsb (raw counts) or s0_x_gauss")]
    NoField,
}

impl Problem {
    /// The same problem of a file that goes from one folder to another.
    pub(crate) fn moved(mut self, from: &Path, to: &Path) -> Self {
        self.place.file = moved(&self.place.file, from, to);
        self
    }
}

impl Notice {
    /// The same notice of a file that goes from one folder to another.
    pub(crate) fn moved(&self, from: &Path, to: &Path) -> Self {
        let mut notice = self.clone();
        notice.place.file = moved(&notice.place.file, from, to);
        notice
    }
}

fn moved(path: &Path, from: &Path, to: &Path) -> PathBuf {
    path.strip_prefix(from)
        .map_or_else(|_| path.to_path_buf(), |rest| to.join(rest))
}

impl Fault {
    /// Ties the fault to its place.
    pub fn at(self, place: Place) -> Problem {
        Problem {
            place: Box::new(place),
            fault: Box::new(self),
        }
    }
}

/// Something that a person should know about their recording, and that does not stop the work.
#[derive(Clone, Debug, PartialEq)]
pub struct Notice {
    /// Where.
    pub place: Place,
    /// One sentence: what was found and what was done about it.
    pub message: String,
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

/// The candidate that was probably meant, where one is close to what was written.
pub fn closest<'a>(
    written: &str,
    candidates: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| {
            let distance = strsim::damerau_levenshtein(written, candidate);
            (
                distance,
                !candidate.eq_ignore_ascii_case(written),
                candidate,
            )
        })
        .filter(|(distance, _, candidate)| *distance * 3 <= candidate.len().max(3))
        .min()
        .map(|(_, _, candidate)| candidate)
}
