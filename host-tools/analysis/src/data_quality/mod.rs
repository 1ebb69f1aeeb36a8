//! Data-quality checks of a campaign: setup errors are reported before a model is evaluated.
//!
//! - [`scan`]: one tolerant pass over every file, in constant memory.
//! - [`checks`]: findings from the files alone.
//! - [`model_checks`]: findings that need a model's prediction.
//! - [`campaign_checks`]: findings from the aligned recordings together.
//! - [`evidence`]: what a check found.
//! - [`finding`], [`fix`]: a setup error, and its unambiguous correction.
//! - [`corrected_copy`]: writing a corrected campaign.
//!
//! Each cause is reported once: later checks skip the columns that an earlier finding explains.

pub mod campaign_checks;
pub mod checks;
pub mod corrected_copy;
pub mod evidence;
pub mod finding;
pub mod fix;
pub mod model_checks;
pub mod scan;

use std::path::Path;

use anyhow::Result;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::stop;
use rayon::prelude::*;

use crate::data_quality::checks::{CheckContext, Found, clock, columns, lines, wraps};
pub use crate::data_quality::finding::Finding;
use crate::data_quality::model_checks::column_findings::column_errors;
use crate::data_quality::model_checks::{ModelResiduals, SensorPrediction};
use crate::data_quality::scan::RecordingScan;

/// Search for one setup error, in the files alone, against a model, or both.
struct Check {
    id: &'static str,
    in_files: Option<for<'a> fn(&CheckContext<'a>) -> Vec<Found<'a>>>,
    /// Receives the identifier.
    against_model: Option<for<'a> fn(&ModelResiduals<'a>, &str) -> Vec<Found<'a>>>,
}

/// All checks, most severe first: a check skips the columns that an earlier one explains.
const CHECKS: [Check; 20] = {
    const fn files(
        id: &'static str,
        check: for<'a> fn(&CheckContext<'a>) -> Vec<Found<'a>>,
    ) -> Check {
        Check { id, in_files: Some(check), against_model: None }
    }
    const fn columns(id: &'static str) -> Check {
        Check { id, in_files: None, against_model: Some(column_errors) }
    }
    [
        files("clock_backwards", clock::backwards),
        files("duplicate_rows", clock::duplicates),
        Check { in_files: Some(columns::wrong_units), ..columns("wrong_unit") },
        columns("axis_permuted"),
        columns("axis_flipped"),
        columns("force_swapped"),
        columns("force_flipped"),
        files("stuck_channel", columns::stuck_channels),
        files("wrapped", wraps::wrapped),
        files("saturated", columns::saturation),
        Check { id: CLOCK_OFFSET, in_files: None, against_model: None },
        Check {
            id: "clock_skew",
            in_files: None,
            against_model: Some(|residuals, _| model_checks::clock::offsets(residuals)),
        },
        files("clock_unit", clock::units),
        files("clock_gap", clock::gaps),
        files("coarse_steps", columns::coarse_steps),
        files("repeated_samples", clock::repeated_samples),
        files("outlier", columns::outliers),
        files("spectral_line", lines::spectral_lines),
        files("missing_temperature", columns::missing_temperatures),
        files("constant_covariate", columns::constant_covariates),
    ]
};

/// Offset and rate of clocks, found without a model.
const CLOCK_OFFSET: &str = "clock_offset";

/// Merges findings from the files and from the model checks and removes consequences of the same cause.
pub fn merge(files: Vec<Finding>, model_checks: Vec<Finding>) -> Vec<Finding> {
    let table = |finding: &Finding| {
        let name = finding.place.file.file_name().unwrap_or_default();
        name.to_string_lossy().trim_end_matches(".gz").to_owned()
    };
    let mut all: Vec<Finding> = files
        .iter()
        .filter(|finding| {
            // Forces in kilonewtons with three digits are coarse too; the wrong unit is the cause.
            let unit = |other: &Finding| other.id == "wrong_unit" && table(other) == table(finding);
            finding.id != "coarse_steps" || !model_checks.iter().any(unit)
        })
        .cloned()
        .collect();
    // A model that was fitted to misaligned recordings shows the rest of their offsets only.
    let is_misaligned = files.iter().any(|finding| finding.id == CLOCK_OFFSET);
    all.extend(
        model_checks.into_iter().filter(|finding| !(is_misaligned && finding.id == "clock_skew")),
    );
    all.sort_by_key(|finding| match finding.id {
        // Repeated samples delay the field, which looks like a clock offset.
        "repeated_samples" => (rank("clock_skew"), 0),
        id => (rank(id), 1),
    });
    all
}

/// Position in the order of severity.
fn rank(id: &str) -> usize {
    CHECKS.iter().position(|check| check.id == id).unwrap_or(CHECKS.len())
}

/// Scans every recording of the campaign in `folder` once and returns its findings, most severe first.
/// Errors of the strict reader (text in a number, a missing file) are skipped here, since the reader
/// reports them. `read` is called once for each recording, from any thread.
///
/// # Errors
/// The folder holds no recordings.
pub fn scan_files(
    folder: &Path,
    alignment: Alignment,
    read: impl Fn(&str) + Sync,
) -> Result<Vec<Finding>> {
    let folders = recording_folders(folder)?;
    let recordings: Vec<RecordingScan> = folders
        .par_iter()
        .map(|folder| {
            stop::check();
            let scan = RecordingScan::read(folder, folders.len());
            read(&scan.name);
            scan
        })
        .collect();
    let mut context = CheckContext::new(&recordings);
    for Check { id, in_files, .. } in CHECKS {
        stop::check();
        let found = match in_files {
            Some(check) => check(&context),
            None if id == CLOCK_OFFSET => {
                checks::alignment::offsets(&context, 1e-6 * alignment.delay_us)
            }
            None => Vec::new(),
        };
        context.add(id, found);
    }
    Ok(context.into_findings())
}

/// Column and clock errors of a campaign that was read with this alignment, most severe first.
pub fn check_against_model(
    campaign: &Campaign,
    alignment: Alignment,
    sensors: &[SensorPrediction],
) -> Vec<Finding> {
    let residuals = ModelResiduals::new(campaign, alignment, sensors);
    let checks = CHECKS.iter().filter_map(|check| Some((check.id, check.against_model?)));
    let found = checks.flat_map(|(id, check)| {
        check(&residuals, id).into_iter().map(move |found| found.finding(id))
    });
    found.collect()
}
