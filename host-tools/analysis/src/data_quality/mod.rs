//! Data-quality checks of a campaign: setup errors are reported before a model is evaluated.
//!
//! - [`scan`]: one tolerant pass over every file, in constant memory.
//! - [`checks`]: findings from the files alone.
//! - [`model_checks`]: findings that need a model's prediction.
//! - [`fix`]: unambiguous corrections, and writing a corrected campaign.
//!
//! Each cause is reported once: later checks skip the columns that an earlier finding explains.

pub mod checks;
pub mod fix;
pub mod model_checks;
pub mod scan;

use std::path::Path;

use anyhow::Result;
use model_export::recordings::campaign::recording_folders;
use rayon::prelude::*;

use crate::data_quality::checks::CheckContext;
use crate::data_quality::fix::repair::Fix;
use crate::data_quality::scan::RecordingScan;
use model_export::recordings::Location;

/// A setup error in the recordings, with evidence and remedy.
#[derive(Clone, Debug)]
pub struct Finding {
    /// Identifier: `clock_backwards`.
    pub id: &'static str,
    /// File, line and column, where applicable.
    pub place: Location,
    /// What was found, the evidence in numbers, and the remedy, in one sentence.
    pub message: String,
    /// True if no further result is valid before it is fixed.
    pub stops: bool,
    /// Repair by `--fix`; `None` where it is ambiguous.
    pub fix: Option<Fix>,
}

/// Identifiers of all findings, most severe first.
pub const ORDER: [&str; 16] = [
    "clock_backwards",
    "duplicate_rows",
    "wrong_unit",
    "axis_permuted",
    "axis_flipped",
    "force_swapped",
    "force_flipped",
    "stuck_channel",
    "saturated",
    "clock_skew",
    "clock_gap",
    "coarse_steps",
    "repeated_samples",
    "outlier",
    "spectral_line",
    "constant_covariate",
];

/// Merges findings from the files and from the model checks and removes consequences of the same cause.
pub fn merge(files: Vec<Finding>, model_checks: Vec<Finding>) -> Vec<Finding> {
    let table = |finding: &Finding| {
        let name = finding.place.file.file_name().unwrap_or_default();
        name.to_string_lossy().trim_end_matches(".gz").to_owned()
    };
    let has = |id: &str| files.iter().any(|finding| finding.id == id);
    let repeated = has("repeated_samples");
    let mut all: Vec<Finding> = files
        .iter()
        .filter(|finding| {
            // Forces in kilonewtons with three digits are coarse too; the wrong unit is the cause.
            let unit = |other: &Finding| other.id == "wrong_unit" && table(other) == table(finding);
            finding.id != "coarse_steps" || !model_checks.iter().any(unit)
        })
        .cloned()
        .collect();
    all.extend(model_checks);
    sort(&mut all);
    if repeated {
        // Repeated samples delay the field, which looks like a clock offset.
        all.sort_by_key(|finding| {
            let rank = rank(finding);
            match finding.id {
                "repeated_samples" => (rank_of("clock_skew"), 0),
                _ => (rank, 1),
            }
        });
    }
    all
}

fn rank(finding: &Finding) -> usize {
    rank_of(finding.id)
}

fn rank_of(id: &str) -> usize {
    ORDER.iter().position(|other| *other == id).unwrap_or(ORDER.len())
}

/// Sorts by severity; the sort is stable.
pub fn sort(findings: &mut [Finding]) {
    findings.sort_by_key(rank);
}

/// Scans every recording of the campaign in `folder` once and returns its findings, most severe first.
/// Errors of the strict reader (text in a number, a missing file) are skipped here, since the reader
/// reports them. `read` is called once for each recording, from any thread.
///
/// # Errors
/// The folder holds no recordings.
pub fn scan_files(folder: &Path, read: impl Fn(&str) + Sync) -> Result<Vec<Finding>> {
    let folders = recording_folders(folder)?;
    let recordings: Vec<RecordingScan> = folders
        .par_iter()
        .map(|folder| {
            let scan = RecordingScan::read(folder, folders.len());
            read(&scan.name);
            scan
        })
        .collect();
    let mut context = CheckContext::new(&recordings);
    checks::run_all(&mut context);
    let mut findings = context.findings;
    sort(&mut findings);
    Ok(findings)
}
