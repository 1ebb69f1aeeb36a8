//! The geometric base: an exact cylinder on two flexures, fitted on all three axes jointly.
//!
//! Fourteen parameters describe a sensor, and a recording seldom tells all of them apart: a larger
//! gap looks like a weaker magnet, a tilted magnet like a shifted one. Left alone, such a fit runs
//! away, above all when the model lacks an effect. So a prior as wide as the manufacturing
//! tolerances stays on throughout, and it is weighed against what the data really tell: where the
//! residual has memory or structure, a thousand rows are no thousand witnesses, and the data's
//! weight is lowered by that factor ([`inflation`]).
//!
//! Every direction in the space of parameters (in tolerances) is then judged by the residual
//! itself: one whose error bar is wider than half a tolerance is not known from these data and is
//! held at nominal while the others are fitted. Which directions are held is decided once, on all
//! recordings; the values are fitted anew for each recording left out.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, OMatrix, Vector3};

use super::blocks::{self, Block};
use super::folds::{folds, stretches};
use super::parameters::{COUNT, Departures, Derivatives, PARAMETERS, depart, tolerances, values};
use super::rows::{Part, SensorRows};
use super::score::{Tally, floor_squared};
use super::space::{Held, KNOWN_WITHIN, Space, inflation};
use super::{AxisScore, FitError, Options};
use crate::physics::ForwardModel;

/// Lowers the data's weight in the first round, before their residual is known.
const FIRST_INFLATION: f64 = 1e4;

/// One fitted parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Name, as in [`PARAMETERS`].
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Of the design.
    pub nominal: f64,
    /// Fitted.
    pub value: f64,
    /// One standard deviation; it contains the tolerance of what was held.
    pub std_error: f64,
    /// True where the data know it to half a manufacturing tolerance or better.
    pub identifiable: bool,
}

/// The fit of one sensor.
#[derive(Clone, Debug)]
pub struct CylinderFit {
    /// Number of the sensor.
    pub sensor: u32,
    /// The fitted model.
    pub model: ForwardModel,
    /// Every parameter.
    pub parameters: Vec<Estimate>,
    /// What was held at nominal.
    pub held: Vec<Held>,
    /// Held-out error beside the floor, each axis.
    pub scores: Vec<AxisScore>,
    /// Length of the bootstrap's blocks in seconds.
    pub block_s: f64,
}

/// Fits one sensor; `rows` hold its own two forces.
pub fn fit(
    rows: &SensorRows,
    nominal: &ForwardModel,
    options: Options,
) -> Result<CylinderFit, FitError> {
    let full = weights(rows, nominal);
    let solve = |parts: Vec<&Part>, weights, space: &Space, start: &Departures| {
        solve(parts, nominal, weights, space, start).map_err(|reason| FitError::NotConverged {
            sensor: rows.sensor,
            reason,
        })
    };
    let all = || rows.parts.iter().collect::<Vec<_>>();
    let whole = Space::whole();
    let linear = |at: &Departures| linearised(rows, nominal, at, full);
    let deserved = |blocks: &[Block]| full / inflation(blocks).sqrt();

    // With the data's weight low, to see their residual; then with the weight that it deserves;
    // last with what the data do not tell held at nominal.
    let first = solve(
        all(),
        full / FIRST_INFLATION.sqrt(),
        &whole,
        &Departures::zeros(),
    )?;
    let second = solve(all(), deserved(&linear(&first).1), &whole, &first)?;
    let (_, blocks) = linear(&second);
    let weights = deserved(&blocks);
    let space = Space::known_from(&blocks);
    if space.free.ncols() == 0 {
        return Err(FitError::NotConverged {
            sensor: rows.sensor,
            reason: "these recordings tell none of its parameters".to_owned(),
        });
    }
    let departures = solve(all(), weights, &space, &second)?;
    let (length_s, blocks) = linear(&departures);

    let mut tally = Tally::default();
    for fold in folds(rows, length_s) {
        let training = fold.training.iter().map(AsRef::as_ref).collect();
        let model = depart(nominal, &solve(training, weights, &space, &departures)?);
        for part in &fold.test {
            judge(&mut tally, part, &model);
        }
    }
    let mut seen = Tally::default();
    let model = depart(nominal, &departures);
    for part in &rows.parts {
        judge(&mut seen, part, &model);
    }
    Ok(CylinderFit {
        sensor: rows.sensor,
        model,
        parameters: estimates(nominal, &departures, &space, &blocks, options),
        held: space.held,
        scores: tally.scores(&seen, rows.sensor, rows.field_span()),
        block_s: length_s,
    })
}

fn judge(tally: &mut Tally, part: &Part, model: &ForwardModel) {
    let frames = model.frames();
    for (force, field) in part.force_n.iter().zip(&part.field_g) {
        let response = model.respond_in(&frames, model.displacement([force[0], force[1]]));
        tally.add(part, field - response.field_g, &model.per_newton(&response));
    }
}

/// One over the floor of each axis at rest: every axis counts by what it can tell.
fn weights(rows: &SensorRows, nominal: &ForwardModel) -> Vector3<f64> {
    let per_newton = nominal.per_newton(&nominal.respond(Vector3::zeros()));
    let part = rows.parts.iter().max_by_key(|part| part.len());
    let floor = part.map_or_else(Vector3::zeros, |part| floor_squared(part, &per_newton));
    // Without any noise (a made-up recording) all axes count alike.
    floor.map(|variance| 1.0 / variance.sqrt().max(1e-3))
}

/// Model minus measurement over some parts, weighted, and the prior of one tolerance, as a function
/// of the free directions.
struct Problem<'a> {
    parts: Vec<&'a Part>,
    nominal: &'a ForwardModel,
    weights: Vector3<f64>,
    space: &'a Space,
    free: DVector<f64>,
}

impl Problem<'_> {
    fn departures(&self) -> Departures {
        let all = &self.space.free * &self.free;
        Departures::from_iterator(all.iter().copied())
    }

    fn rows(&self) -> usize {
        3 * self.parts.iter().map(|part| part.len()).sum::<usize>()
    }

    fn samples(&self) -> impl Iterator<Item = ([f64; 2], &Vector3<f64>)> {
        self.parts.iter().flat_map(|part| {
            part.force_n
                .iter()
                .map(|force| [force[0], force[1]])
                .zip(&part.field_g)
        })
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
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
        let model = depart(self.nominal, &departures);
        let mut residuals: Vec<f64> = Vec::with_capacity(self.rows() + COUNT);
        for (force, field) in self.samples() {
            let residual = (model.field(force) - field).component_mul(&self.weights);
            residuals.extend(residual.iter());
        }
        residuals.extend(departures.iter());
        residuals
            .iter()
            .all(|r| r.is_finite())
            .then(|| DVector::from_vec(residuals))
    }

    fn jacobian(&self) -> Option<OMatrix<f64, Dyn, Dyn>> {
        let model = depart(self.nominal, &self.departures());
        let derivatives = Derivatives::new(&model, self.nominal);
        let mut jacobian = DMatrix::zeros(self.rows() + COUNT, COUNT);
        for (i, (force, _)) in self.samples().enumerate() {
            let (_, mut rows) = derivatives.at(force);
            for (mut row, weight) in rows.row_iter_mut().zip(self.weights.iter()) {
                row *= *weight;
            }
            jacobian
                .fixed_view_mut::<3, COUNT>(3 * i, 0)
                .copy_from(&rows);
        }
        jacobian.rows_mut(self.rows(), COUNT).fill_with_identity();
        Some(onto(&jacobian, &self.space.free))
    }
}

/// `jacobian * free`, column by column. The library's own product picks its instructions by the
/// processor and rounds differently on each; a fit must give the same digits everywhere.
fn onto(jacobian: &DMatrix<f64>, free: &DMatrix<f64>) -> DMatrix<f64> {
    let mut product = DMatrix::zeros(jacobian.nrows(), free.ncols());
    for (mut column, direction) in product.column_iter_mut().zip(free.column_iter()) {
        for (share, derivative) in direction.iter().zip(jacobian.column_iter()) {
            column.axpy(*share, &derivative, 1.0);
        }
    }
    product
}

fn solve(
    parts: Vec<&Part>,
    nominal: &ForwardModel,
    weights: Vector3<f64>,
    space: &Space,
    start: &Departures,
) -> Result<Departures, String> {
    let start = DVector::from_iterator(COUNT, start.iter().copied());
    let problem = Problem {
        parts,
        nominal,
        weights,
        space,
        free: space.free.transpose() * start,
    };
    // A step that lowers the error by a millionth is no news beside noise.
    let method = LevenbergMarquardt::new()
        .with_ftol(1e-8)
        .with_xtol(1e-8)
        .with_gtol(1e-10);
    let (problem, report) = method.minimize(problem);
    // A recording without noise is fitted to the last digit: that is success as well.
    let done = report.termination.was_successful()
        || matches!(
            report.termination,
            TerminationReason::NoImprovementPossible(_)
        );
    if !done {
        return Err(match report.termination {
            TerminationReason::User(_) | TerminationReason::Numerical(_) => {
                "a value is too large to compute with".to_owned()
            }
            other => format!("{other:?}"),
        });
    }
    let departures = problem.departures();
    match departures.iter().all(|d| d.is_finite()) {
        true => Ok(departures),
        false => Err("the parameters left the range of numbers".to_owned()),
    }
}

/// The normal equations at `departures`, in blocks of time; and the length of a block in seconds.
fn linearised(
    rows: &SensorRows,
    nominal: &ForwardModel,
    departures: &Departures,
    weights: Vector3<f64>,
) -> (f64, Vec<Block>) {
    let model = depart(nominal, departures);
    let derivatives = Derivatives::new(&model, nominal);
    let evaluated: Vec<Vec<_>> = rows
        .parts
        .iter()
        .map(|part| {
            let loads = part.force_n.iter().zip(&part.field_g);
            loads
                .map(|(force, field)| {
                    let (response, mut jacobian) = derivatives.at([force[0], force[1]]);
                    for (mut row, weight) in jacobian.row_iter_mut().zip(weights.iter()) {
                        row *= *weight;
                    }
                    ((field - response.field_g).component_mul(&weights), jacobian)
                })
                .collect()
        })
        .collect();
    let length_s = blocks::length_s(rows, |part, axis| {
        evaluated[part]
            .iter()
            .map(|(residual, _)| residual[axis])
            .collect()
    });
    let mut blocks = Vec::new();
    for (part, evaluated) in rows.parts.iter().zip(&evaluated) {
        for range in stretches(&part.time_s, length_s) {
            let mut normal = nalgebra::SMatrix::<f64, COUNT, COUNT>::zeros();
            let mut score = Departures::zeros();
            for (residual, jacobian) in &evaluated[range] {
                normal += jacobian.tr_mul(jacobian);
                score += jacobian.tr_mul(residual);
            }
            blocks.push(Block {
                normal: DMatrix::from_iterator(COUNT, COUNT, normal.iter().copied()),
                score: DVector::from_iterator(COUNT, score.iter().copied()),
            });
        }
    }
    (length_s, blocks)
}

fn estimates(
    nominal: &ForwardModel,
    departures: &Departures,
    space: &Space,
    blocks: &[Block],
    options: Options,
) -> Vec<Estimate> {
    let covariance = space.covariance(blocks, options);
    let scale = tolerances(nominal);
    let (start, fitted) = (values(nominal), values(&depart(nominal, departures)));
    PARAMETERS
        .iter()
        .enumerate()
        .map(|(i, parameter)| {
            let in_tolerances = covariance[(i, i)].max(0.0).sqrt();
            Estimate {
                name: parameter.name,
                unit: parameter.unit,
                nominal: start[i],
                value: fitted[i],
                std_error: in_tolerances * scale[i],
                identifiable: in_tolerances <= KNOWN_WITHIN,
            }
        })
        .collect()
}
