//! Recordings that are not independent: copies, rows of one run, overlapping clocks, and recordings that follow one path of all forces
//! and covariates. What is held out of one of them is in another.

use std::collections::HashSet;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

use serde::Serialize;

use crate::noise_model::von_neumann;
use crate::{Campaign, Recording};

/// Why two recordings are not independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DependenceKind {
    /// Rows of one are rows of the other.
    Copy,
    /// They cover the same time of the campaign's clock.
    Overlap,
    /// Forces, covariates and field are equal functions of time: rows of one run in turn, or a programme repeated exactly.
    OneRun,
    /// Forces and covariates are equal functions of time, the field is not.
    OnePath,
}

/// Recordings that are not independent.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// Why.
    pub kind: DependenceKind,
    /// Indices of the recordings in the campaign, ascending.
    pub recordings: Vec<usize>,
    /// Least share of rows, time, or variance that two of them have in common.
    pub share: f64,
}

/// Folds of a campaign whose recordings are not independent: blocks of time, held out of all recordings together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockFolds {
    /// Whether the common time is that of the campaign's clock, not that since the start of each recording.
    pub by_clock: bool,
    /// Correlation time of what a smooth in forces and covariates leaves of the field, in seconds.
    pub correlation_s: f64,
}

/// Share of equal rows from which recordings are copies.
const COPIED: f64 = 0.2;
/// Share of the shorter recording's time from which clocks overlap.
const OVERLAPS: f64 = 0.05;
/// Mean square of the difference of two paths relative to their variances, up to which they are one: 1 for independent paths.
const ONE_PATH: f64 = 0.02;
/// Points at which paths are compared.
const POINTS: usize = 200;
/// Columns with a von Neumann ratio below this have a path; others are noise.
const HAS_PATH: f64 = 0.3;
/// Median difference of the fields of one run in multiples of their noise: 0.95 from noise alone.
const ONE_RUN_NOISES: f64 = 3.0;
/// Maximum number of recordings that are compared with each other.
const MAX_COMPARED: usize = 60;

/// Dependent recordings of a campaign, most severe kind first.
pub fn dependences(campaign: &Campaign) -> Vec<Dependence> {
    let recordings = &campaign.recordings[..campaign.recordings.len().min(MAX_COMPARED)];
    let rows: Vec<HashSet<u64>> = recordings.iter().map(row_hashes).collect();
    let paths: Vec<Path> = recordings.iter().map(Path::of).collect();
    let mut pairs: Vec<(DependenceKind, usize, usize, f64)> = Vec::new();
    for j in 0..recordings.len() {
        for i in 0..j {
            let common = rows[i].intersection(&rows[j]).count() as f64;
            let copied = common / rows[i].len().min(rows[j].len()).max(1) as f64;
            let overlap = overlap(&recordings[i], &recordings[j]);
            let found = if copied > COPIED {
                Some((DependenceKind::Copy, copied))
            } else if overlap > OVERLAPS {
                Some((DependenceKind::Overlap, overlap))
            } else {
                paths[i].shared(&paths[j])
            };
            pairs.extend(found.map(|(kind, share)| (kind, i, j, share)));
        }
    }
    grouped(pairs)
}

/// Blocks by which a campaign is cross-validated, where its recordings are not independent. Repeats of one path whose fields differ
/// are: what differs between them is predicted of a recording that was held out.
pub fn block_folds(campaign: &Campaign) -> Option<BlockFolds> {
    let found = dependences(campaign);
    let first = found.iter().find(|one| one.kind != DependenceKind::OnePath)?;
    let correlations = campaign.recordings.iter().map(|of| of.noise.correlation_s);
    Some(BlockFolds {
        by_clock: first.kind == DependenceKind::Overlap,
        correlation_s: correlations.fold(0.0, f64::max),
    })
}

/// Groups of connected pairs of each kind; of runs and paths the weaker kind.
fn grouped(pairs: Vec<(DependenceKind, usize, usize, f64)>) -> Vec<Dependence> {
    let mut groups: Vec<Dependence> = Vec::new();
    for (kind, i, j, share) in pairs {
        let joins = |group: &Dependence| {
            let is_path = |kind| kind >= DependenceKind::OneRun;
            let is_alike = group.kind == kind || (is_path(group.kind) && is_path(kind));
            is_alike && [i, j].iter().any(|one| group.recordings.contains(one))
        };
        let (joined, others): (Vec<_>, Vec<_>) = groups.into_iter().partition(joins);
        let mut recordings = vec![i, j];
        recordings.extend(joined.iter().flat_map(|group| &group.recordings));
        recordings.sort_unstable();
        recordings.dedup();
        let kind = joined.iter().map(|group| group.kind).fold(kind, DependenceKind::max);
        let share = joined.iter().map(|group| group.share).fold(share, f64::min);
        groups = others;
        groups.push(Dependence { kind, recordings, share });
    }
    groups.sort_by_key(|group| (group.kind, group.recordings.clone()));
    groups
}

/// Hash of fields and forces of each row in single precision: a copy may have been converted.
fn row_hashes(recording: &Recording) -> HashSet<u64> {
    let row = |row: usize| {
        let fields = recording.sensors.values().filter_map(|sensor| sensor.field_g.get(row));
        let forces = recording.forces.values().filter_map(|force| force.newtons.get(row));
        let values: Vec<f64> = fields.flatten().chain(forces).copied().collect();
        let mut hasher = DefaultHasher::new();
        values.iter().for_each(|value| (*value as f32).to_bits().hash(&mut hasher));
        values.iter().all(|value| value.is_finite()).then(|| hasher.finish())
    };
    (0..recording.time_s.len()).filter_map(row).collect()
}

/// Common time of two recordings relative to that of the shorter one; zero where a start is assumed, or both are equal and so were
/// not stated.
fn overlap(one: &Recording, other: &Recording) -> f64 {
    let (from, other_from) = (one.description.start_s, other.description.start_s);
    let is_assumed = one.description.is_start_assumed() || other.description.is_start_assumed();
    if is_assumed || from == other_from {
        return 0.0;
    }
    let common = (from + one.span_s()).min(other_from + other.span_s()) - from.max(other_from);
    let shorter = one.span_s().min(other.span_s());
    if shorter > 0.0 { (common / shorter).max(0.0) } else { 0.0 }
}

/// Forces, covariates and field of a recording at evenly spaced times since its start.
struct Path {
    span_s: f64,
    /// By column; `None` for a column of noise.
    settings: Vec<Option<Vec<f64>>>,
    fields: Vec<Vec<f64>>,
    /// Noise of each field.
    noise_g: Vec<f64>,
}

impl Path {
    fn of(recording: &Recording) -> Self {
        let at = |column: &[f64]| resampled(&recording.time_s, column, recording.span_s());
        let path = |(name, column): (&str, &Vec<f64>)| {
            let finite: Vec<f64> = column.iter().copied().filter(|v| v.is_finite()).collect();
            let moves = von_neumann(&finite)
                .is_some_and(|ratio| ratio < HAS_PATH || recording.noise.follows(name));
            (moves && column.len() == recording.time_s.len()).then(|| at(column))
        };
        let forces = recording.forces.values().map(|force| ("", &force.newtons));
        let sensors = recording.sensors.values();
        let temperatures = sensors.map(|sensor| ("temp_c", &sensor.temperature_c));
        let covariates = recording.covariates.iter().map(|(name, values)| (name.as_str(), values));
        let columns = forces.chain(covariates).chain(temperatures);
        let axes = recording.sensors.values().flat_map(|sensor| {
            [0, 1, 2].map(|axis| {
                let column: Vec<f64> = sensor.field_g.iter().map(|b| b[axis]).collect();
                (at(&column), sensor.noise_g[axis] * recording.noise_gain)
            })
        });
        let (fields, noise_g) = axes.unzip();
        Self { span_s: recording.span_s(), settings: columns.map(path).collect(), fields, noise_g }
    }

    /// Kind and share, where all columns that move follow one path.
    fn shared(&self, other: &Self) -> Option<(DependenceKind, f64)> {
        let longer = self.span_s.max(other.span_s);
        let is_as_long = (self.span_s - other.span_s).abs() < 0.05 * longer;
        if !is_as_long || self.settings.len() != other.settings.len() {
            return None;
        }
        let mut apart = 0.0_f64;
        let mut count = 0;
        for pair in self.settings.iter().zip(&other.settings) {
            match pair {
                (Some(one), Some(other)) => {
                    apart = apart.max(relative_difference(one, other));
                    count += 1;
                }
                (None, None) => {}
                _ => return None,
            }
        }
        if count == 0 || apart > ONE_PATH {
            return None;
        }
        let fields = self.fields.iter().zip(&other.fields).zip(&self.noise_g);
        let is_one_run = fields.clone().all(|((one, other), noise_g)| {
            let mut apart: Vec<f64> = one.iter().zip(other).map(|(a, b)| (a - b).abs()).collect();
            apart.sort_by(f64::total_cmp);
            apart[apart.len() / 2] < ONE_RUN_NOISES * noise_g
        });
        let kind = if is_one_run { DependenceKind::OneRun } else { DependenceKind::OnePath };
        Some((kind, 1.0 - apart))
    }
}

/// Mean square of the difference over the sum of the variances.
fn relative_difference(one: &[f64], other: &[f64]) -> f64 {
    let variance = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.iter().map(|value| (value - mean).powi(2)).sum::<f64>()
    };
    let apart: f64 = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
    apart / (variance(one) + variance(other)).max(f64::MIN_POSITIVE)
}

/// Values by linear interpolation at [`POINTS`] times over the span; rows without a value are skipped.
fn resampled(time_s: &[f64], values: &[f64], span_s: f64) -> Vec<f64> {
    let rows: Vec<(f64, f64)> = time_s
        .iter()
        .copied()
        .zip(values.iter().copied())
        .filter(|(_, value)| value.is_finite())
        .collect();
    let first_s = time_s.first().copied().unwrap_or(0.0);
    let at = |point: usize| {
        let time = first_s + span_s * point as f64 / (POINTS - 1) as f64;
        let after = rows.partition_point(|(t, _)| *t < time);
        match (after.checked_sub(1).and_then(|before| rows.get(before)), rows.get(after)) {
            (Some((from_s, from)), Some((to_s, to))) if to_s > from_s => {
                from + (to - from) * (time - from_s) / (to_s - from_s)
            }
            (_, Some((_, value))) | (Some((_, value)), None) => *value,
            _ => 0.0,
        }
    };
    (0..POINTS).map(at).collect()
}
