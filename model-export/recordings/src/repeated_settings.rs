//! Pure error: the scatter of rows with equal forces and covariates, within a recording and between recordings.
//!
//! It holds whatever the model, and is the noise of a table of settings, whose successive rows differ by more than noise (NIST/SEMATECH
//! e-Handbook of Statistical Methods, 4.6.1 and 4.4.4.6).

use std::cmp::Ordering;
use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::Recording;
use crate::noise_estimate::{NoiseEstimate, NoiseEstimator};
use crate::noise_model::{root_mean, set_total};

/// Degrees of freedom of repeated settings, and their number, at least.
const MIN_REPEATS: (usize, usize) = (8, 5);
/// Rounds in which settings and offsets of recordings are fitted in turn.
const ROUNDS: usize = 50;

/// A row of a recording.
type Place = (usize, usize);
/// Recording and field of each row of a setting.
type Fields = Vec<(usize, Vector3<f64>)>;
/// Standard deviation of each axis in gauss, of each sensor.
type Scatter = Vec<(u32, Vector3<f64>)>;

/// Pure error of a designed recording: at least half of its rows repeat a setting, and none of them fills a quarter of it, as a rest in a
/// time series does.
pub fn within(recording: &mut Recording) -> Option<NoiseEstimate> {
    let settings = settings(std::slice::from_ref(recording))?;
    let longest = settings.iter().map(Vec::len).max().unwrap_or(0);
    if 4 * longest > recording.time_s.len() {
        return None;
    }
    let (estimate, found) = pure_error(std::slice::from_ref(recording), &settings)?;
    set_total(recording, &found);
    Some(estimate)
}

/// Sets the pure error of recordings without a clock that repeat one set of settings, each with an offset of its own, where no recording
/// repeats its settings.
pub fn between(recordings: &mut [Recording]) {
    let is_table = |recording: &Recording| {
        recording.description.is_clock_assumed()
            && recording.noise.estimator != NoiseEstimator::Repeats
    };
    if recordings.len() < 2 || !recordings.iter().all(is_table) {
        return;
    }
    let Some((estimate, found)) =
        settings(recordings).and_then(|settings| pure_error(recordings, &settings))
    else {
        return;
    };
    for recording in recordings {
        set_total(recording, &found);
        recording.noise = NoiseEstimate {
            unit: recording.noise.unit,
            covariates: std::mem::take(&mut recording.noise.covariates),
            correlation_s: recording.noise.correlation_s,
            order: recording.noise.order,
            ..estimate.clone()
        };
    }
}

/// Scatter of the repeated rows about a mean of each setting and an offset of each recording, with that of each sensor in gauss; `None`
/// with too few of them.
fn pure_error(
    recordings: &[Recording],
    settings: &[Vec<Place>],
) -> Option<(NoiseEstimate, Scatter)> {
    let rows: usize = recordings.iter().map(|recording| recording.time_s.len()).sum();
    let (mut floors2, mut found) = (Vec::new(), Vec::new());
    for &sensor in recordings.first()?.sensors.keys() {
        let field = |&(recording, row): &Place| {
            let field_g = recordings[recording].sensors.get(&sensor)?.field_g.get(row)?;
            let is_finite = field_g.iter().all(|b| b.is_finite());
            is_finite.then(|| (recording, Vector3::from(*field_g)))
        };
        let of_setting = |places: &Vec<Place>| places.iter().filter_map(field).collect::<Vec<_>>();
        let repeated: Vec<Fields> =
            settings.iter().map(of_setting).filter(|fields| fields.len() > 1).collect();
        let used: usize = repeated.iter().map(Vec::len).sum();
        let mut offsets: BTreeMap<usize, Vector3<f64>> = BTreeMap::new();
        for (recording, _) in repeated.iter().flatten() {
            offsets.insert(*recording, Vector3::zeros());
        }
        let freedom = (used + 1).saturating_sub(repeated.len() + offsets.len());
        if freedom < MIN_REPEATS.0 || repeated.len() < MIN_REPEATS.1 || 2 * used < rows {
            return None;
        }
        let variance = squares(&repeated, &mut offsets) / freedom as f64;
        floors2.push(variance.sum() / 3.0);
        found.push((sensor, variance.map(f64::sqrt)));
    }
    let estimate = NoiseEstimate {
        estimator: NoiseEstimator::Repeats,
        floors_g: vec![(NoiseEstimator::Repeats, root_mean(&floors2)?)],
        sample_rows: 1,
        ..NoiseEstimate::default()
    };
    Some((estimate, found))
}

/// Squares about means of settings and offsets of recordings, which are fitted in turn.
fn squares(settings: &[Fields], offsets: &mut BTreeMap<usize, Vector3<f64>>) -> Vector3<f64> {
    let rounds = if offsets.len() > 1 { ROUNDS } else { 1 };
    let mut squares = Vector3::zeros();
    for _ in 0..rounds {
        squares = Vector3::zeros();
        let mut moved: BTreeMap<usize, (Vector3<f64>, f64)> = BTreeMap::new();
        for fields in settings {
            let left =
                || fields.iter().map(|(recording, field)| (recording, field - offsets[recording]));
            let mean = left().map(|(_, b)| b).sum::<Vector3<f64>>() / fields.len() as f64;
            for (recording, field) in left() {
                let deviation = field - mean;
                squares += deviation.component_mul(&deviation);
                let (sum, rows) = moved.entry(*recording).or_default();
                *sum += deviation;
                *rows += 1.0;
            }
        }
        if offsets.len() > 1 {
            for (recording, (sum, rows)) in moved {
                offsets.entry(recording).and_modify(|offset| *offset += sum / rows);
            }
        }
    }
    squares
}

/// Rows with equal forces and covariates, bit by bit; `None` without columns.
fn settings(recordings: &[Recording]) -> Option<Vec<Vec<Place>>> {
    let columns: Vec<Vec<&Vec<f64>>> = recordings.iter().map(columns).collect();
    if columns.first()?.is_empty() {
        return None;
    }
    let key = |place: &Place| {
        let row = place.1;
        columns[place.0].iter().map(move |column| column.get(row).copied())
    };
    let mut places: Vec<Place> = recordings
        .iter()
        .enumerate()
        .flat_map(|(place, recording)| (0..recording.time_s.len()).map(move |row| (place, row)))
        .collect();
    places.sort_by(|a, b| key(a).partial_cmp(key(b)).unwrap_or(Ordering::Equal));
    Some(places.chunk_by(|a, b| key(a).eq(key(b))).map(<[Place]>::to_vec).collect())
}

/// Forces and covariates.
fn columns(recording: &Recording) -> Vec<&Vec<f64>> {
    let forces = recording.forces.values().map(|force| &force.newtons);
    forces.chain(recording.covariates.values()).collect()
}
