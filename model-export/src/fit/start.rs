//! Where the parameters of effects start from: shapes by search, coefficients by least squares.
//!
//! The residual of the base alone is regressed on the answers to the coefficients, together with
//! those of the base's parameters, so that no effect gets credit for what the base could absorb.
//! The shape that explains most over all sensors is taken.

use nalgebra::{DMatrix, DVector, Vector3};
use rayon::prelude::*;

use super::problem::SensorProblem;
use crate::effects::{Kind, Parameter};

/// Rows of one recording that take part in the search.
const ROWS: usize = 400;
/// Rounds through the shapes of one effect where it has several.
const ROUNDS: usize = 2;
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
    /// Fitted values of the base, then present values of the effects.
    pub values: Vec<f64>,
    residual: DVector<f64>,
    base: DMatrix<f64>,
}

impl<'a> Seeker<'a> {
    /// From the base's fitted values.
    pub fn new(mut problem: SensorProblem<'a>, base_values: &[f64]) -> Self {
        problem.centre_base(base_values);
        let values: Vec<f64> = problem.slots.iter().map(|slot| slot.start).collect();
        let departures = problem.departures(&values);
        let (mut residual, mut columns) = (Vec::new(), Vec::new());
        for part in 0..problem.rows.parts.len() {
            let linear = problem.linear(part, &departures);
            for row in picked(problem.rows.parts[part].len()) {
                let error = problem.rows.parts[part].field_g[row] - linear.fields[row];
                for axis in 0..3 {
                    residual.push(error[axis] * problem.weights[axis]);
                    let row = linear.jacobian.row(3 * row + axis);
                    columns.push(row.columns(0, problem.base_count) * problem.weights[axis]);
                }
            }
        }
        let base = DMatrix::from_fn(columns.len(), problem.base_count, |i, j| columns[i][j]);
        Self {
            problem,
            values,
            residual: DVector::from_vec(residual),
            base,
        }
    }

    /// Answers of the field to these slots at `values`, weighted, by unit of the parameter.
    fn columns(&self, slots: &[usize], values: &[f64]) -> DMatrix<f64> {
        let problem = &self.problem;
        let field = problem.base.linear(&values[..problem.base_count]);
        let mut unused = vec![Vector3::zeros(); problem.base_count];
        let mut columns = DMatrix::zeros(self.residual.len(), slots.len());
        let mut at = 0;
        for part in 0..problem.rows.parts.len() {
            let states = problem.states(part, values);
            let picked: Vec<usize> = picked(states.len()).collect();
            let responses: Vec<_> = picked
                .iter()
                .map(|&row| field(&states[row], &mut unused))
                .collect();
            for (column, &slot) in slots.iter().enumerate() {
                let step = 1e-3 * problem.slots[slot].scale.abs().max(1e-9);
                let mut moved = values.to_vec();
                moved[slot] += step;
                let moved = problem.states(part, &moved);
                for (i, (&row, response)) in picked.iter().zip(&responses).enumerate() {
                    let change = response
                        .change(&states[row], &moved[row])
                        .component_mul(&problem.weights)
                        / step;
                    (0..3).for_each(|axis| columns[(at + 3 * i + axis, column)] = change[axis]);
                }
            }
            at += 3 * picked.len();
        }
        columns
    }

    /// Squared residual that is left by the base and these columns, and the columns' coefficients.
    fn regress(&self, columns: &DMatrix<f64>) -> (f64, Vec<f64>) {
        let all: Vec<_> = self
            .base
            .column_iter()
            .chain(columns.column_iter())
            .collect();
        let size = all.len();
        let mut normal = DMatrix::zeros(size, size);
        let mut right = DVector::zeros(size);
        for i in 0..size {
            right[i] = all[i].dot(&self.residual);
            for j in 0..=i {
                normal[(i, j)] = all[i].dot(&all[j]);
                normal[(j, i)] = normal[(i, j)];
            }
        }
        // Scaled, and with a ridge far below any answer that counts.
        let scale = normal
            .diagonal()
            .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
        let scaled = DMatrix::from_fn(size, size, |i, j| {
            normal[(i, j)] * scale[i] * scale[j] + if i == j { 1e-6 } else { 0.0 }
        });
        let Some(factor) = scaled.cholesky() else {
            return (f64::INFINITY, vec![0.0; columns.ncols()]);
        };
        let solution = factor
            .solve(&right.component_mul(&scale))
            .component_mul(&scale);
        let left = self.residual.dot(&self.residual) - solution.dot(&right);
        (
            left,
            solution.iter().skip(self.base.ncols()).copied().collect(),
        )
    }
}

/// Sets the start of every effect's parameters, in the order of the effects.
pub fn seek(seekers: &mut [Seeker]) {
    let Some(first) = seekers.first() else { return };
    let recordings = first.problem.rows.parts.len();
    let effects = first.problem.effects;
    for (i, effect) in effects.iter().enumerate() {
        let parameters = effect.parameters(recordings);
        let shapes = parameters.iter().filter(|p| !p.is_coefficient()).count();
        for round in 0..if shapes > 1 { ROUNDS } else { 1 } {
            for (j, parameter) in parameters.iter().enumerate() {
                let now = first_value(seekers, i, j);
                let tried = grid(parameter, seekers, round, now);
                if tried.len() > 1 {
                    choose(seekers, i, j, &tried);
                }
            }
        }
        scale_unknown(seekers, i, &parameters);
    }
    seekers.par_iter_mut().for_each(start_coefficients);
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

/// Takes the value of parameter `j` of effect `i` that leaves the least, over all sensors.
fn choose(seekers: &mut [Seeker], i: usize, j: usize, tried: &[f64]) {
    let left: Vec<f64> = tried
        .par_iter()
        .map(|&value| {
            let left = seekers.iter().map(|seeker| {
                let range = seeker.problem.ranges()[i].clone();
                let mut values = seeker.values.clone();
                values[range.start + j] = value;
                let slots = coefficients(&seeker.problem, i);
                seeker.regress(&seeker.columns(&slots, &values)).0
            });
            left.sum()
        })
        .collect();
    let best = left.iter().zip(tried).min_by(|a, b| a.0.total_cmp(b.0));
    if let Some((_, &value)) = best {
        for seeker in seekers {
            let slot = seeker.problem.ranges()[i].start + j;
            seeker.values[slot] = value;
            seeker.problem.slots[slot].start = value;
        }
    }
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
            let scale = EXPECTED * seeker.residual.norm() / answer;
            seeker.problem.slots[slot].scale = if scale.is_finite() { scale } else { 1.0 };
        }
    }
}

fn start_coefficients(seeker: &mut Seeker) {
    let effects = 0..seeker.problem.effects.len();
    let slots: Vec<usize> = effects
        .flat_map(|i| coefficients(&seeker.problem, i))
        .collect();
    let (_, found) = seeker.regress(&seeker.columns(&slots, &seeker.values));
    for (slot, value) in slots.into_iter().zip(found) {
        // A start, not a solution: within what is expected at all.
        let limit = seeker.problem.slots[slot].scale.abs();
        seeker.values[slot] = value.clamp(-limit, limit);
    }
}

/// Rows that take part, evenly over a recording.
fn picked(rows: usize) -> impl Iterator<Item = usize> + Clone {
    (0..rows).step_by((rows / ROWS).max(1))
}
