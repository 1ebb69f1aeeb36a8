//! Operators that remember, over rows at any times: play and stop, low pass, and the smoothing that
//! keeps a reference's noise out of them.

use nalgebra::{DMatrix, DVector};

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
    let mut last = values.first().copied().unwrap_or(0.0);
    let mut stretch = start.clamp(-1.0, 1.0) * reach;
    let share = 1.0 / reach;
    let follow = |&value: &f64| {
        let step = value - last;
        last = value;
        stretch = (stretch + step).max(-reach).min(reach);
        stretch * share
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

/// `values` as they were `delay_s` earlier, on straight lines between the rows; beyond the ends the
/// line through the last two goes on.
pub fn delayed(time_s: &[f64], values: &[f64], delay_s: f64) -> Vec<f64> {
    if values.len() < 2 {
        return values.to_vec();
    }
    let at = |time: f64| {
        let after = time_s
            .partition_point(|t| *t < time)
            .clamp(1, time_s.len() - 1);
        let (t0, t1) = (time_s[after - 1], time_s[after]);
        let share = (time - t0) / (t1 - t0);
        values[after - 1] + share * (values[after] - values[after - 1])
    };
    time_s.iter().map(|time| at(time - delay_s)).collect()
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
    fn a_low_pass_trails_a_ramp_by_its_time_constant_at_any_step() {
        let time_s = times(400);
        let ramp: Vec<f64> = time_s.iter().map(|t| 7.0 * t).collect();
        for tau in [1e-4, 5e-3, 0.2] {
            let late = low_pass(&time_s, &ramp, tau);
            assert_abs_diff_eq!(late[399], 7.0 * (time_s[399] - tau), epsilon = 1e-6);
        }
    }
}
