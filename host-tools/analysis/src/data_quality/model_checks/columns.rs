//! Selects the column error that removes the residual and groups it over sensors and recordings.

use std::collections::BTreeSet;

use model_export::recordings::Campaign;
use rayon::prelude::*;

use crate::data_quality::Finding;
use crate::data_quality::model_checks::case::{Case, Names};
use crate::data_quality::model_checks::description;
use crate::data_quality::model_checks::hypothesis::{
    self, Hypothesis, Tried, axes, force_columns, of_sensors,
};

/// Minimum ratio of the mean-square residual to the noise: five in RMS.
const ABOVE_FLOOR: f64 = 25.0;
/// Minimum reduction of the mean square: no missing effect amounts to nine tenths of the signal.
const FALLS: f64 = 10.0;
/// Hypotheses whose mean squares are within this factor are equivalent.
const AS_GOOD: f64 = 4.0;

/// Accepted hypothesis of one case.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Zero-based number of the recording.
    pub recording: usize,
    /// Number of the sensor.
    pub sensor: u32,
    /// Best hypothesis.
    pub best: Tried,
    /// Equivalent hypotheses.
    pub others: Vec<Hypothesis>,
    /// Mean square of the residual as recorded, in gauss squared.
    pub before: f64,
}

/// Findings, and the recordings with column errors.
pub fn check_columns(
    campaign: &Campaign,
    names: &Names,
    cases: &[Case],
) -> (Vec<Finding>, BTreeSet<usize>) {
    let verdicts: Vec<Verdict> =
        cases.par_iter().filter_map(|case| verdict(campaign, case)).collect();
    let hit = verdicts.iter().map(|verdict| verdict.recording).collect();
    let mut groups: Vec<Vec<Verdict>> = Vec::new();
    for verdict in verdicts {
        let same = |group: &&mut Vec<Verdict>| alike(&group[0], &verdict);
        match groups.iter_mut().find(same) {
            Some(group) => group.push(verdict),
            None => groups.push(vec![verdict]),
        }
    }
    let findings = groups.iter().map(|group| description::finding(campaign, names, group));
    (findings.collect(), hit)
}

fn verdict(campaign: &Campaign, case: &Case) -> Option<Verdict> {
    if case.as_recorded < ABOVE_FLOOR * case.floor {
        return None;
    }
    let mut tried = axes(case);
    let recording = &campaign.recordings[case.recording];
    tried.extend(of_sensors(case, recording));
    tried.extend(force_columns(case, recording));
    tried.extend(hypothesis::field(case));
    tried.extend(hypothesis::forces(case));
    let least = tried.iter().map(|tried| tried.left).fold(f64::INFINITY, f64::min);
    if least * FALLS > case.as_recorded {
        return None;
    }
    // Differences below the floor are not significant.
    let as_good = AS_GOOD * least.max(case.floor);
    tried.retain(|tried| tried.left <= as_good);
    tried.sort_by(|a, b| a.cost.cmp(&b.cost).then(a.left.total_cmp(&b.left)));
    let mut tried = tried.into_iter();
    let best = tried.next()?;
    Some(Verdict {
        recording: case.recording,
        sensor: case.sensor,
        others: tried
            .filter(|other| other.cost == best.cost)
            .map(|other| other.hypothesis)
            .collect(),
        before: case.as_recorded,
        best,
    })
}

/// True for the same error at another sensor or in another recording.
fn alike(one: &Verdict, other: &Verdict) -> bool {
    use Hypothesis::{Axes, FieldUnit, ForceUnit, Forces, OfSensor};
    if one.others.is_empty() != other.others.is_empty() {
        return false;
    }
    match (&one.best.hypothesis, &other.best.hypothesis) {
        (Axes(a), Axes(b)) => a == b,
        (OfSensor(_), OfSensor(_)) => true,
        (FieldUnit(a), FieldUnit(b)) => hypothesis::field_unit(*a) == hypothesis::field_unit(*b),
        (ForceUnit(a), ForceUnit(b)) => {
            [0, 1].map(|i| hypothesis::force_unit(a[i]))
                == [0, 1].map(|i| hypothesis::force_unit(b[i]))
        }
        (Forces(a), Forces(b)) => {
            // Relative to the sensor's own place: f1 for f0 and f0 for f1 are the same error.
            let relative = |verdict: &Verdict, sources: &[super::hypothesis::Source]| -> Vec<_> {
                let own = |place: u32| place == verdict.sensor;
                let of = |((place, axis), sign): &super::hypothesis::Source| {
                    (own(*place), *axis, *sign < 0.0)
                };
                sources.iter().map(of).collect()
            };
            relative(one, a) == relative(other, b)
        }
        _ => false,
    }
}
