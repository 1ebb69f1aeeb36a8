//! The tare: what is told where nothing loads, taken off what is told afterwards.
//!
//! A command begins a [`Taring`]. It gathers [`params::TARE_FRAMES`] estimates of every sensor, before any
//! tare, and takes their mean where nothing speaks against it: every sensor must answer and be valid, no
//! foreign magnet near, and the load at rest ([`params::TARE_SPREAD`]). A load that rests looks like no
//! load: that nothing is gripped is for the host to see to. A network's standard deviation stays as it was
//! told: a tare of so many frames adds a sixteenth of a frame's noise.
//!
//! A gripper that was loaded before is not where it would be without friction: what it tells at rest is
//! what friction holds, and no error of zero. Nor is what a network's own standard deviation allows for:
//! its error at rest is another than under load. To take these off would put them into every estimate
//! afterwards, so they are left alone ([`offset`]).

use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::params;
use crate::units::Force;

/// Frames of a tare.
pub const FRAMES: u32 = params::TARE_FRAMES.value as u32;
/// Greatest standard deviation of a force while it is tared.
pub const SPREAD: Force = Force((params::TARE_SPREAD.value * Force::PER_NEWTON) as i32);
/// Greatest tare of a force, either sign: the range that its model is built for.
pub const GREATEST: Force = Force((params::FORCE_RANGE.value * Force::PER_NEWTON) as i32);

/// A force is followed up to this far from the first frame's: a thousand newtons. The sums of so many
/// squares then stay far below the end of 64 bits.
const FOLLOWED: i64 = 1 << 20;

/// Standard errors by which the mean of a rest may be off, and standard deviations by which a network may.
const ERRORS: i64 = 3;
const SIGMAS: i32 = 2;

/// What is surely an offset of a rest's mean, known to the `variance` of its error in units of a force
/// squared: what is beyond all that friction may hold, and nothing where the mean is within what a network
/// that told `sigma` may be off by.
pub fn offset(mean: Force, variance: i64, held: Force, sigma: Force) -> Force {
    let size = mean.0.saturating_abs();
    let held = held.0.max(0);
    let beyond = i64::from(size.saturating_sub(held));
    let unsure =
        held > 0 && beyond.saturating_mul(beyond) <= variance.saturating_mul(ERRORS * ERRORS);
    if beyond <= 0 || unsure || size <= sigma.0.saturating_mul(SIGMAS) {
        return Force(0);
    }
    Force(mean.0.saturating_sub(held.saturating_mul(mean.0.signum())))
}

/// What is taken off the forces, lateral and longitudinal at each sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tare(pub [[Force; 2]; SENSORS]);

impl Tare {
    /// Nothing is taken off.
    pub const NONE: Self = Self([[Force(0); 2]; SENSORS]);

    /// Takes it off the forces of a frame: the last step, after the networks and after
    /// [`crate::foreign::Detector::watch`], which compare forces with each other. What is missing stays
    /// zero; a force stays in its range.
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

/// Why there is no tare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// This sensor does not answer.
    Missing {
        /// Number of the sensor.
        sensor: u8,
    },
    /// This sensor is at the end of its range, or its field outside the model.
    Invalid {
        /// Number of the sensor.
        sensor: u8,
    },
    /// A foreign magnet is near.
    Disturbed {
        /// Number of the first sensor that is marked.
        sensor: u8,
    },
    /// The load at this sensor moves.
    Moving {
        /// Number of the sensor.
        sensor: u8,
    },
    /// The force at this sensor is beyond the model's range: a load, or tables of another gripper.
    TooLarge {
        /// Number of the sensor.
        sensor: u8,
    },
}

impl Refusal {
    /// For the detail of a [`crate::wire::messages::ServiceReply`]: the reason in the upper, the sensor in
    /// the lower byte. Reasons: 1 missing, 2 invalid, 3 disturbed, 4 moving, 5 too large.
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

/// How far a tare is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// It wants more frames.
    Gathering,
    /// It is done.
    Done(Tare),
    /// There is none; what was before holds.
    Refused(Refusal),
}

/// Gathers a tare, from a command to its end.
#[derive(Clone, Copy, Debug, Default)]
pub struct Taring {
    /// What friction may hold at rest.
    held: [[Force; 2]; SENSORS],
    frames: u32,
    sums: [[Sums; 2]; SENSORS],
}

impl Taring {
    /// Where friction may hold so much.
    pub fn new(held: [[Force; 2]; SENSORS]) -> Self {
        Self {
            held,
            ..Self::default()
        }
    }

    /// Takes one frame's estimates, before any tare. After the end of a tare it is used up.
    pub fn take(&mut self, estimates: &[Estimate; SENSORS]) -> Step {
        for (sensor, estimate) in (0_u8..).zip(estimates) {
            let refusal = match estimate.validity {
                Validity::Missing => Refusal::Missing { sensor },
                Validity::Saturated | Validity::OutsideModel => Refusal::Invalid { sensor },
                Validity::Valid if estimate.disturbed => Refusal::Disturbed { sensor },
                Validity::Valid => continue,
            };
            return Step::Refused(refusal);
        }
        for (sums, estimate) in self.sums.iter_mut().zip(estimates) {
            let sigmas = estimate.sigma.unwrap_or_default();
            for (sums, (force, sigma)) in
                sums.iter_mut().zip(estimate.force.into_iter().zip(sigmas))
            {
                sums.add(self.frames, force, sigma);
            }
        }
        self.frames = self.frames.saturating_add(1);
        match self.frames < FRAMES {
            true => Step::Gathering,
            false => self.close(),
        }
    }

    fn close(&self) -> Step {
        let mut tare = Tare::NONE;
        let sensors = tare.0.iter_mut().zip(&self.sums).zip(&self.held);
        for (sensor, ((tare, sums), held)) in (0_u8..).zip(sensors) {
            for ((tare, sums), held) in tare.iter_mut().zip(sums).zip(held) {
                if sums.is_spread(self.frames) {
                    return Step::Refused(Refusal::Moving { sensor });
                }
                let mean = sums.mean(self.frames);
                if mean.0.saturating_abs() > GREATEST.0 {
                    return Step::Refused(Refusal::TooLarge { sensor });
                }
                *tare = offset(
                    mean,
                    sums.variance(self.frames),
                    *held,
                    sums.sigma(self.frames),
                );
            }
        }
        Step::Done(tare)
    }
}

/// Sums over one force, counted from its first value.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    first: Force,
    sum: i64,
    squares: i64,
    sigmas: i64,
}

impl Sums {
    fn add(&mut self, frames: u32, force: Force, sigma: Force) {
        if frames == 0 {
            self.first = force;
        }
        let apart = (i64::from(force.0) - i64::from(self.first.0)).clamp(-FOLLOWED, FOLLOWED);
        self.sum = self.sum.saturating_add(apart);
        self.squares = self.squares.saturating_add(apart * apart);
        self.sigmas = self.sigmas.saturating_add(i64::from(sigma.0.max(0)));
    }

    /// Square of the number of frames times the standard deviation: n sum(x^2) - sum(x)^2.
    fn spread(&self, frames: u32) -> i64 {
        i64::from(frames)
            .saturating_mul(self.squares)
            .saturating_sub(self.sum.saturating_mul(self.sum))
    }

    /// Whether the standard deviation is above [`SPREAD`].
    fn is_spread(&self, frames: u32) -> bool {
        let limit = i64::from(frames).saturating_mul(SPREAD.0.into());
        self.spread(frames) > limit.saturating_mul(limit)
    }

    /// Variance of the mean, if frames err each on its own.
    fn variance(&self, frames: u32) -> i64 {
        let frames = i64::from(frames.max(1));
        self.spread(frames as u32) / frames.saturating_mul(frames).saturating_mul(frames)
    }

    /// The mean of what a network told.
    fn sigma(&self, frames: u32) -> Force {
        Force(crate::fixed::clamped(
            self.sigmas / i64::from(frames.max(1)),
        ))
    }

    /// Rounded to the nearest, halves upwards.
    fn mean(&self, frames: u32) -> Force {
        let frames = i64::from(frames.max(1));
        let apart = (2 * self.sum + frames).div_euclid(2 * frames);
        Force(crate::fixed::clamped(
            i64::from(self.first.0).saturating_add(apart),
        ))
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

    /// The end of a tare over frames that `force` gives, and how many it took.
    fn tared(force: impl Fn(u32, usize) -> [i32; 2]) -> (Step, u32) {
        let mut taring = Taring::default();
        for tick in 0..2 * FRAMES {
            let step = taring.take(&frame(|sensor| force(tick, sensor)));
            if step != Step::Gathering {
                return (step, tick + 1);
            }
        }
        (Step::Gathering, 2 * FRAMES)
    }

    #[test]
    fn the_mean_of_256_frames_is_taken_off_afterwards() {
        // Sensor 0: 1024 and 1027 in turn, mean 1025.5, upwards; -7 and -10 in turn: -8.5 becomes -8.
        let (step, frames) = tared(|tick, sensor| {
            let odd = i32::from(tick % 2 == 1);
            match sensor {
                0 => [1024 + 3 * odd, -7 - 3 * odd],
                _ => [sensor as i32 * 2048, 0],
            }
        });
        let Step::Done(tare) = step else {
            panic!("{step:?}");
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

    /// The tare of a steady force at sensor 0 with noise of `noise` in turn, friction and sigma as given.
    fn tare_of(force: i32, noise: i32, held: i32, sigma: Option<i32>) -> i32 {
        let mut taring = Taring::new([[Force(held); 2]; SENSORS]);
        for tick in 0..FRAMES {
            let sign = if tick % 2 == 0 { 1 } else { -1 };
            let mut estimates = frame(|_| [force + sign * noise; 2]);
            estimates[0].sigma = sigma.map(|sigma| [Force(sigma); 2]);
            if let Step::Done(tare) = taring.take(&estimates) {
                return tare.0[0][0].0;
            }
        }
        panic!("no tare");
    }

    #[test]
    fn what_friction_may_hold_at_rest_is_left_alone_and_only_more_is_taken_off() {
        // Half a newton held, and half a newton of noise: three standard errors of it are 96.
        assert_eq!(tare_of(512, 0, 512, None), 0);
        assert_eq!(tare_of(-512, 0, 512, None), 0);
        assert_eq!(tare_of(513, 0, 512, None), 1);
        assert_eq!(tare_of(608, 512, 512, None), 0);
        assert_eq!(tare_of(-609, 512, 512, None), -97);
    }

    #[test]
    fn what_a_network_s_own_sigma_allows_for_is_left_alone() {
        assert_eq!(tare_of(600, 0, 0, Some(300)), 0);
        assert_eq!(tare_of(601, 0, 0, Some(300)), 601);
        // Where it tells no sigma, or none worth the name, every offset counts.
        assert_eq!(tare_of(1, 0, 0, None), 1);
        assert_eq!(tare_of(1, 0, 0, Some(0)), 1);
    }

    #[test]
    fn a_force_at_the_end_of_its_range_stays_there() {
        let tare = Tare([[Force(1), Force(-1)]; SENSORS]);
        let mut ends = frame(|_| [i32::MIN, i32::MAX]);
        tare.apply(&mut ends);
        assert_eq!(ends[0].force, [Force(i32::MIN), Force(i32::MAX)]);
    }

    #[test]
    fn a_sensor_that_cannot_be_believed_refuses_the_tare_with_its_number_and_reason() {
        let spoilt = |spoil: fn(&mut Estimate)| {
            let mut taring = Taring::default();
            let mut estimates = frame(|_| [0; 2]);
            assert_eq!(taring.take(&estimates), Step::Gathering);
            spoil(&mut estimates[3]);
            match taring.take(&estimates) {
                Step::Refused(refusal) => refusal.detail(),
                other => panic!("{other:?}"),
            }
        };
        assert_eq!(spoilt(|e| e.validity = Validity::Missing), 0x103);
        assert_eq!(spoilt(|e| e.validity = Validity::Saturated), 0x203);
        assert_eq!(spoilt(|e| e.validity = Validity::OutsideModel), 0x203);
        assert_eq!(spoilt(|e| e.disturbed = true), 0x303);
    }

    #[test]
    fn noise_up_to_the_limit_is_tared_and_beyond_it_the_load_moves() {
        // Plus and minus the same size in turn: that is the standard deviation.
        let noise = |size: i32| {
            tared(move |tick, sensor| {
                let sign = if tick % 2 == 0 { 1 } else { -1 };
                [0, if sensor == 2 { sign * size } else { 0 }]
            })
            .0
        };
        assert_eq!(noise(SPREAD.0), Step::Done(Tare::NONE));
        let moving = Step::Refused(Refusal::Moving { sensor: 2 });
        assert_eq!(noise(SPREAD.0 + 1), moving);
        assert_eq!(noise(1 << 29), moving);
    }

    #[test]
    fn a_slow_drift_is_a_moving_load() {
        // A ramp's standard deviation is its length over the square root of twelve.
        let ramp = |length_n: f64| {
            let step = length_n * Force::PER_NEWTON / f64::from(FRAMES);
            tared(move |tick, _| [(f64::from(tick) * step) as i32; 2]).0
        };
        let limit_n = params::TARE_SPREAD.value * 12_f64.sqrt();
        assert!(matches!(ramp(0.98 * limit_n), Step::Done(_)));
        assert_eq!(
            ramp(1.02 * limit_n),
            Step::Refused(Refusal::Moving { sensor: 0 })
        );
    }

    #[test]
    fn a_tare_beyond_the_range_of_the_model_is_refused() {
        let steady = |force: i32| tared(move |_, _| [0, force]).0;
        assert!(matches!(steady(GREATEST.0), Step::Done(_)));
        assert!(matches!(steady(-GREATEST.0), Step::Done(_)));
        let refused = Step::Refused(Refusal::TooLarge { sensor: 0 });
        assert_eq!(steady(GREATEST.0 + 1), refused);
        assert_eq!(steady(i32::MIN), refused);
    }
}
