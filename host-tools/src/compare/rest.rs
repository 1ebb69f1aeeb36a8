//! What wanders while nothing changes.

use super::rows::{Column, SensorColumns};

/// Shortest rest that shows anything slow, in seconds.
const REST_S: f64 = 10.0;
/// At rest every force stays within this many newtons, and the opening within [`STILL_MM`].
const STILL_N: f64 = 2.0;
/// See [`STILL_N`].
const STILL_MM: f64 = 0.2;
/// Seconds over which white noise is averaged away.
const MEAN_S: f64 = 1.0;

/// Standard deviation of one-second means during rests on each axis, in gauss; `None` where the
/// recordings have no rest of ten seconds.
pub fn slow(sensor: &SensorColumns) -> Option<[f64; 3]> {
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

/// Ranges of rows in which nothing moves.
fn rests(sensor: &SensorColumns) -> Vec<(usize, usize)> {
    let limits = [
        ("fx_n", STILL_N),
        ("fz_n", STILL_N),
        ("opening_mm", STILL_MM),
    ];
    let watched: Vec<(&Column, f64)> = limits
        .iter()
        .filter_map(|(name, limit)| Some((sensor.column(name)?, *limit)))
        .collect();
    let mut list = Vec::new();
    let mut from = 0;
    let long =
        |from: usize, to: usize| to > from && sensor.time_s[to - 1] - sensor.time_s[from] >= REST_S;
    for row in 0..sensor.len() {
        let moved = |(column, limit): &(&Column, f64)| {
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

fn means(sensor: &SensorColumns, from: usize, to: usize) -> Vec<[f64; 3]> {
    let second = |row: &usize| ((sensor.time_s[*row] - sensor.time_s[from]) / MEAN_S) as usize;
    let rows: Vec<usize> = (from..to).collect();
    rows.chunk_by(|a, b| second(a) == second(b))
        .map(|rows| {
            let sum = rows
                .iter()
                .map(|&row| sensor.residual_g[row])
                .sum::<nalgebra::Vector3<f64>>();
            (sum / rows.len() as f64).into()
        })
        .collect()
}
