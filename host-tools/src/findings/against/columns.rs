//! The one exchange of columns that mends the residual, told for all sensors and recordings together.

use std::collections::BTreeSet;

use model_export::recordings::Campaign;
use rayon::prelude::*;

use super::case::Case;
use super::force_columns::force_columns;
use super::hypothesis::{Hypothesis, Tried, axes, of_sensors};
use super::names::Names;
use super::{scales, words};
use crate::compare::Finding;

/// As recorded, the residual's square must be this many times what noise leaves: five times in RMS.
const ABOVE_FLOOR: f64 = 25.0;
/// The square must fall at least this many times: no missing effect is nine tenths of the signal.
const FALLS: f64 = 10.0;
/// Two that leave squares within this factor cannot be told apart: a model is not exact.
const AS_GOOD: f64 = 4.0;

/// What is wrong with one case.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Number of the recording.
    pub recording: usize,
    /// Number of the sensor.
    pub sensor: u32,
    /// What is meant.
    pub best: Tried,
    /// What does as well.
    pub others: Vec<Hypothesis>,
    /// Mean square as recorded, in gauss squared.
    pub before: f64,
}

/// The findings, and the recordings that they hit.
pub fn judge(
    campaign: &Campaign,
    names: &Names,
    cases: &[Case],
) -> (Vec<Finding>, BTreeSet<usize>) {
    let verdicts: Vec<Verdict> = cases
        .par_iter()
        .filter_map(|case| verdict(campaign, case))
        .collect();
    let hit = verdicts.iter().map(|verdict| verdict.recording).collect();
    let mut groups: Vec<Vec<Verdict>> = Vec::new();
    for verdict in verdicts {
        let same = |group: &&mut Vec<Verdict>| alike(&group[0], &verdict);
        match groups.iter_mut().find(same) {
            Some(group) => group.push(verdict),
            None => groups.push(vec![verdict]),
        }
    }
    let findings = groups
        .iter()
        .map(|group| words::tell(campaign, names, group));
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
    tried.extend(scales::field(case));
    tried.extend(scales::forces(case));
    let least = tried
        .iter()
        .map(|tried| tried.left)
        .fold(f64::INFINITY, f64::min);
    if least * FALLS > case.as_recorded {
        return None;
    }
    // Below the floor nothing is told apart.
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

/// True for the same mistake at another sensor or in another recording.
fn alike(one: &Verdict, other: &Verdict) -> bool {
    use Hypothesis::{Axes, FieldUnit, ForceUnit, Forces, OfSensor};
    if one.others.is_empty() != other.others.is_empty() {
        return false;
    }
    match (&one.best.hypothesis, &other.best.hypothesis) {
        (Axes(a), Axes(b)) => a == b,
        (OfSensor(_), OfSensor(_)) => true,
        (FieldUnit(a), FieldUnit(b)) => scales::field_unit(*a) == scales::field_unit(*b),
        (ForceUnit(a), ForceUnit(b)) => {
            [0, 1].map(|i| scales::force_unit(a[i])) == [0, 1].map(|i| scales::force_unit(b[i]))
        }
        (Forces(a), Forces(b)) => {
            // Relative to the sensor's own place: f1 in place of f0 and f0 in place of f1 are one.
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
