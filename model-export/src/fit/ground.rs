//! Where an effect is sought from.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector3};

use super::normal::Normals;
use super::problem::SensorProblem;
use crate::physics::{Response, State};

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
        let (mut ends, mut rows) = (Vec::new(), Vec::new());
        let at = problem.base.linear(&values[..problem.base_count]);
        let mut unused = vec![Vector3::zeros(); problem.base_count];
        for part in 0..problem.rows.parts.len() {
            let linear = problem.linear(part, &departures);
            let states = problem.states(part, values);
            let mut of_part = Vec::new();
            for row in picked(problem.rows.parts[part].len(), per_recording) {
                let error = problem.rows.parts[part].field_g[row] - linear.fields[row];
                for axis in 0..3 {
                    residual.push(error[axis] * problem.weights[axis]);
                    let row = linear.jacobian.row(3 * row + axis);
                    columns.extend(fixed.iter().map(|&slot| row[slot] * problem.weights[axis]));
                }
                of_part.push((row, states[row], at(&states[row], &mut unused)));
            }
            ends.push(residual.len());
            rows.push(of_part);
        }
        let fixed = DMatrix::from_row_slice(residual.len(), fixed.len(), &columns);
        let residual = DVector::from_vec(residual);
        Self {
            normals: Arc::new(Normals::new(fixed, residual.clone(), &ends)),
            residual,
            rows: Arc::new(rows),
        }
    }

    /// What is left, weighted: x, y, z of one row after the other.
    pub fn residual(&self) -> &DVector<f64> {
        &self.residual
    }

    /// Answers of what is fitted already, weighted, by departure.
    pub fn fixed(&self) -> &DMatrix<f64> {
        self.normals.fixed()
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
