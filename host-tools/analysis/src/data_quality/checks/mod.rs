//! Checks on the scanned files. They run in order of severity; each marks the channels that it explains in the
//! [`CheckContext`].

pub mod clock;
pub mod lines;
pub mod signal;
pub mod stuck;
pub mod units;

use std::collections::{BTreeSet, HashSet};

use model_export::recordings::Location;

use crate::data_quality::Finding;

use crate::data_quality::scan::{ColumnScan, RecordingScan, TableScan};

/// Number of names in a list before "and n more".
const LISTED: usize = 6;

/// Input and findings of the checks.
pub struct CheckContext<'a> {
    /// Recordings of the campaign.
    pub recordings: &'a [RecordingScan],
    /// Findings so far.
    pub findings: Vec<Finding>,
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

/// Runs every check in order of severity: later ones skip the channels that earlier ones explain.
pub fn run_all(context: &mut CheckContext) {
    let checks: [fn(&mut CheckContext); 10] = [
        clock::check_row_order,
        units::check_units,
        stuck::check_stuck_channels,
        stuck::check_saturation,
        clock::check_gaps,
        signal::check_resolution,
        clock::check_repeated_samples,
        signal::check_outliers,
        lines::check_spectral_lines,
        stuck::check_constant_covariates,
    ];
    for check in checks {
        check(context);
    }
}

impl<'a> CheckContext<'a> {
    /// No findings yet.
    pub fn new(recordings: &'a [RecordingScan]) -> Self {
        Self { recordings, findings: Vec::new(), explained: HashSet::new() }
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

    /// Marks columns as explained.
    pub fn explain(&mut self, seen: &[Channel]) {
        for one in seen {
            self.explained.insert((one.recording, one.table.name, one.column.name.clone()));
        }
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
    match seen.iter().all(|one| Some(&one.column.name) == first) {
        true => one,
        false => several,
    }
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
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
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
