//! Findings on the aligned recordings of a campaign: which of them are not independent, rows without an order, and noise whose
//! estimates disagree.

use model_export::recordings::dependence::dependences;
use model_export::recordings::noise_estimate::RowOrder;
use model_export::recordings::{Campaign, Location};

use crate::data_quality::evidence::{Evidence, RecordingSet};
use crate::data_quality::finding::Finding;
use crate::noise_floor::NoiseSummary;

/// Findings of a campaign, none of which stops a result.
pub fn campaign_findings(campaign: &Campaign) -> Vec<Finding> {
    let of = |id, evidence| Finding {
        id,
        place: Location::file(&campaign.folder),
        evidence,
        stops: false,
        fix: None,
    };
    let recordings = |places: Vec<usize>| {
        RecordingSet::of(places, campaign.recordings.iter().map(|recording| &recording.name))
    };
    let dependent = dependences(campaign).into_iter().map(|one| {
        let evidence = Evidence::DependentRecordings {
            kind: one.kind,
            recordings: recordings(one.recordings),
            share: one.share,
        };
        of("dependent_recordings", evidence)
    });
    let shuffled: Vec<usize> = (0..campaign.recordings.len())
        .filter(|&place| campaign.recordings[place].noise.order == RowOrder::Shuffled)
        .collect();
    let shuffled = (!shuffled.is_empty())
        .then(|| of("row_order", Evidence::ShuffledRows { recordings: recordings(shuffled) }));
    let noise = NoiseSummary::of(campaign.recordings.iter().map(|recording| &recording.noise));
    let noise = noise.disagreement.map(|one| of("noise_floor", Evidence::NoiseDisagreement(one)));
    dependent.chain(shuffled).chain(noise).collect()
}

/// Whether a finding of constant covariates names one that was set anew for each row.
pub fn is_of_set_covariates(finding: &Finding, campaign: &Campaign) -> bool {
    let Evidence::ConstantCovariates { columns, .. } = &finding.evidence else { return false };
    let follows = |name: &str| {
        let name = if name.ends_with("_temp_c") { "temp_c" } else { name };
        campaign.recordings.iter().any(|recording| recording.is_set_by_row(name))
    };
    columns.iter().all(|(name, _)| follows(name))
}
