//! Base model without a known geometry: each field axis as a polynomial of the forces.

use nalgebra::{DMatrix, DVector, Vector3};
use serde::Serialize;

use crate::fit::block_bootstrap::{self, Block};
use crate::fit::cross_validation::{CvSplit, ErrorSums, RowRange, all_rows, time_slices};
use crate::fit::rows::{RecordingRows, SensorRows, least_rows};
use crate::fit::{AxisScore, FitError, FitOptions};
use crate::input::MAX_POLYNOMIAL_TERMS;
use crate::recordings::columns::Axis;

/// Maximum degree of the automatic choice.
pub const MAX_DEGREE: usize = 7;

/// A lower degree is preferred while its held-out mean square exceeds the best by at most this fraction.
const DEGREE_TOLERANCE: f64 = 0.01;

/// Field as a polynomial of the forces: products of Legendre polynomials of the scaled forces, up
/// to a total degree. Legendre polynomials keep the least squares well conditioned.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    /// Total degree.
    pub degree: usize,
    /// The forces, in the order of the arguments.
    pub forces: Vec<(u32, Axis)>,
    /// Range of each force in newtons that is scaled to -1 to 1.
    pub spans_n: Vec<(f64, f64)>,
    /// Coefficients in gauss: a row for each term of [`Polynomial::terms`], a column for each axis.
    pub coefficients_g: DMatrix<f64>,
}

impl Polynomial {
    /// Degrees in each force, one entry for each term, the constant first.
    pub fn terms(forces: usize, degree: usize) -> Vec<Vec<usize>> {
        let mut terms = vec![Vec::new()];
        for _ in 0..forces {
            terms = terms
                .into_iter()
                .flat_map(|term| {
                    let left = degree - term.iter().sum::<usize>();
                    (0..=left).map(move |power| term.iter().copied().chain([power]).collect())
                })
                .collect();
        }
        terms.sort_by_key(|term: &Vec<usize>| term.iter().sum::<usize>());
        terms
    }

    /// Number of [`Polynomial::terms`], the binomial coefficient; `None` beyond the range of an integer.
    pub(crate) fn term_count(forces: usize, degree: usize) -> Option<usize> {
        (1..=forces)
            .try_fold(1_usize, |count, i| Some(count.checked_mul(degree.checked_add(i)?)? / i))
    }

    /// Basis functions of the polynomial, for the evaluation of many rows.
    pub fn basis(&self) -> LegendreBasis {
        LegendreBasis::new(&self.spans_n, self.degree)
    }

    /// Field in gauss with these values of the terms; with their derivatives to a force, its derivative.
    pub fn combine(&self, values: &[f64]) -> Vector3<f64> {
        let mut field = Vector3::zeros();
        for (value, row) in values.iter().zip(self.coefficients_g.row_iter()) {
            field += Vector3::new(row[0], row[1], row[2]) * *value;
        }
        field
    }
}

/// Products of Legendre polynomials of the scaled forces, up to a total degree.
#[derive(Clone, Debug)]
pub struct LegendreBasis {
    degree: usize,
    /// Range of each force in newtons that is scaled to -1 to 1.
    spans_n: Vec<(f64, f64)>,
    terms: Vec<Vec<usize>>,
}

/// Values of all terms at one load, and their derivatives to each force in 1/N.
pub struct BasisValues {
    /// One for each of [`Polynomial::terms`].
    pub values: Vec<f64>,
    /// A list like the values for each force.
    pub per_newton: Vec<Vec<f64>>,
}

impl LegendreBasis {
    /// Up to a total `degree` of forces with these ranges.
    pub fn new(spans_n: &[(f64, f64)], degree: usize) -> Self {
        let terms = Polynomial::terms(spans_n.len(), degree);
        Self { degree, spans_n: spans_n.to_vec(), terms }
    }

    /// Values of all terms under `force_n`, in the order of [`Polynomial::forces`].
    pub fn values(&self, force_n: &[f64]) -> Vec<f64> {
        let legendre = self.legendre(force_n);
        self.products(|force, power| legendre[force][power].0)
    }

    /// Values of all terms under `force_n`, and their derivatives.
    pub fn linearise(&self, force_n: &[f64]) -> BasisValues {
        let legendre = self.legendre(force_n);
        let values = self.products(|force, power| legendre[force][power].0);
        let slope = |along: usize| {
            self.products(|force, power| {
                let (value, slope) = legendre[force][power];
                if force == along { slope } else { value }
            })
        };
        BasisValues { values, per_newton: (0..self.spans_n.len()).map(slope).collect() }
    }

    /// Value and derivative of the Legendre polynomial of each force and degree.
    fn legendre(&self, force_n: &[f64]) -> Vec<Vec<(f64, f64)>> {
        let of = |(force, (low, high)): (&f64, &(f64, f64))| {
            let per_newton = 2.0 / (high - low);
            let x = (2.0 * force - low - high) / (high - low);
            let mut list = Vec::with_capacity(self.degree + 2);
            list.extend([(1.0, 0.0), (x, per_newton)]);
            for n in 1..self.degree {
                let n_f = n as f64;
                let ((before, slope_before), (value, _)) = (list[n - 1], list[n]);
                let next = ((2.0 * n_f + 1.0) * x * value - n_f * before) / (n_f + 1.0);
                let slope = slope_before + (2.0 * n_f + 1.0) * value * per_newton;
                list.push((next, slope));
            }
            list
        };
        force_n.iter().zip(&self.spans_n).map(of).collect()
    }

    /// Products over the forces of `factor(force, power)`, one for each term.
    fn products(&self, factor: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        let product = |term: &Vec<usize>| {
            term.iter().enumerate().map(|(force, &power)| factor(force, power)).product()
        };
        self.terms.iter().map(product).collect()
    }
}

/// The fit of one sensor.
#[derive(Clone, Debug)]
pub struct PolynomialFit {
    /// Number of the sensor.
    pub sensor: u32,
    /// The fitted polynomial.
    pub model: Polynomial,
    /// One standard deviation of each coefficient, in gauss.
    pub std_error_g: DMatrix<f64>,
    /// Held-out error and noise floor of each axis.
    pub scores: Vec<AxisScore>,
    /// Held-out error in gauss, root mean square over the axes, of each degree that was tried: of several degrees that of the field
    /// without what is linear in the covariates.
    pub tried: Vec<(usize, f64)>,
    /// Length of the bootstrap's blocks in seconds.
    pub block_s: f64,
}

/// A higher degree that describes the forces clearly better.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HigherDegree {
    /// The degree.
    pub degree: usize,
    /// Held-out error in gauss, root mean square over the axes, with the degree of the model.
    pub now_g: f64,
    /// The same with the higher degree.
    pub then_g: f64,
}

/// Degrees above a stated one that are compared with it.
const HIGHER: usize = 2;
/// Share of the squared error by which a higher degree reduces it clearly.
const CLEARLY: f64 = 0.2;

impl PolynomialFit {
    /// The lowest of the higher degrees that were tried with about the least error, where that is clearly less than with this one.
    pub fn higher_degree(&self) -> Option<HigherDegree> {
        let of = |degree: usize| self.tried.iter().find(|(tried, _)| *tried == degree);
        let (_, now_g) = *of(self.model.degree)?;
        let higher = || self.tried.iter().filter(|(degree, _)| *degree > self.model.degree);
        let least = higher().map(|(_, rms_g)| rms_g.powi(2)).fold(f64::INFINITY, f64::min);
        let (degree, then_g) =
            *higher().find(|(_, g)| g.powi(2) <= (1.0 + DEGREE_TOLERANCE) * least)?;
        let is_clear = then_g.powi(2) < (1.0 - CLEARLY) * now_g.powi(2);
        is_clear.then_some(HigherDegree { degree, now_g, then_g })
    }
}

/// Fits one sensor with a polynomial of `degree`, or of the lowest degree whose held-out error is within 1 % of
/// the best up to [`MAX_DEGREE`]. What depends on other covariates, and is not in the model yet, would hide the curvature that a
/// higher degree describes: degrees are compared on the field without it, a stated one with the next two. Without forces the degree is
/// zero whatever is stated.
pub fn fit(
    rows: &SensorRows,
    degree: Option<usize>,
    options: FitOptions,
) -> Result<PolynomialFit, FitError> {
    let spans = rows.force_spans();
    let is_determined = |degree: usize| {
        let terms = Polynomial::term_count(spans.len(), degree);
        terms.is_some_and(|terms| terms <= MAX_POLYNOMIAL_TERMS && rows.len() >= least_rows(terms))
    };
    let up_to = |first: usize, last: usize| {
        let largest = (first + 1..=last).take_while(|degree| is_determined(*degree)).last();
        first..=largest.unwrap_or(first)
    };
    let degrees = match (degree, rows.forces.is_empty()) {
        (_, true) => 0..=0,
        (Some(stated), false) => up_to(stated, (stated + HIGHER).min(MAX_DEGREE)),
        // At least the first, for the error.
        (None, false) => up_to(1, MAX_DEGREE),
    };
    if let Some(degree) = degrees.clone().find(|degree| !is_small(spans.len(), *degree)) {
        let (sensor, forces, max) = (rows.sensor, spans.len(), MAX_POLYNOMIAL_TERMS);
        return Err(FitError::TooManyTerms { sensor, degree, forces, max });
    }
    let largest = *degrees.end();
    let is_chosen = degrees.clone().count() > 1;
    let without = is_chosen.then(|| without_covariates(rows, &spans, largest)).flatten();
    let compared = without.as_ref().unwrap_or(rows);
    let tried: Vec<(usize, ErrorSums)> = degrees
        .map(|degree| Ok((degree, held_out(compared, &spans, degree)?)))
        .collect::<Result<_, FitError>>()?;
    let best = tried.iter().map(|(_, sums)| sums.mean_square()).fold(f64::INFINITY, f64::min);
    let chosen = tried.iter().find(|(tried, sums)| match degree {
        Some(_) if !rows.forces.is_empty() => Some(*tried) == degree,
        _ => sums.mean_square() <= (1.0 + DEGREE_TOLERANCE) * best,
    });
    let Some((degree, _)) = chosen else {
        let reason = "no degree gave a finite error".to_owned();
        return Err(FitError::NotConverged { sensor: rows.sensor, reason });
    };
    let sums = held_out(rows, &spans, *degree)?;
    let all = all_rows(rows);
    let model = solve(rows, &all, &spans, *degree)?;
    let mut training = ErrorSums::default();
    add_errors(&mut training, rows, &all, &model);
    let (std_error_g, block_s) = error_bars(rows, &model, options);
    Ok(PolynomialFit {
        sensor: rows.sensor,
        model,
        std_error_g,
        scores: {
            let copied = rows.copied_axes();
            let scores = sums.scores(&training, rows.sensor, rows.field_span());
            scores.into_iter().zip(copied).filter(|(_, copied)| !copied).map(|(of, _)| of).collect()
        },
        tried: tried.iter().map(|(d, sums)| (*d, sums.mean_square().sqrt())).collect(),
        block_s,
    })
}

/// Rows of each recording from which the covariates' part is estimated.
const COVARIATE_ROWS: usize = 2000;
/// Minimum rows for each coefficient of that estimate.
const ROWS_PER_COEFFICIENT: usize = 20;
/// Relative ridge of that estimate: covariates may be linearly dependent.
const RIDGE: f64 = 1e-6;
/// Maximum degree of the polynomial in that estimate.
const MAX_DEGREE_OF_ESTIMATE: usize = 5;

/// The rows with the field without what is linear in each covariate and rate of the forces, also in its product with a force;
/// estimated together with a polynomial of a degree up to `degree`. `None` without a covariate that varies, or with too few rows.
fn without_covariates(
    rows: &SensorRows,
    spans: &[(f64, f64)],
    degree: usize,
) -> Option<SensorRows> {
    let parts: Vec<Vec<(&str, Vec<f64>)>> = rows.parts.iter().map(covariate_columns).collect();
    let names = |part: &[(&str, Vec<f64>)]| part.iter().map(|(name, _)| name.to_string()).collect();
    let all: Vec<Vec<String>> = parts.iter().map(|part| names(part)).collect();
    if all.iter().any(|names| *names != all[0]) {
        return None;
    }
    let values = |column: usize| parts.iter().flat_map(move |part| &part[column].1);
    let mean_and_deviation = |column: usize| {
        let total = values(column).count().max(1) as f64;
        let mean = values(column).sum::<f64>() / total;
        let square = values(column).map(|value| (value - mean).powi(2)).sum::<f64>() / total;
        let varies = square.is_finite() && square.sqrt() > 1e-9 * mean.abs().max(1e-9);
        varies.then(|| (mean, square.sqrt()))
    };
    let scales: Vec<_> = (0..all.first().map_or(0, Vec::len)).map(mean_and_deviation).collect();
    let basis = LegendreBasis::new(spans, degree.min(MAX_DEGREE_OF_ESTIMATE));
    // One, and each force.
    let linear = LegendreBasis::new(spans, 1);
    let terms = basis.terms.len();
    let own = scales.iter().flatten().count() * linear.terms.len();
    let regressors = |part: usize, row: usize, force_n: &[f64]| -> DVector<f64> {
        let mut list = basis.values(force_n);
        let factors = linear.values(force_n);
        for ((_, column), scale) in parts[part].iter().zip(&scales) {
            let Some((mean, deviation)) = scale else { continue };
            let value = (column[row] - mean) / deviation;
            list.extend(factors.iter().map(|factor| value * factor));
        }
        DVector::from_vec(list)
    };
    let mut normal = DMatrix::zeros(terms + own, terms + own);
    let mut right = DMatrix::zeros(terms + own, 3);
    let mut used = 0;
    for (part, rows) in rows.parts.iter().enumerate() {
        for row in (0..rows.len()).step_by(rows.len().div_ceil(COVARIATE_ROWS).max(1)) {
            let values = regressors(part, row, &rows.force_n[row]);
            normal.ger(1.0, &values, &values, 1.0);
            right += &values * rows.field_g[row].transpose();
            used += 1;
        }
    }
    if own == 0 || used < ROWS_PER_COEFFICIENT * (terms + own) {
        return None;
    }
    for i in terms..terms + own {
        normal[(i, i)] += RIDGE * used as f64;
    }
    let mut coefficients = normal.cholesky()?.solve(&right);
    coefficients.rows_mut(0, terms).fill(0.0);
    let mut without = rows.clone();
    for (part, rows) in without.parts.iter_mut().enumerate() {
        for row in 0..rows.field_g.len() {
            let values = regressors(part, row, &rows.force_n[row]);
            rows.field_g[row] -= coefficients.tr_mul(&values).fixed_rows::<3>(0);
        }
    }
    Some(without)
}

/// Covariates of one recording by name: temperature, those of the gripper (angles as sine and cosine), rates of the forces.
fn covariate_columns(rows: &RecordingRows) -> Vec<(&str, Vec<f64>)> {
    let track = &rows.track;
    let mut columns = Vec::new();
    if !track.temperature_c.is_empty() {
        columns.push(("temp_c", track.temperature_c.clone()));
    }
    for (name, values) in &track.covariates {
        if name.ends_with("_rad") {
            columns.push((name, values.iter().map(|angle| angle.sin()).collect()));
            columns.push((name, values.iter().map(|angle| angle.cos()).collect()));
        } else {
            columns.push((name, values.clone()));
        }
    }
    for (axis, name) in ["fx_rate_n_per_s", "fz_rate_n_per_s"].into_iter().enumerate() {
        columns.push((name, track.rate_n_per_s.iter().map(|rate| rate[axis]).collect()));
    }
    columns
}

fn is_small(forces: usize, degree: usize) -> bool {
    Polynomial::term_count(forces, degree).is_some_and(|terms| terms <= MAX_POLYNOMIAL_TERMS)
}

/// Gap between held-out and fitted rows in seconds, at most, and relative to the longest recording.
const MAX_GAP_S: f64 = 1.0;
const GAP: f64 = 1.0 / 24.0;

fn held_out(rows: &SensorRows, spans: &[(f64, f64)], degree: usize) -> Result<ErrorSums, FitError> {
    let mut sums = ErrorSums::default();
    let span_s =
        |part: &RecordingRows| part.time_s.last().zip(part.time_s.first()).map(|(b, a)| b - a);
    let longest_s = rows.parts.iter().filter_map(span_s).fold(0.0, f64::max);
    let gap_s = MAX_GAP_S.min(GAP * longest_s);
    for fold in CvSplit::of(std::slice::from_ref(rows)).folds(rows, gap_s) {
        if fold.test.iter().all(|range| range.rows.is_empty()) {
            continue;
        }
        let model = solve(rows, &fold.training, spans, degree)?;
        add_errors(&mut sums, rows, &fold.test, &model);
    }
    Ok(sums)
}

fn add_errors(sums: &mut ErrorSums, rows: &SensorRows, ranges: &[RowRange], model: &Polynomial) {
    let basis = model.basis();
    for range in ranges {
        let part = &rows.parts[range.part];
        for row in range.rows.clone() {
            let at = basis.linearise(&part.force_n[row]);
            let residual = part.field_g[row] - model.combine(&at.values);
            sums.add(
                (part, row),
                residual,
                at.per_newton.iter().map(|slopes| model.combine(slopes)),
            );
        }
    }
}

fn solve(
    rows: &SensorRows,
    ranges: &[RowRange],
    spans: &[(f64, f64)],
    degree: usize,
) -> Result<Polynomial, FitError> {
    let basis = LegendreBasis::new(spans, degree);
    let count = basis.terms.len();
    let mut normal = DMatrix::zeros(count, count);
    let mut right = DMatrix::zeros(count, 3);
    for range in ranges {
        let part = &rows.parts[range.part];
        for row in range.rows.clone() {
            let values = DVector::from_vec(basis.values(&part.force_n[row]));
            normal.ger(1.0, &values, &values, 1.0);
            right += &values * part.field_g[row].transpose();
        }
    }
    let not_converged = || FitError::NotConverged {
        sensor: rows.sensor,
        reason: format!(
            "the loads do not determine {count} terms of degree {degree}: use a lower --degree"
        ),
    };
    let coefficients_g = normal.cholesky().ok_or_else(not_converged)?.solve(&right);
    Ok(Polynomial { degree, forces: rows.forces.clone(), spans_n: spans.to_vec(), coefficients_g })
}

fn error_bars(rows: &SensorRows, model: &Polynomial, options: FitOptions) -> (DMatrix<f64>, f64) {
    let basis = model.basis();
    let count = basis.terms.len();
    let residuals: Vec<Vec<Vector3<f64>>> = rows
        .parts
        .iter()
        .map(|part| {
            let loads = part.force_n.iter().zip(&part.field_g);
            loads.map(|(force, field)| field - model.combine(&basis.values(force))).collect()
        })
        .collect();
    let (length_s, _) = block_bootstrap::block_length_s(rows, |part, axis| {
        residuals[part].iter().map(|r| r[axis]).collect()
    });
    let mut bars = DMatrix::zeros(count, 3);
    for axis in 0..3 {
        let mut list = Vec::new();
        for (part, residuals) in rows.parts.iter().zip(&residuals) {
            for range in time_slices(&part.time_s, length_s) {
                let mut block = Block::zeros(count);
                for i in range {
                    let values = DVector::from_vec(basis.values(&part.force_n[i]));
                    block.normal.ger(1.0, &values, &values, 1.0);
                    block.score.axpy(residuals[i][axis], &values, 1.0);
                }
                list.push(block);
            }
        }
        let covariance =
            block_bootstrap::bootstrap_covariance(&list, 0.0, options.draws, options.seed);
        bars.set_column(axis, &covariance.diagonal().map(|v| v.max(0.0).sqrt()));
    }
    (bars, length_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_forces_of_degree_two_have_six_terms() {
        let terms = Polynomial::terms(2, 2);
        assert_eq!(terms.len(), 6);
        assert_eq!(terms[0], [0, 0]);
        assert!(terms.contains(&vec![1, 1]) && terms.contains(&vec![0, 2]));
    }

    #[test]
    fn number_of_terms_is_known_without_listing_them() {
        for (forces, degree) in [(0, 3), (1, 0), (1, 9), (2, 2), (3, 9), (8, 4)] {
            let count = Polynomial::terms(forces, degree).len();
            assert_eq!(Polynomial::term_count(forces, degree), Some(count));
        }
        assert_eq!(Polynomial::term_count(60, usize::MAX), None);
        // 715 and 1001 terms of four forces; 1000 and 1001 of a plane.
        for (forces, degree, expected) in
            [(4, 9, true), (4, 10, false), (999, 1, true), (1000, 1, false)]
        {
            assert_eq!(is_small(forces, degree), expected, "{forces} {degree}");
        }
    }

    #[test]
    fn the_basis_is_legendre_s() {
        // P3(0.5) = (5 * 0.125 - 3 * 0.5) / 2 = -0.4375, at force 3 in the range 0 to 4.
        let basis = LegendreBasis::new(&[(0.0, 4.0)], 3);
        assert_eq!(basis.values(&[3.0]), [1.0, 0.5, -0.125, -0.4375]);
        // P2'(0.5) = 3 * 0.5, P3'(0.5) = (15 * 0.25 - 3) / 2, times 2 / 4 per newton.
        assert_eq!(basis.linearise(&[3.0]).per_newton, [[0.0, 0.5, 0.75, 0.1875]]);
        // Terms x z of two forces: 0.5 * 0.25, and the derivatives 0.25 / 2 and 0.5 / 4.
        let basis = LegendreBasis::new(&[(0.0, 4.0), (-4.0, 4.0)], 2);
        let place = basis.terms.iter().position(|term| term == &[1, 1]).unwrap();
        let at = basis.linearise(&[3.0, 1.0]);
        assert_eq!(at.values[place], 0.125);
        assert_eq!([at.per_newton[0][place], at.per_newton[1][place]], [0.125, 0.125]);
    }
}
