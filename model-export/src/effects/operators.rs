//! Operators with memory over non-uniformly sampled rows: stop operator, low pass, delay, and smoothing, which
//! excludes the reference's noise.

use nalgebra::{SMatrix, SVector};

use crate::effects::ExcitationSeries;

/// Half width of the smoothing window in rows.
const HALF_WINDOW: usize = 4;
/// Half widths that are tried, and the one with which the regression hardly averages.
const HALF_WINDOWS: [usize; 2] = [HALF_WINDOW, 3];
const NARROWEST: usize = 2;
/// Maximum ratio of the noise that two windows leave: more of the wider one is motion of the load.
const SAME_NOISE: f64 = 1.2;
/// Minimum number of rows to compare windows.
const MIN_ROWS: usize = 200;

/// Smoothed values and their rates: local cubic regression (Savitzky and Golay 1964, for non-uniform times).
pub fn smooth(time_s: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    smooth_within(HALF_WINDOW, time_s, values)
}

/// The same with a window of this half width.
pub fn smooth_within(half_window: usize, time_s: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = values.len();
    (0..n)
        .map(|i| {
            let range = i.saturating_sub(half_window)..(i + half_window + 1).min(n);
            local_regression(time_s[i], &time_s[range.clone()], &values[range])
        })
        .unzip()
}

/// Half width of the widest window that leaves no more than the noise of these columns, as the narrowest one shows it: a wider one
/// takes a part of a fast load's motion, and with it of its rates.
pub fn half_window<'v>(time_s: &[f64], columns: impl Iterator<Item = &'v [f64]> + Clone) -> usize {
    if time_s.len() < MIN_ROWS {
        return HALF_WINDOW;
    }
    let noise = |half_window: usize| -> Vec<f64> {
        let weight = SmoothingImpulse::within(half_window, time_s).own_weight();
        let variance = |values: &[f64]| {
            let (smooth, _) = smooth_within(half_window, time_s, values);
            let squares: f64 =
                smooth.iter().zip(values).map(|(s, value)| (value - s).powi(2)).sum();
            squares / (1.0 - weight)
        };
        columns.clone().map(variance).collect()
    };
    let least = noise(NARROWEST);
    let is_noise = |half_window: &usize| {
        noise(*half_window).iter().zip(&least).all(|(own, least)| *own <= SAME_NOISE * least)
    };
    HALF_WINDOWS.into_iter().find(is_noise).unwrap_or(NARROWEST)
}

/// Value and slope at `at` of the regression cubic, or of the regression line with too few points.
fn local_regression(at: f64, time_s: &[f64], values: &[f64]) -> (f64, f64) {
    let half_span = time_s.iter().fold(0.0_f64, |max, t| max.max((t - at).abs()));
    if half_span == 0.0 {
        return (values.iter().sum::<f64>() / values.len().max(1) as f64, 0.0);
    }
    let cubic =
        if time_s.len() > 4 { polynomial::<4>((at, half_span), time_s, values) } else { None };
    let mean = (values.iter().sum::<f64>() / values.len() as f64, 0.0);
    cubic.or_else(|| polynomial::<2>((at, half_span), time_s, values)).unwrap_or(mean)
}

/// Value and slope at `at` of the regression polynomial with this number of terms; `half_span` scales the times.
fn polynomial<const TERMS: usize>(
    (at, half_span): (f64, f64),
    time_s: &[f64],
    values: &[f64],
) -> Option<(f64, f64)> {
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SVector::<f64, TERMS>::zeros();
    for (t, value) in time_s.iter().zip(values) {
        let x = (t - at) / half_span;
        let powers = SVector::<f64, TERMS>::from_fn(|i, _| x.powi(i as i32));
        normal.ger(1.0, &powers, &powers, 1.0);
        right.axpy(*value, &powers, 1.0);
    }
    let solution = normal.cholesky()?.solve(&right);
    Some((solution[0], solution[1] / half_span))
}

/// Stop operator (Prandtl element) with `threshold`, normalised to -1 to 1; initial state `start`.
pub fn stop_operator(values: &[f64], threshold: f64, start: f64) -> Vec<f64> {
    stop_operators(values, [(1.0, threshold)], start)
}

/// Weighted sum of parallel stop operators (weight, threshold), in one pass.
pub fn stop_operators<const N: usize>(
    values: &[f64],
    elements: [(f64, f64); N],
    start: f64,
) -> Vec<f64> {
    let mut last = values.first().copied().unwrap_or(0.0);
    let mut states = elements.map(|(_, threshold)| start.clamp(-1.0, 1.0) * threshold);
    let gains = elements.map(|(weight, threshold)| weight / threshold);
    let update = |&value: &f64| {
        let step = value - last;
        last = value;
        let mut sum = 0.0;
        for (i, state) in states.iter_mut().enumerate() {
            let threshold = elements[i].1;
            *state = (*state + step).max(-threshold).min(threshold);
            sum += gains[i] * *state;
        }
        sum
    };
    values.iter().map(update).collect()
}

/// First-order low pass with time constant `tau_s`: exact for linear interpolation between the rows, in steady
/// state at the first value.
pub fn low_pass(time_s: &[f64], values: &[f64], tau_s: f64) -> Vec<f64> {
    low_pass_of(time_s, values, tau_s, |row, _| {
        [values[row], values[row + 1] - values[row], 0.0, 0.0]
    })
}

/// The same, exact for cubic Hermite interpolation with `rates`: rows of a sample are further apart than a load's changes.
pub fn low_pass_with_rates(time_s: &[f64], values: &[f64], rates: &[f64], tau_s: f64) -> Vec<f64> {
    low_pass_of(time_s, values, tau_s, |row, dt| {
        let rise = values[row + 1] - values[row];
        let [from, to] = [rates[row] * dt, rates[row + 1] * dt];
        [values[row], from, 3.0 * rise - 2.0 * from - to, from + to - 2.0 * rise]
    })
}

/// Low pass of a cubic between each row and the next, by its coefficients from the row and the time between the two.
fn low_pass_of(
    time_s: &[f64],
    values: &[f64],
    tau_s: f64,
    cubic: impl Fn(usize, f64) -> [f64; 4],
) -> Vec<f64> {
    let mut filtered: Vec<f64> = values.first().copied().into_iter().collect();
    let mut step = (f64::NAN, 1.0, [0.0; 4]);
    for (row, times) in time_s.windows(2).enumerate() {
        let dt = times[1] - times[0];
        if step.0 != dt {
            step = (dt, libm::exp(-dt / tau_s), decaying_moments(dt / tau_s));
        }
        let (_, decay, moments) = step;
        let driven: f64 = cubic(row, dt).iter().zip(moments).map(|(c, m)| c * m).sum();
        filtered.push(filtered[row] * decay + driven);
    }
    filtered
}

/// Integrals over u from 0 to 1 of `x exp(-x (1 - u)) u^k`, for k from 0 to 3.
fn decaying_moments(x: f64) -> [f64; 4] {
    let decay = libm::exp(-x);
    if x >= 1.0 {
        // By parts. For a small x the differences would cancel.
        let mut moments = [1.0 - decay; 4];
        for k in 1..4 {
            moments[k] = 1.0 - k as f64 / x * moments[k - 1];
        }
        return moments;
    }
    core::array::from_fn(|k| {
        let (mut power, mut sum) = (1.0, 0.0);
        // x^j / j! is below the resolution after 18 terms.
        for j in 0..18 {
            sum += power / (k + j + 1) as f64;
            power *= x / (j + 1) as f64;
        }
        x * decay * sum
    })
}

/// `values` delayed by `delay_s`: cubic Hermite interpolation with `rates`, linear extrapolation.
pub fn delayed(time_s: &[f64], values: &[f64], rates: &[f64], delay_s: f64) -> Vec<f64> {
    if values.len() < 2 {
        return values.to_vec();
    }
    // The times ascend.
    let mut after = 1;
    let mut at = |time: f64| {
        while after < time_s.len() - 1 && time_s[after] < time {
            after += 1;
        }
        let (from, to) = (after - 1, after);
        let step = time_s[to] - time_s[from];
        let u = (time - time_s[from]) / step;
        if u < 0.0 {
            return values[from] + rates[from] * u * step;
        }
        if u > 1.0 {
            return values[to] + rates[to] * (u - 1.0) * step;
        }
        let (blend, v) = (u * u * (3.0 - 2.0 * u), 1.0 - u);
        values[from] * (1.0 - blend)
            + values[to] * blend
            + step * u * v * (rates[from] * v - rates[to] * u)
    };
    time_s.iter().map(|time| at(time - delay_s)).collect()
}

/// Response of [`smooth`] to a unit impulse in one row: the smoothing's effect on the noise of a single row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothingImpulse {
    half_window: usize,
    time_s: Vec<f64>,
    smooth: Vec<f64>,
    rate: Vec<f64>,
}

impl SmoothingImpulse {
    /// Rows on each side of the impulse.
    const MARGIN: usize = 20;

    /// The response at the median period of `time_s`.
    pub fn new(time_s: &[f64]) -> Self {
        Self::within(HALF_WINDOW, time_s)
    }

    /// The same with a window of this half width.
    pub fn within(half_window: usize, time_s: &[f64]) -> Self {
        let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        let Some(step) = steps.get(steps.len() / 2) else {
            return Self::default();
        };
        let rows = 0..=2 * Self::MARGIN;
        let time_s: Vec<f64> = rows.clone().map(|i| step * i as f64).collect();
        let impulse = |i: usize| f64::from(u8::from(i == Self::MARGIN));
        let values: Vec<f64> = rows.map(impulse).collect();
        let (smooth, rate) = smooth_within(half_window, &time_s, &values);
        Self { half_window, time_s, smooth, rate }
    }

    /// Half width of the window in rows; of no response that of [`smooth`].
    pub fn half_window(&self) -> usize {
        if self.smooth.is_empty() { HALF_WINDOW } else { self.half_window }
    }

    /// Weight of a row's own value in its smoothed one.
    fn own_weight(&self) -> f64 {
        self.smooth.get(Self::MARGIN).copied().unwrap_or(0.0)
    }

    /// Additional gain of a row's own noise by `operator` (of times, values, rates) relative to the smoothed
    /// force, normalised by the part that smoothing removes.
    fn noise_gain(&self, operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>) -> f64 {
        let changed = operator(&self.time_s, &self.smooth, &self.rate);
        match (changed.get(Self::MARGIN), self.smooth.get(Self::MARGIN)) {
            (Some(after), Some(before)) => (after - before) / (1.0 - before),
            _ => 0.0,
        }
    }
}

/// Increment by a linear operator of the smoothed force of one axis, row by row.
///
/// A shift or filter reduces the contribution of a row's own noise. Added to the reading, it would average the
/// reference's noise and reduce the residual without physical cause; that part is subtracted.
pub fn operator_increment(
    excitation: &ExcitationSeries,
    axis: usize,
    operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>,
) -> Vec<f64> {
    let column = |of: &[[f64; 2]]| -> Vec<f64> { of.iter().map(|pair| pair[axis]).collect() };
    let (smooth, rate) = (column(&excitation.smooth_n), column(&excitation.rate_n_per_s));
    let noise_gain = excitation.smoothing_impulse.noise_gain(&operator);
    let changed = operator(&excitation.time_s, &smooth, &rate);
    let readings = excitation.force_n.iter().map(|force| force[axis]);
    let rows = changed.iter().zip(&smooth).zip(readings);
    rows.map(|((after, before), read)| after - before - noise_gain * (read - before)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    fn times(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64 * 0.01).collect()
    }

    #[test]
    fn smoothing_reproduces_a_cubic_at_non_uniform_times() {
        let time_s: Vec<f64> = times(50).iter().map(|t| t + 0.3 * t * t).collect();
        let values: Vec<f64> = time_s.iter().map(|t| 2.0 - 3.0 * t + 5.0 * t * t * t).collect();
        let (smooth, rate) = smooth(&time_s, &values);
        for i in 0..50 {
            assert_abs_diff_eq!(smooth[i], values[i], epsilon = 1e-9);
            assert_abs_diff_eq!(rate[i], 15.0 * time_s[i] * time_s[i] - 3.0, epsilon = 1e-6);
        }
    }

    /// Loads of 20 N with noise of 0.15 N at 100 Hz: of 0.3 Hz the noise alone is left, of 12 Hz a part of the load too.
    #[test]
    fn the_window_is_narrower_for_a_fast_load() {
        let mut state = 1_u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            0.15 * 12_f64.sqrt() * ((state >> 40) as f64 / (1_u64 << 24) as f64 - 0.5)
        };
        let time_s = times(3000);
        let mut load = |hz: f64| -> Vec<f64> {
            time_s
                .iter()
                .map(|t| 20.0 * libm::sin(std::f64::consts::TAU * hz * t) + noise())
                .collect()
        };
        let (slow, fast) = (load(0.3), load(12.0));
        let of = |columns: &[&[f64]]| half_window(&time_s, columns.iter().copied());
        assert_eq!((of(&[&slow]), of(&[&fast]), of(&[&slow, &fast])), (4, 2, 2));
        // The exact rate of the fast load where it is largest: 20 N times its angular frequency.
        let rate = |half_window: usize| smooth_within(half_window, &time_s, &fast).1[1000];
        let exact = 20.0 * std::f64::consts::TAU * 12.0;
        assert!((rate(2) / exact - 1.0).abs() < 0.05, "{} of {exact}", rate(2));
        assert!((rate(4) / exact - 1.0).abs() > 0.1, "{} of {exact}", rate(4));
    }

    #[test]
    fn stop_operator_saturates_and_reverses_elastically() {
        let load = [0.0, 3.0, 10.0, 8.0, 4.0, 9.0];
        let found = stop_operator(&load, 2.0, 0.0);
        assert_eq!(found, [0.0, 1.0, 1.0, 0.0, -1.0, 1.0]);
    }

    #[test]
    fn stop_operator_forgets_its_start_after_a_full_swing() {
        let load = [0.0, 1.0, 4.0, 3.0];
        let (centred, saturated) =
            (stop_operator(&load, 2.0, 0.0), stop_operator(&load, 2.0, -1.0));
        assert_ne!(centred[1], saturated[1]);
        assert_eq!(centred[2..], saturated[2..]);
    }

    #[test]
    fn delay_below_one_row_is_exact_for_a_cubic() {
        let time_s = times(40);
        let cubic = |t: f64| 1.0 - 20.0 * t + 300.0 * t * t * t;
        let values: Vec<f64> = time_s.iter().map(|t| cubic(*t)).collect();
        let rates: Vec<f64> = time_s.iter().map(|t| 900.0 * t * t - 20.0).collect();
        let shifted = delayed(&time_s, &values, &rates, 0.003);
        for i in 1..40 {
            assert_abs_diff_eq!(shifted[i], cubic(time_s[i] - 0.003), epsilon = 1e-9);
        }
    }

    #[test]
    fn increment_excludes_the_noise_of_its_own_row() {
        // An error of 1 N in one row must not enter the increment of that row.
        let mut reading = vec![0.0; 101];
        reading[50] = 1.0;
        let time_s = times(101);
        let force_n = reading.iter().map(|x| [*x, 0.0]).collect();
        let excitation = ExcitationSeries {
            smoothing_impulse: SmoothingImpulse::new(&time_s),
            time_s,
            ..ExcitationSeries::default()
        }
        .with_forces(force_n);
        for delay_s in [0.003, -0.003, 0.02] {
            let shift =
                |t: &[f64], values: &[f64], rates: &[f64]| delayed(t, values, rates, delay_s);
            let added = operator_increment(&excitation, 0, shift);
            assert!(added[50].abs() < 1e-12, "{delay_s}: {}", added[50]);
            assert!(added[48].abs() > 1e-4, "{delay_s}: {}", added[48]);
        }
        let late = operator_increment(&excitation, 0, |t, values, _| low_pass(t, values, 0.03));
        assert!(late[50].abs() < 1e-12, "{}", late[50]);
    }

    /// tau y' + y = 5 + t^3 from 5 on: y = 5 + t^3 - 3 tau t^2 + 6 tau^2 t - 6 tau^3 (1 - exp(-t / tau)).
    #[test]
    fn low_pass_of_a_cubic_is_exact_on_rows_far_apart() {
        let time_s: Vec<f64> = [0.0, 0.05, 0.3, 0.31, 0.8, 1.5].to_vec();
        let values: Vec<f64> = time_s.iter().map(|t| 5.0 + t.powi(3)).collect();
        let rates: Vec<f64> = time_s.iter().map(|t| 3.0 * t * t).collect();
        for tau in [1e-3_f64, 0.04, 0.3, 0.9, 70.0] {
            let late = low_pass_with_rates(&time_s, &values, &rates, tau);
            for (t, late) in time_s.iter().zip(late) {
                let gone = 6.0 * tau.powi(3) * -libm::expm1(-t / tau);
                let polynomial = t.powi(3) - 3.0 * tau * t * t + 6.0 * tau * tau * t;
                // The terms of the expected value cancel for a long time constant.
                assert_abs_diff_eq!(late, 5.0 + polynomial - gone, epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn low_pass_lags_a_ramp_by_its_time_constant() {
        let time_s = times(400);
        let ramp: Vec<f64> = time_s.iter().map(|t| 7.0 * t).collect();
        for tau in [1e-4, 5e-3, 0.2] {
            let late = low_pass(&time_s, &ramp, tau);
            assert_abs_diff_eq!(late[399], 7.0 * (time_s[399] - tau), epsilon = 1e-6);
        }
    }
}
