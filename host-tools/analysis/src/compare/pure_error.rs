//! Errors that no model of the recorded columns can explain: scatter between visits of the same condition (pure
//! error), and drift at rest.

use crate::compare::covariates::CovariateKind;
use crate::compare::residual_table::{CovariateColumn, ResidualTable};
use std::collections::HashMap;

/// Cell size of a condition, in standard deviations of each covariate.
const CELL: f64 = 0.1;
/// Minimum time between two visits of a condition in seconds.
const MIN_INTERVAL_S: f64 = 1.0;
/// Minimum degrees of freedom of the pure error.
const MIN_FREEDOM: usize = 30;

/// Mean square of the scatter within groups of the same condition, and its degrees of freedom.
fn scatter_within(groups: &[Vec<f64>]) -> (f64, usize) {
    let (mut within, mut freedom) = (0.0, 0);
    for group in groups {
        let mean = group.iter().sum::<f64>() / group.len() as f64;
        within += group.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        freedom += group.len().saturating_sub(1);
    }
    (within / freedom as f64, freedom)
}

/// Standard deviation between visits of the same condition by axis, in gauss; `None` with too few repeated
/// conditions.
pub fn pure_error(sensor: &ResidualTable) -> Option<[f64; 3]> {
    let widths: Vec<(&[f32], f64)> = sensor
        .covariates
        .iter()
        .filter(|column| column.of.kind == CovariateKind::Quantity)
        .filter_map(|column| Some((column.values.as_slice(), CELL * deviation(&column.values)?)))
        .collect();
    let mut cells: HashMap<Vec<i32>, Vec<usize>> = HashMap::new();
    for row in 0..sensor.len() {
        let place =
            |(values, width): &(&[f32], f64)| (f64::from(values[row]) / width).floor() as i32;
        let visits = cells.entry(widths.iter().map(place).collect()).or_default();
        let is_new_visit = visits.last().is_none_or(|&last| {
            sensor.recording[last] != sensor.recording[row]
                || sensor.time_s[row] - sensor.time_s[last] > MIN_INTERVAL_S
        });
        if is_new_visit {
            visits.push(row);
        }
    }
    let found = [0, 1, 2].map(|axis| {
        let residual = |row: &usize| sensor.residual[*row][axis];
        let groups: Vec<Vec<f64>> =
            cells.values().map(|visits| visits.iter().map(residual).collect()).collect();
        let (square, freedom) = scatter_within(&groups);
        (freedom >= MIN_FREEDOM).then(|| square.sqrt())
    });
    Some([found[0]?, found[1]?, found[2]?])
}

/// Standard deviation of a column; `None` where it was not recorded or is constant.
fn deviation(values: &[f32]) -> Option<f64> {
    let finite = || values.iter().map(|value| f64::from(*value)).filter(|v| v.is_finite());
    let count = finite().count();
    let mean = finite().sum::<f64>() / count.max(1) as f64;
    let variance = finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count.max(1) as f64;
    (count == values.len() && variance > 0.0).then(|| variance.sqrt())
}

/// Minimum duration of a rest in seconds.
const MIN_REST_S: f64 = 10.0;
/// Maximum change of each force at rest, in newtons.
const STILL_N: f64 = 2.0;
/// Maximum change of the opening at rest, in millimetres.
const STILL_MM: f64 = 0.2;
/// Averaging time that suppresses white noise, in seconds.
const MEAN_S: f64 = 1.0;

/// Standard deviation of one-second means at rest by axis, in gauss; `None` without a rest of ten seconds.
pub fn drift_at_rest(sensor: &ResidualTable) -> Option<[f64; 3]> {
    let (mut squares, mut freedom) = ([0.0; 3], 0.0);
    for (from, to) in rests(sensor) {
        let means = means(sensor, from, to);
        freedom += means.len().saturating_sub(1) as f64;
        for (axis, squares) in squares.iter_mut().enumerate() {
            let mean = means.iter().map(|m| m[axis]).sum::<f64>() / means.len().max(1) as f64;
            *squares += means.iter().map(|m| (m[axis] - mean).powi(2)).sum::<f64>();
        }
    }
    (freedom > 0.0).then(|| squares.map(|squares| (squares / freedom).sqrt()))
}

/// Row ranges without motion.
fn rests(sensor: &ResidualTable) -> Vec<(usize, usize)> {
    let limits = [("fx_n", STILL_N), ("fz_n", STILL_N), ("opening_mm", STILL_MM)];
    let watched: Vec<(&CovariateColumn, f64)> =
        limits.iter().filter_map(|(name, limit)| Some((sensor.column(name)?, *limit))).collect();
    let mut list = Vec::new();
    let mut from = 0;
    let long = |from: usize, to: usize| {
        to > from && sensor.time_s[to - 1] - sensor.time_s[from] >= MIN_REST_S
    };
    for row in 0..sensor.len() {
        let moved = |(column, limit): &(&CovariateColumn, f64)| {
            f64::from((column.values[row] - column.values[from]).abs()) > *limit
        };
        if sensor.recording[row] != sensor.recording[from] || watched.iter().any(moved) {
            if long(from, row) {
                list.push((from, row));
            }
            from = row;
        }
    }
    if long(from, sensor.len()) {
        list.push((from, sensor.len()));
    }
    list
}

fn means(sensor: &ResidualTable, from: usize, to: usize) -> Vec<[f64; 3]> {
    let second = |row: &usize| ((sensor.time_s[*row] - sensor.time_s[from]) / MEAN_S) as usize;
    let rows: Vec<usize> = (from..to).collect();
    rows.chunk_by(|a, b| second(a) == second(b))
        .map(|rows| {
            let sum = rows.iter().map(|&row| sensor.residual[row]).sum::<nalgebra::Vector3<f64>>();
            (sum / rows.len() as f64).into()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::covariates::Covariate;
    use model_export::fit::FitOptions;
    use model_export::fit::polynomial::{self, Polynomial};
    use model_export::fit::rows::{RecordingRows, SensorRows};
    use model_export::recordings::columns::Axis;
    use nalgebra::Vector3;
    use std::borrow::Cow;

    const FX: Covariate = Covariate {
        name: Cow::Borrowed("fx_n"),
        words: Cow::Borrowed("force"),
        unit: "N",
        kind: CovariateKind::Quantity,
    };

    /// NIST Statistical Reference Datasets, `Pontius`: load (here in millions) and deflection of a load
    /// cell, each load applied twice. Certified for y = b0 + b1 x + b2 x^2.
    const PONTIUS: [(f64, f64); 40] = [
        (0.15, 0.11019),
        (0.3, 0.21956),
        (0.45, 0.32949),
        (0.6, 0.43899),
        (0.75, 0.54803),
        (0.9, 0.65694),
        (1.05, 0.76562),
        (1.2, 0.87487),
        (1.35, 0.98292),
        (1.5, 1.09146),
        (1.65, 1.20001),
        (1.8, 1.30822),
        (1.95, 1.41599),
        (2.1, 1.52399),
        (2.25, 1.63194),
        (2.4, 1.73947),
        (2.55, 1.84646),
        (2.7, 1.95392),
        (2.85, 2.06128),
        (3.0, 2.16844),
        (0.15, 0.11052),
        (0.3, 0.22018),
        (0.45, 0.32939),
        (0.6, 0.43886),
        (0.75, 0.54798),
        (0.9, 0.65739),
        (1.05, 0.76596),
        (1.2, 0.87474),
        (1.35, 0.98300),
        (1.5, 1.09150),
        (1.65, 1.20004),
        (1.8, 1.30818),
        (1.95, 1.41613),
        (2.1, 1.52408),
        (2.25, 1.63159),
        (2.4, 1.73965),
        (2.55, 1.84696),
        (2.7, 1.95445),
        (2.85, 2.06177),
        (3.0, 2.16829),
    ];

    /// A parabola of the load fitted by the project's own base.
    fn fitted() -> Polynomial {
        let part = RecordingRows {
            time_s: (0..40).map(f64::from).collect(),
            force_n: PONTIUS.iter().map(|(load, _)| vec![*load]).collect(),
            field_g: PONTIUS.iter().map(|(_, y)| Vector3::repeat(*y)).collect(),
            field_noise_g: Vector3::zeros(),
            force_noise_n: vec![0.0],
            jitter_n: Vec::new(),
            precision: Vec::new(),
            track: Default::default(),
        };
        let rows = SensorRows {
            sensor: 0,
            orientation: Default::default(),
            forces: vec![(0, Axis::Z)],
            parts: vec![part],
            stride: 1,
            blocks: None,
        };
        polynomial::fit(&rows, Some(2), FitOptions::default()).unwrap().model
    }

    fn field_x(model: &Polynomial, load: f64) -> f64 {
        model.combine(&model.basis().values(&[load])).x
    }

    #[test]
    fn quadratic_coefficients_match_the_certified_values() {
        let model = fitted();
        let at = |load: f64| field_x(&model, load);
        // Newton's divided differences at three loads give the coefficients of powers.
        let (x0, x1, x2) = (0.15, 1.5, 3.0);
        let slope = (at(x1) - at(x0)) / (x1 - x0);
        let b2 = ((at(x2) - at(x1)) / (x2 - x1) - slope) / (x2 - x0);
        let b1 = slope - b2 * (x0 + x1);
        let b0 = at(x0) - b1 * x0 - b2 * x0 * x0;
        let certified =
            [0.673_565_789_473_684e-3, 0.732_059_160_401_003, -0.316_081_871_345_029e-2];
        for (found, certified) in [b0, b1, b2].into_iter().zip(certified) {
            assert!((found / certified - 1.0).abs() < 1e-9, "{found} {certified}");
        }
    }

    #[test]
    fn pure_error_is_the_scatter_between_visits() {
        let mut sensor = ResidualTable::new(0, &[FX]);
        // A force that goes up and down through 100 values; the residual alternates by visit.
        for row in 0..4000_u32 {
            let (visit, place) = (row / 100, row % 100);
            sensor.recording.push(0);
            sensor.time_s.push(f64::from(visit) * 10.0 + f64::from(place) * 0.01);
            sensor.residual.push(Vector3::repeat(if visit % 2 == 0 { 0.3 } else { -0.3 }));
            sensor.floor2.push(Vector3::zeros());
            sensor.covariates[0].values.push(place as f32);
        }
        let scatter = pure_error(&sensor).unwrap();
        // Twenty visits of +0.3 and twenty of -0.3: 0.3 sqrt(40 / 39).
        assert!((scatter[0] - 0.3 * (40.0_f64 / 39.0).sqrt()).abs() < 1e-12);
    }
}
