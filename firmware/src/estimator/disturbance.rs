//! Detection of external magnets: test statistics of one frame, a vote, a latch.
//!
//! | signal | statistic | condition |
//! | --- | --- | --- |
//! | [`Signals::sigma`] | standard deviation predicted by a network | above 25 N for 5 frames |
//! | [`Signals::model_disagreement`] | difference of network and ideal model | above 40 N and 20 %, for 5 frames |
//! | [`Signals::parity`] | sum of squared parity residuals ([`crate::estimator::parity`]) of all sensors | [`PARITY`] |
//! | [`Signals::common`] | their mean with sign (a distant magnet acts on all sensors alike) | [`COMMON`] |
//! | [`Signals::outside`] | a field outside the design box or the sensor's range | for 5 frames |
//!
//! Two signals, or the parity alone above [`PARITY_ALONE`], set the flag; it is cleared after half a second without any.
//! Slow changes (heat, ageing, an effect missing in the model) are no disturbance: each residual is taken relative to
//! its own mean over about 8 seconds, and low-pass filtered with about 8 ms against noise. The mean is frozen during
//! a suspicion, so the detector is in its normal state once the magnet is removed. A magnet that stays is accepted as
//! the new normal after a minute, and its removal sets the flag again.
//!
//! Thresholds are in standard deviations of the parity fit, which are part of the tables. They were determined by
//! `cargo acceptance magnetic-disturbance`.

use crate::config::limits::DetectionLimits;
use crate::estimator::estimate::{Estimate, Validity};
use crate::estimator::network_monitor::excess_deviations;
use crate::fixed_point::{Force, saturate};
use crate::model::formats::PARITY_SIGMA_BITS;
use crate::sensors::hall::SENSORS;

/// Threshold of the sum of squared normalised residuals.
pub const PARITY: i32 = 40;
/// Threshold above which no second signal is needed.
pub const PARITY_ALONE: i32 = 56;
/// Threshold of the squared sum of the normalised residuals divided by the number of sensors.
pub const COMMON: i32 = 40;
/// Threshold of a network's standard deviation in newtons.
pub const SIGMA_N: i32 = 25;
/// Threshold of the difference of network and ideal model in newtons, in addition to a fifth of the ideal model's force:
/// that of the network monitor.
pub const DISAGREEMENT_N: i32 = DetectionLimits::GRIPPER.divergence_n;

/// Frames for which `sigma`, `model_disagreement` and `outside` must persist.
const DEBOUNCE_FRAMES: u8 = 5;
/// Frames without a signal after which the flag is cleared.
const QUIET_FRAMES: u16 = 500;
/// Frames after a start without parity signals, while the mean forms.
const SETTLING_FRAMES: u32 = 256;
/// Gain of the noise filter per frame: 2^-3.
const FAST_SHIFT: u32 = 3;
/// Gain of the mean per frame: 2^-13, larger at the start.
const SLOW_SHIFT: u32 = 13;
/// Missing frames in a row that a filter bridges: a second.
const BRIDGED_FRAMES: u16 = 1_000;
/// Frames of uninterrupted suspicion after which the means restart.
const ACCEPTANCE_FRAMES: u32 = 60_000;
/// Additional fractional bits of the filtered residual.
const FAST_BITS: u32 = PARITY_SIGMA_BITS;
/// Fractional bits of the mean beyond those of the filtered residual.
const SLOW_BITS: u32 = 16;
/// Bound of a residual in field units: thousands of gauss.
const MAX_RESIDUAL: i32 = 1 << 20;
/// Bound of a filtered residual relative to its mean: a hundred gauss.
const MAX_OFFSET: i32 = 1 << 22;
/// Fractional bits of a normalised residual, and its bound.
const NORMALISED_BITS: u32 = 8;
const MAX_NORMALISED: i32 = 1 << 14;

/// Signals of an external magnet in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signals {
    /// A network predicts a large standard deviation.
    pub sigma: bool,
    /// A network and the ideal model disagree.
    pub model_disagreement: bool,
    /// Large parity residuals.
    pub parity: bool,
    /// Parity residuals large enough without a second signal.
    pub parity_alone: bool,
    /// Parity residuals of the same sign at all sensors.
    pub common: bool,
    /// A field that no force explains.
    pub outside: bool,
}

impl Signals {
    /// Whether the signals indicate an external magnet.
    pub fn vote(&self) -> bool {
        let signals = [self.sigma, self.model_disagreement, self.parity, self.common, self.outside];
        self.parity_alone || signals.iter().filter(|&&signal| signal).count() >= 2
    }

    fn any(&self) -> bool {
        *self != Self::default()
    }
}

/// Test statistics, also used to sweep the thresholds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measures {
    /// Sum of squared normalised residuals, with 16 fractional bits.
    pub parity: i32,
    /// Squared sum of normalised residuals divided by the number of sensors, with 16 fractional bits.
    pub common: i32,
    /// Maximum standard deviation predicted by a network.
    pub sigma: Force,
    /// Maximum difference of network and ideal model beyond a fifth of the force.
    pub model_disagreement: Force,
}

/// Filters of one sensor's residual.
#[derive(Clone, Copy, Debug, Default)]
struct ResidualFilter {
    /// Frames since the start, saturating.
    frames: u32,
    /// Missing frames in a row.
    missing: u16,
    fast: i32,
    slow: i64,
}

/// Successive frames of a condition.
#[derive(Clone, Copy, Debug, Default)]
struct Debounce(u8);

/// Detector of external magnets.
#[derive(Clone, Copy, Debug, Default)]
pub struct DisturbanceDetector {
    filters: [ResidualFilter; SENSORS],
    sigma: Debounce,
    model_disagreement: Debounce,
    outside: Debounce,
    /// Frames of uninterrupted suspicion.
    suspected: u32,
    flag: bool,
    quiet: u16,
    /// Signals of the latest frame.
    pub signals: Signals,
    /// Statistics of the latest frame.
    pub measures: Measures,
}

impl DisturbanceDetector {
    /// Evaluates one frame: `ideal` are the estimates before the networks, `estimates` those after them, which are
    /// marked as disturbed while the flag is set. Returns the flag.
    #[inline(never)]
    pub fn update(
        &mut self,
        ideal: &[Estimate; SENSORS],
        estimates: &mut [Estimate; SENSORS],
    ) -> bool {
        self.measure(ideal, estimates);
        let measures = self.measures;
        let above = |square: i32, limit: i32| square > limit << (2 * NORMALISED_BITS);
        let newtons = |limit: i32| Force(limit << Force::BITS);
        let outside = ideal.iter().any(|estimate| {
            matches!(estimate.validity, Validity::OutsideModel | Validity::Saturated)
        });
        self.signals = Signals {
            sigma: self.sigma.update(measures.sigma > newtons(SIGMA_N)),
            model_disagreement: self
                .model_disagreement
                .update(measures.model_disagreement > newtons(DISAGREEMENT_N)),
            parity: above(measures.parity, PARITY),
            parity_alone: above(measures.parity, PARITY_ALONE),
            common: above(measures.common, COMMON),
            outside: self.outside.update(outside),
        };
        self.suspected = if self.signals.any() { self.suspected.saturating_add(1) } else { 0 };
        if self.suspected >= ACCEPTANCE_FRAMES {
            (self.filters, self.suspected) = ([ResidualFilter::default(); SENSORS], 0);
        }
        self.latch();
        for estimate in estimates.iter_mut() {
            estimate.disturbed = self.flag;
        }
        self.flag
    }

    /// Whether an external magnet is detected.
    pub fn flag(&self) -> bool {
        self.flag
    }

    fn measure(&mut self, ideal: &[Estimate; SENSORS], estimates: &[Estimate; SENSORS]) {
        let (mut squares, mut sum, mut sensors) = (0_i32, 0_i32, 0_usize);
        let mut measures = Measures::default();
        let suspected = self.suspected > 0;
        for (filter, (ideal, estimate)) in self.filters.iter_mut().zip(ideal.iter().zip(estimates))
        {
            if let Some(normalised) = filter.update(ideal, suspected) {
                squares = squares.saturating_add(normalised * normalised);
                sum += normalised;
                sensors += 1;
            }
            if let Some(sigma) = estimate.network_sigma {
                for sigma in sigma {
                    measures.sigma = measures.sigma.max(sigma);
                }
                for excess in excess_deviations(ideal.force, estimate.force) {
                    measures.model_disagreement = measures.model_disagreement.max(excess);
                }
            }
        }
        measures.parity = squares;
        if sensors == SENSORS {
            let square = i64::from(sum) * i64::from(sum) / SENSORS as i64;
            measures.common = saturate(square);
        }
        self.measures = measures;
    }

    fn latch(&mut self) {
        if self.signals.vote() {
            (self.flag, self.quiet) = (true, 0);
        } else if self.signals.any() {
            self.quiet = 0;
        } else {
            self.quiet = self.quiet.saturating_add(1);
            self.flag &= self.quiet < QUIET_FRAMES;
        }
    }
}

impl Debounce {
    fn update(&mut self, condition: bool) -> bool {
        self.0 = if condition { self.0.saturating_add(1) } else { 0 };
        self.0 >= DEBOUNCE_FRAMES
    }
}

impl ResidualFilter {
    /// Filtered residual relative to its mean, in standard deviations; `None` until the mean has formed, and without a
    /// reading. An unknown standard deviation, or a sensor that is missing for long, restarts the filter. A short gap must
    /// not: the field of a magnet would become the mean.
    fn update(&mut self, estimate: &Estimate, suspected: bool) -> Option<i32> {
        let is_missing = estimate.validity == Validity::Missing;
        self.missing = if is_missing { self.missing.saturating_add(1) } else { 0 };
        if is_missing && self.missing <= BRIDGED_FRAMES {
            return None;
        }
        if is_missing || estimate.parity.sigma == 0 {
            *self = Self { missing: self.missing, ..Self::default() };
            return None;
        }
        let residual = estimate.parity.residual.0;
        let now = residual.clamp(-MAX_RESIDUAL, MAX_RESIDUAL) << FAST_BITS;
        if self.frames == 0 {
            (self.fast, self.slow) = (now, i64::from(now) << SLOW_BITS);
        }
        self.frames = self.frames.saturating_add(1);
        self.fast += (now - self.fast) >> FAST_SHIFT;
        if !suspected || self.frames <= SETTLING_FRAMES {
            // Arithmetic mean at the start, then exponential.
            let shift = (u32::BITS - self.frames.leading_zeros()).min(SLOW_SHIFT);
            self.slow += ((i64::from(self.fast) << SLOW_BITS) - self.slow) >> shift;
        }
        let mean = saturate(self.slow >> SLOW_BITS);
        let offset = (self.fast - mean).clamp(-MAX_OFFSET, MAX_OFFSET);
        let normalised = (offset << NORMALISED_BITS).checked_div(estimate.parity.sigma)?;
        (self.frames > SETTLING_FRAMES).then(|| normalised.clamp(-MAX_NORMALISED, MAX_NORMALISED))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::parity::ParityResidual;
    use crate::fixed_point::Field;

    /// A standard deviation of one gauss: 128 field units.
    const SIGMA: i32 = 128 << FAST_BITS;
    /// Constant residuals, in field units.
    const OFFSETS: [i32; SENSORS] = [700, -300, 0, 50];

    fn frame(residuals: [i32; SENSORS]) -> [Estimate; SENSORS] {
        residuals.map(|residual| Estimate {
            validity: Validity::Valid,
            parity: ParityResidual { residual: Field(residual), sigma: SIGMA },
            ..Estimate::MISSING
        })
    }

    /// Adds to [`OFFSETS`].
    fn offset_by(by: [i32; SENSORS]) -> [i32; SENSORS] {
        core::array::from_fn(|sensor| OFFSETS[sensor] + by[sensor])
    }

    /// The flag after these frames without networks.
    fn run(detector: &mut DisturbanceDetector, residuals: [i32; SENSORS], frames: u32) -> bool {
        let flags = (0..frames).map(|_| detector.update(&frame(residuals), &mut frame(residuals)));
        flags.last().unwrap()
    }

    /// A detector whose means have settled at [`OFFSETS`].
    fn settled() -> DisturbanceDetector {
        let mut detector = DisturbanceDetector::default();
        assert!(!run(&mut detector, OFFSETS, 10_000));
        detector
    }

    #[test]
    fn constant_residuals_are_no_disturbance() {
        assert_eq!(settled().measures, Measures::default());
    }

    #[test]
    fn a_residual_of_8_sigma_sets_the_flag_alone() {
        // 8.5 sigma at one sensor: the filter reaches the root of 56, 7.48, after
        // 8 * ln(8.5 / (8.5 - 7.48)) = 17 frames.
        let mut detector = settled();
        let step = offset_by([8 * 128 + 64, 0, 0, 0]);
        assert!(!run(&mut detector, step, 14));
        assert!(run(&mut detector, step, 6));
        // 7 sigma need a second signal.
        let mut detector = settled();
        assert!(!run(&mut detector, offset_by([7 * 128, 0, 0, 0]), 60));
        assert!(detector.signals.parity && !detector.signals.common);
    }

    #[test]
    fn smaller_common_residuals_set_the_flag_by_two_signals() {
        // 3.5 sigma each: both squares are 49.
        let by = 3 * 128 + 64;
        let mut detector = settled();
        assert!(run(&mut detector, offset_by([by; SENSORS]), 60));
        let signals = detector.signals;
        assert!(signals.parity && signals.common && !signals.parity_alone);
        // Of opposite signs they are not common.
        assert!(!run(&mut settled(), offset_by([by, -by, by, -by]), 60));
    }

    #[test]
    fn residual_without_a_standard_deviation_is_no_disturbance() {
        let mut detector = settled();
        // The field of the opposing magnet before homing, then its compensation.
        let unknown = frame([5000, -3000, 2000, 50]).map(|estimate| Estimate {
            parity: ParityResidual { sigma: 0, ..estimate.parity },
            ..estimate
        });
        for _ in 0..1000 {
            assert!(!detector.update(&unknown, &mut unknown.clone()));
        }
        assert!(!run(&mut detector, OFFSETS, 10_000));
        // Afterwards a magnet is detected again.
        assert!(run(&mut detector, offset_by([1000; SENSORS]), 30));
    }

    #[test]
    fn a_slow_drift_is_no_disturbance() {
        // A gauss in five seconds, for a minute.
        let mut detector = settled();
        for second in 0..60 {
            let drifted = offset_by([second * 26; SENSORS]);
            assert!(!run(&mut detector, drifted, 1000));
        }
    }

    #[test]
    fn the_flag_marks_all_estimates_and_clears_after_500_ms() {
        let mut detector = settled();
        let disturbed = [5000, -300, 0, 50];
        assert!(run(&mut detector, disturbed, 30));
        let mut estimates = frame(disturbed);
        detector.update(&frame(disturbed), &mut estimates);
        assert!(estimates.iter().all(|estimate| estimate.disturbed));
        assert!(run(&mut detector, OFFSETS, 500));
        assert!(!run(&mut detector, OFFSETS, 60));
    }

    #[test]
    fn a_magnet_is_accepted_after_a_minute_but_not_after_10_s() {
        let magnet = [9000, 4000, 0, 50];
        let mut detector = settled();
        assert!(run(&mut detector, magnet, 10_000));
        assert!(!run(&mut detector, OFFSETS, 700));
        assert!(run(&mut detector, magnet, 59_000));
        assert!(!run(&mut detector, magnet, 2_500));
        // Its removal is a disturbance.
        assert!(run(&mut detector, OFFSETS, 50));
    }

    #[test]
    fn only_a_long_gap_restarts_the_filter() {
        for (missing, is_detected) in [(1, true), (1000, true), (1001, false)] {
            let mut detector = settled();
            let mut lost = frame(OFFSETS);
            lost[2] = Estimate::MISSING;
            for _ in 0..missing {
                detector.update(&lost, &mut lost.clone());
            }
            assert_eq!(run(&mut detector, [700, -300, 9000, 50], 400), is_detected, "{missing}");
        }
    }

    #[test]
    fn an_uncertain_and_deviating_network_gives_two_signals() {
        let ideal = frame([0; SENSORS]);
        let mut estimates = ideal;
        estimates[1].force = [Force(41 << 10), Force(0)];
        estimates[1].network_sigma = Some([Force(26 << 10), Force(0)]);
        let mut detector = DisturbanceDetector::default();
        for frame in 1..=5 {
            assert_eq!(detector.update(&ideal, &mut estimates.clone()), frame == 5);
        }
        assert!(detector.signals.sigma && detector.signals.model_disagreement);
    }

    #[test]
    fn extreme_residuals_and_a_sigma_of_zero_do_not_overflow() {
        let mut detector = DisturbanceDetector::default();
        for residual in [i32::MIN, i32::MAX, 0, i32::MIN] {
            run(&mut detector, [residual; SENSORS], 300);
        }
        let mut without_sigma = frame([9; SENSORS]);
        without_sigma[0].parity.sigma = 0;
        assert!(detector.update(&without_sigma, &mut without_sigma.clone()));
    }
}
