//! Averaged periodograms (Welch's method) of a recording and their narrow spectral lines.

use std::sync::Arc;

use rustfft::algorithm::Radix4;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftDirection};

/// Segment length in seconds: a resolution of a quarter of a hertz, with several segments in a
/// recording of some seconds.
const SEGMENT_S: f64 = 5.0;
/// Minimum number of segments for a test.
const LEAST_SEGMENTS: usize = 3;
/// Effective share of independent segments for half-overlapping Hann windows.
const INDEPENDENT: f64 = 0.9;
/// Lower bound of the search in hertz: motion and load have lines below.
const LOWEST_HZ: f64 = 5.0;
/// Width of a line in bins on each side, by the window.
const LOBE: usize = 2;
/// Guard bins between a line and its background.
const GUARD: usize = 4;
/// Background bins on each side.
const SIDE: usize = 24;
/// Probability of one false line in a whole campaign.
const FALSE_ALARM: f64 = 1e-3;
/// Additional factor on the threshold: the background is estimated, and real noise is not exactly
/// white.
const MARGIN: f64 = 2.0;
/// Bins below this share of the maximum power are not part of the load.
const LOAD_SHARE: f64 = 1e-3;
/// Number of consecutive bins without load that end its band.
const LOAD_END: usize = 4;

/// Narrow spectral line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpectralLine {
    /// Frequency in hertz, aliased at the table's row rate.
    pub hz: f64,
    /// Amplitude (half of peak to peak), in the column's unit.
    pub amplitude: f64,
    /// Bin width in hertz: the frequency resolution.
    pub bin_hz: f64,
}

/// Averaged periodogram of one column.
#[derive(Clone)]
pub struct Spectrum {
    // Of one algorithm: a planner's many were more than half of the code that the compiler got for the tests of this crate.
    transform: Arc<Radix4<f64>>,
    window: Arc<Vec<f64>>,
    rate_hz: f64,
    buffer: Vec<f64>,
    power: Vec<f64>,
    segments: usize,
}

impl Spectrum {
    /// For rows at `rate_hz`; `None` where the rate is unknown. A clone shares the transform and the window.
    pub fn new(rate_hz: f64) -> Option<Self> {
        if !rate_hz.is_finite() || rate_hz <= 4.0 * LOWEST_HZ {
            return None;
        }
        let length = (SEGMENT_S * rate_hz).log2().round().clamp(6.0, 16.0).exp2() as usize;
        let turn = std::f64::consts::TAU / length as f64;
        let hann = |i: usize| 0.5 - 0.5 * (turn * i as f64).cos();
        Some(Self {
            transform: Arc::new(Radix4::new(length, FftDirection::Forward)),
            window: Arc::new((0..length).map(hann).collect()),
            rate_hz,
            buffer: Vec::with_capacity(length),
            power: vec![0.0; length / 2 + 1],
            segments: 0,
        })
    }

    /// Adds a value; a missing row restarts the segment.
    pub fn push(&mut self, value: f64, regular: bool) {
        if !regular || !value.is_finite() {
            self.buffer.clear();
        }
        if value.is_finite() {
            self.buffer.push(value);
        }
        if self.buffer.len() == self.window.len() {
            self.add_segment();
            self.buffer.drain(..self.window.len() / 2);
        }
    }

    fn add_segment(&mut self) {
        let mean = self.buffer.iter().sum::<f64>() / self.buffer.len() as f64;
        let weighted = self.buffer.iter().zip(self.window.iter());
        let mut values: Vec<Complex<f64>> =
            weighted.map(|(x, weight)| Complex::new((x - mean) * weight, 0.0)).collect();
        self.transform.process(&mut values);
        for (sum, value) in self.power.iter_mut().zip(&values) {
            *sum += value.norm_sqr();
        }
        self.segments += 1;
    }

    fn bin_hz(&self) -> f64 {
        self.rate_hz / self.window.len() as f64
    }

    /// Number of tested bins.
    pub fn bins(&self) -> usize {
        self.power.len()
    }

    /// Upper edge in hertz of the band from zero that contains the load.
    pub fn load_edge_hz(&self) -> f64 {
        let most = self.power.iter().skip(1).copied().fold(0.0, f64::max);
        let mut edge = 0;
        for (bin, power) in self.power.iter().enumerate().skip(1) {
            if *power > LOAD_SHARE * most {
                edge = bin;
            } else if bin > edge + LOAD_END {
                break;
            }
        }
        edge as f64 * self.bin_hz()
    }

    /// Significant lines, corrected for `tests` tested bins in the whole campaign.
    pub fn lines(&self, tests: f64) -> Vec<SpectralLine> {
        if self.segments < LEAST_SEGMENTS {
            return Vec::new();
        }
        let averages = INDEPENDENT * self.segments as f64;
        let threshold = MARGIN * highest_by_chance(averages, FALSE_ALARM / tests);
        // At the Nyquist frequency the imaginary part is zero: half the degrees of freedom.
        let at_the_end = 2.0 * MARGIN * highest_by_chance(0.5 * averages, FALSE_ALARM / tests);
        // Median of a mean of exponential variables, relative to the mean (Wilson and Hilferty 1931).
        let median_share = (1.0 - 1.0 / (9.0 * averages)).powi(3);
        let lowest = (LOWEST_HZ / self.bin_hz()).ceil() as usize;
        let mut lines = Vec::new();
        for bin in lowest..self.power.len() {
            let around = bin - LOBE..=bin + LOBE;
            let is_peak = around.into_iter().all(|i| self.at(i) <= self.power[bin]);
            let background = self.background(bin) / median_share;
            let threshold = if self.is_last(bin) { at_the_end } else { threshold };
            if is_peak && self.power[bin] > threshold * background {
                lines.push(self.line(bin, background));
            }
        }
        lines
    }

    /// Power of a bin; indices beyond the Nyquist frequency alias.
    fn at(&self, bin: usize) -> f64 {
        let last = self.power.len() - 1;
        self.power[if bin > last { 2 * last - bin } else { bin }]
    }

    /// True for the bin at the Nyquist frequency.
    fn is_last(&self, bin: usize) -> bool {
        bin + 1 == self.power.len()
    }

    /// Larger of the medians on both sides, so that a slope is no line.
    fn background(&self, bin: usize) -> f64 {
        let below = bin.saturating_sub(GUARD + SIDE).max(1)..bin.saturating_sub(GUARD).max(1);
        let above =
            (bin + GUARD + 1).min(self.power.len())..(bin + GUARD + 1 + SIDE).min(self.power.len());
        [below, above]
            .into_iter()
            .filter(|side| side.len() >= SIDE / 2)
            .map(|side| {
                let mut side = self.power[side].to_vec();
                side.sort_by(f64::total_cmp);
                side[side.len() / 2]
            })
            .fold(0.0, f64::max)
    }

    fn line(&self, bin: usize, background: f64) -> SpectralLine {
        let excess = |i: usize| (self.at(i) - background).max(0.0);
        let lobe = bin - LOBE..=bin + LOBE;
        let total: f64 = lobe.clone().map(excess).sum();
        let centre: f64 = lobe.map(|i| i as f64 * excess(i)).sum::<f64>() / total;
        let squares: f64 = self.window.iter().map(|weight| weight * weight).sum();
        let length = self.window.len() as f64;
        // Half of the power is at the mirrored frequency; at the Nyquist frequency both coincide.
        let share = if self.is_last(bin) { 1.0 } else { 2.0 };
        SpectralLine {
            hz: centre.min((self.power.len() - 1) as f64) * self.bin_hz(),
            amplitude: share * (total / self.segments as f64 / (length * squares)).sqrt(),
            bin_hz: self.bin_hz(),
        }
    }
}

/// Upper quantile of the mean of `averages` exponential variables of mean 1, at probability `chance`
/// (Chernoff's bound: exp(-n (r - 1 - ln r))).
fn highest_by_chance(averages: f64, chance: f64) -> f64 {
    let wanted = -chance.ln() / averages;
    let (mut low, mut high) = (1.0, 2.0 + 2.0 * wanted);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        if middle - 1.0 - middle.ln() < wanted { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};
    use std::f64::consts::TAU;

    fn spectrum(seed: u64, amplitude: f64) -> Spectrum {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, 0.35).unwrap();
        let mut spectrum = Spectrum::new(1000.0).unwrap();
        for row in 0..30_000 {
            let t = f64::from(row) * 1e-3;
            let load = 100.0 * (TAU * 0.7 * t).sin();
            let hum = amplitude * (TAU * 50.0 * t).sin();
            spectrum.push(load + hum + noise.sample(&mut rng), true);
        }
        spectrum
    }

    #[test]
    fn line_is_found_near_a_load_with_its_frequency_and_amplitude() {
        let lines = spectrum(1, 0.3).lines(1e6);
        assert_eq!(lines.len(), 1, "{lines:?}");
        assert!((lines[0].hz - 50.0).abs() < 0.05, "{lines:?}");
        assert!((lines[0].amplitude - 0.3).abs() < 0.03, "{lines:?}");
    }

    #[test]
    fn noise_and_a_slow_load_give_no_line() {
        for seed in 0..20 {
            assert_eq!(spectrum(seed, 0.0).lines(1e4), []);
        }
    }

    #[test]
    fn the_load_ends_where_it_ends() {
        let edge = spectrum(1, 0.3).load_edge_hz();
        assert!((0.7..2.5).contains(&edge), "{edge}");
    }

    #[test]
    fn the_bound_of_chance_holds_for_a_single_exponential() {
        // exp(-r) = 1e-4 at r = 9.21; the bound is above it, and not by far.
        let bound = highest_by_chance(1.0, 1e-4);
        assert!((9.21..13.0).contains(&bound), "{bound}");
    }
}
