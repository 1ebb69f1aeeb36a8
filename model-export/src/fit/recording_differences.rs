//! Differences between recordings that no effect of the catalogue makes: a zero of the reference that was set again, another offset
//! of the field, another place of a magnet. (Another gain is that of a magnet that lost remanence, which is an effect.)
//!
//! A fitted model is linearised at its solution, and each cause gets a coefficient for each recording but the first. A cause counts where it lowers the error of rows that the regression did not use, and where its
//! coefficients scatter little within a recording: noise that wanders differs as much from one part of a recording to the next.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Vector3};
use rayon::prelude::*;

use crate::effects::EffectTerm;
use crate::fit::campaign::FitSetup;
use crate::fit::linearisation::{
    Linearisation, RecordingNormals, held_out_residuals, least_residual,
};
use crate::fit::problem::SensorProblem;
use crate::fit::rows::SensorRows;
use crate::fit::score_test::CandidateScore;
use crate::physics::FieldResponse;
use crate::recordings::columns::Axis;

const PARTS: usize = 4;
/// Rows of a part, at least.
const LEAST_ROWS: usize = 8;
/// Residual in noise floors from which recordings are compared.
const MIN_FLOORS: f64 = 1.03;
/// Minimum share of the error above the noise that a cause removes.
const MIN_SHARE: f64 = 0.2;
/// Share of the squares that a cause explains next to a candidate, relative to those without it, up to which they explain the same.
const SHARED: f64 = 0.5;
/// A candidate explains as much as a cause if it leaves at most this multiple of what the cause leaves above the noise.
const AS_GOOD: f64 = 2.0;
/// Squared residual above the noise that is nothing, relative to the noise.
const NEGLIGIBLE: f64 = 0.05;
/// Held-out squared residuals within this factor are equal.
const EQUAL: f64 = 1.02;
/// Standard errors of a difference, by its scatter within the recordings, from which it is one.
const SIGMAS: f64 = 6.0;
/// The same of the largest difference of a cause: the parts of a recording are not independent where noise wanders.
const CLEAR_SIGMAS: f64 = 12.0;

/// What differs between recordings. In the order of preference: of those that explain as much, the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DifferenceCause {
    /// Zero of the reference at the sensor's own place, in newtons.
    ReferenceZero,
    /// Offset of the field, in gauss.
    FieldZero,
    /// Place of the magnet at the sensor, in micrometres; with the cylinder base only.
    MagnetPlace,
}

impl DifferenceCause {
    const ALL: [Self; 3] = [Self::ReferenceZero, Self::FieldZero, Self::MagnetPlace];

    /// As a noun.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ReferenceZero => "the zero of the reference",
            Self::FieldZero => "the offset of the field",
            Self::MagnetPlace => "the place of the magnet",
        }
    }

    /// Unit of the coefficients.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::ReferenceZero => "N",
            Self::FieldZero => "G",
            Self::MagnetPlace => "um",
        }
    }

    /// Change of the field in gauss per unit.
    fn slope(self, axis: Axis, response: &FieldResponse, stiffness: [f64; 2]) -> Vector3<f64> {
        let place = axis as usize;
        match self {
            // A reference that reads more than the force: the field is that of less.
            Self::ReferenceZero => {
                -response.per_mm.column(place) / stiffness[usize::from(axis == Axis::Z)]
            }
            Self::FieldZero => Vector3::ith(place, 1.0),
            Self::MagnetPlace => 1e-3 * response.per_mm.column(place),
        }
    }
}

/// A coefficient of a cause.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Number of the sensor.
    pub sensor: u32,
    /// Place of the recording in the campaign.
    pub recording: usize,
    /// Component: of the field in the gripper's axes, of the force, or of the displacement.
    pub axis: Axis,
    /// Against the first recording, in [`DifferenceCause::unit`].
    pub value: f64,
    /// Its standard error, by the scatter within the recordings.
    pub std_error: f64,
}

/// A cause by which recordings differ.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingDifference {
    /// The cause.
    pub cause: DifferenceCause,
    /// Its significant coefficients.
    pub differences: Vec<Difference>,
    /// Other causes that explain as much.
    pub equivalent: Vec<DifferenceCause>,
    /// Places of the candidates that explain as much.
    pub candidates: Vec<usize>,
    /// Residual without and with it, in noise floors.
    pub floors: [f64; 2],
}

/// One linearised sensor.
struct Sensor<'a> {
    rows: &'a SensorRows,
    linearisation: Linearisation,
    stiffness: [f64; 2],
    /// Whether the base is that of a magnet.
    has_magnet: bool,
    /// Weights of each row's axes.
    weights: Vec<Vector3<f64>>,
    /// Fixed columns and target, by parts of the recordings.
    normals: RecordingNormals,
    /// Recording of each part, and its rows in the linearisation.
    parts: Vec<(usize, Range<usize>)>,
}

impl<'a> Sensor<'a> {
    fn new(problem: &SensorProblem<'a>, values: &[f64], has_magnet: bool) -> Self {
        let linearisation = Linearisation::at_solution(problem, values);
        let places: Vec<(usize, usize)> = linearisation.places().collect();
        let mut parts = Vec::new();
        let mut start = 0;
        for run in places.chunk_by(|a, b| a.0 == b.0) {
            let ends = (1..=PARTS).map(|part| start + part * run.len() / PARTS);
            let mut from = start;
            for end in ends {
                parts.push((run[0].0, from..end));
                from = end;
            }
            start += run.len();
        }
        let ends: Vec<usize> = parts.iter().map(|(_, rows)| 3 * rows.end).collect();
        let normals = RecordingNormals::new(
            linearisation.fixed().clone(),
            linearisation.residual().clone(),
            &ends,
        );
        let weights = places.iter().map(|&(part, row)| problem.row_weights(part, row)).collect();
        let stiffness = problem.base.stiffness(values);
        Self { rows: problem.rows, linearisation, stiffness, has_magnet, weights, normals, parts }
    }

    /// Components of a cause; none where it cannot be tested.
    fn components(&self, cause: DifferenceCause) -> Vec<Axis> {
        match cause {
            DifferenceCause::ReferenceZero => {
                let own = self.rows.forces.iter().filter(|(place, _)| *place == self.rows.sensor);
                own.map(|(_, axis)| *axis).collect()
            }
            DifferenceCause::MagnetPlace if !self.has_magnet => Vec::new(),
            DifferenceCause::FieldZero | DifferenceCause::MagnetPlace => Axis::ALL.to_vec(),
        }
    }

    /// Weighted columns of a cause's components over all rows.
    fn patterns(&self, cause: DifferenceCause) -> Vec<DVector<f64>> {
        let of = |axis: &Axis| {
            let rows = self.linearisation.responses().zip(&self.weights);
            let entries: Vec<f64> = rows
                .flat_map(|((_, _, response), weights)| {
                    let slope = cause.slope(*axis, response, self.stiffness);
                    <[f64; 3]>::from(slope.component_mul(weights))
                })
                .collect();
            DVector::from_vec(entries)
        };
        self.components(cause).iter().map(of).collect()
    }

    /// Columns of each component on these groups of rows.
    fn columns(&self, patterns: &[DVector<f64>], groups: &[Vec<Range<usize>>]) -> DMatrix<f64> {
        let values = self.linearisation.residual().len();
        let mut columns = DMatrix::zeros(values, patterns.len() * groups.len());
        for (group, ranges) in groups.iter().enumerate() {
            for (component, pattern) in patterns.iter().enumerate() {
                let mut column = columns.column_mut(group * patterns.len() + component);
                for rows in ranges {
                    let (from, count) = (3 * rows.start, 3 * rows.len());
                    column.rows_mut(from, count).copy_from(&pattern.rows(from, count));
                }
            }
        }
        columns
    }

    /// Rows of each recording but the first.
    fn later(&self) -> Vec<Vec<Range<usize>>> {
        let recordings = self.parts.chunk_by(|a, b| a.0 == b.0).skip(1);
        recordings.map(|parts| parts.iter().map(|(_, rows)| rows.clone()).collect()).collect()
    }

    fn tried(&self, cause: DifferenceCause) -> Tried {
        let patterns = self.patterns(cause);
        let columns = self.columns(&patterns, &self.later());
        let with = self.normals.with(&columns);
        let each: Vec<Vec<Range<usize>>> =
            self.parts.iter().skip(1).map(|(_, rows)| vec![rows.clone()]).collect();
        let by_part = self.normals.with(&self.columns(&patterns, &each));
        let first = self.normals.fixed().ncols();
        let (_, values) = least_residual(&by_part);
        // Of the first part they are zero.
        let values = std::iter::repeat_n(0.0, patterns.len()).chain(values.into_iter().skip(first));
        Tried { held_out: held_out_residuals(&with), values: values.collect(), columns }
    }

    /// Significant differences of a cause between the recordings, with their standard errors.
    fn differences(&self, cause: DifferenceCause, tried: &Tried) -> Vec<Difference> {
        let components = self.components(cause);
        let count = components.len();
        let recordings: Vec<usize> =
            self.parts.chunk_by(|a, b| a.0 == b.0).map(|parts| parts[0].0).collect();
        let mut found = Vec::new();
        for (component, axis) in components.into_iter().enumerate() {
            let values: Vec<f64> =
                tried.values.iter().skip(component).step_by(count).copied().collect();
            let groups: Vec<&[f64]> = values.chunks(PARTS).collect();
            let means: Vec<f64> =
                groups.iter().map(|group| group.iter().sum::<f64>() / PARTS as f64).collect();
            let squares: f64 = groups
                .iter()
                .zip(&means)
                .flat_map(|(group, mean)| group.iter().map(move |value| (value - mean).powi(2)))
                .sum();
            let free = (groups.len() * (PARTS - 1)) as f64;
            // Of the difference of two means.
            let std_error = (2.0 * squares / free / PARTS as f64).sqrt();
            let later = recordings.iter().zip(&means).skip(1);
            let differences = later.map(|(&recording, mean)| Difference {
                sensor: self.rows.sensor,
                recording,
                axis,
                value: mean - means[0],
                std_error,
            });
            found.extend(differences.filter(|one| one.value.abs() > SIGMAS * one.std_error));
        }
        found
    }

    /// Whether there are several recordings, each with enough rows.
    fn is_long_enough(&self) -> bool {
        self.parts.len() == PARTS * self.rows.parts.len()
            && self.rows.parts.len() > 1
            && self.parts.iter().all(|(_, rows)| rows.len() >= LEAST_ROWS)
    }
}

/// A cause in the regression of one sensor.
struct Tried {
    /// Weighted squared residual of each part with the coefficients of all others.
    held_out: Vec<f64>,
    /// Coefficients of each part, component by component.
    values: Vec<f64>,
    columns: DMatrix<f64>,
}

/// Causes by which the recordings differ, the largest first, next to a model with these effects at these values of the sensors'
/// parameters. The candidates are scored next to the same model. What one of them explains as well is attributed to a cause only where
/// there is no other, and ends the list.
pub fn recording_differences(
    setup: &FitSetup,
    effects: &[EffectTerm],
    values: &[Vec<f64>],
    candidates: &[CandidateScore],
) -> Vec<RecordingDifference> {
    let mut effects = effects.to_vec();
    effects.sort_by_key(EffectTerm::stage);
    let has_magnet = setup.design.is_some();
    let mut sensors: Vec<Sensor> = setup
        .rows
        .par_iter()
        .zip(&setup.bases)
        .zip(values)
        .map(|((rows, base), values)| {
            Sensor::new(&SensorProblem::new(rows, base.as_ref(), &effects), values, has_magnet)
        })
        .collect();
    if sensors.is_empty() || !sensors.iter().all(Sensor::is_long_enough) {
        return Vec::new();
    }
    let mut found: Vec<RecordingDifference> = Vec::new();
    while let Some((mut next, columns)) = largest(&sensors, &found) {
        let places = (0..candidates.len()).into_par_iter();
        next.candidates =
            places.filter(|&place| explains(&sensors, &columns, &candidates[place])).collect();
        if !next.candidates.is_empty() {
            if found.is_empty() {
                found.push(next);
            }
            break;
        }
        for (sensor, columns) in sensors.iter_mut().zip(columns) {
            sensor.normals = sensor.normals.extended(&columns);
        }
        found.push(next);
    }
    found
}

/// What another place of a magnet changes in the field of one recording.
pub struct PlaceChange {
    /// Number of the sensor.
    pub sensor: u32,
    /// Place of the recording in the campaign.
    pub recording: usize,
    /// Times of the fitted rows in seconds, and the change of the reading there in gauss.
    pub rows: Vec<(f64, Vector3<f64>)>,
}

/// Changes of the field by the differences of the magnets' places, of all rows of `setup`; arguments as of [`recording_differences`].
pub fn place_changes(
    setup: &FitSetup,
    effects: &[EffectTerm],
    values: &[Vec<f64>],
    found: &RecordingDifference,
) -> Vec<PlaceChange> {
    let mut effects = effects.to_vec();
    effects.sort_by_key(EffectTerm::stage);
    let mut changes = Vec::new();
    for ((rows, base), values) in setup.rows.iter().zip(&setup.bases).zip(values) {
        let problem = SensorProblem::new(rows, base.as_ref(), &effects);
        let base_values = &values[..problem.base_count];
        for (recording, part) in rows.parts.iter().enumerate() {
            let own = |one: &&Difference| one.sensor == rows.sensor && one.recording == recording;
            let moves = found.differences.iter().filter(own);
            let moved_mm: Vector3<f64> =
                moves.map(|one| Vector3::ith(one.axis as usize, 1e-3 * one.value)).sum();
            if moved_mm == Vector3::zeros() {
                continue;
            }
            let mut states = problem.states(recording, values);
            let here = base.fields(base_values, &states);
            states.iter_mut().for_each(|state| state.displacement_mm += moved_mm);
            let there = base.fields(base_values, &states);
            let change = there.iter().zip(&here).map(|(there, here)| there - here);
            let rows_of_part = part.time_s.iter().copied().zip(change).collect();
            changes.push(PlaceChange { sensor: rows.sensor, recording, rows: rows_of_part });
        }
    }
    changes
}

/// Whether a candidate explains at least half of what these columns of the sensors do, and leaves about as little.
fn explains(sensors: &[Sensor], columns: &[DMatrix<f64>], candidate: &CandidateScore) -> bool {
    let noise: f64 =
        sensors.iter().map(|sensor| sensor.linearisation.residual().len() as f64).sum();
    let mut squares = [0.0; 4];
    for ((sensor, columns), own) in sensors.iter().zip(columns).zip(candidate.regressors()) {
        let none = DMatrix::zeros(columns.nrows(), 0);
        let with_candidate = sensor.normals.extended(own);
        let normals = [
            sensor.normals.with(&none),
            sensor.normals.with(columns),
            with_candidate.with(&none),
            with_candidate.with(columns),
        ];
        for (sum, normals) in squares.iter_mut().zip(&normals) {
            *sum += least_residual(normals).0;
        }
    }
    let [neither, cause, other, both] = squares;
    // The floor may be too high: there is no more noise than both leave.
    let noise = both.min(noise);
    let left = |squares: f64| (squares - noise).max(NEGLIGIBLE * noise);
    other - both <= SHARED * (neither - cause) && left(other) <= AS_GOOD * left(cause)
}

/// The cause that explains most of what is left, with its columns for each sensor.
fn largest(
    sensors: &[Sensor],
    found: &[RecordingDifference],
) -> Option<(RecordingDifference, Vec<DMatrix<f64>>)> {
    let entries: f64 =
        sensors.iter().map(|sensor| sensor.linearisation.residual().len() as f64).sum();
    let none = |sensor: &Sensor| {
        let without =
            sensor.normals.with(&DMatrix::zeros(sensor.linearisation.residual().len(), 0));
        held_out_residuals(&without)
    };
    let without: Vec<Vec<f64>> = sensors.par_iter().map(none).collect();
    let sum = |of: &[f64]| of.iter().sum::<f64>();
    let before: f64 = without.iter().map(|held_out| sum(held_out)).sum();
    let excess = before - entries;
    if !before.is_finite() || before < MIN_FLOORS.powi(2) * entries {
        return None;
    }
    let mut tried: Vec<(DifferenceCause, f64, Vec<Tried>)> = DifferenceCause::ALL
        .into_par_iter()
        .filter(|cause| found.iter().all(|other| other.cause != *cause))
        .map(|cause| {
            let tried: Vec<Tried> = sensors.par_iter().map(|sensor| sensor.tried(cause)).collect();
            let left: f64 = tried.iter().map(|tried| sum(&tried.held_out)).sum();
            (cause, left - entries, tried)
        })
        .collect();
    tried.retain(|(cause, left, tried)| {
        let wins = tried.iter().zip(&without).any(|(tried, without)| {
            let pairs = tried.held_out.iter().zip(without);
            let wins = pairs.filter(|(with, without)| with < without).count();
            4 * wins >= 3 * without.len()
        });
        let mut of_sensors = sensors.iter().zip(tried);
        let is_clear = of_sensors.any(|(sensor, tried)| {
            let differences = sensor.differences(*cause, tried);
            differences.iter().any(|one| one.value.abs() > CLEAR_SIGMAS * one.std_error)
        });
        *left <= (1.0 - MIN_SHARE) * excess && wins && is_clear
    });
    let least = tried.iter().map(|(_, left, _)| *left).fold(f64::INFINITY, f64::min);
    tried.retain(|(_, left, _)| *left + entries <= EQUAL * (least + entries));
    let mut tried = tried.into_iter();
    let (cause, left, best) = tried.next()?;
    let difference = RecordingDifference {
        cause,
        differences: sensors
            .iter()
            .zip(&best)
            .flat_map(|(sensor, tried)| sensor.differences(cause, tried))
            .collect(),
        equivalent: tried.map(|(cause, ..)| cause).collect(),
        candidates: Vec::new(),
        floors: [before, left + entries].map(|squares| (squares / entries).max(0.0).sqrt()),
    };
    Some((difference, best.into_iter().map(|tried| tried.columns).collect()))
}
