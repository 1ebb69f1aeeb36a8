//! The stretches of time in which a model errs most.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::Worst;
use super::rows::SensorColumns;

/// Length of a stretch in seconds: long enough to be looked at, short enough to be one event.
const STRETCH_S: f64 = 1.0;
/// Stretches that are named.
const NAMED: usize = 5;
/// What was going on, by these columns.
const DOING: [(&str, &str); 4] = [
    ("fx_n", "Fx"),
    ("fz_n", "Fz"),
    ("opening_mm", "opening"),
    ("temp_c", ""),
];

/// Sums of one stretch.
#[derive(Clone, Default)]
struct Sums {
    squares: f64,
    rows: usize,
    /// Of each sensor.
    by_sensor: Vec<f64>,
}

/// The worst stretches of all recordings, the worst first. `names` are those of the recordings.
pub fn worst(sensors: &[SensorColumns], names: &[String], spans_s: &[f64]) -> Vec<Worst> {
    let mut stretches: BTreeMap<(u32, usize), Sums> = BTreeMap::new();
    for (i, sensor) in sensors.iter().enumerate() {
        let rows = sensor
            .recording
            .iter()
            .zip(&sensor.time_s)
            .zip(&sensor.residual_g);
        for ((recording, time), residual) in rows {
            let sums = stretches
                .entry((*recording, (time / STRETCH_S) as usize))
                .or_default();
            sums.by_sensor.resize(sensors.len(), 0.0);
            let square = Vector3::norm_squared(residual);
            sums.by_sensor[i] += square;
            sums.squares += square;
            sums.rows += 1;
        }
    }
    let usual = stretches.values().map(|sums| sums.rows).max().unwrap_or(0);
    // The last stretch of a recording may hold a few rows only, which say nothing.
    let mut list: Vec<_> = stretches
        .into_iter()
        .filter(|(_, sums)| 2 * sums.rows >= usual)
        .collect();
    let mean = |sums: &Sums| sums.squares / (3 * sums.rows.max(1)) as f64;
    list.sort_by(|a, b| mean(&b.1).total_cmp(&mean(&a.1)));
    list.truncate(NAMED);
    list.into_iter()
        .map(|((recording, stretch), sums)| {
            let shares = sums.by_sensor.iter().enumerate();
            let sensor = shares
                .max_by(|a, b| a.1.total_cmp(b.1))
                .map_or(0, |(i, _)| i);
            let from_s = stretch as f64 * STRETCH_S;
            let end = spans_s
                .get(recording as usize)
                .copied()
                .unwrap_or(f64::INFINITY);
            Worst {
                recording: names.get(recording as usize).cloned().unwrap_or_default(),
                from_s,
                to_s: (from_s + STRETCH_S).min(end.max(from_s)),
                sensor: sensors[sensor].sensor,
                rms_g: mean(&sums).sqrt(),
                doing: doing(&sensors[sensor], recording, from_s),
            }
        })
        .collect()
}

/// Means over a stretch, in words.
fn doing(sensor: &SensorColumns, recording: u32, from_s: f64) -> String {
    let inside = |row: &usize| {
        let since = sensor.time_s[*row] - from_s;
        sensor.recording[*row] == recording && (0.0..STRETCH_S).contains(&since)
    };
    let rows: Vec<usize> = (0..sensor.len()).filter(inside).collect();
    let mut words = Vec::new();
    for (name, short) in DOING {
        let Some(column) = sensor.column(name) else {
            continue;
        };
        let values = rows.iter().map(|&row| f64::from(column.values[row]));
        let mean = values.sum::<f64>() / rows.len().max(1) as f64;
        let moves = column.values.iter().any(|value| *value != 0.0);
        if mean.is_finite() && moves {
            let unit = column.of.unit;
            words.push(format!("{short} {mean:.0} {unit}").trim_start().to_owned());
        }
    }
    words.join(", ")
}
