//! Operators with memory over non-uniformly sampled rows: stop operator, low pass, delay.

/// Stop operator (Prandtl element) with `threshold`, normalised to -1 to 1; initial state `start`.
pub(crate) fn stop_operator(values: &[f64], threshold: f64, start: f64) -> Vec<f64> {
    stop_operators(values, &[], [(1.0, threshold)], start)
}

/// Weighted sum of parallel stop operators (weight, threshold), in one pass; `turns` as of [`turns_between`], empty
/// where the values turn at rows.
pub(crate) fn stop_operators<const N: usize>(
    values: &[f64],
    turns: &[Option<f64>],
    elements: [(f64, f64); N],
    start: f64,
) -> Vec<f64> {
    let mut last = values.first().copied().unwrap_or(0.0);
    let mut states = elements.map(|(_, threshold)| start.clamp(-1.0, 1.0) * threshold);
    let gains = elements.map(|(weight, threshold)| weight / threshold);
    let mut advance = |value: f64| {
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
    let turns = turns.iter().copied().chain(std::iter::repeat(None));
    let update = |(&value, turn): (&f64, Option<f64>)| {
        if let Some(turn) = turn {
            advance(turn);
        }
        advance(value)
    };
    values.iter().zip(turns).map(update).collect()
}

/// Extremum between each row and the one before it, where the sign of the rate changes: of the cubic with these values and
/// rates at the rows. A load turns between the rows of a slow reference, and friction depends on where.
pub(crate) fn turns_between(time_s: &[f64], values: &[f64], rates: &[f64]) -> Vec<Option<f64>> {
    let turn = |row: usize| {
        let before = row.checked_sub(1)?;
        let step_s = time_s[row] - time_s[before];
        let [from, to] = [rates[before] * step_s, rates[row] * step_s];
        if from * to >= 0.0 {
            return None;
        }
        let rise = values[row] - values[before];
        // Derivative c + b u + a u^2 of the cubic, u from 0 to 1.
        let [a, b, c] = [3.0 * (from + to) - 6.0 * rise, 6.0 * rise - 4.0 * from - 2.0 * to, from];
        let q = -0.5 * (b + b.signum() * (b * b - 4.0 * a * c).max(0.0).sqrt());
        let u = [q / a, c / q].into_iter().find(|u| (0.0..=1.0).contains(u))?;
        Some(values[before] + u * (c + u * (0.5 * b + u * a / 3.0)))
    };
    (0..values.len()).map(turn).collect()
}

/// First-order low pass with time constant `tau_s`: exact for linear interpolation between the rows, in steady
/// state at the first value.
pub fn low_pass(time_s: &[f64], values: &[f64], tau_s: f64) -> Vec<f64> {
    low_pass_of(time_s, values, tau_s, |row, _| {
        [values[row], values[row + 1] - values[row], 0.0, 0.0]
    })
}

/// The same, exact for cubic Hermite interpolation with `rates`: rows of a sample are further apart than a load's changes.
pub(crate) fn low_pass_with_rates(
    time_s: &[f64],
    values: &[f64],
    rates: &[f64],
    tau_s: f64,
) -> Vec<f64> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    fn times(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64 * 0.01).collect()
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
    fn a_load_turns_between_slow_rows() {
        // 10 N at 0.5 s, between the rows.
        let time_s = [0.2, 0.9, 1.0];
        let values = time_s.map(|t: f64| 10.0 - 4.0 * (t - 0.5).powi(2));
        let rates = time_s.map(|t| -8.0 * (t - 0.5));
        let turns = turns_between(&time_s, &values, &rates);
        assert_abs_diff_eq!(turns[1].unwrap(), 10.0, epsilon = 1e-12);
        assert_eq!([turns[0], turns[2]], [None, None]);
        // 9.64, 10.00, 9.36 N: of a reach of 0.5 N, from the middle 0.36 N up and 0.64 N down.
        let found = stop_operators(&values, &turns, [(1.0, 0.5)], 0.0);
        assert_abs_diff_eq!(found[1], (0.36 - 0.64) / 0.5, epsilon = 1e-12);
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
