//! The board's stream brought to the reference's clock by averaging.
//!
//! Around each reference time the board's samples are joined by straight lines and averaged over
//! a window centred on that time (plus the stated delay). The mean of a motion of constant speed
//! is then exact whatever the phase of the two clocks; a plain mean of the ten samples at hand
//! would sit half a millisecond to one side and look like a clock skew.

use std::collections::VecDeque;

/// How two clocks are brought together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Added to the reference's time before looking up the board's: positive where the reference
    /// stamps its rows early.
    pub delay_us: f64,
}

/// A sample of several channels at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Time in microseconds.
    pub t_us: f64,
    /// One value for each channel; NaN spoils the windows that it lies in.
    pub values: Vec<f64>,
}

/// The mean over one window.
#[derive(Clone, Debug, PartialEq)]
pub struct Mean {
    /// One mean for each channel.
    pub values: Vec<f64>,
    /// Factor by which the averaging multiplies the standard deviation of white noise.
    pub noise_gain: f64,
}

/// What is known about a window so far.
#[derive(Clone, Debug, PartialEq)]
pub enum Window {
    /// Averaged.
    Ready(Mean),
    /// Samples up to a later time are needed: push more.
    NeedsMore,
    /// The window begins before the first sample, or a gap in the clock lies in it.
    Uncovered,
}

/// Averages windows whose times only grow; holds no more samples than one window needs.
#[derive(Clone, Debug)]
pub struct Aligner {
    half_width_us: f64,
    gap_us: f64,
    held: VecDeque<Sample>,
}

impl Aligner {
    /// Windows of `half_width_us` to either side; a step of the clock above `gap_us` is a gap.
    pub fn new(half_width_us: f64, gap_us: f64) -> Self {
        Self {
            half_width_us,
            gap_us,
            held: VecDeque::new(),
        }
    }

    /// Adds the next sample; its time is after that of the one before.
    pub fn push(&mut self, sample: Sample) {
        self.held.push_back(sample);
    }

    /// The mean around `centre_us`, which must not be before an earlier one.
    pub fn mean_around(&mut self, centre_us: f64) -> Window {
        let (from, to) = (
            centre_us - self.half_width_us,
            centre_us + self.half_width_us,
        );
        while self.held.get(1).is_some_and(|second| second.t_us <= from) {
            self.held.pop_front();
        }
        match (self.held.front(), self.held.back()) {
            (Some(first), _) if first.t_us > from => Window::Uncovered,
            (Some(_), Some(last)) if last.t_us >= to => self.average(from, to),
            _ => Window::NeedsMore,
        }
    }

    fn average(&self, from: f64, to: f64) -> Window {
        let channels = self.held.front().map_or(0, |sample| sample.values.len());
        let mut values = vec![0.0; channels];
        let mut squares = 0.0;
        // Weight that the segment before gave to the sample that it shares with the next.
        let mut carried = 0.0;
        for (a, b) in self.held.iter().zip(self.held.iter().skip(1)) {
            if a.t_us >= to {
                break;
            }
            let step = b.t_us - a.t_us;
            if step > self.gap_us {
                return Window::Uncovered;
            }
            let (p, q) = (a.t_us.max(from), b.t_us.min(to));
            let share = (q - p) / (to - from);
            let towards_b = (0.5 * (p + q) - a.t_us) / step;
            let (weight_a, weight_b) = (share * (1.0 - towards_b), share * towards_b);
            for (value, (&x, &y)) in values.iter_mut().zip(a.values.iter().zip(&b.values)) {
                *value += weight_a * x + weight_b * y;
            }
            squares += (carried + weight_a).powi(2);
            carried = weight_b;
        }
        squares += carried * carried;
        Window::Ready(Mean {
            values,
            noise_gain: squares.sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn aligner_with(samples: impl IntoIterator<Item = (f64, f64)>) -> Aligner {
        let mut aligner = Aligner::new(5000.0, 5000.0);
        for (t_us, value) in samples {
            aligner.push(Sample {
                t_us,
                values: vec![value],
            });
        }
        aligner
    }

    fn ready(window: Window) -> Mean {
        match window {
            Window::Ready(mean) => mean,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn eleven_samples_on_the_grid_get_the_weights_of_the_trapezoid() {
        // One sample of height 1 at the edge of the window weighs 1/20, inside it 1/10.
        for (place, weight) in [(5, 0.05), (7, 0.1), (10, 0.1), (15, 0.05)] {
            let samples = (0..30).map(|i| (f64::from(i) * 1000.0, f64::from(u8::from(i == place))));
            let mean = ready(aligner_with(samples).mean_around(10_000.0));
            assert!((mean.values[0] - weight).abs() < 1e-12, "{place}: {mean:?}");
            // sqrt(9 / 100 + 2 / 400)
            assert!((mean.noise_gain - 0.308_220_700_148_448_8).abs() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn constant_speed_is_exact_whatever_the_phase_and_the_jitter(
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
    fn a_window_in_a_gap_or_before_the_start_is_not_covered() {
        let samples = [0.0, 1000.0, 2000.0, 9000.0, 10_000.0, 30_000.0].map(|t| (t, 1.0));
        assert_eq!(aligner_with(samples).mean_around(3000.0), Window::Uncovered);
        assert_eq!(aligner_with(samples).mean_around(6000.0), Window::Uncovered);
        assert_eq!(
            aligner_with(samples).mean_around(40_000.0),
            Window::NeedsMore
        );
    }
}
