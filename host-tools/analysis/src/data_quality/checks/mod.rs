//! Checks on the scanned files.
//!
//! - [`alignment`]: offset and rate of the reference's clock.
//! - [`clock`]: order of the rows, gaps, repeated samples.
//! - [`columns`]: values of single columns.
//! - [`lines`]: periodic disturbances.
//! - [`wraps`]: counts that wrapped.

pub mod alignment;
pub mod clock;
pub mod columns;
pub mod lines;
pub mod wraps;

use std::collections::{BTreeSet, HashSet};

use model_export::recordings::Location;

use crate::data_quality::evidence::{ColumnSet, Evidence, RecordingSet};
use crate::data_quality::finding::Finding;
use crate::data_quality::fix::Fix;
use crate::data_quality::scan::column::ColumnScan;
use crate::data_quality::scan::{RecordingScan, TableScan};

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
    evidence: Evidence,
    stops: bool,
    fix: Option<Fix>,
    /// Columns that later checks skip.
    explained: Vec<Channel<'a>>,
}

impl<'a> Found<'a> {
    /// A warning.
    pub fn new(place: Location, evidence: Evidence) -> Self {
        Self { place, evidence, stops: false, fix: None, explained: Vec::new() }
    }

    /// Makes it an error, with its unambiguous correction if there is one.
    pub fn stopping(self, fix: Option<Fix>) -> Self {
        Self { stops: true, fix, ..self }
    }

    /// Adds an unambiguous correction to a warning.
    pub fn with_fix(self, fix: Fix) -> Self {
        Self { fix: Some(fix), ..self }
    }

    /// Excludes these columns from the checks after this one.
    pub fn explaining(self, explained: &[Channel<'a>]) -> Self {
        Self { explained: explained.to_vec(), ..self }
    }

    /// The finding of the check with this identifier.
    pub fn finding(self, id: &'static str) -> Finding {
        let Self { place, evidence, stops, fix, .. } = self;
        Finding { id, place, evidence, stops, fix }
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

    pub fn recordings_in(&self, hit: impl IntoIterator<Item = usize>) -> RecordingSet {
        RecordingSet::of(hit, self.recordings.iter().map(|recording| &recording.name))
    }

    /// Names of the columns, and the recordings of each.
    pub fn columns_in(&self, seen: &[Channel]) -> ColumnSet {
        let mut groups: Vec<(Vec<String>, BTreeSet<usize>)> = Vec::new();
        let mut done = BTreeSet::new();
        for one in seen {
            let name = &one.column.name;
            if !done.insert(name) {
                continue;
            }
            let own = seen.iter().filter(|other| other.column.name == *name);
            let own: BTreeSet<usize> = own.map(|other| other.recording).collect();
            match groups.iter_mut().find(|(_, recordings)| *recordings == own) {
                Some((names, _)) => names.push(name.clone()),
                None => groups.push((vec![name.clone()], own)),
            }
        }
        let set = |(names, own)| (names, self.recordings_in(own));
        ColumnSet(groups.into_iter().map(set).collect())
    }
}

/// Splits into columns of the board and of the reference.
pub fn by_table<'a>(seen: Vec<Channel<'a>>) -> [Vec<Channel<'a>>; 2] {
    let (hall, force) = seen.into_iter().partition(|one| one.table.name == "hall.csv");
    [hall, force]
}
