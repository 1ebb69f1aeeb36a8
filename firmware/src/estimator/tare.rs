//! Tare: determines the estimates' offset without a load and subtracts it afterwards.
//!
//! On a command a [`TareCollector`] averages [`constants::TARE_FRAMES`] estimates of every sensor before any tare. Every
//! sensor must be valid and undisturbed, and the load constant ([`constants::TARE_SIGMA_MAX`]). A constant load is
//! indistinguishable from no load: the host must ensure that nothing is gripped. Standard deviations of networks stay
//! unchanged: averaging adds a sixteenth of a frame's noise.
//!
//! After a load, friction leaves a force at rest that is no offset error. Nor is an error within a network's own
//! standard deviation, because it differs under load. Subtracting either would bias all later estimates, so both are
//! excluded ([`offset`]).
//!
//! A network that is replaced by the ideal model ([`crate::estimator::network_monitor`]) leaves the tare with what it added
//! itself during the tare. [`FallbackTare`] corrects that until the next boot.

use crate::config::constants;
use crate::estimator::estimate::{Estimate, Validity};
use crate::fixed_point::{Force, saturate};
use crate::sensors::hall::SENSORS;

/// Frames of a tare.
pub const FRAMES: u32 = constants::TARE_FRAMES.value as u32;
/// Maximum standard deviation of a force during a tare.
pub const MAX_SIGMA: Force = Force((constants::TARE_SIGMA_MAX.value * Force::PER_NEWTON) as i32);
/// Maximum magnitude of a tare: the range of the model.
pub const MAX_OFFSET: Force = Force((constants::FORCE_RANGE.value * Force::PER_NEWTON) as i32);

/// Bound of a force relative to the first frame, a thousand newtons, so that sums of squares fit 64 bits.
const MAX_DEVIATION: i64 = 1 << 20;

/// Coverage factors for the standard error of the mean and for a network's standard deviation.
const MEAN_COVERAGE: i64 = 3;
const NETWORK_COVERAGE: i32 = 2;

/// Significant part of a mean force at rest: the excess over the friction `deadband`, if it exceeds the mean's
/// standard error (`variance` in squared force units) and a network's `sigma`; else zero.
pub fn offset(mean: Force, variance: i64, deadband: Force, sigma: Force) -> Force {
    let magnitude = mean.0.saturating_abs();
    let deadband = deadband.0.max(0);
    let excess = i64::from(magnitude.saturating_sub(deadband));
    let is_insignificant = deadband > 0
        && excess.saturating_mul(excess) <= variance.saturating_mul(MEAN_COVERAGE * MEAN_COVERAGE);
    if excess <= 0 || is_insignificant || magnitude <= sigma.0.saturating_mul(NETWORK_COVERAGE) {
        return Force(0);
    }
    Force(mean.0.saturating_sub(deadband.saturating_mul(mean.0.signum())))
}

/// Offsets of the lateral and longitudinal force at each sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tare(pub [[Force; 2]; SENSORS]);

impl Tare {
    /// No offset.
    pub const NONE: Self = Self([[Force(0); 2]; SENSORS]);

    /// Subtracts the offsets from a frame's forces. The last step: networks and
    /// [`crate::estimator::disturbance::DisturbanceDetector::update`] compare untared forces. Missing estimates stay
    /// zero.
    pub fn apply(&self, estimates: &mut [Estimate]) {
        for (estimate, tare) in estimates.iter_mut().zip(&self.0) {
            if estimate.validity == Validity::Missing {
                continue;
            }
            for (force, tare) in estimate.force.iter_mut().zip(tare) {
                *force = Force(force.0.saturating_sub(tare.0));
            }
        }
    }
}

/// Correction of a tare for sensors whose network has been replaced since.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FallbackTare {
    /// The tare that it belongs to.
    tare: Option<Tare>,
    /// What the networks added during it.
    added: [[Force; 2]; SENSORS],
}

impl FallbackTare {
    /// Corrects the estimate of a sensor without its network, whose `tare` has been subtracted.
    pub fn apply(&self, sensor: usize, tare: &Tare, estimate: &mut Estimate) {
        if self.tare != Some(*tare) || estimate.validity == Validity::Missing {
            return;
        }
        let added = self.added.get(sensor).copied().unwrap_or_default();
        for (force, added) in estimate.force.iter_mut().zip(added) {
            *force = Force(force.0.saturating_add(added.0));
        }
    }
}

/// Reason of a refused tare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TareRefusal {
    /// No reading.
    Missing {
        /// Number of the sensor.
        sensor: u8,
    },
    /// Saturated, or the field is outside the model.
    Invalid {
        /// Number of the sensor.
        sensor: u8,
    },
    /// An external magnet is detected.
    Disturbed {
        /// Number of the first disturbed sensor.
        sensor: u8,
    },
    /// The load is not constant.
    Moving {
        /// Number of the sensor.
        sensor: u8,
    },
    /// The force exceeds the model's range: a load, or tables of another gripper.
    TooLarge {
        /// Number of the sensor.
        sensor: u8,
    },
}

impl TareRefusal {
    /// Detail of a [`crate::protocol::messages::ServiceReply`]: reason in the upper, sensor in the lower byte. Reasons:
    /// 1 missing, 2 invalid, 3 disturbed, 4 moving, 5 too large.
    pub const fn detail(self) -> u32 {
        let (reason, sensor) = match self {
            Self::Missing { sensor } => (1, sensor),
            Self::Invalid { sensor } => (2, sensor),
            Self::Disturbed { sensor } => (3, sensor),
            Self::Moving { sensor } => (4, sensor),
            Self::TooLarge { sensor } => (5, sensor),
        };
        reason << 8 | sensor as u32
    }
}

/// Progress of a tare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TareProgress {
    /// More frames are needed.
    Collecting,
    /// The new tare.
    Done(Tare),
    /// Refused; the previous tare stays in effect.
    Refused(TareRefusal),
}

/// Collects the frames of one tare.
#[derive(Clone, Copy, Debug, Default)]
pub struct TareCollector {
    /// Force that friction may leave at rest.
    deadband: [[Force; 2]; SENSORS],
    frames: u32,
    sums: [[ForceSums; 2]; SENSORS],
    /// Sums of what the networks add.
    added: [[i64; 2]; SENSORS],
}

impl TareCollector {
    /// Collector for this friction deadband.
    pub fn new(deadband: [[Force; 2]; SENSORS]) -> Self {
        Self { deadband, ..Self::default() }
    }

    /// Adds a frame's estimates before any tare. The collector is used up once this does not return `Collecting`.
    pub fn update(&mut self, estimates: &[Estimate; SENSORS]) -> TareProgress {
        for (sensor, estimate) in (0_u8..).zip(estimates) {
            let refusal = match estimate.validity {
                Validity::Missing => TareRefusal::Missing { sensor },
                Validity::Saturated | Validity::OutsideModel => TareRefusal::Invalid { sensor },
                Validity::Valid | Validity::MissingInputs if estimate.disturbed => {
                    TareRefusal::Disturbed { sensor }
                }
                Validity::Valid | Validity::MissingInputs => continue,
            };
            return TareProgress::Refused(refusal);
        }
        for (sums, estimate) in self.sums.iter_mut().zip(estimates) {
            let sigmas = estimate.sigma.unwrap_or_default();
            for (sums, (force, sigma)) in
                sums.iter_mut().zip(estimate.force.into_iter().zip(sigmas))
            {
                sums.add(self.frames, force, sigma);
            }
        }
        for (sums, estimate) in self.added.iter_mut().zip(estimates) {
            for (sum, force) in sums.iter_mut().zip(estimate.network_force) {
                *sum = sum.saturating_add(force.0.into());
            }
        }
        self.frames = self.frames.saturating_add(1);
        if self.frames < FRAMES { TareProgress::Collecting } else { self.finish() }
    }

    /// Correction for networks that are replaced after this tare.
    pub fn fallback(&self, tare: Tare) -> FallbackTare {
        let frames = i64::from(self.frames.max(1));
        let mut added = self.added.map(|sums| sums.map(|sum| Force(saturate(sum / frames))));
        // Where the tare is zero, nothing of the network is in it.
        for (added, tare) in added.as_flattened_mut().iter_mut().zip(tare.0.as_flattened()) {
            if tare.0 == 0 {
                *added = Force(0);
            }
        }
        FallbackTare { tare: Some(tare), added }
    }

    fn finish(&self) -> TareProgress {
        let mut tare = Tare::NONE;
        let sensors = tare.0.iter_mut().zip(&self.sums).zip(&self.deadband);
        for (sensor, ((tare, sums), deadband)) in (0_u8..).zip(sensors) {
            for ((tare, sums), deadband) in tare.iter_mut().zip(sums).zip(deadband) {
                if sums.is_moving(self.frames) {
                    return TareProgress::Refused(TareRefusal::Moving { sensor });
                }
                let mean = sums.mean(self.frames);
                if mean.0.saturating_abs() > MAX_OFFSET.0 {
                    return TareProgress::Refused(TareRefusal::TooLarge { sensor });
                }
                *tare =
                    offset(mean, sums.variance(self.frames), *deadband, sums.sigma(self.frames));
            }
        }
        TareProgress::Done(tare)
    }
}

/// Sums of one force relative to its first value.
#[derive(Clone, Copy, Debug, Default)]
struct ForceSums {
    first: Force,
    sum: i64,
    squares: i64,
    sigmas: i64,
}

impl ForceSums {
    fn add(&mut self, frames: u32, force: Force, sigma: Force) {
        if frames == 0 {
            self.first = force;
        }
        let deviation = i64::from(force.0) - i64::from(self.first.0);
        let deviation = deviation.clamp(-MAX_DEVIATION, MAX_DEVIATION);
        self.sum = self.sum.saturating_add(deviation);
        self.squares = self.squares.saturating_add(deviation * deviation);
        self.sigmas = self.sigmas.saturating_add(i64::from(sigma.0.max(0)));
    }

    /// Squared standard deviation times the squared number of frames: n sum(x^2) - sum(x)^2.
    fn scaled_variance(&self, frames: u32) -> i64 {
        i64::from(frames)
            .saturating_mul(self.squares)
            .saturating_sub(self.sum.saturating_mul(self.sum))
    }

    /// Whether the standard deviation is above [`MAX_SIGMA`].
    fn is_moving(&self, frames: u32) -> bool {
        let limit = i64::from(frames).saturating_mul(MAX_SIGMA.0.into());
        self.scaled_variance(frames) > limit.saturating_mul(limit)
    }

    /// Variance of the mean for uncorrelated frames.
    fn variance(&self, frames: u32) -> i64 {
        let frames = frames.max(1);
        let squared = i64::from(frames).saturating_mul(frames.into());
        let cubed = squared.saturating_mul(frames.into());
        self.scaled_variance(frames).checked_div(cubed).unwrap_or(i64::MAX)
    }

    /// Mean standard deviation predicted by a network.
    fn sigma(&self, frames: u32) -> Force {
        Force(saturate(self.sigmas / i64::from(frames.max(1))))
    }

    /// Mean rounded to the nearest, halves up.
    fn mean(&self, frames: u32) -> Force {
        let frames = i64::from(frames.max(1));
        let deviation = (2 * self.sum + frames).div_euclid(2 * frames);
        Force(saturate(i64::from(self.first.0).saturating_add(deviation)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(force: impl Fn(usize) -> [i32; 2]) -> [Estimate; SENSORS] {
        core::array::from_fn(|sensor| Estimate {
            force: force(sensor).map(Force),
            validity: Validity::Valid,
            ..Estimate::MISSING
        })
    }

    /// Alternates.
    fn sign(tick: u32) -> i32 {
        if tick.is_multiple_of(2) { 1 } else { -1 }
    }

    /// Result of a tare over frames with these forces, and the number of frames.
    fn tare(force: impl Fn(u32, usize) -> [i32; 2]) -> (TareProgress, u32) {
        let mut collector = TareCollector::default();
        for tick in 0..2 * FRAMES {
            let progress = collector.update(&frame(|sensor| force(tick, sensor)));
            if progress != TareProgress::Collecting {
                return (progress, tick + 1);
            }
        }
        (TareProgress::Collecting, 2 * FRAMES)
    }

    #[test]
    fn the_mean_of_256_frames_is_subtracted() {
        // Sensor 0: 1024 and 1027 alternating, mean 1025.5, rounded up; -7 and -10: -8.5 becomes -8.
        let (progress, frames) = tare(|tick, sensor| {
            let odd = i32::from(tick % 2 == 1);
            match sensor {
                0 => [1024 + 3 * odd, -7 - 3 * odd],
                _ => [sensor as i32 * 2048, 0],
            }
        });
        let TareProgress::Done(tare) = progress else {
            panic!("{progress:?}");
        };
        assert_eq!(frames, 256);
        let expected = [[1026, -8], [2048, 0], [4096, 0], [6144, 0]];
        assert_eq!(tare.0.map(|forces| forces.map(|force| force.0)), expected);
        let mut loaded = frame(|sensor| [100_000 + 1024 * sensor as i32, -5]);
        loaded[2] = Estimate::MISSING;
        tare.apply(&mut loaded);
        assert_eq!(loaded[0].force, [Force(98_974), Force(3)]);
        assert_eq!(loaded[3].force, [Force(96_928), Force(-5)]);
        assert_eq!(loaded[2], Estimate::MISSING);
    }

    #[test]
    fn offsets_within_friction_or_the_network_s_sigma_are_excluded() {
        for (force, noise, deadband, sigma, expected) in [
            // Half a newton of friction.
            (512, 0, 512, None, 0),
            (-512, 0, 512, None, 0),
            (513, 0, 512, None, 1),
            // With half a newton of noise, whose triple standard error is 96.
            (608, 512, 512, None, 0),
            (-609, 512, 512, None, -97),
            // Twice a network's sigma.
            (600, 0, 0, Some(300), 0),
            (601, 0, 0, Some(300), 601),
            (1, 0, 0, None, 1),
            (1, 0, 0, Some(0), 1),
        ] {
            let mut collector = TareCollector::new([[Force(deadband); 2]; SENSORS]);
            let progress = (0..FRAMES).map(|tick| {
                let mut estimates = frame(|_| [force + sign(tick) * noise; 2]);
                estimates[0].sigma = sigma.map(|sigma| [Force(sigma); 2]);
                collector.update(&estimates)
            });
            let Some(TareProgress::Done(Tare(offsets))) = progress.last() else {
                panic!("no tare");
            };
            assert_eq!(offsets[0][0].0, expected, "{force} {noise} {deadband}");
        }
    }

    #[test]
    fn replaced_network_leaves_nothing_in_the_tare() {
        // The ideal model is off by 3000, and the network adds 2000 to it.
        let mut collector = TareCollector::default();
        let with_network =
            |estimate: Estimate| Estimate { network_force: [Force(2000), Force(0)], ..estimate };
        let mut last = TareProgress::Collecting;
        for _ in 0..FRAMES {
            last = collector.update(&frame(|_| [5000, 0]).map(with_network));
        }
        let TareProgress::Done(tare) = last else { panic!("{last:?}") };
        let fallback = collector.fallback(tare);
        let ideal = |tare: &Tare| {
            let mut estimates = frame(|_| [3000, 0]);
            tare.apply(&mut estimates);
            fallback.apply(2, tare, &mut estimates[2]);
            estimates[2].force[0].0
        };
        assert_eq!(ideal(&tare), 0);
        // Another tare, of a host.
        assert_eq!(ideal(&Tare([[Force(1000), Force(0)]; SENSORS])), 2000);
    }

    #[test]
    fn subtraction_saturates_at_the_range_of_a_force() {
        let tare = Tare([[Force(1), Force(-1)]; SENSORS]);
        let mut extreme = frame(|_| [i32::MIN, i32::MAX]);
        tare.apply(&mut extreme);
        assert_eq!(extreme[0].force, [Force(i32::MIN), Force(i32::MAX)]);
    }

    #[test]
    fn an_unusable_sensor_refuses_with_number_and_reason() {
        type Change = fn(&mut Estimate);
        let cases: [(Change, u32); 4] = [
            (|e| e.validity = Validity::Missing, 0x103),
            (|e| e.validity = Validity::Saturated, 0x203),
            (|e| e.validity = Validity::OutsideModel, 0x203),
            (|e| e.disturbed = true, 0x303),
        ];
        for (change, detail) in cases {
            let mut collector = TareCollector::default();
            let mut estimates = frame(|_| [0; 2]);
            assert_eq!(collector.update(&estimates), TareProgress::Collecting);
            change(&mut estimates[3]);
            let TareProgress::Refused(refusal) = collector.update(&estimates) else {
                panic!("not refused");
            };
            assert_eq!(refusal.detail(), detail);
        }
    }

    #[test]
    fn noise_above_the_limit_is_a_moving_load() {
        // The amplitude of an alternating force is its standard deviation.
        let noise = |amplitude: i32| {
            tare(move |tick, sensor| {
                let is_noisy = sensor == 2;
                [0, if is_noisy { sign(tick) * amplitude } else { 0 }]
            })
            .0
        };
        assert_eq!(noise(MAX_SIGMA.0), TareProgress::Done(Tare::NONE));
        let moving = TareProgress::Refused(TareRefusal::Moving { sensor: 2 });
        assert_eq!(noise(MAX_SIGMA.0 + 1), moving);
        assert_eq!(noise(1 << 29), moving);
    }

    #[test]
    fn a_slow_drift_is_a_moving_load() {
        // The standard deviation of a ramp is its length over the square root of twelve.
        let ramp = |length_n: f64| {
            let step = length_n * Force::PER_NEWTON / f64::from(FRAMES);
            tare(move |tick, _| [(f64::from(tick) * step) as i32; 2]).0
        };
        let limit_n = constants::TARE_SIGMA_MAX.value * 12_f64.sqrt();
        assert!(matches!(ramp(0.98 * limit_n), TareProgress::Done(_)));
        assert_eq!(ramp(1.02 * limit_n), TareProgress::Refused(TareRefusal::Moving { sensor: 0 }));
    }

    #[test]
    fn an_offset_beyond_the_model_s_range_is_refused() {
        let constant = |force: i32| tare(move |_, _| [0, force]).0;
        for force in [MAX_OFFSET.0, -MAX_OFFSET.0] {
            assert!(matches!(constant(force), TareProgress::Done(_)));
        }
        let refused = TareProgress::Refused(TareRefusal::TooLarge { sensor: 0 });
        for force in [MAX_OFFSET.0 + 1, i32::MIN] {
            assert_eq!(constant(force), refused);
        }
    }
}
