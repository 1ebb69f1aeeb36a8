//! Checks on the scanned files.
//!
//! - [`clock`]: order of the rows, gaps, repeated samples.
//! - [`columns`]: values of single columns.
//! - [`lines`]: periodic disturbances.

pub mod clock;
pub mod columns;
pub mod lines;

use std::collections::{BTreeSet, HashSet};

use model_export::recordings::Location;

use crate::data_quality::Finding;
use crate::data_quality::fix::Fix;
use crate::data_quality::scan::column::ColumnScan;
use crate::data_quality::scan::{RecordingScan, TableScan};
use crate::numbers::decimal;

/// Number of names in a list before "and n more".
const LISTED: usize = 6;

/// Input of a check: the scanned recordings, and the findings of the checks before it.
pub struct CheckContext<'a> {
    /// Recordings of the campaign.
    pub recordings: &'a [RecordingScan],
    findings: Vec<Finding>,
    /// Columns explained by an earlier finding: recording, table, column.
    explained: HashSet<(usize, &'static str, String)>,
}

/// One column of one recording.
#[derive(Clone, Copy)]
pub struct Channel<'a> {
    /// Zero-based number of the recording.
    pub recording: usize,
    /// Table of the column.
    pub table: &'a TableScan,
    /// Scan result of the column.
    pub column: &'a ColumnScan,
}

impl Channel<'_> {
    /// Location in the file, for a line.
    pub fn at(&self, line: u64) -> Location {
        Location::file(&self.table.path).line(line).column(self.column.name.as_str())
    }
}

/// Finding of a check.
pub struct Found<'a> {
    place: Location,
    message: String,
    stops: bool,
    fix: Option<Fix>,
    /// Columns that later checks skip.
    explained: Vec<Channel<'a>>,
}

impl<'a> Found<'a> {
    /// A warning; the sentence gives the evidence and the remedy.
    pub fn new(place: Location, message: String) -> Self {
        Self { place, message, stops: false, fix: None, explained: Vec::new() }
    }

    /// Makes it an error, with its unambiguous correction if there is one.
    pub fn stopping(self, fix: Option<Fix>) -> Self {
        Self { stops: true, fix, ..self }
    }

    /// Excludes these columns from the checks after this one.
    pub fn explaining(self, explained: &[Channel<'a>]) -> Self {
        Self { explained: explained.to_vec(), ..self }
    }

    /// The finding of the check with this identifier.
    pub fn finding(self, id: &'static str) -> Finding {
        let Self { place, message, stops, fix, .. } = self;
        Finding { id, place, message, stops, fix }
    }
}

impl<'a> CheckContext<'a> {
    /// No findings yet.
    pub fn new(recordings: &'a [RecordingScan]) -> Self {
        Self { recordings, findings: Vec::new(), explained: HashSet::new() }
    }

    /// Adds the findings of a check.
    pub fn add(&mut self, id: &'static str, found: Vec<Found>) {
        for found in found {
            let key = |one: &Channel| (one.recording, one.table.name, one.column.name.clone());
            self.explained.extend(found.explained.iter().map(key));
            self.findings.push(found.finding(id));
        }
    }

    /// All findings.
    pub fn into_findings(self) -> Vec<Finding> {
        self.findings
    }

    /// Columns that no earlier finding explains.
    pub fn columns(&self) -> Vec<Channel<'a>> {
        let mut seen = Vec::new();
        for (recording, table) in self.tables() {
            for column in &table.columns {
                let key = (recording, table.name, column.name.clone());
                if !self.explained.contains(&key) {
                    seen.push(Channel { recording, table, column });
                }
            }
        }
        seen
    }

    /// All tables with the number of their recording.
    pub fn tables(&self) -> Vec<(usize, &'a TableScan)> {
        let numbered = self.recordings.iter().enumerate();
        numbered
            .flat_map(|(i, recording)| recording.tables.iter().map(move |table| (i, table)))
            .collect()
    }

    /// True where a finding with this identifier names the table.
    pub fn has(&self, id: &str, table: &TableScan) -> bool {
        let named = |finding: &Finding| finding.id == id && finding.place.file == table.path;
        self.findings.iter().any(named)
    }

    /// True where `seen` contains this column of every recording.
    pub fn everywhere(&self, seen: &[Channel], column: &str) -> bool {
        let hit: HashSet<usize> =
            seen.iter().filter(|one| one.column.name == column).map(|one| one.recording).collect();
        hit.len() == self.recordings.len()
    }

    /// "in every recording", or the names of the recordings.
    pub fn recordings_in(&self, hit: impl IntoIterator<Item = usize>) -> String {
        let hit: BTreeSet<usize> = hit.into_iter().collect();
        if hit.len() == self.recordings.len() {
            return match hit.len() {
                1 => "in the recording".to_owned(),
                _ => "in every recording".to_owned(),
            };
        }
        let names: Vec<&str> = hit.iter().map(|&i| self.recordings[i].name.as_str()).collect();
        match names.len() {
            1 => format!("in recording {}", names[0]),
            _ => format!("in recordings {}", list(&names)),
        }
    }

    /// Names of the columns and of their recordings.
    pub fn whose(&self, seen: &[Channel]) -> String {
        let mut names: Vec<&str> = Vec::new();
        for one in seen {
            if !names.contains(&one.column.name.as_str()) {
                names.push(&one.column.name);
            }
        }
        let recordings = self.recordings_in(seen.iter().map(|one| one.recording));
        format!("{} {recordings}", list(&names))
    }
}

/// `a, b and c`; long lists are truncated.
pub fn list(names: &[&str]) -> String {
    if names.len() > LISTED {
        let more = names.len() - LISTED + 1;
        return format!("{} and {more} more", names[..LISTED - 1].join(", "));
    }
    match names {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// Singular or plural form of a verb, by the number of distinct columns.
pub fn verb(seen: &[Channel], one: &'static str, several: &'static str) -> &'static str {
    let first = seen.first().map(|one| &one.column.name);
    if seen.iter().all(|one| Some(&one.column.name) == first) { one } else { several }
}

/// Splits into columns of the board and of the reference.
pub fn by_table<'a>(seen: Vec<Channel<'a>>) -> [Vec<Channel<'a>>; 2] {
    let (hall, force) = seen.into_iter().partition(|one| one.table.name == "hall.csv");
    [hall, force]
}

/// Formats a number with three significant digits.
pub fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let before = value.abs().log10().floor() as i32;
    if !(-4..6).contains(&before) {
        return format!("{value:.2e}");
    }
    let decimals = usize::try_from(2 - before).unwrap_or(0);
    decimal(value, decimals)
}

/// Formats a share in percent; small positive shares are not rounded to zero.
pub fn percent(share: f64) -> String {
    if share > 0.0 && share < 1e-4 {
        "less than 0.01 %".to_owned()
    } else {
        format!("{} %", digits(100.0 * share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_joined_with_and() {
        assert_eq!(list(&["a"]), "a");
        assert_eq!(list(&["a", "b", "c"]), "a, b and c");
        assert_eq!(list(&["a", "b", "c", "d", "e", "f", "g"]), "a, b, c, d, e and 2 more");
    }

    #[test]
    fn numbers_have_three_digits_without_trailing_zeros() {
        assert_eq!(digits(0.012_345), "0.0123");
        assert_eq!(digits(12.0), "12");
        assert_eq!(digits(1234.5), "1234");
        assert_eq!(digits(-0.1), "-0.1");
        assert_eq!(percent(0.5), "50 %");
    }
}
