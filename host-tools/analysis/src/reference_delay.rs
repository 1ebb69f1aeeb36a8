//! Delay between the clocks of board and reference, from the loads alone.
//!
//! The reference's forces are regressed on the fields and their squares, averaged over the reference's period at a
//! delayed time; the delay minimises the residual. Its standard error comes from the scores, summed over blocks so that
//! correlated residuals do not make it too small (Liang and Zeger 1986). An effect that lags the load, such as viscous lag,
//! is seen as a delay: compare with `viscous_lag` and `clock_skew` of `diagnose`.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Length of a block in seconds: longer than the correlation of the residuals.
const BLOCK_S: f64 = 0.5;
/// Steps of the search in seconds, coarse to fine.
const STEPS_S: [f64; 2] = [20e-3, 4e-3];
/// Least standard deviation of a force that carries information, in newtons.
const MIN_N: f64 = 1.0;
/// Least number of rows of a channel.
const MIN_ROWS: usize = 100;
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
}

/// An estimated delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Delay {
    /// Added to the reference's time to obtain the board's, in seconds.
    pub delay_s: f64,
    /// Standard error in seconds.
    pub standard_error_s: f64,
    /// 95 % interval in seconds.
    pub interval_s: [f64; 2],
    /// Share of the forces' variance that the fields explain at this delay.
    pub explained: f64,
}

/// Estimates the delay within `±search_s`. `None` if no force varies, or the series do not overlap.
pub fn estimate(fields: &[FieldSeries], forces: &[ForceSeries], search_s: f64) -> Option<Delay> {
    let integrals: Vec<Integral> = fields.iter().map(Integral::new).collect();
    let channels: Vec<Channel> =
        forces.iter().filter_map(|force| Channel::new(force, &integrals, search_s)).collect();
    if channels.is_empty() {
        return None;
    }
    let cost = |delay_s: f64| {
        let fits = channels.iter().map(|channel| channel.fit(delay_s));
        fits.map(|fit| fit.map_or(0.0, |fit| (fit.unexplained.max(1e-12)).ln())).sum::<f64>()
    };
    let mut best_s = 0.0;
    let mut reach_s = search_s;
    for step_s in STEPS_S {
        let steps = (reach_s / step_s).ceil() as i32;
        let centre_s = best_s;
        let tried = (-steps..=steps).map(|step| centre_s + f64::from(step) * step_s);
        best_s = tried.min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
        reach_s = step_s;
    }
    for _ in 0..ITERATIONS {
        let (score, information) = scores(&channels, best_s)
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
    interval(&channels, best_s)
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
struct Channel<'a> {
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
        let half_s = 0.5 * median_step(&force.time_s)?;
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
        Some(Self { integral, half_s, time_s, force_n, scale })
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
    /// slowly varying error besides its noise.
    fn recording(seed: u64, delay_s: f64) -> (Vec<FieldSeries>, Vec<ForceSeries>) {
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
            let (x, z) = (load(0, time_s), load(1, time_s));
            let bend = 1e-3 * (x * x + z * z);
            field.time_s.push(time_s);
            field.field.push(
                [1.8 * x + 0.1 * z, bend - 0.2 * x, 1.6 * z + 0.3 * bend].map(|g| g + noise(0.35)),
            );
        }
        let mut forces = [0, 1].map(|_| ForceSeries::default());
        for row in 0..(100.0 * SECONDS) as u32 {
            let time_s = 1e-2 * f64::from(row);
            for (axis, series) in forces.iter_mut().enumerate() {
                series.time_s.push(time_s - delay_s);
                series.force_n.push(load(axis, time_s) + 0.01 * load(2, time_s) + noise(0.15));
            }
        }
        (vec![field], forces.to_vec())
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
}
