//! Resampling of the board's stream onto the reference clock.
//!
//! The piecewise linear interpolant of the board's samples is averaged over a window centred on each
//! reference time (plus the delay). For constant speed the mean is exact at any phase of the two clocks; a
//! plain mean of the samples in the window would be biased by up to half a millisecond, like a clock skew.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};

/// Relation of the two clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Added to the reference time to obtain the board time; positive where the reference's time stamps
    /// are early.
    pub delay_us: f64,
}

/// One sample of all channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Time in microseconds.
    pub t_us: f64,
    /// One value for each channel; NaN propagates to every window that contains it.
    pub values: Vec<f64>,
}

/// Mean over a window.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowMean {
    /// Mean of each channel.
    pub values: Vec<f64>,
    /// Ratio of the standard deviation of white noise after averaging to that before.
    pub noise_gain: f64,
    /// How the channels move within the window; `None` where its samples are too few.
    pub motion: Option<WindowMotion>,
}

/// Samples of a window, at least, of which the motion is evaluated.
const MIN_SAMPLES: usize = 7;

/// Motion of the channels within a window, by a parabola through its samples.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowMotion {
    /// Mean of each channel minus the value of the parabola at the centre.
    pub bends: Vec<f64>,
    /// Standard deviation of a bend of white noise of standard deviation 1.
    pub bend_gain: f64,
    /// Standard deviation of the samples about the parabola.
    pub scatters: Vec<f64>,
}

impl WindowMotion {
    /// Of samples with their weights in the mean. `None` where they are too few.
    fn of(samples: &[(&Sample, f64)], means: &[f64], (from, to): (f64, f64)) -> Option<Self> {
        let is_inside = |sample: &Sample| (from..=to).contains(&sample.t_us);
        let inside: Vec<&Sample> =
            samples.iter().map(|(sample, _)| *sample).filter(|sample| is_inside(sample)).collect();
        if inside.len() < MIN_SAMPLES {
            return None;
        }
        let terms = |sample: &Sample| {
            let x = (sample.t_us - 0.5 * (from + to)) / (0.5 * (to - from));
            Vector3::new(1.0, x, x * x)
        };
        let normal: Matrix3<f64> =
            inside.iter().map(|sample| terms(sample) * terms(sample).transpose()).sum();
        let inverse = normal.try_inverse()?;
        // The value at the centre is the first coefficient.
        let weight_at_centre = |sample: &Sample| match is_inside(sample) {
            true => (inverse * terms(sample)).x,
            false => 0.0,
        };
        let gain2 =
            samples.iter().map(|(sample, weight)| (weight - weight_at_centre(sample)).powi(2));
        let freedom = (inside.len() - 3) as f64;
        let of_channel = |channel: usize| {
            // Relative to the mean: a field is large next to its noise.
            let value = |sample: &Sample| sample.values[channel] - means[channel];
            let moments: Vector3<f64> =
                inside.iter().map(|sample| terms(sample) * value(sample)).sum();
            let parabola = inverse * moments;
            let left = |sample: &&Sample| (value(sample) - parabola.dot(&terms(sample))).powi(2);
            (-parabola.x, (inside.iter().map(left).sum::<f64>() / freedom).sqrt())
        };
        let (bends, scatters) = (0..means.len()).map(of_channel).unzip();
        Some(Self { bends, bend_gain: gain2.sum::<f64>().sqrt(), scatters })
    }
}

/// Result of averaging over a window.
#[derive(Clone, Debug, PartialEq)]
pub enum Window {
    /// Complete.
    Ready(WindowMean),
    /// The samples end before the window: push more.
    NeedsMore,
    /// The window begins before the first sample or contains a gap of the clock.
    Uncovered,
}

/// Averages over windows of ascending times; stores the samples of one window.
#[derive(Clone, Debug)]
pub struct Aligner {
    half_width_us: f64,
    gap_us: f64,
    samples: VecDeque<Sample>,
}

impl Aligner {
    /// A step of the clock above `gap_us` is a gap.
    pub fn new(half_width_us: f64, gap_us: f64) -> Self {
        Self { half_width_us, gap_us, samples: VecDeque::new() }
    }

    /// Adds a sample; times must ascend.
    pub fn push(&mut self, sample: Sample) {
        self.samples.push_back(sample);
    }

    /// Number of stored values.
    pub(crate) fn stored_values(&self) -> usize {
        self.samples.len() * self.samples.front().map_or(0, |sample| sample.values.len())
    }

    /// Mean over the window around `centre_us`, of no width the interpolated value there; calls must be in ascending order of time.
    pub(crate) fn mean_around(&mut self, centre_us: f64) -> Window {
        let (from, to) = (centre_us - self.half_width_us, centre_us + self.half_width_us);
        while self.samples.get(1).is_some_and(|second| second.t_us <= from) {
            self.samples.pop_front();
        }
        match (self.samples.front(), self.samples.back()) {
            (Some(first), _) if first.t_us > from => Window::Uncovered,
            (Some(_), Some(last)) if last.t_us >= to && from == to => self.interpolate(centre_us),
            (Some(_), Some(last)) if last.t_us >= to => self.average(from, to),
            _ => Window::NeedsMore,
        }
    }

    fn interpolate(&self, at_us: f64) -> Window {
        let Some(before) = self.samples.front() else { return Window::NeedsMore };
        let after = self.samples.get(1).filter(|_| before.t_us < at_us).unwrap_or(before);
        let step = after.t_us - before.t_us;
        if step > self.gap_us {
            return Window::Uncovered;
        }
        let fraction = if step > 0.0 { (at_us - before.t_us) / step } else { 0.0 };
        let pairs = before.values.iter().zip(&after.values);
        let values = match fraction {
            0.0 => before.values.clone(),
            _ => pairs.map(|(a, b)| a + fraction * (b - a)).collect(),
        };
        let noise_gain = fraction.hypot(1.0 - fraction);
        Window::Ready(WindowMean { values, noise_gain, motion: None })
    }

    fn average(&self, from: f64, to: f64) -> Window {
        let channels = self.samples.front().map_or(0, |sample| sample.values.len());
        let mut values = vec![0.0; channels];
        let mut weights = vec![0.0; self.samples.len()];
        for (i, (a, b)) in self.samples.iter().zip(self.samples.iter().skip(1)).enumerate() {
            if a.t_us >= to {
                break;
            }
            let step = b.t_us - a.t_us;
            if step > self.gap_us {
                return Window::Uncovered;
            }
            let (p, q) = (a.t_us.max(from), b.t_us.min(to));
            let weight = (q - p) / (to - from);
            let fraction = (0.5 * (p + q) - a.t_us) / step;
            let (weight_a, weight_b) = (weight * (1.0 - fraction), weight * fraction);
            for (value, (&x, &y)) in values.iter_mut().zip(a.values.iter().zip(&b.values)) {
                *value += weight_a * x + weight_b * y;
            }
            weights[i] += weight_a;
            weights[i + 1] += weight_b;
        }
        let noise_gain = weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt();
        let weighted = self.samples.iter().zip(weights).filter(|(_, weight)| *weight > 0.0);
        let motion = WindowMotion::of(&weighted.collect::<Vec<_>>(), &values, (from, to));
        Window::Ready(WindowMean { values, noise_gain, motion })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn aligner_with(samples: impl IntoIterator<Item = (f64, f64)>) -> Aligner {
        let mut aligner = Aligner::new(5000.0, 5000.0);
        for (t_us, value) in samples {
            aligner.push(Sample { t_us, values: vec![value] });
        }
        aligner
    }

    fn ready(window: Window) -> WindowMean {
        match window {
            Window::Ready(mean) => mean,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn samples_on_the_grid_have_trapezoidal_weights() {
        // Weight 1/20 at the edges of the window, 1/10 inside.
        for (position, weight) in [(5, 0.05), (7, 0.1), (10, 0.1), (15, 0.05)] {
            let samples =
                (0..30).map(|i| (f64::from(i) * 1000.0, f64::from(u8::from(i == position))));
            let mean = ready(aligner_with(samples).mean_around(10_000.0));
            assert!((mean.values[0] - weight).abs() < 1e-12, "{position}: {mean:?}");
            // sqrt(9 / 100 + 2 / 400)
            assert!((mean.noise_gain - 0.308_220_700_148_448_8).abs() < 1e-12);
        }
    }

    #[test]
    fn a_bend_is_the_mean_minus_the_parabola_at_the_centre() {
        // Samples at -5 to 5 ms of the centre. Interpolated linearly, the mean of x^2 over the window is 1/3 + 1/150.
        let motion = |value: fn(f64) -> f64| {
            let samples =
                (0..30).map(|i| (f64::from(i) * 1000.0, value((f64::from(i) - 10.0) / 5.0)));
            ready(aligner_with(samples).mean_around(10_000.0)).motion.unwrap()
        };
        for (value, bend) in [
            ((|x| 900.0 + 7.0 * x) as fn(f64) -> f64, 0.0),
            (|x| 900.0 - 3.0 * x + 2.0 * x * x, 2.0 * (1.0 / 3.0 + 1.0 / 150.0)),
        ] {
            let motion = motion(value);
            assert!((motion.bends[0] - bend).abs() < 1e-9, "{motion:?}");
            assert!(motion.scatters[0] < 1e-6, "{motion:?}");
            // Weights of a parabola's centre over eleven rows (Savitzky and Golay 1964): (-36, 9, 44, 69, 84, 89, ...) / 429.
            let centre = [-36.0, 9.0, 44.0, 69.0, 84.0, 89.0, 84.0, 69.0, 44.0, 9.0, -36.0];
            let squares = centre.iter().enumerate().map(|(i, c)| {
                let mean = if i == 0 || i == 10 { 0.05 } else { 0.1 };
                (mean - c / 429.0_f64).powi(2)
            });
            assert!((motion.bend_gain - squares.sum::<f64>().sqrt()).abs() < 1e-12, "{motion:?}");
        }
    }

    #[test]
    fn few_samples_show_no_motion() {
        let samples = (0..10).map(|i| (f64::from(i) * 2000.0, f64::from(i)));
        assert_eq!(ready(aligner_with(samples).mean_around(10_000.0)).motion, None);
    }

    proptest! {
        #[test]
        fn constant_speed_is_exact_at_any_phase_and_jitter(
            phase in 0.0..1000.0_f64,
            jitter in proptest::collection::vec(-300.0..300.0_f64, 40),
            speed in -5.0..5.0_f64,
        ) {
            let samples = jitter.iter().enumerate().map(|(i, j)| {
                let t = i as f64 * 1000.0 + phase + j;
                (t, speed * t)
            });
            let mean = ready(aligner_with(samples).mean_around(20_000.0));
            prop_assert!((mean.values[0] - speed * 20_000.0).abs() < 1e-6);
        }
    }

    #[test]
    fn window_in_a_gap_or_before_the_start_is_uncovered() {
        let samples = [0.0, 1000.0, 2000.0, 9000.0, 10_000.0, 30_000.0].map(|t| (t, 1.0));
        assert_eq!(aligner_with(samples).mean_around(3000.0), Window::Uncovered);
        assert_eq!(aligner_with(samples).mean_around(6000.0), Window::Uncovered);
        assert_eq!(aligner_with(samples).mean_around(40_000.0), Window::NeedsMore);
    }
}
