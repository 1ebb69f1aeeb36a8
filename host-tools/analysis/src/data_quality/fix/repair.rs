//! Corrections as data: the link between a finding and `--fix`.

use std::fmt;
use std::path::PathBuf;

/// Correction that `--fix` applies for a finding.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// Description.
    pub words: String,
    /// Changes, table by table.
    pub repairs: Vec<Repair>,
}

impl fmt::Display for Fix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words)
    }
}

/// One change of one table.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    /// Recorded table.
    pub file: PathBuf,
    /// Change to apply.
    pub change: Change,
}

/// Change that preserves all measured values.
#[derive(Clone, Debug, PartialEq)]
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
    /// Copy a column from another (or itself), negated where `negate`.
    Take {
        /// Destination column.
        to: String,
        /// Source column.
        from: String,
        /// Negate the values.
        negate: bool,
    },
}

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
            Self::Take { to, from, negate } => match (to == from, negate) {
                (true, _) => write!(f, "{to} was negated"),
                (false, false) => write!(f, "{to} was replaced by {from}"),
                (false, true) => write!(f, "{to} was replaced by the negated {from}"),
            },
        }
    }
}
