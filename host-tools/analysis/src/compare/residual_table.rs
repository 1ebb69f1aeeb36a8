//! Residuals with their covariates by row, the intervals with the largest error, and the residual over two
//! covariates.

use crate::compare::covariates::Covariate;
use crate::compare::{ErrorUnit, MeanCondition, ResidualMap, WorstInterval};
use model_export::effects::ExcitationSeries;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Maximum rows per sensor, five minutes at 100 Hz; longer campaigns are subsampled.
pub const MAX_ROWS: usize = 30_000;

/// Residuals and covariates of one sensor.
#[derive(Clone, Debug)]
pub struct ResidualTable {
    pub sensor: u32,
    /// Index of the recording of each row.
    pub recording: Vec<u32>,
    /// Time in the recording, in seconds.
    pub time_s: Vec<f64>,
    /// Unit of the residual.
    pub unit: ErrorUnit,
    /// Measured minus modelled field, or estimated minus measured forces along x and z.
    pub residual: Vec<Vector3<f64>>,
    /// Squared noise floor.
    pub floor2: Vec<Vector3<f64>>,
    /// The same as forces; empty where the field does not determine both.
    forces: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// The covariates, equal for all sensors.
    pub covariates: Vec<CovariateColumn>,
}

/// Values of a covariate by row.
#[derive(Clone, Debug)]
pub struct CovariateColumn {
    pub of: Covariate,
    /// Values; NaN where it was not recorded.
    pub values: Vec<f32>,
}

impl ResidualTable {
    /// An empty table.
    pub fn new(sensor: u32, covariates: &[Covariate]) -> Self {
        Self {
            sensor,
            recording: Vec::new(),
            time_s: Vec::new(),
            unit: ErrorUnit::default(),
            residual: Vec::new(),
            floor2: Vec::new(),
            forces: Vec::new(),
            covariates: covariates
                .iter()
                .map(|of| CovariateColumn { of: of.clone(), values: Vec::new() })
                .collect(),
        }
    }

    /// Appends every `stride`-th row of one recording.
    pub fn push(
        &mut self,
        recording: usize,
        track: &ExcitationSeries,
        residual: &[Vector3<f64>],
        floor2: &[Vector3<f64>],
        stride: usize,
    ) {
        let rows = || (0..track.len()).step_by(stride);
        self.recording.extend(rows().map(|_| recording as u32));
        self.time_s.extend(rows().map(|row| track.time_s[row]));
        self.residual.extend(rows().map(|row| residual[row]));
        self.floor2.extend(rows().map(|row| floor2[row]));
        for CovariateColumn { of, values: column } in &mut self.covariates {
            match of.values(track, recording + 1) {
                Some(values) => column.extend(rows().map(|row| values[row] as f32)),
                None => column.extend(rows().map(|_| f32::NAN)),
            }
        }
    }

    /// Appends the residual of the same rows as forces in newtons, each with its squared noise floor.
    pub fn push_forces(&mut self, forces: &[(Vector3<f64>, Vector3<f64>)], stride: usize) {
        self.forces.extend(forces.iter().step_by(stride));
    }

    /// The table of the forces; that of the field where the field does not determine both forces.
    pub fn in_newtons(mut self) -> Self {
        if self.forces.len() == self.residual.len() {
            (self.residual, self.floor2) = std::mem::take(&mut self.forces).into_iter().unzip();
            self.unit = ErrorUnit::Newton;
        }
        self
    }

    pub fn column(&self, name: &str) -> Option<&CovariateColumn> {
        self.covariates.iter().find(|column| column.of.name == name)
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }
}

pub fn error_unit(sensors: &[ResidualTable]) -> ErrorUnit {
    sensors.first().map_or_else(ErrorUnit::default, |sensor| sensor.unit)
}

/// Length of an interval in seconds.
const INTERVAL_S: f64 = 1.0;
/// Number of intervals listed.
const LISTED: usize = 5;
/// Covariates that describe an interval, with their labels.
const DESCRIBED_BY: [(&str, &str); 4] =
    [("fx_n", "Fx"), ("fz_n", "Fz"), ("opening_mm", "opening"), ("temp_c", "")];

/// Sums over one interval.
#[derive(Clone, Default)]
struct IntervalSums {
    squares: f64,
    rows: usize,
    /// Squared residual by sensor.
    by_sensor: Vec<f64>,
}

/// The intervals with the largest RMS residual, largest first; `names` and `spans_s` are of the recordings.
pub fn worst_intervals(
    sensors: &[ResidualTable],
    names: &[String],
    spans_s: &[f64],
) -> Vec<WorstInterval> {
    let mut intervals: BTreeMap<(u32, usize), IntervalSums> = BTreeMap::new();
    for (i, sensor) in sensors.iter().enumerate() {
        let rows = sensor.recording.iter().zip(&sensor.time_s).zip(&sensor.residual);
        for ((recording, time), residual) in rows {
            let sums = intervals.entry((*recording, (time / INTERVAL_S) as usize)).or_default();
            sums.by_sensor.resize(sensors.len(), 0.0);
            let square = Vector3::norm_squared(residual);
            sums.by_sensor[i] += square;
            sums.squares += square;
            sums.rows += 1;
        }
    }
    let usual = intervals.values().map(|sums| sums.rows).max().unwrap_or(0);
    // The last interval of a recording may have too few rows.
    let mut list: Vec<_> =
        intervals.into_iter().filter(|(_, sums)| 2 * sums.rows >= usual).collect();
    let unit = error_unit(sensors);
    let mean = |sums: &IntervalSums| sums.squares / (unit.axes() * sums.rows.max(1)) as f64;
    list.sort_by(|a, b| mean(&b.1).total_cmp(&mean(&a.1)));
    list.truncate(LISTED);
    list.into_iter()
        .map(|((recording, interval), sums)| {
            let shares = sums.by_sensor.iter().enumerate();
            let sensor = shares.max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i);
            let from_s = interval as f64 * INTERVAL_S;
            let end = spans_s.get(recording as usize).copied().unwrap_or(f64::INFINITY);
            WorstInterval {
                recording: names.get(recording as usize).cloned().unwrap_or_default(),
                from_s,
                to_s: (from_s + INTERVAL_S).min(end.max(from_s)),
                sensor: sensors[sensor].sensor,
                rms: mean(&sums).sqrt(),
                error_unit: unit,
                conditions: conditions(&sensors[sensor], recording, from_s),
            }
        })
        .collect()
}

/// Means of the main covariates over an interval.
fn conditions(sensor: &ResidualTable, recording: u32, from_s: f64) -> Vec<MeanCondition> {
    let inside = |row: &usize| {
        let since = sensor.time_s[*row] - from_s;
        sensor.recording[*row] == recording && (0.0..INTERVAL_S).contains(&since)
    };
    let rows: Vec<usize> = (0..sensor.len()).filter(inside).collect();
    let mut conditions = Vec::new();
    for (name, label) in DESCRIBED_BY {
        let Some(column) = sensor.column(name) else {
            continue;
        };
        let values = rows.iter().map(|&row| f64::from(column.values[row]));
        let mean = values.sum::<f64>() / rows.len().max(1) as f64;
        let moves = column.values.iter().any(|value| *value != 0.0);
        if mean.is_finite() && moves {
            conditions.push(MeanCondition { label, mean, unit: column.of.unit });
        }
    }
    conditions
}

/// Cells along each side.
const CELLS: usize = 12;
/// Minimum rows of a cell.
const MIN_ROWS: usize = 5;

/// RMS residual on an even grid over the central 99 % of two covariates; `None` if one is constant.
pub fn residual_map(
    sensors: &[ResidualTable],
    across: usize,
    upwards: usize,
) -> Option<ResidualMap> {
    let edges = [edges(sensors, across)?, edges(sensors, upwards)?];
    let mut squares = vec![[0.0; CELLS]; CELLS];
    let mut rows = vec![[0_usize; CELLS]; CELLS];
    let (mut floor, mut all) = (0.0, 0_usize);
    for sensor in sensors {
        let (x, y) = (&sensor.covariates[across].values, &sensor.covariates[upwards].values);
        for (row, residual) in sensor.residual.iter().enumerate() {
            floor += sensor.floor2[row].sum();
            all += 1;
            let cell = |edges: &[f64], value: f32| {
                let value = f64::from(value);
                let inside = edges.first()? <= &value && &value <= edges.last()?;
                let place = edges.partition_point(|edge| *edge <= value).saturating_sub(1);
                inside.then(|| place.min(CELLS - 1))
            };
            if let (Some(i), Some(j)) = (cell(&edges[0], x[row]), cell(&edges[1], y[row])) {
                squares[j][i] += residual.norm_squared();
                rows[j][i] += 1;
            }
        }
    }
    let [across_edges, upwards_edges] = edges;
    let unit = error_unit(sensors);
    Some(ResidualMap {
        axes: [across, upwards].map(|covariate| label(sensors, covariate)),
        across: across_edges,
        upwards: upwards_edges,
        rms: squares
            .iter()
            .zip(&rows)
            .map(|(squares, rows)| {
                let cell = |(square, rows): (&f64, &usize)| {
                    if *rows >= MIN_ROWS {
                        (square / (unit.axes() * rows) as f64).sqrt()
                    } else {
                        f64::NAN
                    }
                };
                squares.iter().zip(rows).map(cell).collect()
            })
            .collect(),
        floor: (floor / (unit.axes() * all.max(1)) as f64).sqrt(),
        error_unit: unit,
    })
}

fn label(sensors: &[ResidualTable], covariate: usize) -> String {
    let Some(first) = sensors.first() else {
        return String::new();
    };
    let covariate = &first.covariates[covariate].of;
    match covariate.unit {
        "" => covariate.words.to_string(),
        unit => format!("{} / {unit}", covariate.words),
    }
}

fn edges(sensors: &[ResidualTable], covariate: usize) -> Option<Vec<f64>> {
    let values = sensors.iter().flat_map(|sensor| &sensor.covariates[covariate].values);
    let mut sorted: Vec<f32> = values.copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let at = |share: f64| sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize);
    let (low, high) = (f64::from(*at(0.005)?), f64::from(*at(0.995)?));
    let edge = |i: usize| low + (high - low) * i as f64 / CELLS as f64;
    (high > low).then(|| (0..=CELLS).map(edge).collect())
}
