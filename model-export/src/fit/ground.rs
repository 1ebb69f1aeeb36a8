//! Where an effect is sought from.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector3};

use super::normal::Normals;
use super::problem::SensorProblem;
use super::rows::SensorRows;
use crate::effects::{Addition, Series, Track};
use crate::physics::{Response, State};

/// Height of a curve free in time by departure, in floors: no prior may hold it.
const HIGH: f64 = 1000.0;

/// Where an effect is sought from: the rows that take part, what is left in them, and the answers of
/// everything that is fitted already.
#[derive(Clone)]
pub struct Ground {
    pub(super) residual: DVector<f64>,
    /// Answers of what is fitted, by recording.
    pub(super) normals: Arc<Normals>,
    /// The rows with their states and responses, recording by recording. While an effect is sought its
    /// coefficients are zero, so that they hold throughout.
    pub(super) rows: Arc<Vec<Vec<(usize, State, Response)>>>,
    /// What the same rows met, recording by recording, and their state.
    met: Arc<Vec<(Track, Series)>>,
}

impl Ground {
    /// Around values at which the slots `fixed` were fitted; the coefficients of the others are zero. So
    /// many rows of each recording take part.
    pub fn new(
        problem: &SensorProblem,
        values: &[f64],
        fixed: &[usize],
        per_recording: usize,
    ) -> Self {
        let departures = problem.departures(values);
        let (mut residual, mut columns) = (Vec::new(), Vec::new());
        let (mut ends, mut rows, mut met) = (Vec::new(), Vec::new(), Vec::new());
        let at = problem.base.linear(&values[..problem.base_count]);
        let mut unused = vec![Vector3::zeros(); problem.base_count];
        for (part, of) in problem.rows.parts.iter().enumerate() {
            let linear = problem.linear(part, &departures);
            let series = problem.series(part, values);
            let picked: Vec<usize> = picked(of.len(), per_recording).collect();
            for &row in &picked {
                let error = of.field_g[row] - linear.fields[row];
                for axis in 0..3 {
                    residual.push(error[axis] * problem.weights[axis]);
                    let row = linear.jacobian.row(3 * row + axis);
                    columns.extend(fixed.iter().map(|&slot| row[slot] * problem.weights[axis]));
                }
            }
            let response = |&row: &usize| {
                let state = series.states[row];
                (row, state, at(&state, &mut unused))
            };
            rows.push(picked.iter().map(response).collect());
            ends.push(residual.len());
            met.push((of.track.at(&picked), series.at(&picked)));
        }
        let fixed = DMatrix::from_row_slice(residual.len(), fixed.len(), &columns);
        let residual = DVector::from_vec(residual);
        Self {
            normals: Arc::new(Normals::new(fixed, residual.clone(), &ends)),
            residual,
            rows: Arc::new(rows),
            met: Arc::new(met),
        }
    }

    /// Every so-manieth row of it.
    pub fn thinned(&self, step: usize) -> Self {
        let (mut entries, mut ends) = (Vec::new(), Vec::new());
        let (mut rows, mut met) = (Vec::new(), Vec::new());
        let mut start = 0;
        for (of, (track, series)) in self.rows.iter().zip(self.met.iter()) {
            let kept: Vec<usize> = (0..of.len()).step_by(step.max(1)).collect();
            let first = |row: &usize| start + 3 * row;
            entries.extend(kept.iter().flat_map(|row| first(row)..first(row) + 3));
            ends.push(entries.len());
            rows.push(kept.iter().map(|&row| of[row]).collect());
            met.push((track.at(&kept), series.at(&kept)));
            start += 3 * of.len();
        }
        let residual = self.residual.select_rows(&entries);
        let fixed = self.fixed().select_rows(&entries);
        Self {
            normals: Arc::new(Normals::new(fixed, residual.clone(), &ends)),
            residual,
            rows: Arc::new(rows),
            met: Arc::new(met),
        }
    }

    /// States of a recording's rows with an effect whose coefficients are zero in the ground.
    pub fn with(&self, part: usize, effect: &Addition, values: &[f64]) -> Vec<State> {
        let Some((track, series)) = self.met.get(part) else {
            return Vec::new();
        };
        let mut series = series.clone();
        effect.apply(values, track, &mut series);
        series.states
    }

    /// Columns of a curve that is free in time: straight lines between so many knots over each recording,
    /// for each axis.
    pub fn hats(&self, rows: &SensorRows, knots: usize) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(self.residual.len(), 3 * knots * self.rows.len());
        for (at, (part, row)) in self.places().enumerate() {
            let time_s = &rows.parts[part].time_s;
            let (first, last) = (time_s[0], time_s[time_s.len() - 1]);
            let place = (time_s[row] - first) / (last - first).max(f64::MIN_POSITIVE);
            let place = place * (knots - 1) as f64;
            for knot in [place.floor(), place.floor() + 1.0] {
                let height = HIGH * (1.0 - (place - knot).abs());
                for axis in 0..3 {
                    let column = 3 * (knots * part + (knot as usize).min(knots - 1)) + axis;
                    columns[(3 * at + axis, column)] += height;
                }
            }
        }
        columns
    }

    /// What is left, weighted: x, y, z of one row after the other.
    pub fn residual(&self) -> &DVector<f64> {
        &self.residual
    }

    /// Answers of what is fitted already, weighted, by departure.
    pub fn fixed(&self) -> &DMatrix<f64> {
        self.normals.fixed()
    }

    /// Recording, row and response of each row that takes part.
    pub fn responses(&self) -> impl Iterator<Item = (usize, usize, &Response)> {
        let parts = self.rows.iter().enumerate();
        parts.flat_map(|(part, rows)| rows.iter().map(move |(row, _, r)| (part, *row, r)))
    }

    /// Recording and row of each row that takes part.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> {
        let parts = self.rows.iter().enumerate();
        parts.flat_map(|(part, rows)| rows.iter().map(move |(row, ..)| (part, *row)))
    }
}

/// Rows that take part, evenly over a recording.
fn picked(rows: usize, most: usize) -> impl Iterator<Item = usize> + Clone {
    (0..rows).step_by((rows / most).max(1))
}
