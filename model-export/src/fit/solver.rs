//! Levenberg-Marquardt over some rows of one sensor, with a prior of one scale on every parameter.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, OMatrix, Vector3};

use crate::fit::FitError;
use crate::fit::block_bootstrap::Block;
use crate::fit::cross_validation::RowRange;
use crate::fit::identifiability::FreeDirections;
use crate::fit::problem::SensorProblem;

/// Evaluations per round, so that rejected steps do not look like convergence. The library's default takes
/// minutes in a flat valley.
const EVALUATIONS: usize = 50;
/// Relative tolerance of the sum of squares for a final solution.
pub const FINE_TOLERANCE: f64 = 1e-7;
/// The same for a fit to the training rows of a fold, which starts at the fit to all rows.
pub(crate) const FOLD_TOLERANCE: f64 = 1e-4;
/// The same for intermediate solutions. Their residual determines the weight of the data: with 1e-4 it was too large, and the prior
/// shifted the final solution.
pub(crate) const COARSE_TOLERANCE: f64 = 1e-5;
/// Minimum relative gain of a round; below it the valley is flat and the position is determined by noise.
const MIN_GAIN: f64 = 1e-4;
/// Maximum difference of a scaled parameter between two points that count as one.
const SAME_POINT: f64 = 1e-9;
/// Maximum number of rounds.
const ROUNDS: usize = 30;

/// Weighted residuals and prior as a function of the free directions.
///
/// The solver sees an equivalent problem of few rows with the same normal equations and sum of squares: the
/// Cholesky factor in place of ten thousands of rows.
struct Descent<'a> {
    problem: &'a SensorProblem<'a>,
    ranges: &'a [RowRange],
    /// Variance inflation of the data.
    inflation: f64,
    space: &'a FreeDirections,
    /// Component outside the free directions.
    fixed: DVector<f64>,
    free: DVector<f64>,
    /// Equivalent problem at `free`; `None` where a value overflows.
    reduced: Option<ReducedProblem>,
}

/// Equivalent least-squares problem of few rows.
struct ReducedProblem {
    jacobian: DMatrix<f64>,
    residuals: DVector<f64>,
}

impl Descent<'_> {
    fn scaled(&self) -> DVector<f64> {
        &self.fixed + multiply(&self.space.free, &self.free)
    }

    /// Indices of the recordings used, each once.
    fn parts(&self) -> Vec<usize> {
        let mut parts: Vec<usize> = self.ranges.iter().map(|range| range.part).collect();
        parts.dedup();
        parts
    }

    /// Normal equations of the data at the current point.
    fn data(&self) -> Block {
        let scaled = self.scaled();
        let mut sum = Block::zeros(scaled.len());
        for part in self.parts() {
            let acting = self.problem.acting(part);
            self.problem.linearise_in_blocks(part, &scaled, |rows, responses, jacobian| {
                let ranges = self.ranges.iter().filter(|range| range.part == part);
                let within = ranges.filter_map(|range| {
                    let within = range.rows.start.max(rows.start)..range.rows.end.min(rows.end);
                    (!within.is_empty()).then_some(within)
                });
                let mut within = within.peekable();
                if within.peek().is_none() {
                    return;
                }
                let modelled = responses.iter().map(|response| response.field_g);
                let residuals = weighted(self.problem, jacobian, (part, rows.start), modelled);
                for range in within {
                    let rows = 3 * (range.start - rows.start)..3 * (range.end - rows.start);
                    sum += &Block::of((&*jacobian, &acting, scaled.len()), &residuals, rows);
                }
            });
        }
        sum
    }

    /// The reduced problem with these normal equations of the data, and the prior.
    fn reduced(&self, data: &Block) -> Option<ReducedProblem> {
        let scaled = self.scaled();
        let squares = data.squares / self.inflation + scaled.norm_squared();
        let mut full = Block {
            acting: data.acting.clone(),
            normal: &data.normal / self.inflation,
            score: &data.score / self.inflation - scaled,
            squares,
        };
        for i in 0..full.score.len() {
            full.normal[(i, i)] += 1.0;
        }
        let free = &self.space.free;
        let normal = multiply(&multiply(&full.normal, free).transpose(), free);
        let score = multiply(&free.transpose(), &full.score);
        let finite = squares.is_finite() && normal.iter().chain(&score).all(|v| v.is_finite());
        let factor = finite.then(|| normal.cholesky()).flatten()?.unpack();
        // The score is measured minus modelled; the solver expects modelled minus measured.
        let along = -factor.solve_lower_triangular(&score)?;
        let across = (squares - along.norm_squared()).max(0.0).sqrt();
        Some(ReducedProblem {
            jacobian: factor.transpose().insert_row(free.ncols(), 0.0),
            residuals: along.push(across),
        })
    }
}

/// Weighted Jacobian of the acting parameters ([`SensorProblem::acting`]) and residuals of one recording; three rows for each of its
/// rows.
pub fn weighted_jacobian(
    problem: &SensorProblem,
    part: usize,
    scaled: &DVector<f64>,
) -> (DMatrix<f64>, Vec<f64>) {
    let (modelled, mut jacobian) = problem.linearise(part, scaled);
    let residuals = weighted(problem, &mut jacobian, (part, 0), modelled.fields.into_iter());
    (jacobian, residuals)
}

/// Weights a Jacobian of the rows of a recording from `first` on; returns their weighted residuals.
fn weighted(
    problem: &SensorProblem,
    jacobian: &mut DMatrix<f64>,
    (part, first): (usize, usize),
    modelled: impl ExactSizeIterator<Item = Vector3<f64>>,
) -> Vec<f64> {
    let measured = &problem.rows.parts[part].field_g[first..];
    let weights: Vec<Vector3<f64>> =
        (first..first + modelled.len()).map(|row| problem.row_weights(part, row)).collect();
    for mut column in jacobian.column_iter_mut() {
        for (row, weights) in column.as_mut_slice().chunks_exact_mut(3).zip(&weights) {
            row.iter_mut().zip(weights.iter()).for_each(|(v, w)| *v *= w);
        }
    }
    let errors = measured.iter().zip(modelled).zip(&weights);
    let errors = errors.flat_map(|((measured, modelled), weights)| {
        let error = (measured - modelled).component_mul(weights);
        [error.x, error.y, error.z]
    });
    errors.collect()
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Descent<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, free: &DVector<f64>) {
        self.free.copy_from(free);
        self.reduced = self.reduced(&self.data());
    }

    fn params(&self) -> DVector<f64> {
        self.free.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        Some(self.reduced.as_ref()?.residuals.clone())
    }

    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, Dyn>> {
        Some(self.reduced.as_ref()?.jacobian.clone())
    }
}

/// `left * right`, column by column. The library's product selects instructions by processor and rounds
/// differently on each; a fit must be bit-equal everywhere.
fn multiply<C: nalgebra::Dim>(
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

/// Scaled parameters that minimise the squared residuals of these rows, divided by the variance `inflation`, and the prior, from
/// `start`, within the free directions; converged where a step lowers the sum of squares by less than `tolerance`, relative.
/// `at_start` are the normal equations of the same rows at `start`, where they are known.
pub fn minimise(
    problem: &SensorProblem,
    ranges: &[RowRange],
    inflation: f64,
    space: &FreeDirections,
    (start, at_start): (&DVector<f64>, Option<Block>),
    tolerance: f64,
) -> Result<DVector<f64>, FitError> {
    let not_converged =
        |reason: String| FitError::NotConverged { sensor: problem.rows.sensor, reason };
    let free = multiply(&space.free.transpose(), start);
    let mut descent = Descent {
        problem,
        ranges,
        inflation,
        space,
        fixed: space.fixed_part(start),
        free,
        reduced: None,
    };
    // The component outside of the free directions may have changed: then the equations are those of another point, at which the
    // descent would already look converged.
    let has_moved = (descent.scaled() - start).amax() > SAME_POINT;
    let at_start = at_start.filter(|_| !has_moved).unwrap_or_else(|| descent.data());
    descent.reduced = descent.reduced(&at_start);
    let descent = descend(descent, tolerance).map_err(not_converged)?;
    let mut scaled = descent.scaled();
    scaled.iter_mut().zip(&problem.parameters).for_each(|(v, index)| *v = index.within_limits(*v));
    if scaled.iter().all(|d| d.is_finite()) {
        Ok(scaled)
    } else {
        Err(not_converged("the parameters left the range of numbers".to_owned()))
    }
}

/// Minimises in rounds until convergence; the error is the reason for failure.
fn descend(mut descent: Descent, tolerance: f64) -> Result<Descent, String> {
    let method = LevenbergMarquardt::new()
        .with_ftol(tolerance)
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
                if before - left <= MIN_GAIN * before && before.is_finite() {
                    return Ok(descent);
                }
                before = left;
            }
            // A noise-free recording is fitted to the last digit, which is success as well.
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
