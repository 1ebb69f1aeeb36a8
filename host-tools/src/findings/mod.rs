//! What is wrong with a campaign's recordings: mistakes of the rig, told before anything is said of a
//! model.
//!
//! - [`scan`]: every file read once, tolerantly, into figures that do not grow with its length.
//! - [`files`]: findings from the files alone; [`judge`](mod@judge) holds one file for each kind.
//! - [`against`](mod@against): findings from the recordings beside a model.
//! - [`repair`]: what can be mended without doubt, as data.
//! - [`fix`]: a campaign written anew with that mended.
//!
//! One cause is told once: a column that a graver finding explains is not looked at again.

pub mod against;
pub mod files;
pub mod fix;
pub mod judge;
pub mod repair;
pub mod scan;

use crate::compare::Finding;

/// Every kind, the gravest first.
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

/// Findings of the files and beside a model as one list: what one of them explains is told once.
pub fn merge(files: Vec<Finding>, beside: Vec<Finding>) -> Vec<Finding> {
    let table = |finding: &Finding| {
        let name = finding.place.file.file_name().unwrap_or_default();
        name.to_string_lossy().trim_end_matches(".gz").to_owned()
    };
    let has = |id: &str| files.iter().any(|finding| finding.id == id);
    let held = has("repeated_samples");
    let mut all: Vec<Finding> = files
        .iter()
        .filter(|finding| {
            // Kilonewtons to three digits are coarse, too, and the unit is what is wrong.
            let unit = |other: &Finding| other.id == "wrong_unit" && table(other) == table(finding);
            finding.id != "coarse_steps" || !beside.iter().any(unit)
        })
        .cloned()
        .collect();
    all.extend(beside);
    sort(&mut all);
    if held {
        // Samples that are held come late: what looks like a clock may be no more than that.
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
    ORDER
        .iter()
        .position(|other| *other == id)
        .unwrap_or(ORDER.len())
}

/// Puts the gravest first; findings of one kind stay in their order.
pub fn sort(findings: &mut [Finding]) {
    findings.sort_by_key(rank);
}
