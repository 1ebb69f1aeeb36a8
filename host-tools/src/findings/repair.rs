//! What can be mended without doubt, as data: the tie between a finding and `--fix`.

use std::fmt;
use std::path::PathBuf;

/// What `--fix` does about a finding.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// In words.
    pub words: String,
    /// Table by table.
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
    /// The table as it was recorded.
    pub file: PathBuf,
    /// What is done to it.
    pub change: Change,
}

/// A change that keeps everything that was measured.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Rows that repeat an earlier one, cell by cell, are left out.
    DropCopies,
    /// Rows that stand a little out of place are put in order of time.
    SortRows,
    /// Every value becomes `value * factor + offset`.
    Convert {
        /// Its column.
        column: String,
        /// Unit wanted, per unit found.
        factor: f64,
        /// In the unit wanted.
        offset: f64,
    },
    /// A column takes the values of another (or of itself), with the other sign where `negate`.
    Take {
        /// Column that is written.
        to: String,
        /// Column that holds what belongs there.
        from: String,
        /// Sign turned.
        negate: bool,
    },
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DropCopies => write!(f, "rows that repeat another were left out"),
            Self::SortRows => write!(f, "rows were put in order of time"),
            Self::Convert {
                column,
                factor,
                offset,
            } => {
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
                (true, _) => write!(f, "the sign of {to} was turned"),
                (false, false) => write!(f, "{to} took the values of {from}"),
                (false, true) => write!(f, "{to} took the values of {from} with their sign turned"),
            },
        }
    }
}
