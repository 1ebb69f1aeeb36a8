//! Trajectory limited in speed, acceleration and jerk. Accepts a new target at any time and ends on it exactly.
//!
//! An integer generator accelerates and brakes at the acceleration limit and stops on the target to the nanometre. A
//! moving average of its speed limits the jerk; it preserves the limits of speed and acceleration and the end, and
//! delays the motion by its window.

use crate::config::constants;
use crate::math::sqrt;
use crate::motor::timing::MOTION_HZ;

/// Acceleration in nanometres per tick squared.
const ACCELERATION: i32 =
    (constants::MOTION_ACCELERATION.value * 1e6 / (MOTION_HZ * MOTION_HZ)) as i32;
/// Ticks of the moving average: reversing the acceleration takes as long at the jerk limit.
const WINDOW: usize = (2.0 * constants::MOTION_ACCELERATION.value
    / (constants::MOTION_JERK.value * 1e3)
    * MOTION_HZ) as usize;
/// Nanometres per millimetre.
const NM: f32 = 1e6;

/// State of a trajectory.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory {
    /// Position of the generator in nanometres.
    position: i32,
    /// Speed of the generator in nanometres per tick.
    speed: i32,
    /// Last speeds of the generator, a ring buffer.
    speeds: [i32; WINDOW],
    oldest: usize,
    /// Sum of [`Self::speeds`].
    sum: i32,
    last_sum: i32,
    /// Averaged position in nanometres, times [`WINDOW`].
    mean: i64,
}

impl Trajectory {
    /// Starts at a position in millimetres with a speed in mm/s.
    pub fn start(position_mm: f32, speed_mm_s: f32) -> Self {
        let speed = (speed_mm_s * (NM / MOTION_HZ as f32)) as i32;
        // The average lags by half a window.
        let behind = i64::from(speed).wrapping_mul((WINDOW * (WINDOW - 1) / 2) as i64);
        let position = ((position_mm * NM) as i32).saturating_add((behind / WINDOW as i64) as i32);
        let sum = speed.saturating_mul(WINDOW as i32);
        Self {
            position,
            speed,
            speeds: [speed; WINDOW],
            oldest: 0,
            sum,
            last_sum: sum,
            mean: i64::from(position) * WINDOW as i64 - behind,
        }
    }

    /// One tick towards a target in millimetres, at most at a speed in mm/s.
    pub fn tick(&mut self, target_mm: f32, speed_mm_s: f32) {
        let target = (target_mm * NM) as i32;
        let max_speed = ((speed_mm_s * (NM / MOTION_HZ as f32)) as i32).max(0);
        let remaining = target.saturating_sub(self.position);
        let target_speed =
            speed_to_stop(remaining.unsigned_abs()).min(max_speed) * remaining.signum();
        let (slower, faster) =
            (self.speed.saturating_sub(ACCELERATION), self.speed.saturating_add(ACCELERATION));
        self.speed = target_speed.max(slower).min(faster);
        self.position = self.position.saturating_add(self.speed);
        self.last_sum = self.sum;
        if let Some(oldest) = self.speeds.get_mut(self.oldest) {
            self.sum = self.sum.saturating_add(self.speed).saturating_sub(*oldest);
            *oldest = self.speed;
        }
        self.oldest = (self.oldest + 1) % WINDOW;
        self.mean = self.mean.saturating_add(self.sum.into());
    }

    /// Position in millimetres.
    pub fn position_mm(&self) -> f32 {
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

    /// Whether the motion has ended.
    pub fn is_at_rest(&self) -> bool {
        self.sum == 0 && self.last_sum == 0
    }
}

/// Speed in nanometres per tick from which [`ACCELERATION`] just stops within a distance: in the fewest ticks, the last
/// one shorter.
fn speed_to_stop(distance: u32) -> i32 {
    const A: u32 = ACCELERATION as u32;
    let ticks = ticks_to_stop(distance.div_ceil(A));
    let slowing = ticks.saturating_mul(ticks.saturating_sub(1)) / 2;
    let total = distance.saturating_add(A.saturating_mul(slowing));
    total.checked_div(ticks).unwrap_or(0) as i32
}

/// The least n with n (n + 1) / 2 >= `halves`, below 2^22, where the root is exact to a hundredth.
fn ticks_to_stop(halves: u32) -> u32 {
    let suffices = |ticks: u32| ticks.saturating_mul(ticks.saturating_add(1)) / 2 >= halves;
    let near = (0.5 * sqrt(8.0 * halves as f32 + 1.0)) as u32;
    match near.saturating_sub(1) {
        less if suffices(less) => less,
        _ if suffices(near) => near,
        _ => near.saturating_add(1),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FASTEST: f32 = 58.3;

    #[test]
    fn ticks_to_stop_are_minimal() {
        assert_eq!([0, 1, 2, 3, 4, 6, 7].map(ticks_to_stop), [0, 1, 2, 2, 3, 3, 4]);
        for halves in 0..1 << 20 {
            let ticks = u64::from(ticks_to_stop(halves));
            assert!(ticks * (ticks + 1) / 2 >= halves.into(), "{halves}");
            assert!(ticks == 0 || ticks * (ticks - 1) / 2 < halves.into(), "{halves}");
        }
    }

    #[test]
    fn motion_from_rest_to_rest_has_expected_duration_and_end() {
        let mut trajectory = Trajectory::start(40.0, 0.0);
        let mut ticks = 0;
        while trajectory.position_mm() != 50.0 || !trajectory.is_at_rest() {
            trajectory.tick(50.0, FASTEST);
            ticks += 1;
            assert!(ticks < 10_000);
        }
        // 10 mm at 58.3 mm/s, its acceleration, and the window: 171.5 + 29.2 + 8 ms.
        let seconds = f64::from(ticks) / MOTION_HZ;
        assert!((0.205..0.212).contains(&seconds), "{seconds}");
    }

    #[test]
    fn start_in_motion_keeps_the_speed() {
        let mut trajectory = Trajectory::start(40.0, -30.0);
        assert!(
            (trajectory.position_mm() - 40.0).abs() < 1e-5
                && (trajectory.speed_mm_s() + 30.0).abs() < 1e-4
        );
        trajectory.tick(10.0, FASTEST);
        assert!((trajectory.speed_mm_s() + 30.0).abs() < 0.1);
    }

    proptest! {
        #[test]
        fn trajectory_respects_all_limits_and_ends_exactly(
            start in 0_f32..80.0,
            targets in prop::collection::vec((0_f32..80.0, 1_f32..60.0, 1_u32..900), 1..5),
        ) {
            let mut trajectory = Trajectory::start(start, 0.0);
            let mut last = 0_i64;
            let mut fastest = 0;
            for (target, speed, ticks) in targets.iter().copied() {
                // A lower speed limit is reached with the same acceleration.
                fastest = fastest.max((speed * (NM / MOTION_HZ as f32)) as i32);
                for _ in 0..ticks {
                    trajectory.tick(target, speed);
                    let acceleration = i64::from(trajectory.sum) - i64::from(trajectory.last_sum);
                    // In integers, as a float may round the limit up.
                    prop_assert!(trajectory.sum.abs() <= fastest * WINDOW as i32);
                    prop_assert!(acceleration.abs() <= i64::from(ACCELERATION) * WINDOW as i64);
                    prop_assert!((acceleration - last).abs() <= 2 * i64::from(ACCELERATION));
                    last = acceleration;
                }
            }
            let (target, ..) = *targets.last().unwrap();
            for _ in 0..10 * 4000 {
                trajectory.tick(target, FASTEST);
            }
            prop_assert!(trajectory.is_at_rest());
            prop_assert_eq!(trajectory.mean, i64::from((target * NM) as i32) * WINDOW as i64);
        }

        #[test]
        fn trajectory_from_rest_never_overshoots(start in 0_f32..80.0, target in 0_f32..80.0) {
            let mut trajectory = Trajectory::start(start, 0.0);
            let ahead = (target - start).signum() as i64;
            for _ in 0..8000 {
                trajectory.tick(target, FASTEST);
                let beyond = trajectory.mean - i64::from((target * NM) as i32) * WINDOW as i64;
                prop_assert!(beyond * ahead <= 0);
            }
            prop_assert_eq!(trajectory.position, (target * NM) as i32);
        }
    }
}
