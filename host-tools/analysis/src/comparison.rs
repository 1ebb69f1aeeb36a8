//! From files to a [`Comparison`]: the setup errors of the files, against the model and between the recordings, then the errors of
//! the model.

use std::path::Path;

use anyhow::Result;
use model_export::fit::FitOptions;
use model_export::recordings::align::Alignment;

use crate::compare::Comparison;
use crate::compare::campaign_reader::{Caching, CampaignReader};
use crate::compare::checked_campaign::CheckedCampaign;
use crate::compare::pipeline::compare_checked;
use crate::data_quality::Finding;
use crate::diagnose::recording_differences;
use crate::model::Model;

/// Compares a model, and a baseline on the same rows, with a campaign.
///
/// # Errors
/// A recording cannot be read, or model and recordings do not match.
pub fn compare(
    model: &Model,
    campaign: &Path,
    baseline: Option<&Model>,
    alignment: Alignment,
    options: FitOptions,
) -> Result<Comparison> {
    let checked = check(model, campaign, alignment, options)?;
    compare_checked(model, baseline, &checked, None, options)
}

/// Setup errors of a campaign, from its files, from the predictions of a model, and by what differs between recordings.
///
/// # Errors
/// A recording cannot be read.
pub fn setup_errors(
    model: &Model,
    campaign: &Path,
    alignment: Alignment,
    options: FitOptions,
) -> Result<Vec<Finding>> {
    Ok(check(model, campaign, alignment, options)?.findings)
}

/// A campaign with its setup errors, and with what differs between the recordings in memory, if nothing else stops an evaluation.
fn check(
    model: &Model,
    campaign: &Path,
    alignment: Alignment,
    options: FitOptions,
) -> Result<CheckedCampaign> {
    let mut checked = CheckedCampaign::open(campaign, model, alignment, Caching::IfFew)?;
    let campaign = checked.reader().and_then(CampaignReader::cached);
    if let Some(campaign) = campaign.filter(|one| one.recordings.len() > 1) {
        let differences = recording_differences::next_to(campaign, model, options);
        checked.findings.extend(differences);
    }
    Ok(checked)
}
