//! Smoothing of non-uniformly sampled rows, and how much of their noise it leaves.
//!
//! The window is as wide in each row as the noise permits (intersection of confidence intervals, Goldenshluger and Nemirovski 1997):
//! wide where a load is slow, narrow at its corners. What has a memory (friction, a lag) would take the noise of narrow windows for
//! motion.

use nalgebra::{SMatrix, SVector};

/// Half width of the smoothing window in rows.
pub const HALF_WINDOW: usize = 4;
/// Half widths that are tried, and the one with which the regression hardly averages.
pub const HALF_WINDOWS: [usize; 2] = [HALF_WINDOW, 3];
const NARROWEST: usize = 2;
/// Maximum ratio of the noise that two windows leave: more of the wider one is motion of the load.
const SAME_NOISE: f64 = 1.2;
/// Standard deviations of its noise by which a wider window's value may differ from the narrower ones': with more of them, wide
/// windows round off a load's corners.
const BOUND: f64 = 2.0;
/// Minimum number of rows to compare windows.
const MIN_ROWS: usize = 200;

/// Smoothed values and their rates: local cubic regression (Savitzky and Golay 1964, for non-uniform times).
pub fn smooth(time_s: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    smooth_within(HALF_WINDOW, time_s, values)
}

/// The same with a window of this half width.
pub fn smooth_within(half_window: usize, time_s: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = values.len();
    (0..n).map(|row| regression_at(row, half_window, time_s, values)).unzip()
}

/// Value and rate of one row.
fn regression_at(row: usize, half_window: usize, time_s: &[f64], values: &[f64]) -> (f64, f64) {
    let range = row.saturating_sub(half_window)..(row + half_window + 1).min(values.len());
    local_regression(time_s[row], &time_s[range.clone()], &values[range])
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

/// Smoothed values of a column, their rates, and the place in [`Smoother`] of the window of each row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothColumn {
    /// Smoothed values.
    pub values: Vec<f64>,
    /// Their rates per second.
    pub rates: Vec<f64>,
    /// Window of each row.
    pub windows: Vec<u8>,
}

/// Windows for rows at these times, from the narrowest, with the effect of each one on the noise of a single row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Smoother {
    windows: Vec<SmoothingImpulse>,
}

impl Smoother {
    /// Wider windows are multiples of the narrowest.
    const FACTORS: [usize; 4] = [1, 2, 4, 8];

    /// Of rows at these times whose narrowest window has this half width (see [`half_window`]).
    pub fn new(half_window: usize, time_s: &[f64]) -> Self {
        let window = |factor| SmoothingImpulse::within(factor * half_window, time_s);
        Self { windows: Self::FACTORS.map(window).into() }
    }

    /// The column with the widest window in each row whose value agrees, within the noise, with those of all narrower ones.
    pub fn smooth(&self, time_s: &[f64], values: &[f64]) -> SmoothColumn {
        let Some((narrowest, wider)) = self.windows.split_first() else {
            let (values, rates) = smooth(time_s, values);
            return SmoothColumn { windows: vec![0; values.len()], values, rates };
        };
        let (mut smooth, mut rates) = smooth_within(narrowest.half_window, time_s, values);
        let mut windows = vec![0; smooth.len()];
        let squares: f64 = smooth.iter().zip(values).map(|(s, value)| (value - s).powi(2)).sum();
        let variance = squares / (values.len() as f64 * (1.0 - narrowest.own_weight()));
        let bound = |window: &SmoothingImpulse| BOUND * (variance * window.own_weight()).sqrt();
        if variance > 0.0 && variance.is_finite() {
            let own = bound(narrowest);
            let mut limits: Vec<_> = smooth.iter().map(|s| Some((s - own, s + own))).collect();
            for (place, window) in (1..).zip(wider) {
                let own = bound(window);
                for (row, limit) in limits.iter_mut().enumerate() {
                    let Some((low, high)) = *limit else { continue };
                    let (value, rate) = regression_at(row, window.half_window, time_s, values);
                    let (low, high) = (low.max(value - own), high.min(value + own));
                    *limit = (low <= high).then_some((low, high));
                    if limit.is_some() {
                        (smooth[row], rates[row], windows[row]) = (value, rate, place);
                    }
                }
            }
        }
        SmoothColumn { values: smooth, rates, windows }
    }

    /// Additional gain, for each window, of a row's own noise by `operator` (of times, values, rates) relative to the smoothed
    /// force, normalised by the part that smoothing removes.
    pub fn noise_gains(&self, operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>) -> Vec<f64> {
        self.windows.iter().map(|window| window.noise_gain(&operator)).collect()
    }
}

/// Response of [`smooth_within`] to a unit impulse in one row: the smoothing's effect on the noise of a single row.
#[derive(Clone, Debug, Default, PartialEq)]
struct SmoothingImpulse {
    half_window: usize,
    time_s: Vec<f64>,
    smooth: Vec<f64>,
    rate: Vec<f64>,
}

impl SmoothingImpulse {
    /// Rows on each side of the impulse and of the window.
    const MARGIN: usize = 16;

    /// The response with a window of this half width at the median period of `time_s`.
    fn within(half_window: usize, time_s: &[f64]) -> Self {
        let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        let step = steps.get(steps.len() / 2).copied().unwrap_or(1.0);
        let centre = half_window + Self::MARGIN;
        let rows = 0..=2 * centre;
        let time_s: Vec<f64> = rows.clone().map(|i| step * i as f64).collect();
        let impulse = |i: usize| f64::from(u8::from(i == centre));
        let values: Vec<f64> = rows.map(impulse).collect();
        let (smooth, rate) = smooth_within(half_window, &time_s, &values);
        Self { half_window, time_s, smooth, rate }
    }

    /// Weight of a row's own value in its smoothed one.
    fn own_weight(&self) -> f64 {
        self.smooth.get(self.half_window + Self::MARGIN).copied().unwrap_or(0.0)
    }

    fn noise_gain(&self, operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>) -> f64 {
        let changed = operator(&self.time_s, &self.smooth, &self.rate);
        let before = self.own_weight();
        let after = changed.get(self.half_window + Self::MARGIN);
        after.map_or(0.0, |after| (after - before) / (1.0 - before))
    }
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
}
