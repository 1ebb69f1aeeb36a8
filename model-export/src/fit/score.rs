//! Held-out error beside the noise floor.

use nalgebra::{DMatrix, DVector, Vector3};

use super::rows::Part;
use crate::inverse::parity;
use crate::recordings::columns::Axis;

/// How well one axis of one sensor is modelled on recordings that the fit did not see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisScore {
    /// Number of the sensor.
    pub sensor: u32,
    /// Axis of its field.
    pub axis: Axis,
    /// Root mean square of measured minus modelled field, in gauss.
    pub held_out_rms_g: f64,
    /// The same on the rows that were fitted.
    pub fitted_rms_g: f64,
    /// What it would be were the model perfect: the sensor's white noise after averaging, and the
    /// reference's noise through dB/dF, added in squares.
    pub floor_g: f64,
    /// Peak-to-peak field in the campaign, in gauss.
    pub span_g: f64,
}

/// Adds up squared errors and squared floors over held-out rows.
#[derive(Clone, Copy, Debug)]
pub struct Tally {
    rows: usize,
    error: Vector3<f64>,
    floor: Vector3<f64>,
    /// Squared errors of the forces that the residual would be taken for, and how many.
    force: (f64, usize),
    /// Squared residuals beside the plane of both forces' fields, and how many.
    beside: (f64, usize),
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            rows: 0,
            error: Vector3::zeros(),
            floor: Vector3::zeros(),
            force: (0.0, 0),
            beside: (0.0, 0),
        }
    }
}

impl Tally {
    /// One row: its residual in gauss, and the field's answer to each force in G/N.
    pub fn add(
        &mut self,
        part: &Part,
        residual: Vector3<f64>,
        per_newton: impl IntoIterator<Item = Vector3<f64>>,
    ) {
        let per_newton: Vec<Vector3<f64>> = per_newton.into_iter().collect();
        let floor = floor_squared(part, per_newton.iter().copied());
        self.rows += 1;
        self.error += residual.component_mul(&residual);
        self.floor += floor;
        if let Some(taken_for) = local_inverse(residual, &per_newton, floor) {
            self.force.0 += taken_for.norm_squared();
            self.force.1 += taken_for.len();
        }
        if let Some((_, beside)) = parity::beside(&per_newton, residual) {
            self.beside.0 += beside * beside;
            self.beside.1 += 1;
        }
    }

    /// The sums over both.
    pub fn with(self, other: &Self) -> Self {
        Self {
            rows: self.rows + other.rows,
            error: self.error + other.error,
            floor: self.floor + other.floor,
            force: (self.force.0 + other.force.0, self.force.1 + other.force.1),
            beside: (
                self.beside.0 + other.beside.0,
                self.beside.1 + other.beside.1,
            ),
        }
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// What would be left by a perfect model: root of the mean over rows and axes, in gauss.
    pub fn floor_g(&self) -> f64 {
        (self.floor.sum() / (3 * self.rows.max(1)) as f64).sqrt()
    }

    /// Root mean square of the force that the residual would be taken for, over all forces, in
    /// newtons; `None` where no force was recorded.
    pub fn rmse_n(&self) -> Option<f64> {
        let (squares, count) = self.force;
        (count > 0).then(|| (squares / count as f64).sqrt())
    }

    /// Root mean square in gauss of what no forces explain: the residual beside the plane of both
    /// forces' fields; `None` where two forces were not recorded.
    pub fn beside_g(&self) -> Option<f64> {
        let (squares, count) = self.beside;
        (count > 0).then(|| (squares / count as f64).sqrt())
    }

    /// Mean squared error over all axes, in gauss squared.
    pub fn mean_square(&self) -> f64 {
        self.error.sum() / (3 * self.rows.max(1)) as f64
    }

    /// One score for each axis; `seen` is the tally of the rows that were fitted.
    pub fn scores(&self, seen: &Self, sensor: u32, span_g: Vector3<f64>) -> Vec<AxisScore> {
        let rows = self.rows.max(1) as f64;
        let axes = Axis::ALL.into_iter().enumerate();
        axes.map(|(i, axis)| AxisScore {
            sensor,
            axis,
            fitted_rms_g: (seen.error[i] / seen.rows.max(1) as f64).sqrt(),
            held_out_rms_g: (self.error[i] / rows).sqrt(),
            floor_g: (self.floor[i] / rows).sqrt(),
            span_g: span_g[i],
        })
        .collect()
    }
}

/// Variance of a perfect model's residual in one row, each axis. Noise that cannot be known (a
/// recording of a few rows) counts as none: the floor is then too low, never too high.
pub fn floor_squared(
    part: &Part,
    per_newton: impl IntoIterator<Item = Vector3<f64>>,
) -> Vector3<f64> {
    let known = |noise: f64| if noise.is_finite() { noise } else { 0.0 };
    let sensor = part.field_noise_g.map(|noise| known(noise).powi(2));
    let through = |(slope, noise): (Vector3<f64>, &f64)| (slope * known(*noise)).map(|x| x * x);
    per_newton
        .into_iter()
        .zip(&part.force_noise_n)
        .map(through)
        .fold(sensor, |sum, term| sum + term)
}

/// The forces that explain a residual best, each axis weighted by its floor: what an error of the
/// field means in newtons.
fn local_inverse(
    residual: Vector3<f64>,
    per_newton: &[Vector3<f64>],
    floor_squared: Vector3<f64>,
) -> Option<DVector<f64>> {
    if per_newton.is_empty() {
        return None;
    }
    let least = 1e-6 * floor_squared.amax().max(f64::MIN_POSITIVE);
    let weight = floor_squared.map(|variance| 1.0 / variance.max(least));
    let count = per_newton.len();
    let weighted: Vec<Vector3<f64>> = per_newton
        .iter()
        .map(|slope| slope.component_mul(&weight))
        .collect();
    let normal = DMatrix::from_fn(count, count, |i, j| weighted[i].dot(&per_newton[j]));
    let right = DVector::from_fn(count, |i, _| weighted[i].dot(&residual));
    Some(normal.cholesky()?.solve(&right))
}

/// Pools scores into one number over all axes and sensors: root of the mean square.
pub fn pooled_rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| {
        (sum + value * value, count + 1)
    });
    (sum / count.max(1) as f64).sqrt()
}
