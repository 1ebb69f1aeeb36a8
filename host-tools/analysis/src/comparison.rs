//! From files to a [`Comparison`]: the setup errors of the files, against the model and between the recordings, then the errors of
//! the model.

use std::path::Path;

use anyhow::Result;
use model_export::fit::FitOptions;
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;

use crate::compare::Comparison;
use crate::compare::campaign_reader::{Caching, CampaignReader, ScannedCampaign};
use crate::compare::pipeline::{compare_scanned, setup_errors_of};
use crate::data_quality::Finding;
use crate::diagnose::recording_differences;

/// Compares the model at `path`, and the one at `other` on the same rows, with a campaign.
///
/// # Errors
/// A file cannot be read, or model and recordings do not match.
pub fn compare(
    path: &Path,
    campaign: &Path,
    other: Option<&Path>,
    alignment: Alignment,
    options: FitOptions,
) -> Result<Comparison> {
    let model = ModelFile::read(path)?;
    let scanned = ScannedCampaign::open(campaign, alignment, Caching::IfFew)?;
    let findings = with_differences(&scanned, &model, path, options)?;
    compare_scanned((path, &model), other, (scanned, findings), None, options)
}

/// Setup errors of a campaign, from its files, from the predictions of the model at `path`, and by what differs between recordings.
///
/// # Errors
/// A file cannot be read.
pub fn setup_errors(
    path: &Path,
    campaign: &Path,
    alignment: Alignment,
    options: FitOptions,
) -> Result<Vec<Finding>> {
    let model = ModelFile::read(path)?;
    let scanned = ScannedCampaign::open(campaign, alignment, Caching::IfFew)?;
    with_differences(&scanned, &model, path, options)
}

/// Setup errors of files and model, and what differs between the recordings of a campaign in memory, if nothing else stops an
/// evaluation.
fn with_differences(
    scanned: &ScannedCampaign,
    model: &ModelFile,
    path: &Path,
    options: FitOptions,
) -> Result<Vec<Finding>> {
    let mut findings = setup_errors_of(scanned, model, path)?;
    let is_stopped = findings.iter().any(|finding| finding.stops);
    let campaign = scanned.reader.as_ref().and_then(CampaignReader::cached);
    if let Some(campaign) = campaign.filter(|one| !is_stopped && one.recordings.len() > 1) {
        let effects = model.effect_terms(path)?;
        findings.extend(recording_differences::next_to(campaign, model, effects, options));
    }
    Ok(findings)
}
