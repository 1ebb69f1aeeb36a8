//! A way to a place, bounded in speed, acceleration and jerk, that takes a new target at any time and ends on
//! it exactly.
//!
//! A generator in integers accelerates and brakes as hard as it may, so that it comes to rest on the target to
//! the nanometre; the mean over a window of its ticks bounds the jerk, and neither adds speed or acceleration
//! nor misses the end. It comes a window later.

use super::MOTION_HZ;
use super::number::sqrt;
use crate::params;

/// Acceleration in nanometres for each tick squared.
const ACCELERATION: i32 =
    (params::MOTION_ACCELERATION.value * 1e6 / (MOTION_HZ * MOTION_HZ)) as i32;
/// Ticks of the mean: from the one end of the acceleration to the other the jerk is at its bound.
const WINDOW: usize = (2.0 * params::MOTION_ACCELERATION.value / (params::MOTION_JERK.value * 1e3)
    * MOTION_HZ) as usize;
/// Nanometres in a millimetre.
const NM: f32 = 1e6;

/// The way.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory {
    /// Of the generator, in nanometres.
    place: i32,
    /// Of the generator, in nanometres a tick.
    speed: i32,
    /// The generator's last speeds.
    speeds: [i32; WINDOW],
    oldest: usize,
    /// Of them.
    sum: i32,
    last_sum: i32,
    /// Place of the mean, in nanometres over [`WINDOW`].
    mean: i64,
}

impl Trajectory {
    /// Starts at a place in millimetres with a speed in mm/s.
    pub fn start(place_mm: f32, speed_mm_s: f32) -> Self {
        let speed = (speed_mm_s * (NM / MOTION_HZ as f32)) as i32;
        // The mean is half a window behind.
        let behind = i64::from(speed).wrapping_mul((WINDOW * (WINDOW - 1) / 2) as i64);
        let place = ((place_mm * NM) as i32).saturating_add((behind / WINDOW as i64) as i32);
        let sum = speed.saturating_mul(WINDOW as i32);
        Self {
            place,
            speed,
            speeds: [speed; WINDOW],
            oldest: 0,
            sum,
            last_sum: sum,
            mean: i64::from(place) * WINDOW as i64 - behind,
        }
    }

    /// Goes on by a tick towards a target in millimetres, at most at a speed in mm/s.
    pub fn tick(&mut self, target_mm: f32, speed_mm_s: f32) {
        let target = (target_mm * NM) as i32;
        let fastest = ((speed_mm_s * (NM / MOTION_HZ as f32)) as i32).max(0);
        let left = target.saturating_sub(self.place);
        let wanted = speed_to_stop(left.unsigned_abs()).min(fastest) * left.signum();
        let (slower, faster) = (
            self.speed.saturating_sub(ACCELERATION),
            self.speed.saturating_add(ACCELERATION),
        );
        self.speed = wanted.max(slower).min(faster);
        self.place = self.place.saturating_add(self.speed);
        self.last_sum = self.sum;
        if let Some(oldest) = self.speeds.get_mut(self.oldest) {
            self.sum = self.sum.saturating_add(self.speed).saturating_sub(*oldest);
            *oldest = self.speed;
        }
        self.oldest = (self.oldest + 1) % WINDOW;
        self.mean = self.mean.saturating_add(self.sum.into());
    }

    /// Place in millimetres.
    pub fn place_mm(&self) -> f32 {
        (self.mean / WINDOW as i64) as i32 as f32 / NM
    }

    /// Speed in mm/s.
    pub fn speed_mm_s(&self) -> f32 {
        self.sum as f32 * (MOTION_HZ as f32 / (NM * WINDOW as f32))
    }

    /// Acceleration in mm/s^2.
    pub fn acceleration_mm_s2(&self) -> f32 {
        let change = self.sum.saturating_sub(self.last_sum);
        change as f32 * ((MOTION_HZ * MOTION_HZ) as f32 / (NM * WINDOW as f32))
    }

    /// Whether it has come to rest.
    pub fn is_at_rest(&self) -> bool {
        self.sum == 0 && self.last_sum == 0
    }
}

/// The speed in nanometres a tick from which the rest of the way is just enough to stop: in as few ticks as
/// it takes, each slower by [`ACCELERATION`], the last one shorter.
fn speed_to_stop(left: u32) -> i32 {
    const A: u32 = ACCELERATION as u32;
    let ticks = ticks_to_stop(left.div_ceil(A));
    let slowing = ticks.saturating_mul(ticks.saturating_sub(1)) / 2;
    let way = left.saturating_add(A.saturating_mul(slowing));
    way.checked_div(ticks).unwrap_or(0) as i32
}

/// The least n with n (n + 1) / 2 of at least a number below 2^22: the root is right to a hundredth.
fn ticks_to_stop(halves: u32) -> u32 {
    let enough = |ticks: u32| ticks.saturating_mul(ticks.saturating_add(1)) / 2 >= halves;
    let near = (0.5 * sqrt(8.0 * halves as f32 + 1.0)) as u32;
    match near.saturating_sub(1) {
        less if enough(less) => less,
        _ if enough(near) => near,
        _ => near.saturating_add(1),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FASTEST: f32 = 58.3;

    #[test]
    fn the_ticks_to_stop_are_the_fewest() {
        assert_eq!(
            [0, 1, 2, 3, 4, 6, 7].map(ticks_to_stop),
            [0, 1, 2, 2, 3, 3, 4]
        );
        for halves in 0..1 << 20 {
            let ticks = u64::from(ticks_to_stop(halves));
            assert!(ticks * (ticks + 1) / 2 >= halves.into(), "{halves}");
            assert!(
                ticks == 0 || ticks * (ticks - 1) / 2 < halves.into(),
                "{halves}"
            );
        }
    }

    #[test]
    fn from_rest_to_rest_it_takes_as_long_as_it_must_and_ends_exactly() {
        let mut way = Trajectory::start(40.0, 0.0);
        let mut ticks = 0;
        while way.place_mm() != 50.0 || !way.is_at_rest() {
            way.tick(50.0, FASTEST);
            ticks += 1;
            assert!(ticks < 10_000);
        }
        // 10 mm at 58.3 mm/s, its acceleration, and the window: 171.5 + 29.2 + 8 ms.
        let seconds = f64::from(ticks) / MOTION_HZ;
        assert!((0.205..0.212).contains(&seconds), "{seconds}");
    }

    #[test]
    fn a_start_in_motion_goes_on_from_there() {
        let mut way = Trajectory::start(40.0, -30.0);
        assert!((way.place_mm() - 40.0).abs() < 1e-5 && (way.speed_mm_s() + 30.0).abs() < 1e-4);
        way.tick(10.0, FASTEST);
        assert!((way.speed_mm_s() + 30.0).abs() < 0.1);
    }

    proptest! {
        #[test]
        fn speed_acceleration_and_jerk_stay_within_their_bounds_and_the_end_is_exact(
            start in 0_f32..80.0,
            targets in prop::collection::vec((0_f32..80.0, 1_f32..60.0, 1_u32..900), 1..5),
        ) {
            let mut way = Trajectory::start(start, 0.0);
            let mut last = 0_i64;
            let mut fastest = 0_f32;
            for (target, speed, ticks) in targets.iter().copied() {
                // What is slower from now on is reached with the same acceleration.
                fastest = fastest.max(speed);
                for _ in 0..ticks {
                    way.tick(target, speed);
                    let acceleration = i64::from(way.sum) - i64::from(way.last_sum);
                    prop_assert!(way.speed_mm_s().abs() <= fastest);
                    prop_assert!(acceleration.abs() <= i64::from(ACCELERATION) * WINDOW as i64);
                    prop_assert!((acceleration - last).abs() <= 2 * i64::from(ACCELERATION));
                    last = acceleration;
                }
            }
            let (target, ..) = *targets.last().unwrap();
            for _ in 0..10 * 4000 {
                way.tick(target, FASTEST);
            }
            prop_assert!(way.is_at_rest());
            prop_assert_eq!(way.mean, i64::from((target * NM) as i32) * WINDOW as i64);
        }

        #[test]
        fn from_rest_the_target_is_never_passed(start in 0_f32..80.0, target in 0_f32..80.0) {
            let mut way = Trajectory::start(start, 0.0);
            let ahead = (target - start).signum() as i64;
            for _ in 0..8000 {
                way.tick(target, FASTEST);
                let beyond = way.mean - i64::from((target * NM) as i32) * WINDOW as i64;
                prop_assert!(beyond * ahead <= 0);
            }
            prop_assert_eq!(way.place, (target * NM) as i32);
        }
    }
}
