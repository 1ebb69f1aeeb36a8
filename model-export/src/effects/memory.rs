//! Operators that remember, over rows at any times: play and stop, low pass, and the smoothing that
//! keeps a reference's noise out of them.

use nalgebra::{DMatrix, DVector};

use super::Track;

/// Rows on each side that a value is smoothed over.
const SIDE: usize = 4;

/// Smoothed values and their rate, by a cubic through the rows around each (Savitzky and Golay 1964,
/// for uneven times).
pub fn smooth(time_s: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = values.len();
    (0..n)
        .map(|i| {
            let range = i.saturating_sub(SIDE)..(i + SIDE + 1).min(n);
            local(time_s[i], &time_s[range.clone()], &values[range])
        })
        .unzip()
}

/// Value and slope at `at` of the cubic through the points, or of the straight line where they are
/// too few for one.
fn local(at: f64, time_s: &[f64], values: &[f64]) -> (f64, f64) {
    let reach = time_s
        .iter()
        .fold(0.0_f64, |most, t| most.max((t - at).abs()));
    if reach == 0.0 {
        return (values.iter().sum::<f64>() / values.len().max(1) as f64, 0.0);
    }
    let fit = |terms: usize| {
        let mut normal = DMatrix::zeros(terms, terms);
        let mut right = DVector::zeros(terms);
        for (t, value) in time_s.iter().zip(values) {
            let x = (t - at) / reach;
            let powers = DVector::from_fn(terms, |i, _| x.powi(i as i32));
            normal.ger(1.0, &powers, &powers, 1.0);
            right.axpy(*value, &powers, 1.0);
        }
        let solution = normal.cholesky()?.solve(&right);
        Some((solution[0], solution[1] / reach))
    };
    let cubic = if time_s.len() > 4 { fit(4) } else { None };
    let mean = (values.iter().sum::<f64>() / values.len() as f64, 0.0);
    cubic.or_else(|| fit(2)).unwrap_or(mean)
}

/// The stop operator: an elastic slider that follows `values` and slips at `reach` either way, as a
/// share of `reach` (Prandtl's element). It begins at the share `start`.
pub fn stop(values: &[f64], reach: f64, start: f64) -> Vec<f64> {
    stops(values, [(1.0, reach)], start)
}

/// Several sliders side by side, each with its weight and its reach: their weighted sum. (In one pass:
/// each slider waits for its last step, and meanwhile the others move.)
pub fn stops<const N: usize>(values: &[f64], sliders: [(f64, f64); N], start: f64) -> Vec<f64> {
    let mut last = values.first().copied().unwrap_or(0.0);
    let mut stretches = sliders.map(|(_, reach)| start.clamp(-1.0, 1.0) * reach);
    let shares = sliders.map(|(weight, reach)| weight / reach);
    let follow = |&value: &f64| {
        let step = value - last;
        last = value;
        let mut sum = 0.0;
        for (i, stretch) in stretches.iter_mut().enumerate() {
            let reach = sliders[i].1;
            *stretch = (*stretch + step).max(-reach).min(reach);
            sum += shares[i] * *stretch;
        }
        sum
    };
    values.iter().map(follow).collect()
}

/// First-order low pass with time constant `tau_s`, exact for straight lines between the rows,
/// settled at the first value.
pub fn low_pass(time_s: &[f64], values: &[f64], tau_s: f64) -> Vec<f64> {
    let Some((&first, _)) = values.split_first() else {
        return Vec::new();
    };
    let mut state = first;
    let mut filtered = vec![first];
    for (times, pair) in time_s.windows(2).zip(values.windows(2)) {
        let dt = times[1] - times[0];
        let slope = (pair[1] - pair[0]) / dt;
        let fade = libm::exp(-dt / tau_s);
        // On a ramp the filter trails by slope * tau; what it starts beside that dies away.
        state = pair[1] - slope * tau_s + (state - pair[0] + slope * tau_s) * fade;
        filtered.push(state);
    }
    filtered
}

/// `values` with these rates as they were `delay_s` earlier, on the cubics between the rows; beyond the
/// ends the line goes on.
pub fn delayed(time_s: &[f64], values: &[f64], rates: &[f64], delay_s: f64) -> Vec<f64> {
    if values.len() < 2 {
        return values.to_vec();
    }
    let at = |time: f64| {
        let after = time_s
            .partition_point(|t| *t < time)
            .clamp(1, time_s.len() - 1);
        let (from, to) = (after - 1, after);
        let step = time_s[to] - time_s[from];
        let u = (time - time_s[from]) / step;
        if u < 0.0 {
            return values[from] + rates[from] * u * step;
        }
        if u > 1.0 {
            return values[to] + rates[to] * (u - 1.0) * step;
        }
        let (back, v) = (u * u * (3.0 - 2.0 * u), 1.0 - u);
        values[from] * (1.0 - back)
            + values[to] * back
            + step * u * v * (rates[from] * v - rates[to] * u)
    };
    time_s.iter().map(|time| at(time - delay_s)).collect()
}

/// A reading of one among rows that read nothing, smoothed: what the smoothing makes of the noise of a
/// single row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoneReading {
    time_s: Vec<f64>,
    smooth: Vec<f64>,
    rate: Vec<f64>,
}

impl LoneReading {
    /// Rows on each side.
    const AROUND: usize = 20;

    /// Among rows as far apart as these usually are.
    pub fn among(time_s: &[f64]) -> Self {
        let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        let Some(step) = steps.get(steps.len() / 2) else {
            return Self::default();
        };
        let rows = 0..=2 * Self::AROUND;
        let time_s: Vec<f64> = rows.clone().map(|i| step * i as f64).collect();
        let one = |i: usize| f64::from(u8::from(i == Self::AROUND));
        let reading: Vec<f64> = rows.map(one).collect();
        let (smooth, rate) = smooth(&time_s, &reading);
        Self {
            time_s,
            smooth,
            rate,
        }
    }

    /// The share of its own noise that a row gets back through `operator` of times, values and rates,
    /// in place of the share that the smoothed force has of it; of what smoothing took away.
    fn share(&self, operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>) -> f64 {
        let changed = operator(&self.time_s, &self.smooth, &self.rate);
        match (changed.get(Self::AROUND), self.smooth.get(Self::AROUND)) {
            (Some(after), Some(before)) => (after - before) / (1.0 - before),
            _ => 0.0,
        }
    }
}

/// What a linear operator makes of the smoothed force of one axis beyond that force, row by row.
///
/// Any shift or filter gives a row less of its own noise than the smoothed force holds: added to the
/// reading it would average the reference's noise, and seem to help where it is not. What a row would
/// get back of its own noise is therefore taken off.
pub fn beyond(
    track: &Track,
    axis: usize,
    operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>,
) -> Vec<f64> {
    let column = |of: &[[f64; 2]]| -> Vec<f64> { of.iter().map(|pair| pair[axis]).collect() };
    let (smooth, rate) = (column(&track.smooth_n), column(&track.rate_n_per_s));
    let share = track.lone_reading.share(&operator);
    let changed = operator(&track.time_s, &smooth, &rate);
    let readings = track.force_n.iter().map(|force| force[axis]);
    let rows = changed.iter().zip(&smooth).zip(readings);
    rows.map(|((after, before), read)| after - before - share * (read - before))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    fn times(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64 * 0.01).collect()
    }

    #[test]
    fn a_cubic_is_smoothed_to_itself_with_its_slope_even_at_uneven_times() {
        let time_s: Vec<f64> = times(50).iter().map(|t| t + 0.3 * t * t).collect();
        let values: Vec<f64> = time_s
            .iter()
            .map(|t| 2.0 - 3.0 * t + 5.0 * t * t * t)
            .collect();
        let (smooth, rate) = smooth(&time_s, &values);
        for i in 0..50 {
            assert_abs_diff_eq!(smooth[i], values[i], epsilon = 1e-9);
            assert_abs_diff_eq!(rate[i], 15.0 * time_s[i] * time_s[i] - 3.0, epsilon = 1e-6);
        }
    }

    #[test]
    fn a_slider_slips_at_its_reach_and_turns_back_elastically() {
        let load = [0.0, 3.0, 10.0, 8.0, 4.0, 9.0];
        let found = stop(&load, 2.0, 0.0);
        assert_eq!(found, [0.0, 1.0, 1.0, 0.0, -1.0, 1.0]);
    }

    #[test]
    fn where_a_slider_began_is_forgotten_after_a_swing_of_twice_the_reach() {
        let load = [0.0, 1.0, 4.0, 3.0];
        let (middle, end) = (stop(&load, 2.0, 0.0), stop(&load, 2.0, -1.0));
        assert_ne!(middle[1], end[1]);
        assert_eq!(middle[2..], end[2..]);
    }

    #[test]
    fn a_shift_of_less_than_a_row_is_exact_for_a_cubic() {
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
    fn no_shift_averages_the_noise_of_a_row() {
        // One row reads 1 N too much: none of that may come back at this row by any shift.
        let mut reading = vec![0.0; 101];
        reading[50] = 1.0;
        let time_s = times(101);
        let force_n = reading.iter().map(|x| [*x, 0.0]).collect();
        let track = Track {
            lone_reading: LoneReading::among(&time_s),
            time_s,
            ..Track::default()
        }
        .under(force_n);
        for delay_s in [0.003, -0.003, 0.02] {
            let shift =
                |t: &[f64], values: &[f64], rates: &[f64]| delayed(t, values, rates, delay_s);
            let added = beyond(&track, 0, shift);
            assert!(added[50].abs() < 1e-12, "{delay_s}: {}", added[50]);
            assert!(added[48].abs() > 1e-4, "{delay_s}: {}", added[48]);
        }
        let late = beyond(&track, 0, |t, values, _| low_pass(t, values, 0.03));
        assert!(late[50].abs() < 1e-12, "{}", late[50]);
    }

    #[test]
    fn a_low_pass_trails_a_ramp_by_its_time_constant_at_any_step() {
        let time_s = times(400);
        let ramp: Vec<f64> = time_s.iter().map(|t| 7.0 * t).collect();
        for tau in [1e-4, 5e-3, 0.2] {
            let late = low_pass(&time_s, &ramp, tau);
            assert_abs_diff_eq!(late[399], 7.0 * (time_s[399] - tau), epsilon = 1e-6);
        }
    }
}
