//! Levenberg-Marquardt over some rows of one sensor, with a prior of one scale on every parameter.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, OMatrix, Vector3};

use super::FitError;
use super::blocks::Block;
use super::folds::Stretch;
use super::problem::SensorProblem;
use super::space::Space;

/// Evaluations in one round of the descent, or a little more: enough that steps turned down do not
/// look like an arrival. The library's own hundred for each free direction are minutes in a flat valley.
const EVALUATIONS: usize = 50;
/// Arrived: a step that lowers the error by less is no news beside noise.
pub const THERE: f64 = 1e-8;
/// Near enough to look around.
pub const NEAR: f64 = 1e-5;
/// A round that lowers the sum of squares by a smaller share than this has arrived: what is left of
/// the valley is flat, and noise decides where in it the solution stands.
const LEAST_GAIN: f64 = 1e-4;
/// A descent that still gains after so many rounds runs away.
const ROUNDS: usize = 30;

/// Model minus measurement over some rows, weighted, and the prior, as a function of the free
/// directions.
///
/// The method only sees a problem of a few rows with the same normal equations and the same sum of
/// squares: the factor of the normal equations in place of ten thousands of rows.
struct Descent<'a> {
    problem: &'a SensorProblem<'a>,
    stretches: &'a [Stretch],
    weights: Vector3<f64>,
    space: &'a Space,
    /// Everything that is not free stays as it is here.
    fixed: DVector<f64>,
    free: DVector<f64>,
    /// At `free`; `None` where a value is too large to compute with.
    small: Option<Small>,
}

/// A least-squares problem of few rows that stands for one of many.
struct Small {
    jacobian: DMatrix<f64>,
    residuals: DVector<f64>,
}

impl Descent<'_> {
    fn departures(&self) -> DVector<f64> {
        &self.fixed + onto(&self.space.free, &self.free)
    }

    /// The recordings that have rows here, each once.
    fn parts(&self) -> Vec<usize> {
        let mut parts: Vec<usize> = self.stretches.iter().map(|stretch| stretch.part).collect();
        parts.dedup();
        parts
    }

    /// Normal equations and sum of squares at the present place, prior included.
    fn normal(&self) -> (Block, f64) {
        let departures = self.departures();
        let mut sum = Block::zeros(departures.len());
        sum.normal.fill_with_identity();
        sum.score -= &departures;
        let mut squares = departures.norm_squared();
        for part in self.parts() {
            let (jacobian, residuals) = weighted(self.problem, part, &departures, &self.weights);
            for stretch in self.stretches.iter().filter(|stretch| stretch.part == part) {
                let rows = 3 * stretch.rows.start..3 * stretch.rows.end;
                let block = Block::of(jacobian.rows_range(rows.clone()), &residuals[rows.clone()]);
                sum.normal += block.normal;
                sum.score += block.score;
                squares += residuals[rows].iter().map(|r| r * r).sum::<f64>();
            }
        }
        (sum, squares)
    }

    fn small(&self) -> Option<Small> {
        let (full, squares) = self.normal();
        let free = &self.space.free;
        let normal = onto(&onto(&full.normal, free).transpose(), free);
        let score = onto(&free.transpose(), &full.score);
        let finite = squares.is_finite() && normal.iter().chain(&score).all(|v| v.is_finite());
        let factor = finite.then(|| normal.cholesky()).flatten()?.unpack();
        // Measured minus modelled is the score's sign; the method wants modelled minus measured.
        let along = -factor.solve_lower_triangular(&score)?;
        let across = (squares - along.norm_squared()).max(0.0).sqrt();
        Some(Small {
            jacobian: factor.transpose().insert_row(free.ncols(), 0.0),
            residuals: along.push(across),
        })
    }
}

/// Answers and what is left over one recording, weighted; three rows for each of its rows.
pub fn weighted(
    problem: &SensorProblem,
    part: usize,
    departures: &DVector<f64>,
    weights: &Vector3<f64>,
) -> (DMatrix<f64>, Vec<f64>) {
    let linear = problem.linear(part, departures);
    let mut jacobian = linear.jacobian;
    for mut column in jacobian.column_iter_mut() {
        for row in column.as_mut_slice().chunks_exact_mut(3) {
            row.iter_mut()
                .zip(weights.iter())
                .for_each(|(v, w)| *v *= w);
        }
    }
    let measured = &problem.rows.parts[part].field_g;
    let left = measured.iter().zip(&linear.fields);
    let left = left.flat_map(|(measured, modelled)| {
        let error = (measured - modelled).component_mul(weights);
        [error.x, error.y, error.z]
    });
    (jacobian, left.collect())
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Descent<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, free: &DVector<f64>) {
        self.free.copy_from(free);
        self.small = self.small();
    }

    fn params(&self) -> DVector<f64> {
        self.free.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        Some(self.small.as_ref()?.residuals.clone())
    }

    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, Dyn>> {
        Some(self.small.as_ref()?.jacobian.clone())
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
        let shares = direction.iter().zip(left.column_iter());
        for (share, derivative) in shares.filter(|(share, _)| **share != 0.0) {
            column.axpy(*share, &derivative, 1.0);
        }
    }
    product
}

/// The departures that fit these rows best, from `start`; what `space` does not free stays there. It
/// has arrived where a step lowers the sum of squares by a smaller share than `arrived`.
pub fn solve(
    problem: &SensorProblem,
    stretches: &[Stretch],
    weights: Vector3<f64>,
    space: &Space,
    start: &DVector<f64>,
    arrived: f64,
) -> Result<DVector<f64>, FitError> {
    let not_converged = |reason: String| FitError::NotConverged {
        sensor: problem.rows.sensor,
        reason,
    };
    let free = onto(&space.free.transpose(), start);
    let mut descent = Descent {
        problem,
        stretches,
        weights,
        space,
        fixed: space.pinned(start),
        free,
        small: None,
    };
    descent.small = descent.small();
    let descent = descend(descent, arrived).map_err(not_converged)?;
    let departures = descent.departures();
    match departures.iter().all(|d| d.is_finite()) {
        true => Ok(departures),
        false => Err(not_converged(
            "the parameters left the range of numbers".to_owned(),
        )),
    }
}

/// The descent in rounds, until it arrives; an error says why it did not.
fn descend(mut descent: Descent, arrived: f64) -> Result<Descent, String> {
    let method = LevenbergMarquardt::new()
        .with_ftol(arrived)
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
            ref end if end.was_successful() => return Ok(descent),
            TerminationReason::User(_) | TerminationReason::Numerical(_) => {
                return Err("a value is too large to compute with".to_owned());
            }
            other => return Err(format!("{other:?}")),
        }
    }
    Err(format!("the descent still moves after {ROUNDS} rounds"))
}
