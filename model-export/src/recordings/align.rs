//! Resampling of the board's stream onto the reference clock.
//!
//! The piecewise linear interpolant of the board's samples is averaged over a window centred on each
//! reference time (plus the delay). For constant speed the mean is exact at any phase of the two clocks; a
//! plain mean of the samples in the window would be biased by up to half a millisecond, like a clock skew.

use std::collections::VecDeque;

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
    pub fn stored_values(&self) -> usize {
        self.samples.len() * self.samples.front().map_or(0, |sample| sample.values.len())
    }

    /// The sample of this very time, where there is one: a reading at the instant of the reference needs no interpolation, which would
    /// mix it with its neighbours. Calls as of [`Aligner::mean_around`].
    pub fn at(&mut self, time_us: f64) -> Window {
        while self.samples.get(1).is_some_and(|second| second.t_us <= time_us - self.half_width_us)
        {
            self.samples.pop_front();
        }
        if self.samples.back().is_none_or(|last| last.t_us < time_us) {
            return Window::NeedsMore;
        }
        let same = self.samples.iter().find(|sample| sample.t_us == time_us);
        same.map_or(Window::Uncovered, |sample| {
            Window::Ready(WindowMean { values: sample.values.clone(), noise_gain: 1.0 })
        })
    }

    /// Mean over the window around `centre_us`; calls must be in ascending order of time.
    pub fn mean_around(&mut self, centre_us: f64) -> Window {
        let (from, to) = (centre_us - self.half_width_us, centre_us + self.half_width_us);
        while self.samples.get(1).is_some_and(|second| second.t_us <= from) {
            self.samples.pop_front();
        }
        match (self.samples.front(), self.samples.back()) {
            (Some(first), _) if first.t_us > from => Window::Uncovered,
            (Some(_), Some(last)) if last.t_us >= to => self.average(from, to),
            _ => Window::NeedsMore,
        }
    }

    fn average(&self, from: f64, to: f64) -> Window {
        let channels = self.samples.front().map_or(0, |sample| sample.values.len());
        let mut values = vec![0.0; channels];
        let mut squares = 0.0;
        // Weight of the shared sample from the previous segment.
        let mut previous_weight = 0.0;
        for (a, b) in self.samples.iter().zip(self.samples.iter().skip(1)) {
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
            squares += (previous_weight + weight_a).powi(2);
            previous_weight = weight_b;
        }
        squares += previous_weight * previous_weight;
        Window::Ready(WindowMean { values, noise_gain: squares.sqrt() })
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
    fn sample_of_the_same_time_is_taken_as_it_is() {
        let samples = [(0.0, 1.0), (5000.0, 4.0), (10_000.0, 2.0)];
        let mut aligner = aligner_with(samples);
        assert_eq!(ready(aligner.at(0.0)).values, [1.0]);
        assert_eq!(ready(aligner.at(5000.0)), WindowMean { values: vec![4.0], noise_gain: 1.0 });
        assert_eq!(aligner.at(6000.0), Window::Uncovered);
        assert_eq!(aligner.at(11_000.0), Window::NeedsMore);
    }

    #[test]
    fn window_in_a_gap_or_before_the_start_is_uncovered() {
        let samples = [0.0, 1000.0, 2000.0, 9000.0, 10_000.0, 30_000.0].map(|t| (t, 1.0));
        assert_eq!(aligner_with(samples).mean_around(3000.0), Window::Uncovered);
        assert_eq!(aligner_with(samples).mean_around(6000.0), Window::Uncovered);
        assert_eq!(aligner_with(samples).mean_around(40_000.0), Window::NeedsMore);
    }
}
