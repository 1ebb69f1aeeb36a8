//! Hypotheses about the columns of one sensor (permuted or negated axes, exchanged forces, wrong units), and the
//! selection of the one that removes the residual.

use crate::data_quality::model_checks::case::{Case, mean_square};
use model_export::effects::ExcitationSeries;
use model_export::recordings::columns::Axis;
use model_export::recordings::{Campaign, Recording};
use model_export::stop;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Signed permutation of the field's axes: axis i is `sign[i]` times column `from[i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// Column indices, 0 to 2.
    pub from: [usize; 3],
    /// 1 or -1.
    pub sign: [f64; 3],
}

/// Source of a force: a column, and its sign.
pub type Source = ((u32, Axis), f64);

/// Possible column error.
#[derive(Clone, Debug, PartialEq)]
pub enum Hypothesis {
    /// Permuted or negated field axes.
    Axes(Turned),
    /// Field of another sensor.
    OfSensor(u32),
    /// Sources of the sensor's forces, in their order.
    Forces(Vec<Source>),
    /// Gauss per recorded unit of the field's axes; 1 for a correct column.
    FieldUnit([f64; 3]),
    /// Newtons per recorded unit of the forces, lateral and longitudinal; 1 for a correct
    /// column.
    ForceUnit([f64; 2]),
}

/// Hypothesis with its residual.
#[derive(Clone, Debug)]
pub struct Tried {
    /// Tested hypothesis.
    pub hypothesis: Hypothesis,
    /// Mean square of the residual in gauss squared (at the model's scale).
    pub left: f64,
    /// Number of affected columns: among equivalent hypotheses the simplest is preferred.
    pub cost: usize,
}

/// All signed permutations of the three axes except the identity.
fn axes(case: &Case) -> Vec<Tried> {
    const ORDERS: [[usize; 3]; 6] =
        [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let mut tried = Vec::new();
    for from in ORDERS {
        for signs in 0..8 {
            let sign = [0, 1, 2].map(|axis| if signs >> axis & 1 == 1 { -1.0 } else { 1.0 });
            let turned = Turned { from, sign };
            let cost = (0..3).map(|i| usize::from(from[i] != i) + usize::from(sign[i] < 0.0)).sum();
            if cost > 0 {
                tried.push(Tried {
                    left: mean_square(&turned.applied(&case.measured), &case.modelled),
                    hypothesis: Hypothesis::Axes(turned),
                    cost,
                });
            }
        }
    }
    tried
}

/// The fields of all other sensors.
fn of_sensors(case: &Case, recording: &Recording) -> Vec<Tried> {
    let indices = case.indices(recording);
    let others = recording.sensors.iter().filter(|(sensor, _)| **sensor != case.sensor);
    others
        .map(|(sensor, track)| {
            let at = |i: &usize| track.field_g.get(*i).copied().map_or_else(nan, Vector3::from);
            let fields: Vec<Vector3<f64>> = indices.iter().map(at).collect();
            Tried {
                hypothesis: Hypothesis::OfSensor(*sensor),
                left: mean_square(&fields, &case.modelled),
                cost: 1,
            }
        })
        .collect()
}

fn nan() -> Vector3<f64> {
    Vector3::repeat(f64::NAN)
}

impl Turned {
    fn applied(&self, fields: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let turn = |field: &Vector3<f64>| {
            Vector3::from_fn(|axis, _| self.sign[axis] * field[self.from[axis]])
        };
        fields.iter().map(turn).collect()
    }
}

/// A force column over the rows of a case: as recorded, smoothed, and its rate.
struct Column {
    force: Vec<f64>,
    smooth: Vec<f64>,
    rate: Vec<f64>,
}

/// Each single column for one of the sensor's forces, both exchanged, and both from another
/// place, each with either sign.
fn force_columns(case: &Case, recording: &Recording) -> Vec<Tried> {
    let columns = columns(case, recording);
    let own = case.forces;
    let mut candidates: Vec<Vec<Source>> = Vec::new();
    for source in columns.keys() {
        for sign in [1.0, -1.0] {
            for place in 0..own.len() {
                let mut sources: Vec<Source> = own.iter().map(|force| (*force, 1.0)).collect();
                sources[place] = (*source, sign);
                candidates.push(sources);
            }
        }
    }
    let places: Vec<u32> = columns.keys().map(|(place, _)| *place).collect();
    if own.len() == 2 {
        for place in places {
            for axes in [[Axis::X, Axis::Z], [Axis::Z, Axis::X]] {
                for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
                    let source = |i: usize| ((place, axes[i]), signs[i]);
                    candidates.push(vec![source(0), source(1)]);
                }
            }
        }
    }
    let mut tried: Vec<Tried> = Vec::new();
    for sources in candidates {
        let cost = cost(&sources, own);
        let known = sources.iter().all(|(column, _)| columns.contains_key(column));
        let hypothesis = Hypothesis::Forces(sources.clone());
        let new = tried.iter().all(|other| other.hypothesis != hypothesis);
        if cost > 0 && known && new {
            tried.push(Tried {
                left: case.left_under(&track(case, &columns, &sources)),
                hypothesis,
                cost,
            });
        }
    }
    tried
}

fn cost(sources: &[Source], own: &[(u32, Axis)]) -> usize {
    let pairs = sources.iter().zip(own);
    pairs.map(|((column, sign), own)| usize::from(column != own) + usize::from(*sign < 0.0)).sum()
}

fn track(
    case: &Case,
    columns: &BTreeMap<(u32, Axis), Column>,
    sources: &[Source],
) -> ExcitationSeries {
    let mut track = case.track.clone();
    for ((source, sign), (_, axis)) in sources.iter().zip(case.forces) {
        let Some(column) = columns.get(source) else {
            continue;
        };
        let axis = usize::from(*axis == Axis::Z);
        for row in 0..track.len() {
            track.force_n[row][axis] = sign * column.force[row];
            track.smooth_n[row][axis] = sign * column.smooth[row];
            track.rate_n_per_s[row][axis] = sign * column.rate[row];
        }
    }
    track
}

/// Force columns that are present in all rows of the case.
fn columns(case: &Case, recording: &Recording) -> BTreeMap<(u32, Axis), Column> {
    let indices = case.indices_of_part(recording);
    let mut columns = BTreeMap::new();
    for (key, forces) in &recording.forces {
        let newtons: Vec<f64> = indices.iter().map(|&i| forces.newtons[i]).collect();
        if newtons.len() != case.part.len() || newtons.iter().any(|n| !n.is_finite()) {
            continue;
        }
        let pairs = newtons.iter().map(|n| [*n, 0.0]).collect();
        let track = case.part.track.with_forces(pairs).at(&case.rows);
        let first = |pairs: &[[f64; 2]]| pairs.iter().map(|pair| pair[0]).collect();
        columns.insert(
            *key,
            Column {
                force: first(&track.force_n),
                smooth: first(&track.smooth_n),
                rate: first(&track.rate_n_per_s),
            },
        );
    }
    columns
}

/// Gains within this factor of 1 may be a property of the magnet, the spring or the amplifier.
const A_UNIT: f64 = 3.0;
/// Relative tolerance of a unit factor.
const NAMED_WITHIN: f64 = 0.05;
/// Search range of force factors in decades, and steps per decade.
const DECADES: (i32, i32) = (-4, 4);
/// See [`DECADES`].
const STEPS: i32 = 4;
/// Number of bisections: resolution of a ten-thousandth of a decade.
const REFINEMENTS: usize = 12;

/// Wrong field units, in gauss.
const OF_FIELD: [(&str, f64); 5] =
    [("mT", 10.0), ("uT", 0.01), ("mG", 1e-3), ("T", 1e4), ("nT", 1e-5)];
/// Wrong force units, in newtons.
const OF_FORCE: [(&str, f64); 5] =
    [("kgf", 9.806_65), ("gf", 9.806_65e-3), ("mN", 1e-3), ("kN", 1e3), ("lbf", 4.448_222)];

/// Name and exact factor of a field unit.
pub fn field_unit(factor: f64) -> Option<(&'static str, f64)> {
    named(&OF_FIELD, factor)
}

/// Name and exact factor of a force unit.
pub fn force_unit(factor: f64) -> Option<(&'static str, f64)> {
    named(&OF_FORCE, factor)
}

fn named(units: &[(&'static str, f64)], factor: f64) -> Option<(&'static str, f64)> {
    let near = |(_, exact): &&(&str, f64)| (factor / exact - 1.0).abs() < NAMED_WITHIN;
    units.iter().find(near).copied()
}

/// True for a factor outside the range of magnets, springs and amplifiers.
fn is_a_unit(factor: f64) -> bool {
    factor.is_finite() && (factor > A_UNIT || (factor > 0.0 && factor < 1.0 / A_UNIT))
}

/// Best-fitting factor of the field: common, and of each axis alone.
fn field(case: &Case) -> Vec<Tried> {
    let pairs = || case.measured.iter().zip(&case.modelled);
    let product =
        |axis: usize| pairs().map(|(measured, modelled)| measured[axis] * modelled[axis]).sum();
    let square = |axis: usize| pairs().map(|(measured, _)| measured[axis].powi(2)).sum();
    let (products, squares): ([f64; 3], [f64; 3]) = ([0, 1, 2].map(product), [0, 1, 2].map(square));
    let common = products.iter().sum::<f64>() / squares.iter().sum::<f64>();
    let alone = |axis: usize| {
        let factor = products[axis] / squares[axis];
        [0, 1, 2].map(|other| if other == axis { factor } else { 1.0 })
    };
    [[common; 3], alone(0), alone(1), alone(2)]
        .into_iter()
        .filter(|factors| factors.iter().any(|factor| is_a_unit(*factor)))
        .map(|factors| {
            let scale = Vector3::from(factors);
            let scaled: Vec<Vector3<f64>> =
                case.measured.iter().map(|field| field.component_mul(&scale)).collect();
            Tried {
                hypothesis: Hypothesis::FieldUnit(factors),
                left: mean_square(&scaled, &case.modelled),
                cost: 1,
            }
        })
        .collect()
}

/// Best-fitting factor of the forces: common, and each alone.
fn forces(case: &Case) -> Vec<Tried> {
    let has = |wanted| case.forces.iter().any(|(_, axis)| *axis == wanted);
    let alone = [[true, false], [false, true], [true, true]];
    let recorded = [has(Axis::X), has(Axis::Z)];
    alone
        .into_iter()
        .filter(|which| (0..2).all(|axis| recorded[axis] || !which[axis]))
        .filter_map(|which| {
            let factors = |factor: f64| which.map(|scaled| if scaled { factor } else { 1.0 });
            let left = |decade: f64| {
                let factor = 10_f64.powf(decade);
                case.left_under(&scaled(&case.track, factors(factor)))
            };
            let (decade, left) = least(left);
            let factor = 10_f64.powf(decade);
            is_a_unit(factor).then(|| Tried {
                hypothesis: Hypothesis::ForceUnit(factors(factor)),
                left,
                cost: which.iter().filter(|scaled| **scaled).count(),
            })
        })
        .collect()
}

/// Minimiser in decades, and the minimum.
fn least(of: impl Fn(f64) -> f64) -> (f64, f64) {
    let mut step = 1.0 / f64::from(STEPS);
    let mut best = (DECADES.0 * STEPS..=DECADES.1 * STEPS)
        .map(|i| f64::from(i) * step)
        .map(|decade| (decade, of(decade)))
        .fold((0.0, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best });
    for _ in 0..REFINEMENTS {
        step *= 0.5;
        for decade in [best.0 - step, best.0 + step] {
            let left = of(decade);
            if left < best.1 {
                best = (decade, left);
            }
        }
    }
    best
}

fn scaled(track: &ExcitationSeries, factors: [f64; 2]) -> ExcitationSeries {
    let times = |pairs: &[[f64; 2]]| -> Vec<[f64; 2]> {
        let pair = |[x, z]: &[f64; 2]| [factors[0] * x, factors[1] * z];
        pairs.iter().map(pair).collect()
    };
    ExcitationSeries {
        force_n: times(&track.force_n),
        smooth_n: times(&track.smooth_n),
        rate_n_per_s: times(&track.rate_n_per_s),
        ..track.clone()
    }
}

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
    pub sensor: u32,
    /// Best hypothesis.
    pub best: Tried,
    /// Equivalent hypotheses.
    pub others: Vec<Hypothesis>,
    /// Mean square of the residual as recorded, in gauss squared.
    pub before: f64,
}

impl Verdict {
    /// Identifier of the finding.
    pub fn id(&self) -> &'static str {
        match &self.best.hypothesis {
            Hypothesis::Axes(turned) if turned.from == [0, 1, 2] => "axis_flipped",
            Hypothesis::Axes(_) | Hypothesis::OfSensor(_) => "axis_permuted",
            Hypothesis::Forces(sources) => {
                let mut pairs = own_forces(self.sensor).into_iter().zip(sources);
                if pairs.any(|(own, (source, _))| own != *source) {
                    "force_swapped"
                } else {
                    "force_flipped"
                }
            }
            Hypothesis::FieldUnit(_) | Hypothesis::ForceUnit(_) => "wrong_unit",
        }
    }
}

/// Force columns of a sensor, lateral and longitudinal.
pub fn own_forces(sensor: u32) -> [(u32, Axis); 2] {
    [(sensor, Axis::X), (sensor, Axis::Z)]
}

/// Column errors of all cases; the same error at several sensors or in several recordings is one group.
pub fn column_errors(campaign: &Campaign, cases: &[Case]) -> Vec<Vec<Verdict>> {
    let verdicts: Vec<Verdict> =
        cases.par_iter().filter_map(|case| verdict(campaign, case)).collect();
    let mut groups: Vec<Vec<Verdict>> = Vec::new();
    for verdict in verdicts {
        let same = |group: &&mut Vec<Verdict>| alike(&group[0], &verdict);
        match groups.iter_mut().find(same) {
            Some(group) => group.push(verdict),
            None => groups.push(vec![verdict]),
        }
    }
    groups
}

fn verdict(campaign: &Campaign, case: &Case) -> Option<Verdict> {
    stop::check();
    if case.as_recorded < ABOVE_FLOOR * case.floor {
        return None;
    }
    let mut tried = axes(case);
    let recording = &campaign.recordings[case.recording];
    tried.extend(of_sensors(case, recording));
    tried.extend(force_columns(case, recording));
    tried.extend(field(case));
    tried.extend(forces(case));
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
        (FieldUnit(a), FieldUnit(b)) => a.map(field_unit) == b.map(field_unit),
        (ForceUnit(a), ForceUnit(b)) => {
            [0, 1].map(|i| force_unit(a[i])) == [0, 1].map(|i| force_unit(b[i]))
        }
        (Forces(a), Forces(b)) => {
            // Relative to the sensor's own place: f1 for f0 and f0 for f1 are the same error.
            let relative = |verdict: &Verdict, sources: &[Source]| -> Vec<_> {
                let own = |place: u32| place == verdict.sensor;
                let of = |((place, axis), sign): &Source| (own(*place), *axis, *sign < 0.0);
                sources.iter().map(of).collect()
            };
            relative(one, a) == relative(other, b)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_is_named_within_five_percent() {
        assert_eq!(force_unit(9.5).map(|(name, _)| name), Some("kgf"));
        assert_eq!(force_unit(9.2), None);
        assert_eq!(field_unit(0.0102).map(|(name, _)| name), Some("uT"));
        assert_eq!(field_unit(1.0), None);
    }

    #[test]
    fn factor_is_found_to_a_tenth_of_a_percent() {
        let (decade, _) = least(|decade| (decade - 0.991_52).powi(2));
        assert!((decade - 0.991_52).abs() < 4e-4, "{decade}");
    }
}
