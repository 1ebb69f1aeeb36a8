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

/// Puts the gravest first; findings of one kind stay in their order.
pub fn sort(findings: &mut [Finding]) {
    findings.sort_by_key(|finding| {
        ORDER
            .iter()
            .position(|id| *id == finding.id)
            .unwrap_or(ORDER.len())
    });
}
