//! The noise of the recordings of a campaign, and how it was estimated.

use crate::numbers::signal;
use crate::statistics::pooled_rms;
use model_export::recordings::columns::SignalUnit;
use model_export::recordings::noise_estimate::{NoiseEstimate, NoiseEstimator};
use serde::Serialize;
use std::collections::BTreeMap;

/// Ratio of two estimates of one noise from which they disagree.
pub const DISAGREE: f64 = 1.3;

/// Two estimates of the same noise that differ by more than [`DISAGREE`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Disagreement {
    /// Unit of both.
    #[serde(skip)]
    pub unit: SignalUnit,
    /// Rows of the estimates, in words.
    pub rows: &'static str,
    /// By the estimator that is used.
    pub used_g: f64,
    /// The other estimator, in words.
    pub other: &'static str,
    pub other_g: f64,
}

/// Noise over all recordings of a campaign.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct NoiseSummary {
    /// Unit of the floors and of all residuals of the signal.
    #[serde(skip)]
    pub unit: SignalUnit,
    /// Estimator of most recordings; `None` without an estimate.
    pub estimator: Option<NoiseEstimator>,
    /// Floor by each estimator in gauss, root mean square over the recordings.
    pub floors_g: BTreeMap<NoiseEstimator, f64>,
    /// Whether raw differences hold the motion of the load.
    pub differences_hold_motion: bool,
    /// Timing error of the reference in milliseconds, and its standard error; `None` where it is not significant.
    pub jitter_ms: Option<[f64; 2]>,
    /// Rows between independent samples of the slower table.
    pub sample_rows: usize,
    /// Estimates that disagree without a known reason.
    pub disagreement: Option<Disagreement>,
}

impl NoiseSummary {
    /// Over the estimates of all recordings.
    pub fn of<'a>(recordings: impl Iterator<Item = &'a NoiseEstimate>) -> Self {
        let mut recordings = recordings.peekable();
        let unit = recordings.peek().map_or(SignalUnit::Gauss, |one| one.unit);
        let known: Vec<&NoiseEstimate> =
            recordings.filter(|one| !one.floors_g.is_empty()).collect();
        let uses = |of: NoiseEstimator| known.iter().filter(|one| one.estimator == of).count();
        let mut floors: BTreeMap<NoiseEstimator, Vec<f64>> = BTreeMap::new();
        for (estimator, floor_g) in known.iter().flat_map(|one| &one.floors_g) {
            floors.entry(*estimator).or_default().push(*floor_g);
        }
        let jitters: Vec<[f64; 2]> = known
            .iter()
            .filter(|one| one.jitter_s.0 > 0.0)
            .map(|one| [1e3 * one.jitter_s.0, 1e3 * one.jitter_s.1])
            .collect();
        let jitter_ms = (!jitters.is_empty()).then(|| {
            let [jitter, error] = [0, 1].map(|i| pooled_rms(jitters.iter().map(|one| one[i])));
            [jitter, error / (jitters.len() as f64).sqrt()]
        });
        let mut summary = Self {
            unit,
            estimator: floors
                .keys()
                .copied()
                .max_by_key(|of| uses(*of))
                .filter(|_| !known.is_empty()),
            floors_g: floors.into_iter().map(|(of, floors)| (of, pooled_rms(floors))).collect(),
            differences_hold_motion: known.iter().any(|one| one.differences_hold_motion),
            jitter_ms,
            sample_rows: known.iter().map(|one| one.sample_rows).max().unwrap_or(1),
            disagreement: None,
        };
        summary.disagreement = summary.disagreement_of(&known);
        summary
    }

    fn disagreement_of(&self, known: &[&NoiseEstimate]) -> Option<Disagreement> {
        let differ = |a: f64, b: f64| a.max(b) > DISAGREE * a.min(b);
        let floor = |of| self.floors_g.get(&of).copied();
        let raw = floor(NoiseEstimator::Differences)?;
        let adjusted = floor(NoiseEstimator::ResidualDifferences)?;
        if self.estimator == Some(NoiseEstimator::Differences) && differ(raw, adjusted) {
            return Some(Disagreement {
                rows: "all rows",
                unit: self.unit,
                used_g: raw,
                other: NoiseEstimator::ResidualDifferences.words(),
                other_g: adjusted,
            });
        }
        let quiet: Vec<[f64; 2]> = known.iter().filter_map(|one| one.quiet_g).collect();
        let [other_g, used_g] = [0, 1].map(|i| pooled_rms(quiet.iter().map(|one| one[i])));
        (!quiet.is_empty() && differ(used_g, other_g)).then_some(Disagreement {
            rows: "rows in which the load hardly moves",
            unit: self.unit,
            used_g,
            other: "their raw differences",
            other_g,
        })
    }

    /// How the floor was estimated, in sentences.
    pub fn sentence(&self) -> String {
        let Some(estimator) = self.estimator else {
            return "The noise of these recordings is unknown: too few rows.".to_owned();
        };
        let floor = |of| self.floors_g.get(&of).map(|floor| signal(*floor, self.unit));
        let mut text = format!("The noise floor is from {}", estimator.words());
        if let Some(floor) = floor(estimator) {
            text += &format!(", {floor}");
        }
        let raw = floor(NoiseEstimator::Differences).filter(|_| self.differences_hold_motion);
        if let Some(raw) = raw {
            text += &format!(
                "; differences of the rows themselves give {raw} and hold the motion of the load"
            );
        }
        if self.sample_rows > 1 {
            text += &format!("; one table has a new sample every {} rows only", self.sample_rows);
        }
        text += ".";
        if let Some([jitter, error]) = self.jitter_ms {
            text += &format!(
                " It grows with dF/dt, as by a timing error of the reference of {jitter:.2}±{error:.2} ms (jitter of its clock, or a load that moves between the rows); rows count by their noise."
            );
        }
        text
    }
}
