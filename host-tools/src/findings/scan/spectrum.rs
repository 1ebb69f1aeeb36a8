//! Periodograms averaged over a recording (Welch's method), and the narrow lines in them.

use std::sync::Arc;

use realfft::{RealFftPlanner, RealToComplex};

/// A segment is about this long, in seconds: lines a quarter of a hertz apart are told apart, and a
/// recording of some seconds still gives several segments.
const SEGMENT_S: f64 = 5.0;
/// Fewer segments than this do not tell a line from chance.
const LEAST_SEGMENTS: usize = 3;
/// Half-overlapping Hann windows share some noise: of n segments so many count as independent.
const INDEPENDENT: f64 = 0.9;
/// Below this, in hertz, motion and load have their own lines.
const LOWEST_HZ: f64 = 5.0;
/// Bins beside a line that its window fills.
const LOBE: usize = 2;
/// Bins between a line and its background.
const GUARD: usize = 4;
/// Bins of background on each side.
const SIDE: usize = 24;
/// Chance of one false line in a whole campaign.
const FALSE_ALARM: f64 = 1e-3;
/// The background is an estimate too, and no noise is quite white: a line must be this many times
/// what chance alone would give.
const MARGIN: f64 = 2.0;
/// Bins whose power is below this share of the greatest are no load.
const LOAD_SHARE: f64 = 1e-3;
/// Bins without load that end its band.
const LOAD_END: usize = 4;

/// A narrow line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Frequency in hertz, at the table's row rate.
    pub hz: f64,
    /// Amplitude (half of peak to peak), in the column's unit.
    pub amplitude: f64,
    /// Width of a bin in hertz: how well the frequency is known.
    pub bin_hz: f64,
}

/// Sums periodograms of one column.
#[derive(Clone)]
pub struct Spectrum {
    plan: Arc<dyn RealToComplex<f64>>,
    window: Arc<Vec<f64>>,
    rate_hz: f64,
    buffer: Vec<f64>,
    power: Vec<f64>,
    segments: usize,
}

impl Spectrum {
    /// For rows at `rate_hz`; `None` where that is not known.
    pub fn new(rate_hz: f64, planner: &mut RealFftPlanner<f64>) -> Option<Self> {
        if !rate_hz.is_finite() || rate_hz <= 4.0 * LOWEST_HZ {
            return None;
        }
        let length = (SEGMENT_S * rate_hz).log2().round().clamp(6.0, 16.0).exp2() as usize;
        let turn = std::f64::consts::TAU / length as f64;
        let hann = |i: usize| 0.5 - 0.5 * (turn * i as f64).cos();
        Some(Self {
            plan: planner.plan_fft_forward(length),
            window: Arc::new((0..length).map(hann).collect()),
            rate_hz,
            buffer: Vec::with_capacity(length),
            power: vec![0.0; length / 2 + 1],
            segments: 0,
        })
    }

    /// Takes the next value; after a missing row a segment begins anew.
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
        let mut input: Vec<f64> = weighted.map(|(x, weight)| (x - mean) * weight).collect();
        let mut output = self.plan.make_output_vec();
        if self.plan.process(&mut input, &mut output).is_ok() {
            for (sum, value) in self.power.iter_mut().zip(&output) {
                *sum += value.norm_sqr();
            }
            self.segments += 1;
        }
    }

    fn bin_hz(&self) -> f64 {
        self.rate_hz / self.window.len() as f64
    }

    /// Bins that are looked at.
    pub fn bins(&self) -> usize {
        self.power.len()
    }

    /// Highest frequency in hertz of the band that goes up from zero and holds what moves most.
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

    /// The lines, where `tests` bins are looked at in the whole campaign.
    pub fn lines(&self, tests: f64) -> Vec<Line> {
        if self.segments < LEAST_SEGMENTS {
            return Vec::new();
        }
        let averages = INDEPENDENT * self.segments as f64;
        let threshold = MARGIN * highest_by_chance(averages, FALSE_ALARM / tests);
        // There, one part of the number is always zero: half as many count.
        let at_the_end = 2.0 * MARGIN * highest_by_chance(0.5 * averages, FALSE_ALARM / tests);
        // The median of a mean of exponentials is below its mean (Wilson and Hilferty 1931).
        let median_share = (1.0 - 1.0 / (9.0 * averages)).powi(3);
        let lowest = (LOWEST_HZ / self.bin_hz()).ceil() as usize;
        let mut lines = Vec::new();
        for bin in lowest..self.power.len() {
            let around = bin - LOBE..=bin + LOBE;
            let is_peak = around.into_iter().all(|i| self.at(i) <= self.power[bin]);
            let background = self.background(bin) / median_share;
            let threshold = match self.is_last(bin) {
                true => at_the_end,
                false => threshold,
            };
            if is_peak && self.power[bin] > threshold * background {
                lines.push(self.line(bin, background));
            }
        }
        lines
    }

    /// The power of a bin; beyond half the row rate frequencies fold back.
    fn at(&self, bin: usize) -> f64 {
        let last = self.power.len() - 1;
        self.power[if bin > last { 2 * last - bin } else { bin }]
    }

    /// True for the bin of half the row rate.
    fn is_last(&self, bin: usize) -> bool {
        bin + 1 == self.power.len()
    }

    /// The greater of the medians on both sides, so that a slope is no line.
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

    fn line(&self, bin: usize, background: f64) -> Line {
        let excess = |i: usize| (self.at(i) - background).max(0.0);
        let lobe = bin - LOBE..=bin + LOBE;
        let total: f64 = lobe.clone().map(excess).sum();
        let centre: f64 = lobe.map(|i| i as f64 * excess(i)).sum::<f64>() / total;
        let squares: f64 = self.window.iter().map(|weight| weight * weight).sum();
        let length = self.window.len() as f64;
        // Half of a line lies at the mirrored frequency; at half the row rate both fall together.
        let share = if self.is_last(bin) { 1.0 } else { 2.0 };
        Line {
            hz: centre.min((self.power.len() - 1) as f64) * self.bin_hz(),
            amplitude: share * (total / self.segments as f64 / (length * squares)).sqrt(),
            bin_hz: self.bin_hz(),
        }
    }
}

/// The mean of `averages` exponential variables of mean 1 is above this with at most `chance`
/// (Chernoff's bound: exp(-n (r - 1 - ln r))).
fn highest_by_chance(averages: f64, chance: f64) -> f64 {
    let wanted = -chance.ln() / averages;
    let (mut low, mut high) = (1.0, 2.0 + 2.0 * wanted);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        match middle - 1.0 - middle.ln() < wanted {
            true => low = middle,
            false => high = middle,
        }
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
        let mut spectrum = Spectrum::new(1000.0, &mut RealFftPlanner::new()).unwrap();
        for row in 0..30_000 {
            let t = f64::from(row) * 1e-3;
            let load = 100.0 * (TAU * 0.7 * t).sin();
            let hum = amplitude * (TAU * 50.0 * t).sin();
            spectrum.push(load + hum + noise.sample(&mut rng), true);
        }
        spectrum
    }

    #[test]
    fn a_line_is_found_beside_a_load_with_its_frequency_and_amplitude() {
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
