//! The result of a diagnosis.

use anyhow::{Context, Result};
use model_export::effects::{EffectTerm, find};
use model_export::fit::joint::JointFit;
use model_export::fit::polynomial::HigherDegree;
use model_export::fit::recording_differences::DifferenceCause;
use model_export::inverse::device_support::DeviceSupport;
use model_export::recordings::Campaign;
use model_export::recordings::mapping::ATTITUDE_COLUMNS;
use serde::Serialize;

use crate::compare::{EffectOrigin, ForceError};
use crate::data_quality::evidence::Evidence;
use crate::data_quality::finding::Finding;
use crate::diagnose::fitted_model::WorstAxis;
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::recording_differences;
use crate::diagnose::recording_plan::RecordingProposal;
use crate::diagnose::remaining_structure::RemainingStructure;
use crate::diagnose::selection::DroppedStep;
use crate::diagnose::shapes::EffectShape;
use crate::diagnose::verdict::{Unexplained, Verdict};
use crate::noise_floor::NoiseSummary;

#[derive(Clone, Debug, Default)]
pub struct Diagnosis {
    /// The model's file.
    pub model: String,
    /// The campaign's folder.
    pub campaign: String,
    /// Setup errors in the recordings; if one stops the diagnosis, everything else is empty.
    pub findings: Vec<Finding>,
    /// A verdict on each candidate, sorted by kind and gain.
    pub verdicts: Vec<Verdict>,
    /// Steps that were accepted and dropped again, in this order.
    pub dropped: Vec<DroppedStep>,
    /// Accepted steps, each one effect or several equivalent ones; the effects of formulas last.
    pub accepted: Vec<Vec<String>>,
    /// Formulas of the covariates that explain what no effect of the catalogue does.
    pub formulas: Vec<DiscoveredFormula>,
    /// Formulas that explain as much as the accepted effects together.
    pub equivalent_formulas: Vec<DiscoveredFormula>,
    /// Whether the device compensates the accepted effects, those equivalent to them, and the formulas.
    pub device: Vec<DeviceSupport>,
    /// Residual structure that no effect explains, largest share first.
    pub unexplained: Vec<Unexplained>,
    /// What of the residual follows no covariate; none at the noise floor.
    pub remaining: Option<RemainingStructure>,
    /// Degree of the polynomial that describes the forces clearly better than that of the model.
    pub higher_degree: Option<HigherDegree>,
    /// Offsets of sensors that are confounded with an accepted effect.
    pub confounded_offsets: Option<ConfoundedOffsets>,
    /// The axis with the largest error of the last model, in its noise floors.
    pub worst_axis: Option<WorstAxis>,
    /// True if the residual is indistinguishable from noise.
    pub at_floor: bool,
    /// Noise of the recordings, and how it was estimated.
    pub noise: NoiseSummary,
    /// Cross-validated error after every step.
    pub staircase: Vec<StaircaseStep>,
    /// Effects of the last step whose error is not one of the device's model.
    pub origins: Vec<EffectOrigin>,
    /// Residual removed by each step, in order.
    pub shapes: Vec<EffectShape>,
    /// Proposed recording for what is open, where it was asked for.
    pub proposal: Option<RecordingProposal>,
    /// Suggested next command.
    pub next: Suggestion,
    /// True if it was ended early: candidates and formulas that would have been tried later are missing.
    pub is_interrupted: bool,
    /// True if the effects explain the residual except noise; otherwise names are provisional.
    pub is_complete: bool,
    /// Rows of all sensors by which effects were selected, and all rows, to which the models were fitted.
    pub rows: [usize; 2],
    /// Recordings by which effects were selected, and all recordings.
    pub recordings: [usize; 2],
    /// Number of bootstrap blocks.
    pub blocks: usize,
    /// Length of a block in seconds.
    pub block_s: f64,
    /// Seed of the bootstrap.
    pub seed: u64,
}

impl Diagnosis {
    /// Whether the effects were sought on recordings without the other places of their magnets.
    pub fn is_without_places(&self) -> bool {
        self.findings.iter().any(|finding| match &finding.evidence {
            Evidence::RecordingDifference { cause, floors, .. } => {
                *cause == DifferenceCause::MagnetPlace
                    && recording_differences::explains_all(*floors)
            }
            _ => false,
        })
    }

    /// Sorts the verdicts by their kind, then by the force error that they leave, then by the error of the field.
    pub(super) fn sort_verdicts(&mut self) {
        let key = |verdict: &Verdict| {
            let excess_n = verdict.excess_n.unwrap_or(f64::INFINITY);
            let gain = if verdict.gain.is_nan() { f64::NEG_INFINITY } else { verdict.gain };
            (verdict.kind, excess_n, -gain)
        };
        self.verdicts.sort_by(|a, b| {
            let ((kind, excess_n, gain), (other, other_n, other_gain)) = (key(a), key(b));
            let by_error = excess_n.total_cmp(&other_n).then(gain.total_cmp(&other_gain));
            kind.cmp(&other).then(by_error)
        });
    }

    /// Name of each accepted step with its effects: the first of several equivalent ones, and all of a formula.
    ///
    /// # Errors
    /// A step is neither of the catalogue nor a discovered formula.
    pub fn accepted_steps(&self) -> Result<Vec<(String, Vec<EffectTerm>)>> {
        let steps = if self.accepted.is_empty() { &[] } else { self.staircase.as_slice() };
        let terms = |step: &StaircaseStep| {
            let first = step.added.first().context("an empty step")?;
            let terms = match self.formulas.iter().find(|formula| formula.name == *first) {
                Some(formula) => formula.effects.clone(),
                None => vec![EffectTerm::Catalogue(find(first)?)],
            };
            Ok((step.added.join(" or "), terms))
        };
        steps.iter().skip(1).map(terms).collect()
    }
}

/// Error after a step of the selection.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StaircaseStep {
    /// Added effects; empty for the first step.
    pub added: Vec<String>,
    /// Free parameters of the model at one sensor.
    pub parameters: usize,
    /// Cross-validated error over all channels, in gauss.
    pub held_out_rms_g: f64,
    /// Held-out force error; `None` where the device cannot compute the forces, or the diagnosis was ended early.
    pub force: Option<ForceError>,
    /// Noise floor in gauss.
    pub floor_g: f64,
}

/// Offsets of sensors that are confounded with the ambient field of an effect in these recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConfoundedOffsets {
    pub sensors: Vec<u32>,
    /// Range of roll, pitch and yaw in degrees.
    pub range_deg: [f64; 3],
}

impl ConfoundedOffsets {
    /// Of a fit to a campaign; `None` where the offsets are determined.
    pub fn of(campaign: &Campaign, fit: &JointFit) -> Option<Self> {
        let confounded = fit.sensors.iter().filter(|fit| fit.offset_confounded);
        let sensors: Vec<u32> = confounded.map(|fit| fit.sensor).collect();
        if sensors.is_empty() {
            return None;
        }
        let range_deg = ATTITUDE_COLUMNS.map(|name| {
            let values = || campaign.recordings.iter().filter_map(|r| r.covariates.get(name));
            let low = values().flatten().copied().fold(f64::INFINITY, f64::min);
            let high = values().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
            (high - low).to_degrees()
        });
        Some(Self { sensors, range_deg })
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SuggestionKind {
    /// No suggestion.
    #[default]
    None,
    /// Add the accepted effects.
    AddEffects,
    /// Separate equivalent effects, or add one of them.
    ChooseEffect,
    /// Fit with the clocks aligned.
    AlignClocks,
    /// Correct what differs between the recordings, and fit the copy.
    CorrectRecordings,
    /// Fit a polynomial of a higher degree.
    RaiseDegree,
    /// Export the model.
    Export,
    /// Replay a model that was fitted to other recordings, before it is used.
    Replay,
    /// Test a formula of a covariate.
    TestFormula,
    /// Inspect the residual.
    Compare,
}

/// Suggestion for the next step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Suggestion {
    pub kind: SuggestionKind,
    /// Alternative commands; those of a correction one after the other.
    pub commands: Vec<String>,
}
