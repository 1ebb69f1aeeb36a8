//! Excitation of one sensor over one recording: reference forces, covariates and load cycles.

use std::collections::BTreeMap;

use crate::recordings::Recording;
use crate::recordings::columns::{Axis, force_column_name};
use crate::recordings::recording::ForceSeries;
use crate::recordings::smoothing::{self, Smoother};

/// Forces and covariates of one sensor over one recording, on the reference clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExcitationSeries {
    /// Index of the recording in the campaign.
    pub recording: usize,
    /// Start of the recording in seconds since the start of the campaign.
    pub start_s: f64,
    /// Total duration of the previous recordings in seconds: the time origin of the recordings laid end to end,
    /// which is unique even where start times are not recorded.
    pub before_s: f64,
    /// Time since the first row of the recording in seconds.
    pub time_s: Vec<f64>,
    /// Lateral and longitudinal reference force in newtons; zero for a missing axis.
    pub force_n: Vec<[f64; 2]>,
    /// Smoothed force in newtons. Operators with memory or derivatives use it, so that no effect reduces the
    /// residual by averaging the reference's noise.
    pub smooth_n: Vec<[f64; 2]>,
    /// Rate of the force in N/s.
    pub rate_n_per_s: Vec<[f64; 2]>,
    /// Windows of the smoothing.
    pub smoother: Smoother,
    /// Window of each row and axis, a place in the smoother; empty: the narrowest.
    pub windows: Vec<[u8; 2]>,
    /// Load cycles of each axis since the start of the campaign (see [`LoadCycleCounter`]).
    pub cycles: Vec<[f64; 2]>,
    /// Temperature of the sensor in degrees Celsius; empty if not recorded.
    pub temperature_c: Vec<f64>,
    /// Covariates of the gripper by column name.
    pub covariates: BTreeMap<String, Vec<f64>>,
    /// Forces on the other sensors by column name, and zero for this sensor's own; empty where it is the only one with forces.
    pub forces_of_others: BTreeMap<String, Vec<f64>>,
}

impl ExcitationSeries {
    /// The rows `usable` of `sensor` in `recording`; `position`: index of the recording and total duration of the
    /// previous ones in seconds; `forces`: lateral and longitudinal reference (`None` for a missing axis).
    pub fn new(
        recording: &Recording,
        position: (usize, f64),
        sensor: u32,
        forces: [Option<(u32, Axis)>; 2],
        usable: &[usize],
    ) -> Self {
        let first_s = recording.time_s.first().copied().unwrap_or(0.0);
        let time_s: Vec<f64> = usable.iter().map(|&i| recording.time_s[i] - first_s).collect();
        let columns = forces.map(|force| {
            let series = force.and_then(|force| recording.forces.get(&force));
            series.map_or_else(
                || vec![0.0; usable.len()],
                |series| select_rows(&series.newtons, usable),
            )
        });
        let half_window = smoothing::half_window(&time_s, columns.iter().map(Vec::as_slice));
        let force_n = columns[0].iter().zip(&columns[1]).map(|(x, z)| [*x, *z]).collect();
        let temperature = recording.sensors.get(&sensor).map(|series| &series.temperature_c);
        Self {
            recording: position.0,
            start_s: recording.description.start_s,
            before_s: position.1,
            cycles: Vec::new(),
            smoother: Smoother::new(half_window, &time_s),
            temperature_c: temperature.map_or_else(Vec::new, |t| select_rows(t, usable)),
            covariates: recording
                .covariates
                .iter()
                .map(|(name, values)| (name.clone(), select_rows(values, usable)))
                .collect(),
            forces_of_others: forces_of_others(recording, forces, usable),
            time_s,
            ..Self::default()
        }
        .with_forces(force_n)
    }

    /// The same rows with other forces in newtons; smoothed forces and rates are recomputed, load cycles kept.
    pub fn with_forces(&self, force_n: Vec<[f64; 2]>) -> Self {
        let [x, z] = [0, 1].map(|axis| {
            let column: Vec<f64> = force_n.iter().map(|force| force[axis]).collect();
            self.smoother.smooth(&self.time_s, &column)
        });
        let pair = |x: &[f64], z: &[f64]| x.iter().zip(z).map(|(x, z)| [*x, *z]).collect();
        Self {
            smooth_n: pair(&x.values, &z.values),
            rate_n_per_s: pair(&x.rates, &z.rates),
            windows: x.windows.iter().zip(&z.windows).map(|(x, z)| [*x, *z]).collect(),
            force_n,
            ..self.clone()
        }
    }

    /// The selected rows, in this order.
    pub fn at(&self, rows: &[usize]) -> Self {
        Self {
            time_s: select_rows(&self.time_s, rows),
            force_n: select_rows(&self.force_n, rows),
            smooth_n: select_rows(&self.smooth_n, rows),
            rate_n_per_s: select_rows(&self.rate_n_per_s, rows),
            cycles: select_rows(&self.cycles, rows),
            temperature_c: select_rows(&self.temperature_c, rows),
            covariates: self
                .covariates
                .iter()
                .map(|(name, values)| (name.clone(), select_rows(values, rows)))
                .collect(),
            forces_of_others: self
                .forces_of_others
                .iter()
                .map(|(name, values)| (name.clone(), select_rows(values, rows)))
                .collect(),
            windows: select_rows(&self.windows, rows),
            smoother: self.smoother.clone(),
            ..*self
        }
    }

    /// The one of these values of each window that applies to the row of an axis; 0 of none.
    pub(super) fn at_window(&self, values: &[f64], row: usize, axis: usize) -> f64 {
        let window = self.windows.get(row).map_or(0, |windows| usize::from(windows[axis]));
        values.get(window).copied().unwrap_or(0.0)
    }

    /// Rows at which the smoothed force along an axis (0 lateral, 1 longitudinal) turns by more than a twentieth of its amplitude; at
    /// most `most` of them, those of the larger turns.
    pub(crate) fn turning_points(&self, axis: usize, most: usize) -> Vec<usize> {
        let force_n = || self.smooth_n.iter().map(|force| force[axis]);
        let mean = force_n().sum::<f64>() / self.len().max(1) as f64;
        let squares: f64 = force_n().map(|force| (force - mean).powi(2)).sum();
        let amplitude_n = (2.0 * squares / self.len().max(1) as f64).sqrt();
        let deadbands = std::iter::successors(Some(DEADBAND), |deadband| Some(1.5 * deadband));
        deadbands
            .take_while(|deadband| *deadband < 1.0)
            .map(|deadband| turning_points(force_n(), deadband * amplitude_n))
            .find(|points| points.len() <= most)
            .unwrap_or_default()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// A covariate by column name, recorded or one of [`BUILT_IN_COVARIATES`].
    pub fn covariate(&self, name: &str) -> Option<Vec<f64>> {
        let force = |axis: usize| self.force_n.iter().map(|force| force[axis]).collect();
        match name {
            "fx_n" => Some(force(0)),
            "fz_n" => Some(force(1)),
            "temp_c" => (!self.temperature_c.is_empty()).then(|| self.temperature_c.clone()),
            "time_s" => Some(self.time_s.clone()),
            "fx_rate_n_per_s" => Some(self.rate_n_per_s.iter().map(|rate| rate[0]).collect()),
            "fz_rate_n_per_s" => Some(self.rate_n_per_s.iter().map(|rate| rate[1]).collect()),
            OPENING_RATE => {
                let opening_mm = self.covariates.get("opening_mm")?;
                Some(smoothing::smooth(&self.time_s, opening_mm).1)
            }
            "session_s" => Some(self.time_s.iter().map(|t| t + self.start_s).collect()),
            _ => self.covariates.get(name).or_else(|| self.forces_of_others.get(name)).cloned(),
        }
    }
}

/// Forces on all sensors but that of `own`, whose columns are zero; none where no other sensor has any.
fn forces_of_others(
    recording: &Recording,
    own: [Option<(u32, Axis)>; 2],
    usable: &[usize],
) -> BTreeMap<String, Vec<f64>> {
    let is_own = |sensor: u32| own.iter().flatten().any(|force| force.0 == sensor);
    if recording.forces.keys().all(|(sensor, _)| is_own(*sensor)) {
        return BTreeMap::new();
    }
    let column = |(key, series): (&(u32, Axis), &ForceSeries)| {
        let values = match is_own(key.0) {
            true => vec![0.0; usable.len()],
            false => select_rows(&series.newtons, usable),
        };
        (force_column_name(*key), values)
    };
    recording.forces.iter().map(column).collect()
}

/// The values at these rows; empty for an empty column.
pub(super) fn select_rows<T: Copy>(values: &[T], rows: &[usize]) -> Vec<T> {
    let found = rows.iter().filter_map(|&row| values.get(row));
    found.copied().collect()
}

/// Covariates of every sensor: its two forces and their rates, its temperature, time since the start of the recording and
/// of the campaign.
pub const BUILT_IN_COVARIATES: [&str; 7] =
    ["fx_n", "fz_n", "fx_rate_n_per_s", "fz_rate_n_per_s", "temp_c", "time_s", "session_s"];

/// Covariate of recordings with an opening: its rate.
pub const OPENING_RATE: &str = "opening_rate_mm_per_s";

/// Recorded or built-in column from which a covariate is computed.
pub fn source_column(covariate: &str) -> &str {
    match covariate {
        OPENING_RATE => "opening_mm",
        own => own,
    }
}

/// Deadband relative to the amplitude of the load: smaller reversals count as noise.
const DEADBAND: f64 = 0.05;

/// Load cycles over the recordings of a campaign: accumulated path of the load divided by the path of one cycle
/// with the amplitude of the first recording. Continuous; small cycles count proportionally.
#[derive(Clone, Copy, Debug, Default)]
pub struct LoadCycleCounter {
    /// Cycles of the previous recordings.
    previous: [f64; 2],
    /// Amplitude of a sine with the RMS of the first recording's load in newtons; zero before it and without
    /// load.
    amplitude_n: [f64; 2],
}

impl LoadCycleCounter {
    /// Sets [`ExcitationSeries::cycles`] of the next recording.
    pub fn update(&mut self, excitation: &mut ExcitationSeries) {
        excitation.cycles = vec![self.previous; excitation.len()];
        for axis in [0, 1] {
            let force: Vec<f64> = excitation.smooth_n.iter().map(|force| force[axis]).collect();
            if self.amplitude_n[axis] <= 0.0 {
                let squares: f64 = force.iter().map(|force| force * force).sum();
                self.amplitude_n[axis] = (2.0 * squares / force.len().max(1) as f64).sqrt();
            }
            let amplitude_n = self.amplitude_n[axis];
            if amplitude_n <= 0.0 {
                continue;
            }
            let path_n = path_length(&force, DEADBAND * amplitude_n);
            for (cycles, path_n) in excitation.cycles.iter_mut().zip(path_n) {
                // The path of a cycle is four amplitudes.
                cycles[axis] += path_n / (4.0 * amplitude_n);
            }
        }
        if let Some(last) = excitation.cycles.last() {
            self.previous = *last;
        }
    }
}

/// Places of the extrema from which the values then move away by more than `deadband`.
fn turning_points(values: impl Iterator<Item = f64>, deadband: f64) -> Vec<usize> {
    let mut found = Vec::new();
    // Extreme values since the last turning point, with their places.
    let (mut high, mut low) = ((0, f64::NEG_INFINITY), (0, f64::INFINITY));
    let mut rises = None;
    for (place, value) in values.enumerate() {
        if value > high.1 {
            high = (place, value);
        }
        if value < low.1 {
            low = (place, value);
        }
        if rises != Some(false) && value < high.1 - deadband {
            found.push(high.0);
            (rises, low) = (Some(false), (place, value));
        } else if rises != Some(true) && value > low.1 + deadband {
            found.push(low.0);
            (rises, high) = (Some(true), (place, value));
        }
    }
    found
}

/// Accumulated path of the force after a play operator with this half width.
fn path_length(force_n: &[f64], half_width_n: f64) -> Vec<f64> {
    let (mut output, mut path) = (force_n.first().copied().unwrap_or(0.0), 0.0);
    let step = |force: &f64| {
        let next = output.clamp(force - half_width_n, force + half_width_n);
        path += (next - output).abs();
        output = next;
        path
    };
    force_n.iter().map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::StateSeries;
    use crate::effects::operators::{delayed, low_pass};

    #[test]
    fn with_forces_recomputes_rates_and_keeps_covariates() {
        let time_s: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.01).collect();
        let excitation = ExcitationSeries {
            force_n: vec![[1.0, 2.0]; 100],
            temperature_c: time_s.clone(),
            time_s,
            ..ExcitationSeries::default()
        };
        let ramp = excitation.time_s.iter().map(|t| [5.0 * t, -3.0]).collect();
        let changed = excitation.with_forces(ramp).at(&[10, 90]);
        assert_eq!(changed.time_s, [0.1, 0.9]);
        assert_eq!(changed.temperature_c, [0.1, 0.9]);
        assert!((changed.smooth_n[1][0] - 4.5).abs() < 1e-9);
        assert!((changed.rate_n_per_s[0][0] - 5.0).abs() < 1e-6);
        assert!(changed.rate_n_per_s[1][1].abs() < 1e-6);
    }

    #[test]
    fn turning_points_ignore_what_is_within_the_deadband() {
        let values = [0.0, 3.0, 2.5, 5.0, 1.0, 1.4, 0.5, 4.0, 4.2, 3.9];
        assert_eq!(turning_points(values.into_iter(), 1.0), [0, 3, 6]);
        // A turn at the row that ended the rise before.
        assert_eq!(turning_points([0.0, 2.0, 0.5, 2.0].into_iter(), 1.0), [0, 1, 2]);
        assert!(turning_points([1.0; 5].into_iter(), 0.0).is_empty());
    }

    #[test]
    fn load_cycles_accumulate_over_recordings() {
        let time_s: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).collect();
        let sine = |t: &f64| [100.0 * (std::f64::consts::TAU * t).sin(), 0.0];
        let mut series = vec![
            ExcitationSeries {
                smooth_n: time_s.iter().map(sine).collect(),
                time_s,
                ..ExcitationSeries::default()
            };
            2
        ];
        let mut counter = LoadCycleCounter::default();
        series.iter_mut().for_each(|one| counter.update(one));
        let last = |one: &ExcitationSeries| one.cycles.last().unwrap()[0];
        // Ten periods each; the deadband shortens the path at each reversal.
        assert!((last(&series[0]) - 10.0 * 0.95).abs() < 0.05);
        assert!((last(&series[1]) - 20.0 * 0.95).abs() < 0.1);
        assert_eq!(series[1].cycles[0][1], 0.0);
    }

    type Operator<'a> = &'a dyn Fn(&[f64], &[f64], &[f64]) -> Vec<f64>;

    /// Added to the lateral force.
    fn added_by(excitation: &ExcitationSeries, operator: Operator) -> Vec<f64> {
        let mut series = StateSeries::unloaded(excitation);
        series.apply_operator(excitation, 0, operator);
        let rows = series.force_n.iter().zip(&excitation.force_n);
        rows.map(|(after, before)| after[0] - before[0]).collect()
    }

    /// The increment of a row does not follow the row's own noise, in slow and in fast stretches: else a lag would average the
    /// reference's noise. The choice of the windows follows the noise and leaves a share for large delays, of 0.025 for 20 ms; nine
    /// rows everywhere would leave (39 - 59) / 231 = -0.09 without the correction. A low pass of 30 ms has 0.033.
    #[test]
    fn increment_excludes_the_noise_of_its_own_row() {
        let time_s: Vec<f64> = (0..6000).map(|i| f64::from(i) * 0.01).collect();
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
        };
        let noise: Vec<f64> = time_s.iter().map(|_| uniform()).collect();
        let load = |t: f64| 20.0 * libm::sin(t * t * 0.2);
        let force_n = |noise: &[f64]| -> Vec<[f64; 2]> {
            time_s.iter().zip(noise).map(|(t, noise)| [load(*t) + noise, 0.0]).collect()
        };
        let excitation = ExcitationSeries {
            smoother: Smoother::new(smoothing::HALF_WINDOW, &time_s),
            time_s: time_s.clone(),
            ..ExcitationSeries::default()
        }
        .with_forces(force_n(&noise));
        assert!((0..4).all(|window| excitation.windows.iter().any(|own| own[0] == window)));
        let exact = excitation.with_forces(force_n(&vec![0.0; noise.len()]));
        let share = |operator: Operator| {
            let (noisy, exact) = (added_by(&excitation, operator), added_by(&exact, operator));
            let rows = noisy.iter().zip(&exact).zip(&noise);
            let product: f64 = rows.map(|((noisy, exact), noise)| (noisy - exact) * noise).sum();
            product / noise.iter().map(|noise| noise * noise).sum::<f64>()
        };
        for delay_s in [0.003, -0.003, 0.02] {
            let share = share(&|t, values, rates| delayed(t, values, rates, delay_s));
            assert!(share.abs() < 0.005_f64.max(1.5 * delay_s), "{delay_s}: {share}");
        }
        let share = share(&|t, values, _| low_pass(t, values, 0.03));
        assert!(share.abs() < 0.05, "{share}");
    }
}
