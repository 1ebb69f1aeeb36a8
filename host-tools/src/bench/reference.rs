//! The reference sensor of one axis: its filter, its wandering zero, its noise.

use super::effects::Effects;

/// Longest step of the filter's integration, in seconds.
const STEP_S: f64 = 2.5e-4;

/// A reference sensor for both axes of one finger.
#[derive(Clone, Debug)]
pub struct Reference {
    filter_s: f64,
    drift_n_per_s: f64,
    at_s: f64,
    input_n: [f64; 2],
    output_n: [f64; 2],
}

impl Reference {
    /// A reference at rest at the start of a recording.
    pub fn new(effects: &Effects) -> Self {
        Self {
            filter_s: 1e-3 * effects.size("reference_filter"),
            drift_n_per_s: effects.size("reference_drift") / 60.0,
            at_s: 0.0,
            input_n: [0.0; 2],
            output_n: [0.0; 2],
        }
    }

    /// What it shows at a time of the recording, before noise; `load` is the true one at any time.
    pub fn read(&mut self, time_s: f64, start_s: f64, load: impl Fn(f64) -> [f64; 2]) -> [f64; 2] {
        if self.filter_s > 0.0 {
            self.filter_to(time_s, load);
        } else {
            self.output_n = load(time_s);
        }
        let [x, z] = self.output_n;
        [x + self.drift_n_per_s * (start_s + time_s), z]
    }

    /// `filter_s y' = F - y`, by the trapezoidal rule.
    fn filter_to(&mut self, time_s: f64, load: impl Fn(f64) -> [f64; 2]) {
        let steps = ((time_s - self.at_s) / STEP_S).ceil().max(1.0);
        let half = 0.5 * (time_s - self.at_s) / (steps * self.filter_s);
        let from_s = self.at_s;
        for step in 1..=steps as u32 {
            let share = f64::from(step) / steps;
            let input = load(from_s + share * (time_s - from_s));
            for ((output, &now), before) in self.output_n.iter_mut().zip(&input).zip(self.input_n) {
                *output += half * (before + now - 2.0 * *output) / (1.0 + half);
            }
            self.input_n = input;
        }
        self.at_s = time_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reference(wanted: &str) -> Reference {
        Reference::new(&Effects::new(&[wanted.parse().unwrap()], 1, 1, 0.0).unwrap())
    }

    #[test]
    fn a_filtered_ramp_arrives_late_by_the_time_constant() {
        let mut reference = reference("reference_filter=4");
        let mut shown = 0.0;
        for step in 1..=100 {
            let time_s = 0.01 * f64::from(step);
            shown = reference.read(time_s, 0.0, |t| [100.0 * t, 0.0])[0];
        }
        assert!((100.0 - shown - 0.4).abs() < 1e-6, "{shown}");
    }

    #[test]
    fn the_lateral_zero_wanders_with_the_session() {
        let shown = reference("reference_drift=0.4").read(30.0, 600.0, |_| [0.0; 2]);
        assert!((shown[0] - 4.2).abs() < 1e-12 && shown[1] == 0.0);
    }
}
