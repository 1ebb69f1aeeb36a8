//! Corrections of recordings: what `--fix` changes.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

/// Correction that `--fix` applies for a finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fix {
    /// What it does.
    pub kind: FixKind,
    /// Changes, table by table.
    pub repairs: Vec<Repair>,
}

/// What a correction does.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum FixKind {
    /// Sorts rows by time.
    SortRows,
    /// Removes exact duplicates of rows.
    RemoveDuplicates,
    /// Converts columns from the first unit to the second.
    ConvertUnit(&'static str, &'static str),
    /// Converts columns to their unit.
    ConvertColumns,
    /// Negates columns.
    NegateColumns,
    /// Restores the order of the columns.
    ReorderColumns,
    /// Moves the reference's times to the board's clock.
    AlignClock,
    /// Gives the forces of all recordings one zero.
    AlignZeros,
    /// Adds to values whose counts wrapped.
    Unwrap,
}

/// One change of one table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Repair {
    /// Recorded table.
    pub file: PathBuf,
    /// Change to apply.
    pub change: Change,
}

impl Repair {
    /// Replaces each value of a column by `value * factor + offset`.
    pub fn convert(file: &Path, column: &str, factor: f64, offset: f64) -> Self {
        let column = column.to_owned();
        Self { file: file.to_path_buf(), change: Change::Convert { column, factor, offset } }
    }
}

/// Change that preserves all measured values.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Change {
    /// Remove exact duplicates.
    DropCopies,
    /// Sort rows that are slightly out of order by time.
    SortRows,
    /// Replace each value by `value * factor + offset`.
    Convert {
        /// Column to convert.
        column: String,
        /// Expected unit per found unit.
        factor: f64,
        /// In the expected unit.
        offset: f64,
    },
    /// Add `offset` to the values below `threshold`, or above it where `offset` is negative.
    Unwrap {
        /// Column to correct.
        column: String,
        /// In the unit of the column.
        threshold: f64,
        /// In the unit of the column.
        offset: f64,
    },
    /// Copy a column from another (or itself), negated where `negate`.
    Take {
        /// Destination column.
        to: String,
        /// Source column.
        from: String,
        negate: bool,
    },
}

/// The change as written to the description of the corrected recording.
impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DropCopies => write!(f, "duplicate rows were removed"),
            Self::SortRows => write!(f, "rows were sorted by time"),
            Self::Convert { column, factor, offset } => {
                write!(f, "{column} was")?;
                if *factor != 1.0 {
                    write!(f, " multiplied by {factor}")?;
                }
                match *offset {
                    0.0 => Ok(()),
                    offset => write!(f, " shifted by {offset}"),
                }
            }
            Self::Unwrap { column, threshold, offset } => {
                let side = if *offset > 0.0 { "below" } else { "above" };
                write!(f, "{offset} was added to the values of {column} {side} {threshold}")
            }
            Self::Take { to, from, negate } => match (to == from, negate) {
                (true, _) => write!(f, "{to} was negated"),
                (false, false) => write!(f, "{to} was replaced by {from}"),
                (false, true) => write!(f, "{to} was replaced by the negated {from}"),
            },
        }
    }
}
