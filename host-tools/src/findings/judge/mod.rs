//! From the figures of a scan to findings, one file for each kind.
//!
//! The judges are asked in the order of gravity; each takes what it explains off the [`Desk`].

pub mod clock;
pub mod coarse;
pub mod constant;
pub mod gap;
pub mod lines;
pub mod outlier;
pub mod repeated;
pub mod saturated;
pub mod stuck;
pub mod units;

use std::collections::{BTreeSet, HashSet};

use model_export::recordings::Place;

use crate::compare::Finding;

use super::scan::{ColumnScan, RecordingScan, TableScan};

/// Names that are listed before "and n more".
const LISTED: usize = 6;

/// What is looked at, and what was found so far.
pub struct Desk<'a> {
    /// The campaign.
    pub recordings: &'a [RecordingScan],
    /// What was found.
    pub findings: Vec<Finding>,
    /// Columns that a graver finding explains: recording, table, column.
    explained: HashSet<(usize, &'static str, String)>,
}

/// A column of one recording.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// Number of the recording, from zero.
    pub recording: usize,
    /// Its table.
    pub table: &'a TableScan,
    /// The column.
    pub column: &'a ColumnScan,
}

impl Seen<'_> {
    /// Its place, at a line of the file.
    pub fn at(&self, line: u64) -> Place {
        Place::file(&self.table.path)
            .line(line)
            .column(self.column.name.as_str())
    }
}

impl<'a> Desk<'a> {
    /// Nothing found yet.
    pub fn new(recordings: &'a [RecordingScan]) -> Self {
        Self {
            recordings,
            findings: Vec::new(),
            explained: HashSet::new(),
        }
    }

    /// Every column that nothing graver explains.
    pub fn columns(&self) -> Vec<Seen<'a>> {
        let mut seen = Vec::new();
        for (recording, table) in self.tables() {
            for column in &table.columns {
                let key = (recording, table.name, column.name.clone());
                if !self.explained.contains(&key) {
                    seen.push(Seen {
                        recording,
                        table,
                        column,
                    });
                }
            }
        }
        seen
    }

    /// Every table with the number of its recording.
    pub fn tables(&self) -> Vec<(usize, &'a TableScan)> {
        let numbered = self.recordings.iter().enumerate();
        numbered
            .flat_map(|(i, recording)| recording.tables.iter().map(move |table| (i, table)))
            .collect()
    }

    /// The columns of `seen` are explained.
    pub fn explain(&mut self, seen: &[Seen]) {
        for one in seen {
            self.explained
                .insert((one.recording, one.table.name, one.column.name.clone()));
        }
    }

    /// True where a finding of this kind names the table.
    pub fn has(&self, id: &str, table: &TableScan) -> bool {
        let named = |finding: &Finding| finding.id == id && finding.place.file == table.path;
        self.findings.iter().any(named)
    }

    /// True where this column of every recording is in `seen`.
    pub fn everywhere(&self, seen: &[Seen], column: &str) -> bool {
        let hit: HashSet<usize> = seen
            .iter()
            .filter(|one| one.column.name == column)
            .map(|one| one.recording)
            .collect();
        hit.len() == self.recordings.len()
    }

    /// `in every recording`, or which.
    pub fn recordings_in(&self, hit: impl IntoIterator<Item = usize>) -> String {
        let hit: BTreeSet<usize> = hit.into_iter().collect();
        if hit.len() == self.recordings.len() {
            return match hit.len() {
                1 => "in the recording".to_owned(),
                _ => "in every recording".to_owned(),
            };
        }
        let names: Vec<&str> = hit
            .iter()
            .map(|&i| self.recordings[i].name.as_str())
            .collect();
        match names.len() {
            1 => format!("in recording {}", names[0]),
            _ => format!("in recordings {}", list(&names)),
        }
    }

    /// Which columns, and in which recordings.
    pub fn whose(&self, seen: &[Seen]) -> String {
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

/// `a, b and c`; long lists are cut.
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

/// The verb for one column or several.
pub fn verb(seen: &[Seen], one: &'static str, several: &'static str) -> &'static str {
    let first = seen.first().map(|one| &one.column.name);
    match seen.iter().all(|one| Some(&one.column.name) == first) {
        true => one,
        false => several,
    }
}

/// Splits `seen` into the board's and the reference's columns.
pub fn by_table<'a>(seen: Vec<Seen<'a>>) -> [Vec<Seen<'a>>; 2] {
    let (hall, force) = seen
        .into_iter()
        .partition(|one| one.table.name == "hall.csv");
    [hall, force]
}

/// A number to three digits, as people write it.
pub fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let before = value.abs().log10().floor() as i32;
    if !(-4..6).contains(&before) {
        return format!("{value:.2e}");
    }
    let decimals = usize::try_from(2 - before).unwrap_or(0);
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// A share in percent, never rounded to nothing.
pub fn percent(share: f64) -> String {
    match share > 0.0 && share < 1e-4 {
        true => "less than 0.01 %".to_owned(),
        false => format!("{} %", digits(100.0 * share)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_read_as_sentences_do() {
        assert_eq!(list(&["a"]), "a");
        assert_eq!(list(&["a", "b", "c"]), "a, b and c");
        assert_eq!(
            list(&["a", "b", "c", "d", "e", "f", "g"]),
            "a, b, c, d, e and 2 more"
        );
    }

    #[test]
    fn numbers_have_three_digits_and_no_idle_zeros() {
        assert_eq!(digits(0.012_345), "0.0123");
        assert_eq!(digits(12.0), "12");
        assert_eq!(digits(1234.5), "1234");
        assert_eq!(digits(-0.1), "-0.1");
        assert_eq!(percent(0.5), "50 %");
    }
}
