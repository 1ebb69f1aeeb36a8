//! Levenberg-Marquardt over some rows of one sensor, with a prior of one scale on every parameter.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, OMatrix, Vector3};

use super::FitError;
use super::folds::Stretch;
use super::problem::SensorProblem;
use super::space::Space;

/// Evaluations in one round of the descent, or a little more: enough that steps turned down do not
/// look like an arrival. The library's own hundred for each free direction are minutes in a flat valley.
const EVALUATIONS: usize = 50;
/// A round that lowers the sum of squares by a smaller share than this has arrived: what is left of
/// the valley is flat, and noise decides where in it the solution stands.
const LEAST_GAIN: f64 = 1e-4;
/// A descent that still gains after so many rounds runs away.
const ROUNDS: usize = 30;

/// Model minus measurement over some rows, weighted, and the prior, as a function of the free
/// directions.
struct Descent<'a> {
    problem: &'a SensorProblem<'a>,
    stretches: &'a [Stretch],
    weights: Vector3<f64>,
    space: &'a Space,
    /// Everything that is not free stays as it is here.
    fixed: DVector<f64>,
    free: DVector<f64>,
}

impl Descent<'_> {
    fn departures(&self) -> DVector<f64> {
        &self.fixed + onto(&self.space.free, &self.free)
    }

    fn rows(&self) -> usize {
        3 * self
            .stretches
            .iter()
            .map(|stretch| stretch.rows.len())
            .sum::<usize>()
    }

    /// The recordings that have rows here, each once.
    fn parts(&self) -> Vec<usize> {
        let mut parts: Vec<usize> = self.stretches.iter().map(|stretch| stretch.part).collect();
        parts.dedup();
        parts
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Descent<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, free: &DVector<f64>) {
        self.free.copy_from(free);
    }

    fn params(&self) -> DVector<f64> {
        self.free.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        let departures = self.departures();
        let mut residuals: Vec<f64> = Vec::with_capacity(self.rows() + departures.len());
        for part in self.parts() {
            let fields = self.problem.fields(part, &departures);
            let measured = &self.problem.rows.parts[part].field_g;
            for stretch in self.stretches.iter().filter(|stretch| stretch.part == part) {
                for row in stretch.rows.clone() {
                    residuals.extend(
                        (fields[row] - measured[row])
                            .component_mul(&self.weights)
                            .iter(),
                    );
                }
            }
        }
        residuals.extend(departures.iter());
        residuals
            .iter()
            .all(|r| r.is_finite())
            .then(|| DVector::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, Dyn>> {
        let departures = self.departures();
        let count = departures.len();
        let mut jacobian = DMatrix::zeros(self.rows() + count, count);
        let mut at = 0;
        for part in self.parts() {
            let linear = self.problem.linear(part, &departures);
            for stretch in self.stretches.iter().filter(|stretch| stretch.part == part) {
                let length = 3 * stretch.rows.len();
                let mut target = jacobian.rows_mut(at, length);
                target.copy_from(&linear.jacobian.rows(3 * stretch.rows.start, length));
                for mut column in target.column_iter_mut() {
                    column
                        .iter_mut()
                        .enumerate()
                        .for_each(|(i, value)| *value *= self.weights[i % 3]);
                }
                at += length;
            }
        }
        jacobian.rows_mut(at, count).fill_with_identity();
        Some(onto(&jacobian, &self.space.free))
    }
}

/// `left * right`, column by column. The library's own product picks its instructions by the
/// processor and rounds differently on each; a fit must give the same digits everywhere.
fn onto<C: nalgebra::Dim>(
    left: &DMatrix<f64>,
    right: &nalgebra::OMatrix<f64, Dyn, C>,
) -> nalgebra::OMatrix<f64, Dyn, C>
where
    nalgebra::DefaultAllocator: nalgebra::allocator::Allocator<Dyn, C>,
{
    let columns = C::from_usize(right.ncols());
    let mut product = nalgebra::OMatrix::zeros_generic(Dyn(left.nrows()), columns);
    for (mut column, direction) in product.column_iter_mut().zip(right.column_iter()) {
        for (share, derivative) in direction.iter().zip(left.column_iter()) {
            column.axpy(*share, &derivative, 1.0);
        }
    }
    product
}

/// The departures that fit these rows best, from `start`; what `space` does not free stays there.
pub fn solve(
    problem: &SensorProblem,
    stretches: &[Stretch],
    weights: Vector3<f64>,
    space: &Space,
    start: &DVector<f64>,
) -> Result<DVector<f64>, FitError> {
    let not_converged = |reason: String| FitError::NotConverged {
        sensor: problem.rows.sensor,
        reason,
    };
    let free = onto(&space.free.transpose(), start);
    let descent = Descent {
        problem,
        stretches,
        weights,
        space,
        fixed: space.pinned(start),
        free,
    };
    let descent = descend(descent).map_err(not_converged)?;
    let departures = descent.departures();
    match departures.iter().all(|d| d.is_finite()) {
        true => Ok(departures),
        false => Err(not_converged(
            "the parameters left the range of numbers".to_owned(),
        )),
    }
}

/// The descent in rounds, until it arrives; an error says why it did not.
fn descend(mut descent: Descent) -> Result<Descent, String> {
    // A step that lowers the error by a millionth is no news beside noise.
    let method = LevenbergMarquardt::new()
        .with_ftol(1e-8)
        .with_xtol(1e-8)
        .with_gtol(1e-10)
        .with_patience(EVALUATIONS.div_ceil(descent.free.len() + 1));
    let mut before = f64::INFINITY;
    for _ in 0..ROUNDS {
        let (after, report) = method.minimize(descent);
        descent = after;
        match report.termination {
            TerminationReason::LostPatience => {
                let left = report.objective_function;
                if before - left <= LEAST_GAIN * before && before.is_finite() {
                    return Ok(descent);
                }
                before = left;
            }
            // A recording without noise is fitted to the last digit: that is success as well.
            TerminationReason::NoImprovementPossible(_) => return Ok(descent),
            ref arrived if arrived.was_successful() => return Ok(descent),
            TerminationReason::User(_) | TerminationReason::Numerical(_) => {
                return Err("a value is too large to compute with".to_owned());
            }
            other => return Err(format!("{other:?}")),
        }
    }
    Err(format!("the descent still moves after {ROUNDS} rounds"))
}
