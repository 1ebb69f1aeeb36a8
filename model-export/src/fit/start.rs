//! Where the parameters of effects start from: shapes by search, coefficients by least squares.
//!
//! The residual of the base alone is regressed on the answers to the coefficients, together with
//! those of the base's parameters, so that no effect gets credit for what the base could absorb.
//! The shape that explains most over all sensors is taken; one that spans recordings is taken where it
//! carries over best to recordings left out, as the degree of a polynomial is, and stays there.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::ground::Ground;
use super::normal::{left_by, left_out_by};
use super::problem::SensorProblem;
use crate::effects::{Kind, Parameter};
use crate::physics::State;

/// Rows of one recording that take part in the search.
const ROWS: usize = 400;
/// Rounds through all effects where there are several, and through the shapes of one where it has
/// several.
const ROUNDS: usize = 2;
/// Steps between two values of the grid in which a shape that spans recordings is refined.
const FINE: i32 = 4;
/// Seconds between the instants that are tried: over the whole campaign, then around the best.
const INSTANT_S: [f64; 2] = [0.5, 0.05];
/// Instants on each side of the best that are tried in the second round.
const AROUND: usize = 12;
/// Where nobody knows how large a coefficient may be: what moves the field by this many times its
/// present residual.
const EXPECTED: f64 = 10.0;

/// One sensor while its start is sought: its problem, and the values so far.
pub struct Seeker<'a> {
    /// The problem with all effects; its slots' starts are set here.
    pub problem: SensorProblem<'a>,
    /// Fitted values, then present values of the effects that are sought.
    pub values: Vec<f64>,
    ground: Ground,
    /// Answers of the other effects that were sought so far.
    others: DMatrix<f64>,
}

impl<'a> Seeker<'a> {
    /// From the base's fitted values.
    pub fn new(mut problem: SensorProblem<'a>, base_values: &[f64]) -> Self {
        problem.centre_base(base_values);
        let values: Vec<f64> = problem.slots.iter().map(|slot| slot.start).collect();
        let fixed: Vec<usize> = (0..problem.base_count).collect();
        let ground = Ground::new(&problem, &values, &fixed, ROWS);
        Self::upon(ground, problem, values)
    }

    /// Upon a ground; `problem` may have effects more, whose coefficients are zero in `values`.
    pub fn upon(ground: Ground, problem: SensorProblem<'a>, values: Vec<f64>) -> Self {
        Self {
            others: DMatrix::zeros(ground.residual.len(), 0),
            ground,
            problem,
            values,
        }
    }

    /// The same with what was found, upon other rows.
    pub fn moved_to(self, ground: Ground) -> Self {
        Self::upon(ground, self.problem, self.values)
    }

    /// Answers of the coefficients of `effect` at the shapes found, weighted, by departure.
    pub fn answers(&self, effect: usize) -> DMatrix<f64> {
        let slots = coefficients(&self.problem, effect);
        let mut columns = self.columns(&slots, &self.values);
        for (mut column, slot) in columns.column_iter_mut().zip(slots) {
            column *= self.problem.slots[slot].scale;
        }
        columns
    }

    /// Answers of the field to these slots at `values`, weighted, by unit of the parameter.
    fn columns(&self, slots: &[usize], values: &[f64]) -> DMatrix<f64> {
        let problem = &self.problem;
        let mut columns = DMatrix::zeros(self.ground.residual.len(), slots.len());
        let mut at = 0;
        for (part, rows) in self.ground.rows.iter().enumerate() {
            for (column, &slot) in slots.iter().enumerate() {
                let step = 1e-3 * problem.slots[slot].scale.abs().max(1e-9);
                let mut moved = values.to_vec();
                moved[slot] += step;
                let moved = self.states(part, slot, &moved);
                for (i, ((_, state, response), moved)) in rows.iter().zip(&moved).enumerate() {
                    let change = response
                        .change(state, moved)
                        .component_mul(&problem.weights)
                        / step;
                    (0..3).for_each(|axis| columns[(at + 3 * i + axis, column)] = change[axis]);
                }
            }
            at += 3 * rows.len();
        }
        columns
    }

    /// States of a recording's rows where the parameter of one slot was moved.
    fn states(&self, part: usize, slot: usize, moved: &[f64]) -> Vec<State> {
        let ranges = self.problem.ranges().into_iter();
        let mut of_effects = self.problem.effects.iter().zip(ranges);
        let own = of_effects.find(|(_, range)| range.contains(&slot));
        if let Some((effect, range)) = own.filter(|(effect, _)| effect.is_pointwise()) {
            return self.ground.with(part, effect, &moved[range]);
        }
        let states = self.problem.states(part, moved);
        let rows = self.ground.rows[part].iter();
        rows.map(|(row, ..)| states[*row]).collect()
    }

    /// Squared residual that is left beside the other effects by the coefficients of `effect`, with its
    /// parameter `j` at `value`: over all recordings, or (`left_out`) over each in turn by the fit to
    /// the others, recording by recording.
    fn left(&self, effect: usize, j: usize, value: f64, left_out: bool) -> Vec<f64> {
        let mut values = self.values.clone();
        values[self.problem.ranges()[effect].start + j] = value;
        let own = self.columns(&coefficients(&self.problem, effect), &values);
        let all = side_by_side(&self.others, &own);
        let normals = self.ground.normals.with(&all);
        match left_out {
            true => left_out_by(&normals),
            false => vec![left_by(&normals).0],
        }
    }

    /// Keeps at hand the answers of the effects in `sought`.
    fn beside(&mut self, sought: &[usize]) {
        let slots: Vec<usize> = sought
            .iter()
            .flat_map(|&i| coefficients(&self.problem, i))
            .collect();
        self.others = self.columns(&slots, &self.values);
    }
}

fn side_by_side(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let columns: Vec<_> = left.column_iter().chain(right.column_iter()).collect();
    match columns.is_empty() {
        true => DMatrix::zeros(left.nrows(), 0),
        false => DMatrix::from_columns(&columns),
    }
}

/// Sets the start of every effect's parameters, in the order of the effects.
pub fn seek(seekers: &mut [Seeker]) {
    let Some(first) = seekers.first() else { return };
    let recordings = first.problem.rows.parts.len();
    let effects = first.problem.effects;
    // Alone, each effect would take the shape that best stands in for all the others.
    for pass in 0..if effects.len() > 1 { ROUNDS } else { 1 } {
        for (i, effect) in effects.iter().enumerate() {
            let sought: Vec<usize> = (0..effects.len())
                .filter(|&other| other != i && (pass > 0 || other < i))
                .collect();
            seekers.par_iter_mut().for_each(|s| s.beside(&sought));
            seek_one(seekers, i, &effect.parameters(recordings));
        }
    }
    seekers.par_iter_mut().for_each(start_coefficients);
}

/// Finds the shapes of one effect beside what is fitted already.
pub fn seek_beside(seekers: &mut [Seeker], effect: usize) {
    let Some(first) = seekers.first() else { return };
    let recordings = first.problem.rows.parts.len();
    let parameters = first.problem.effects[effect].parameters(recordings);
    seek_one(seekers, effect, &parameters);
}

/// Sets the start of one effect's parameters.
fn seek_one(seekers: &mut [Seeker], i: usize, parameters: &[Parameter]) {
    let shapes = parameters.iter().filter(|p| !p.is_coefficient()).count();
    for round in 0..if shapes > 1 { ROUNDS } else { 1 } {
        for (j, parameter) in parameters.iter().enumerate() {
            let now = first_value(seekers, i, j);
            let tried = grid(parameter, seekers, round, now);
            if !tried.is_empty() {
                let across = parameter.across && recordings_with_rows(seekers) > 1;
                choose(seekers, i, j, &tried, across);
            }
        }
    }
    scale_unknown(seekers, i, parameters);
}

/// Recordings from which at least one sensor has rows.
fn recordings_with_rows(seekers: &[Seeker]) -> usize {
    let filled = |s: &Seeker| {
        s.problem
            .rows
            .parts
            .iter()
            .filter(|p| !p.is_empty())
            .count()
    };
    seekers.iter().map(filled).max().unwrap_or(0)
}

/// The present value of parameter `j` of effect `i`: the same at every sensor, while it is sought.
fn first_value(seekers: &[Seeker], i: usize, j: usize) -> f64 {
    seekers.first().map_or(0.0, |seeker| {
        seeker.values[seeker.problem.ranges()[i].start + j]
    })
}

fn grid(parameter: &Parameter, seekers: &[Seeker], round: usize, now: f64) -> Vec<f64> {
    match &parameter.kind {
        Kind::Coefficient | Kind::Beginning => Vec::new(),
        Kind::Shape { grid } if parameter.across => refined(grid),
        Kind::Shape { grid } if parameter.within_swing => {
            let most = half_swing_n(seekers).max(grid[0]);
            grid.iter()
                .copied()
                .filter(|value| *value <= most)
                .collect()
        }
        Kind::Shape { grid } => grid.to_vec(),
        Kind::Instant if round > 0 => (0..=2 * AROUND)
            .map(|k| now + INSTANT_S[1] * (k as f64 - AROUND as f64))
            .collect(),
        Kind::Instant => {
            let spans = seekers.iter().flat_map(|s| &s.problem.rows.parts);
            let end =
                spans.filter_map(|part| Some(part.track.before_s + part.track.time_s.last()?));
            let end_s = end.fold(0.0, f64::max);
            (1..(end_s / INSTANT_S[0]) as usize)
                .map(|k| INSTANT_S[0] * k as f64)
                .collect()
        }
    }
}

/// Half of the greatest swing of any force, in newtons.
fn half_swing_n(seekers: &[Seeker]) -> f64 {
    let spans = seekers.iter().flat_map(|s| s.problem.rows.force_spans());
    let swings = spans.map(|(low, high)| 0.5 * (high - low));
    swings.fold(0.0, f64::max)
}

/// A grid with steps between its values, in equal ratios.
fn refined(grid: &[f64]) -> Vec<f64> {
    let between = |pair: &[f64]| {
        let ratio = pair[1] / pair[0];
        let from = pair[0];
        (0..FINE).map(move |k| from * libm::pow(ratio, f64::from(k) / f64::from(FINE)))
    };
    grid.windows(2)
        .flat_map(between)
        .chain(grid.last().copied())
        .collect()
}

/// Takes the value of parameter `j` of effect `i` that leaves the least, over all sensors. Where it
/// spans recordings (`across`) that is judged on each recording left out, and there it stays.
fn choose(seekers: &mut [Seeker], i: usize, j: usize, tried: &[f64], across: bool) {
    let left: Vec<Vec<f64>> = tried
        .par_iter()
        .map(|&value| {
            let mut sum: Vec<f64> = Vec::new();
            for left in seekers.iter().map(|s| s.left(i, j, value, across)) {
                sum.resize(left.len(), 0.0);
                sum.iter_mut().zip(left).for_each(|(sum, own)| *sum += own);
            }
            sum
        })
        .collect();
    let Some(value) = best(tried, &left, None) else {
        return;
    };
    let spread = across.then(|| jackknife(tried, &left));
    for seeker in seekers {
        let slot = seeker.problem.ranges()[i].start + j;
        seeker.values[slot] = value;
        seeker.problem.slots[slot].start = value;
        seeker.problem.slots[slot].chosen =
            spread.map(|spread| spread / seeker.problem.slots[slot].scale);
    }
}

/// The value that leaves the least over all recordings but `without`.
fn best(tried: &[f64], left: &[Vec<f64>], without: Option<usize>) -> Option<f64> {
    let sum = |left: &Vec<f64>| -> f64 {
        let counted = left.iter().enumerate().filter(|(k, _)| Some(*k) != without);
        counted.map(|(_, left)| left).sum()
    };
    let pairs = left.iter().map(sum).zip(tried);
    pairs
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, value)| *value)
}

/// Standard deviation of the logarithm of the chosen value: how far it moves where each recording in
/// turn has no say.
fn jackknife(tried: &[f64], left: &[Vec<f64>]) -> f64 {
    let count = left.first().map_or(0, Vec::len);
    let logs: Vec<f64> = (0..count)
        .filter_map(|k| best(tried, left, Some(k)).map(f64::ln))
        .collect();
    let n = logs.len().max(1) as f64;
    let mean = logs.iter().sum::<f64>() / n;
    let squares: f64 = logs.iter().map(|log| (log - mean).powi(2)).sum();
    (squares * (n - 1.0) / n).sqrt()
}

fn coefficients(problem: &SensorProblem, effect: usize) -> Vec<usize> {
    let parameters = problem.effects[effect].parameters(problem.rows.parts.len());
    let start = problem.ranges()[effect].start;
    let is_coefficient =
        |(j, parameter): (usize, &Parameter)| parameter.is_coefficient().then_some(start + j);
    parameters
        .iter()
        .enumerate()
        .filter_map(is_coefficient)
        .collect()
}

/// Coefficients whose size nobody knows beforehand get their scale from the data.
fn scale_unknown(seekers: &mut [Seeker], effect: usize, parameters: &[Parameter]) {
    for (j, _) in parameters
        .iter()
        .enumerate()
        .filter(|(_, p)| p.is_coefficient() && p.typical.is_nan())
    {
        for seeker in seekers.iter_mut() {
            let slot = seeker.problem.ranges()[effect].start + j;
            seeker.problem.slots[slot].scale = 1.0;
            let answer = seeker.columns(&[slot], &seeker.values).norm();
            let scale = EXPECTED * seeker.ground.residual.norm() / answer;
            seeker.problem.slots[slot].scale = if scale.is_finite() { scale } else { 1.0 };
        }
    }
}

fn start_coefficients(seeker: &mut Seeker) {
    let effects = 0..seeker.problem.effects.len();
    let slots: Vec<usize> = effects
        .flat_map(|i| coefficients(&seeker.problem, i))
        .collect();
    let columns = seeker.columns(&slots, &seeker.values);
    let (_, found) = left_by(&seeker.ground.normals.with(&columns));
    let found = found.into_iter().skip(seeker.problem.base_count);
    for (slot, value) in slots.into_iter().zip(found) {
        // A start, not a solution: within what is expected at all.
        let limit = seeker.problem.slots[slot].scale.abs();
        seeker.values[slot] = value.clamp(-limit, limit);
    }
}
