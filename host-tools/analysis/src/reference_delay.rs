//! Delay between the clocks of board and reference, from the loads alone.
//!
//! The reference's forces are regressed on the fields and their squares, averaged over the reference's period at a
//! delayed time; the delay minimises the residual. Its standard error comes from the scores, summed over blocks so that
//! correlated residuals do not make it too small (Liang and Zeger 1986).
//!
//! An effect that lags the load, such as viscous lag, is seen as a delay. If the lateral and the longitudinal forces differ,
//! the smaller delay is the clock's, because a field follows its load. What both axes have in common stays in the delay:
//! compare with `viscous_lag` and `clock_skew` of `diagnose`.
//!
//! A small standard error is no evidence that the reference is the right one: of 50 simulated pairs of unrelated fields and forces, 31
//! have one of at most 2 ms. [`DelayDoubt`] states what else is required; these pairs have at most 0.29 of their variance explained.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::Context;
use model_export::output::write_output;
use model_export::recordings::DataError;
use model_export::recordings::csv_table::{CellRule, CsvTable};
use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::progress;

/// Length of a block in seconds: longer than the correlation of the residuals.
const BLOCK_S: f64 = 0.5;
/// Steps of the search in seconds, coarse to fine.
const STEPS_S: [f64; 2] = [20e-3, 4e-3];
/// Least standard deviation of a force that carries information, in newtons.
const MIN_N: f64 = 0.05;
/// Least number of rows of a channel.
const MIN_ROWS: usize = 60;
/// Of two delays that a periodic load leaves equally likely the smaller is taken: the cost of the whole search range.
const TIE: f64 = 0.02;
/// Difference of the axes' delays in standard errors from which one of them lags.
const LAG_SIGMAS: f64 = 4.0;
const ITERATIONS: usize = 20;
/// End of the iteration in seconds.
const TOLERANCE_S: f64 = 1e-7;

/// Fields of one sensor on the board's clock.
#[derive(Clone, Debug, Default)]
pub struct FieldSeries {
    /// Ascending times in seconds.
    pub time_s: Vec<f64>,
    /// Field along x, y, z in any unit.
    pub field: Vec<[f64; 3]>,
}

/// A force of the reference on its own clock, next to the sensor whose field it changes.
#[derive(Clone, Debug, Default)]
pub struct ForceSeries {
    /// Ascending times in seconds.
    pub time_s: Vec<f64>,
    /// Forces in newtons; NaN where not measured.
    pub force_n: Vec<f64>,
    /// Index of the sensor.
    pub sensor: usize,
    /// 0: lateral, 1: longitudinal.
    pub axis: usize,
    /// Time over which the reference averages in seconds, where rows were left out; zero: from row to row.
    pub average_s: f64,
}

/// An estimated delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Delay {
    /// Added to the reference's time to obtain the board's, in seconds.
    pub delay_s: f64,
    pub standard_error_s: f64,
    /// 95 % interval in seconds.
    pub interval_s: [f64; 2],
    /// Share of the forces' variance that the fields explain at this delay.
    pub explained: f64,
    /// Additional delay of the lateral and of the longitudinal forces in seconds: the lag of an effect; zero where the axes
    /// agree.
    pub lag_s: [f64; 2],
    /// Unexplained variance at this delay relative to that at the next best separate delay; zero where there is none.
    pub rival: f64,
    /// Unexplained variance at this delay relative to its median over the search range.
    pub depth: f64,
}

/// Least share of the variance that the fields of the right reference explain: the rest is friction, hysteresis and noise.
const MIN_EXPLAINED: f64 = 0.5;
/// Largest ratios of [`Delay::rival`] and [`Delay::depth`] of a distinct delay.
const MAX_RIVAL: f64 = 0.8;
const MAX_DEPTH: f64 = 0.7;
/// Standard error above which the estimated delay is not applied: half a millisecond is the goal.
const MAX_STANDARD_ERROR_S: f64 = 2e-3;

/// Why an estimated delay is not applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DelayDoubt {
    /// The forces hardly vary.
    NoVariation,
    /// The fields do not explain the forces.
    Unexplained,
    /// Another delay explains them nearly as well.
    Ambiguous,
    /// All delays explain them nearly as well: the forces vary slowly.
    SlowVariation,
    /// The standard error is too large.
    Imprecise,
}

impl DelayDoubt {
    /// Reason, and what to record instead.
    pub const fn text(self) -> &'static str {
        match self {
            Self::NoVariation => "its forces hardly vary: vary the loads, or tap",
            Self::Unexplained => {
                "the fields explain too little of it: is it the reference of this gripper, with the right columns?"
            }
            Self::Ambiguous => {
                "another delay explains it nearly as well: vary the loads without a period, or tap"
            }
            Self::SlowVariation => {
                "every delay explains it nearly as well: vary the loads faster, or tap"
            }
            Self::Imprecise => "the estimate is not precise enough: vary the loads faster, or tap",
        }
    }

    /// Why this delay is not applied; none if the data support it.
    fn of(delay: Option<&Delay>) -> Option<Self> {
        let Some(delay) = delay else { return Some(Self::NoVariation) };
        let doubts = [
            (delay.explained < MIN_EXPLAINED, Self::Unexplained),
            (delay.rival > MAX_RIVAL, Self::Ambiguous),
            (delay.depth > MAX_DEPTH, Self::SlowVariation),
            (delay.standard_error_s > MAX_STANDARD_ERROR_S, Self::Imprecise),
        ];
        doubts.into_iter().find_map(|(is_in_doubt, doubt)| is_in_doubt.then_some(doubt))
    }
}

/// Estimates the delay within `±search_s`. `None` if no force varies, or the series do not overlap.
pub fn estimate(fields: &[FieldSeries], forces: &[ForceSeries], search_s: f64) -> Option<Delay> {
    let integrals: Vec<Integral> = fields.iter().map(Integral::new).collect();
    let channels: Vec<Channel> =
        forces.iter().filter_map(|force| Channel::new(force, &integrals, search_s)).collect();
    if channels.is_empty() {
        return None;
    }
    // Mean logarithm of the unexplained variance.
    let unexplained = |delay_s: f64| {
        let fits = channels.iter().map(|channel| channel.fit(delay_s));
        let logarithms = fits.map(|fit| fit.map_or(0.0, |fit| (fit.unexplained.max(1e-12)).ln()));
        logarithms.sum::<f64>() / channels.len() as f64
    };
    let mut best_s = 0.0;
    let mut reach_s = search_s;
    let mut coarse = Vec::new();
    for step_s in STEPS_S {
        let steps = (reach_s / step_s).ceil() as i32;
        let centre_s = best_s;
        let tried = (-steps..=steps).map(|step| centre_s + f64::from(step) * step_s);
        let costs: Vec<_> = tried.map(|delay_s| (delay_s, unexplained(delay_s))).collect();
        let cost =
            |(delay_s, unexplained): &(f64, f64)| unexplained + TIE * delay_s.abs() / search_s;
        (best_s, _) = *costs.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        reach_s = step_s;
        if coarse.is_empty() {
            coarse = costs;
        }
    }
    let delay = refine(&channels, best_s)?;
    let best = unexplained(delay.delay_s);
    // A minimum of the coarse grid is up to half a step from that of the curve.
    let refined = |near_s| refine(&channels, near_s).map(|delay| unexplained(delay.delay_s));
    let rival = rival_s(&coarse, delay.delay_s).and_then(refined);
    let rival = rival.map_or(0.0, |rival| (best - rival).exp());
    coarse.sort_by(|a, b| a.1.total_cmp(&b.1));
    let depth = coarse.get(coarse.len() / 2).map_or(1.0, |(_, median)| (best - median).exp());
    let delay = Delay { rival, depth, ..delay };
    let by_axis = [0, 1].map(|axis| {
        let of_axis: Vec<Channel> =
            channels.iter().filter(|channel| channel.axis == axis).cloned().collect();
        refine(&of_axis, best_s)
    });
    let [Some(x), Some(z)] = by_axis else { return Some(delay) };
    let difference_s = x.delay_s - z.delay_s;
    let sigma_s = x.standard_error_s.hypot(z.standard_error_s);
    Some(if difference_s.abs() < LAG_SIGMAS * sigma_s {
        delay
    } else if difference_s > 0.0 {
        Delay { lag_s: [difference_s, 0.0], rival, depth, ..z }
    } else {
        Delay { lag_s: [0.0, -difference_s], rival, depth, ..x }
    })
}

/// Best separate delay: a minimum of the unexplained variance over the search range, or its end.
fn rival_s(coarse: &[(f64, f64)], best_s: f64) -> Option<f64> {
    let is_minimum = |place: usize| {
        let neighbours = [place.checked_sub(1), Some(place + 1)].into_iter().flatten();
        neighbours.filter_map(|place| coarse.get(place)).all(|(_, other)| coarse[place].1 <= *other)
    };
    let minima = (0..coarse.len()).filter(|place| is_minimum(*place)).map(|place| coarse[place]);
    let separate = minima.filter(|(delay_s, _)| (delay_s - best_s).abs() > 1.5 * STEPS_S[0]);
    separate.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(delay_s, _)| delay_s)
}

/// Share of the variance of each force that the fields at its times do not explain; NaN where it does not vary.
pub fn unexplained(fields: &[FieldSeries], forces: &[ForceSeries]) -> Vec<f64> {
    let integrals: Vec<Integral> = fields.iter().map(Integral::new).collect();
    let left = |force: &ForceSeries| {
        let fit = Channel::new(force, &integrals, 0.0)?.fit(0.0)?;
        Some(fit.unexplained)
    };
    forces.iter().map(|force| left(force).unwrap_or(0.0)).collect()
}

/// Minimum of the residual near a delay.
fn refine(channels: &[Channel], near_s: f64) -> Option<Delay> {
    let mut best_s = near_s;
    for _ in 0..ITERATIONS {
        let (score, information) = scores(channels, best_s)
            .fold((0.0, 0.0), |sum, (_, score, information)| (sum.0 + score, sum.1 + information));
        let step_s = (score / information).clamp(-STEPS_S[1], STEPS_S[1]);
        if !step_s.is_finite() {
            return None;
        }
        best_s += step_s;
        if step_s.abs() < TOLERANCE_S {
            break;
        }
    }
    interval(channels, best_s)
}

/// Estimates the delay of a recording from its tables, over at most its first five minutes.
///
/// # Errors
/// A table cannot be read.
pub fn of_recording(folder: &Path, search_s: f64) -> Result<Option<Delay>, DataError> {
    let (fields, forces) = series(folder)?;
    Ok(estimate(&fields, &forces, search_s))
}

/// Fields and forces of a recording from its tables, over at most its first five minutes.
///
/// # Errors
/// A table cannot be read.
pub fn series(folder: &Path) -> Result<(Vec<FieldSeries>, Vec<ForceSeries>), DataError> {
    let hall = columns(folder, "hall.csv")?;
    let force = columns(folder, "force.csv")?;
    let of_prefix = |prefix: &str| hall.iter().find(|(known, _)| known.starts_with(prefix));
    let column = |prefix: &str| of_prefix(prefix).map(|(_, values)| values);
    let sensor_of = |(name, _): &(String, Vec<f64>)| {
        let (sensor, _) = name.strip_prefix('s')?.split_once('_')?;
        sensor.parse::<u32>().ok()
    };
    let sensors: BTreeSet<u32> = hall.iter().filter_map(sensor_of).collect();
    let mut fields = Vec::new();
    let mut forces = Vec::new();
    for sensor in sensors {
        let axes = ["x", "y", "z"].map(|axis| column(&format!("s{sensor}_{axis}_")));
        let Some(first) = axes.into_iter().flatten().next() else { continue };
        let [x, y, z] = axes.map(|axis| axis.unwrap_or(first));
        let Some(times) = column("t_us") else { continue };
        let field = x.iter().zip(y).zip(z).map(|((x, y), z)| [*x, *y, *z]);
        let place = fields.len();
        fields.push(FieldSeries { time_s: seconds(times), field: field.collect() });
        let Some((_, times)) = force.iter().find(|(name, _)| name == "t_us") else { continue };
        for (axis, letter) in ["x", "z"].into_iter().enumerate() {
            let column = format!("f{sensor}_{letter}_n");
            if let Some((_, values)) = force.iter().find(|(name, _)| *name == column) {
                let (time_s, force_n) = (seconds(times), values.clone());
                let average_s = median_step(&time_s).unwrap_or(0.0);
                forces.push(ForceSeries { time_s, force_n, sensor: place, axis, average_s });
            }
        }
    }
    Ok((fields, forces))
}

/// Largest delay of the reference: that of a slow amplifier and of the buffers on its way.
const SEARCH_S: f64 = 0.3;

/// Alignment of the reference's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceAlignment {
    /// The estimate; none where the loads do not show it.
    pub delay: Option<Delay>,
    /// Why the times of the reference were not corrected by it; none where they were.
    pub doubt: Option<DelayDoubt>,
}

/// Estimates the delay of a new recording's reference and corrects its times, if the data support the estimate.
///
/// # Errors
/// A table cannot be read or written.
pub fn align_recording(folder: &Path) -> anyhow::Result<ReferenceAlignment> {
    let spinner = progress::status_spinner("aligning the reference");
    let delay = of_recording(folder, SEARCH_S)?;
    let doubt = DelayDoubt::of(delay.as_ref());
    if let (Some(delay), None) = (delay, doubt) {
        shift_reference(folder, delay.delay_s)?;
    }
    spinner.finish_and_clear();
    Ok(ReferenceAlignment { delay, doubt })
}

/// Adds a delay to the times of `force.csv`: a new file, renamed at the end. Rows before the board's first are removed.
///
/// # Errors
/// The table cannot be read or written.
pub fn shift_reference(folder: &Path, delay_s: f64) -> anyhow::Result<()> {
    let path = folder.join("force.csv");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let mut shifted = String::with_capacity(text.len());
    for (number, line) in text.lines().enumerate() {
        let line = line.trim_end();
        let Some((time, rest)) = line.split_once(',').filter(|_| number > 0) else {
            shifted += line;
            shifted.push('\n');
            continue;
        };
        let time_us: f64 = time.trim().parse().with_context(|| {
            format!("{}: line {}: {time:?} is not a time", path.display(), number + 1)
        })?;
        let time_us = (time_us + 1e6 * delay_s).round();
        if time_us >= 0.0 {
            shifted += &format!("{time_us:.0},{rest}\n");
        }
    }
    write_output(&path, shifted.as_bytes(), "t_us")?;
    Ok(())
}

/// Longest part of a recording that is used, in seconds.
const MAX_S: f64 = 300.0;

/// Columns of a table by name.
fn columns(folder: &Path, name: &'static str) -> Result<Vec<(String, Vec<f64>)>, DataError> {
    let mut table = CsvTable::open(folder, name)?;
    let names = table.header().to_vec();
    let Some(time_column) = names.iter().position(|name| name == "t_us") else {
        return Ok(Vec::new());
    };
    table.set_rules(time_column, vec![CellRule::Optional; names.len()]);
    let mut columns: Vec<(String, Vec<f64>)> =
        names.into_iter().map(|name| (name, Vec::new())).collect();
    while let Some(row) = table.next_row()? {
        if row.cells[time_column] > 1e6 * MAX_S {
            break;
        }
        for ((_, values), cell) in columns.iter_mut().zip(row.cells) {
            values.push(cell);
        }
    }
    Ok(columns)
}

fn seconds(times_us: &[f64]) -> Vec<f64> {
    times_us.iter().map(|us| 1e-6 * us).collect()
}

/// Time, score and information of each row of each channel, weighted by the channel's residual.
fn scores(channels: &[Channel], delay_s: f64) -> impl Iterator<Item = (f64, f64, f64)> {
    channels.iter().filter_map(move |channel| Some((channel, channel.fit(delay_s)?))).flat_map(
        |(channel, fit)| {
            let weight = 1.0 / fit.variance.max(f64::MIN_POSITIVE);
            let rows = fit.gradient.iter().zip(fit.residual.iter()).zip(&channel.time_s);
            let rows = rows.map(move |((gradient, residual), time_s)| {
                (*time_s, weight * gradient * residual, weight * gradient * gradient)
            });
            rows.collect::<Vec<_>>()
        },
    )
}

fn interval(channels: &[Channel], delay_s: f64) -> Option<Delay> {
    let mut blocks = std::collections::BTreeMap::<i64, f64>::new();
    let mut information = 0.0;
    for (time_s, score, share) in scores(channels, delay_s) {
        *blocks.entry((time_s / BLOCK_S).floor() as i64).or_default() += score;
        information += share;
    }
    let count = blocks.len() as f64;
    let squares: f64 = blocks.values().map(|sum| sum * sum).sum();
    // A small-sample factor: the blocks' sums are residuals of a fit.
    let variance = squares / (information * information) * count / (count - 1.0);
    let standard_error_s = variance.sqrt();
    let quantile = StudentsT::new(0.0, 1.0, count - 1.0).ok()?.inverse_cdf(0.975);
    let fits = channels.iter().filter_map(|channel| channel.fit(delay_s));
    let (unexplained, fitted) =
        fits.fold((0.0, 0.0), |sum, fit| (sum.0 + fit.unexplained, sum.1 + 1.0));
    let reach_s = quantile * standard_error_s;
    standard_error_s.is_finite().then_some(Delay {
        delay_s,
        standard_error_s,
        interval_s: [delay_s - reach_s, delay_s + reach_s],
        explained: 1.0 - unexplained / fitted,
        lag_s: [0.0; 2],
        rival: 0.0,
        depth: 0.0,
    })
}

/// Integral over time of the piecewise linear interpolant of a field.
struct Integral<'a> {
    series: &'a FieldSeries,
    /// Up to each sample.
    sums: Vec<[f64; 3]>,
}

impl<'a> Integral<'a> {
    fn new(series: &'a FieldSeries) -> Self {
        let mut sum = [0.0; 3];
        let mut sums = Vec::with_capacity(series.field.len());
        for (place, field) in series.field.iter().enumerate() {
            if let Some(before) = place.checked_sub(1) {
                let step_s = series.time_s[place] - series.time_s[before];
                for axis in 0..3 {
                    sum[axis] += 0.5 * step_s * (field[axis] + series.field[before][axis]);
                }
            }
            sums.push(sum);
        }
        Self { series, sums }
    }

    /// Value and integral at a time; `None` outside of the series.
    fn at(&self, time_s: f64) -> Option<([f64; 3], [f64; 3])> {
        let after = self.series.time_s.partition_point(|time| *time < time_s).max(1);
        let end_s = *self.series.time_s.get(after)?;
        let start_s = self.series.time_s[after - 1];
        if time_s < start_s {
            return None;
        }
        let share = (time_s - start_s) / (end_s - start_s);
        let (from, to) = (self.series.field[after - 1], self.series.field[after]);
        let value = [0, 1, 2].map(|axis| from[axis] + share * (to[axis] - from[axis]));
        let sum = [0, 1, 2].map(|axis| {
            self.sums[after - 1][axis] + 0.5 * (time_s - start_s) * (from[axis] + value[axis])
        });
        Some((value, sum))
    }

    /// Mean over a window and its derivative with respect to the window's time.
    fn mean(&self, centre_s: f64, half_s: f64) -> Option<([f64; 3], [f64; 3])> {
        let ((low, low_sum), (high, high_sum)) =
            (self.at(centre_s - half_s)?, self.at(centre_s + half_s)?);
        let over = |high: [f64; 3], low: [f64; 3]| {
            [0, 1, 2].map(|axis| (high[axis] - low[axis]) / (2.0 * half_s))
        };
        Some((over(high_sum, low_sum), over(high, low)))
    }
}

/// One force with the field of its sensor.
#[derive(Clone)]
struct Channel<'a> {
    axis: usize,
    integral: &'a Integral<'a>,
    half_s: f64,
    /// Times at which the field exists for every delay that is searched.
    time_s: Vec<f64>,
    force_n: Vec<f64>,
    /// Mean and scale of each axis of the field, for the conditioning of the regression.
    scale: [(f64, f64); 3],
}

/// Regression of a force on the delayed field.
struct Fit {
    residual: DVector<f64>,
    /// Derivative of the fitted force with respect to the delay, without what the regressors explain.
    gradient: DVector<f64>,
    /// Mean square of the residual.
    variance: f64,
    /// Relative to the variance of the force.
    unexplained: f64,
}

/// Regressors: a constant, the field, its squares and products.
const REGRESSORS: usize = 10;

impl<'a> Channel<'a> {
    fn new(force: &ForceSeries, integrals: &'a [Integral], search_s: f64) -> Option<Self> {
        let integral = integrals.get(force.sensor)?;
        let half_s = 0.5 * force.average_s.max(0.0);
        let half_s = if half_s > 0.0 { half_s } else { 0.5 * median_step(&force.time_s)? };
        let margin_s = search_s + half_s;
        let (begin_s, end_s) =
            (integral.series.time_s.first()? + margin_s, integral.series.time_s.last()? - margin_s);
        let rows = force.time_s.iter().zip(&force.force_n);
        let (time_s, force_n): (Vec<f64>, Vec<f64>) = rows
            .filter(|(time_s, force_n)| (begin_s..=end_s).contains(*time_s) && force_n.is_finite())
            .unzip();
        let count = force_n.len() as f64;
        let mean_n = force_n.iter().sum::<f64>() / count;
        let std_n = (force_n.iter().map(|n| (n - mean_n).powi(2)).sum::<f64>() / count).sqrt();
        if force_n.len() < MIN_ROWS || std_n < MIN_N {
            return None;
        }
        let field = &integral.series.field;
        let scale = [0, 1, 2].map(|axis| {
            let count = field.len() as f64;
            let mean = field.iter().map(|field| field[axis]).sum::<f64>() / count;
            let squares = field.iter().map(|field| (field[axis] - mean).powi(2));
            (mean, (squares.sum::<f64>() / count).sqrt().max(f64::MIN_POSITIVE))
        });
        Some(Self { axis: force.axis, integral, half_s, time_s, force_n, scale })
    }

    fn fit(&self, delay_s: f64) -> Option<Fit> {
        let rows = self.force_n.len();
        let mut regressors = DMatrix::zeros(rows, REGRESSORS);
        let mut derivatives = DMatrix::zeros(rows, REGRESSORS);
        for (row, time_s) in self.time_s.iter().enumerate() {
            let (value, rate) = self.integral.mean(time_s + delay_s, self.half_s)?;
            let [x, y, z] =
                [0, 1, 2].map(|axis| (value[axis] - self.scale[axis].0) / self.scale[axis].1);
            let [dx, dy, dz] = [0, 1, 2].map(|axis| rate[axis] / self.scale[axis].1);
            let values = [1.0, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x];
            let rates = [
                0.0,
                dx,
                dy,
                dz,
                2.0 * x * dx,
                2.0 * y * dy,
                2.0 * z * dz,
                x * dy + y * dx,
                y * dz + z * dy,
                z * dx + x * dz,
            ];
            for (column, (value, rate)) in values.into_iter().zip(rates).enumerate() {
                regressors[(row, column)] = value;
                derivatives[(row, column)] = rate;
            }
        }
        let force = DVector::from_column_slice(&self.force_n);
        let transposed = regressors.transpose();
        let mut normal = &transposed * &regressors;
        // Axes without variation would make it singular.
        for place in 0..REGRESSORS {
            normal[(place, place)] += 1e-9 * rows as f64;
        }
        let normal = normal.cholesky()?;
        let coefficients = normal.solve(&(&transposed * &force));
        let residual = &force - &regressors * &coefficients;
        let slope = &derivatives * &coefficients;
        let gradient = &slope - &regressors * normal.solve(&(&transposed * &slope));
        let variance = residual.norm_squared() / rows as f64;
        let centred = force.add_scalar(-force.mean());
        Some(Fit {
            unexplained: residual.norm_squared() / centred.norm_squared(),
            residual,
            gradient,
            variance,
        })
    }
}

fn median_step(times_s: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().filter(|step| *step > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    const SECONDS: f64 = 30.0;

    /// Two forces of a sensor as sums of sines, its field with the noise of the sensor, and the reference at 100 Hz with a
    /// slowly varying error in addition to its noise. The field of the lateral force is late by `lag_s`.
    fn recording_with_lag(
        seed: u64,
        delay_s: f64,
        lag_s: f64,
    ) -> (Vec<FieldSeries>, Vec<ForceSeries>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut sines = || -> Vec<[f64; 3]> {
            (0..8)
                .map(|_| {
                    let hz = 0.05 * 60_f64.powf(rng.random::<f64>());
                    [30.0 / (1.0 + hz), TAU * hz, TAU * rng.random::<f64>()]
                })
                .collect()
        };
        let loads = [sines(), sines(), sines()];
        let load = |which: usize, time_s: f64| {
            loads[which]
                .iter()
                .map(|[n, rad_s, phase]| n * (rad_s * time_s + phase).sin())
                .sum::<f64>()
        };
        let mut noise = |sigma: f64| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            sigma * normal
        };
        let mut field = FieldSeries::default();
        for tick in 0..(1000.0 * SECONDS) as u32 {
            let time_s = 1e-3 * f64::from(tick);
            let (x, z) = (load(0, time_s - lag_s), load(1, time_s));
            let bend = 1e-3 * (x * x + z * z);
            field.time_s.push(time_s);
            field.field.push(
                [1.8 * x + 0.1 * z, bend - 0.2 * x, 1.6 * z + 0.3 * bend].map(|g| g + noise(0.35)),
            );
        }
        let mut forces = [0, 1].map(|axis| ForceSeries { axis, ..ForceSeries::default() });
        for row in 0..(100.0 * SECONDS) as u32 {
            let time_s = 1e-2 * f64::from(row);
            for (axis, series) in forces.iter_mut().enumerate() {
                series.time_s.push(time_s - delay_s);
                series.force_n.push(load(axis, time_s) + 0.01 * load(2, time_s) + noise(0.15));
            }
        }
        (vec![field], forces.to_vec())
    }

    fn recording(seed: u64, delay_s: f64) -> (Vec<FieldSeries>, Vec<ForceSeries>) {
        recording_with_lag(seed, delay_s, 0.0)
    }

    #[test]
    fn delay_is_within_half_a_millisecond_and_its_interval_covers_the_truth() {
        let (mut covered, mut worst_s) = (0, 0.0_f64);
        for seed in 0..100 {
            let delay_s = 0.1 * (f64::from(seed as u32) / 50.0 - 1.0);
            let (fields, forces) = recording(seed, delay_s);
            let found = estimate(&fields, &forces, 0.2).unwrap();
            let [low_s, high_s] = found.interval_s;
            covered += u32::from((low_s..=high_s).contains(&delay_s));
            worst_s = worst_s.max((found.delay_s - delay_s).abs());
            assert!(found.explained > 0.99, "{found:?}");
        }
        println!("{covered} of 100 intervals, worst {:.3} ms", 1e3 * worst_s);
        assert!(covered >= 93 && worst_s < 0.5e-3, "{covered} of 100, {worst_s} s");
    }

    #[test]
    fn delay_is_that_of_the_axis_that_does_not_lag() {
        let mut lag_sum_s = 0.0;
        for seed in 0..20 {
            let (fields, forces) = recording(seed, 0.03);
            let agrees = estimate(&fields, &forces, 0.2).unwrap();
            assert_eq!(agrees.lag_s, [0.0; 2], "{agrees:?}");
            let (fields, forces) = recording_with_lag(seed, 0.03, 5e-3);
            let found = estimate(&fields, &forces, 0.2).unwrap();
            let [x_s, z_s] = found.lag_s;
            lag_sum_s += x_s;
            assert!((x_s - 5e-3).abs() < 2e-3 && z_s == 0.0, "{found:?}");
            assert!((found.delay_s - 0.03).abs() < 0.7e-3, "{found:?}");
        }
        assert!((lag_sum_s / 20.0 - 5e-3).abs() < 0.3e-3, "{lag_sum_s}");
    }

    #[test]
    fn delay_is_applied_only_to_the_reference_of_the_gripper() {
        let mut explained: f64 = 0.0;
        for seed in 0..50 {
            let (fields, forces) = recording(seed, 0.03);
            let found = estimate(&fields, &forces, SEARCH_S);
            assert_eq!(DelayDoubt::of(found.as_ref()), None, "{seed}: {found:?}");
            // The forces of another experiment.
            let (_, others) = recording(1000 + seed, 0.0);
            let found = estimate(&fields, &others, SEARCH_S);
            explained = explained.max(found.map_or(0.0, |delay| delay.explained));
            assert!(DelayDoubt::of(found.as_ref()).is_some(), "{seed}: {found:?}");
        }
        // As stated at the top.
        assert!((0.25..0.295).contains(&explained), "{explained}");
    }

    #[test]
    fn delay_of_periodic_or_slow_loads_is_not_applied() {
        // Field and force of one load; its noise is that of the sensors.
        let loaded = |load: &dyn Fn(f64) -> f64| {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let mut noise = |sigma: f64| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                sigma * normal
            };
            let mut field = FieldSeries::default();
            for tick in 0..(1000.0 * SECONDS) as u32 {
                let time_s = 1e-3 * f64::from(tick);
                field.time_s.push(time_s);
                field.field.push([1.8 * load(time_s), 0.0, 0.0].map(|gauss| gauss + noise(0.35)));
            }
            let mut force = ForceSeries::default();
            for row in 0..(100.0 * SECONDS) as u32 {
                let time_s = 1e-2 * f64::from(row);
                force.time_s.push(time_s - 0.03);
                force.force_n.push(load(time_s) + noise(0.5));
            }
            let found = estimate(&[field], &[force], SEARCH_S);
            (DelayDoubt::of(found.as_ref()), found)
        };
        let (doubt, found) = loaded(&|time_s| 20.0 * (TAU * 5.0 * time_s).sin());
        assert_eq!(doubt, Some(DelayDoubt::Ambiguous), "{found:?}");
        let (doubt, found) = loaded(&|time_s| 1.5 * time_s);
        assert!(doubt.is_some(), "{found:?}");
        let (doubt, found) = loaded(&|_| 0.0);
        assert!(doubt.is_some(), "{found:?}");
    }

    #[test]
    fn constant_forces_and_disjoint_clocks_give_no_delay() {
        let (fields, mut forces) = recording(1, 0.0);
        for series in &mut forces {
            series.time_s.iter_mut().for_each(|time_s| *time_s += 1000.0);
        }
        assert_eq!(estimate(&fields, &forces, 0.2), None);
        let (fields, mut forces) = recording(1, 0.0);
        for series in &mut forces {
            series.force_n.fill(5.0);
        }
        assert_eq!(estimate(&fields, &forces, 0.2), None);
    }

    #[test]
    fn times_of_a_recording_are_corrected_by_its_delay() {
        let folder = tempfile::TempDir::new().unwrap();
        let (fields, forces) = recording(3, 0.04);
        let mut hall = "t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n".to_owned();
        for (time_s, [x, y, z]) in fields[0].time_s.iter().zip(&fields[0].field) {
            let [x, y, z] = [x, y, z].map(|g| (8.0 * g).round());
            hall += &format!("{:.0},{x},{y},{z}\n", 1e6 * time_s);
        }
        let mut force = "t_us,f0_x_n,f0_z_n\n".to_owned();
        for (row, time_s) in forces[0].time_s.iter().enumerate() {
            let [x, z] = [0, 1].map(|axis| forces[axis].force_n[row]);
            if *time_s >= 0.0 {
                force += &format!("{:.0},{x:.4},{z:.4}\n", 1e6 * time_s);
            }
        }
        std::fs::write(folder.path().join("hall.csv"), hall).unwrap();
        std::fs::write(folder.path().join("force.csv"), force).unwrap();
        let found = of_recording(folder.path(), 0.2).unwrap().unwrap();
        assert!((found.delay_s - 0.04).abs() < 0.5e-3, "{found:?}");
        shift_reference(folder.path(), found.delay_s).unwrap();
        let after = of_recording(folder.path(), 0.2).unwrap().unwrap();
        assert!(after.delay_s.abs() < 2e-6, "{after:?}");
    }
}
