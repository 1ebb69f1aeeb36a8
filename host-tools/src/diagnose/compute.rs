//! From a model and a campaign to a diagnosis.

use std::path::Path;

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::model_file::{Base, ModelFile};
use model_export::recordings::Campaign;

use super::Diagnosis;
use super::assemble::assemble;
use super::candidates::candidates;
use super::select::select;
use super::shape::shapes;

/// Diagnoses what `model` (read from `path`) lacks on `campaign`, with `own` effects of a user beside those
/// of the catalogue. `said` is told what is being done.
pub fn compute(
    campaign: &Campaign,
    model: &ModelFile,
    path: &Path,
    own: &[Addition],
    options: Options,
    said: &dyn Fn(&str),
) -> Result<Diagnosis> {
    let prepared = match model.base {
        Base::Cylinder => Prepared::cylinder(campaign)?,
        Base::Polynomial => Prepared::polynomial(campaign, model.degree(), options)?,
    };
    let present: Vec<Addition> = model.additions(path)?;
    let (judged, unjudged) = candidates(campaign, model.base, model.force_axes(), &present, own);
    let selection = select(campaign, &prepared, &present, &judged, options, said)?;
    let mut diagnosis = assemble(&selection, &unjudged, campaign.recordings.len());
    diagnosis.shapes = shapes(campaign, &prepared, &selection, options.seed);
    diagnosis.model = path.display().to_string();
    diagnosis.campaign = campaign.folder.display().to_string();
    diagnosis.seed = options.seed;
    Ok(diagnosis)
}
