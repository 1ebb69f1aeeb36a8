//! Backdrive test: grips slowly, ramps the current to zero, and checks whether the load turns the rotor back.

use crate::motor::state::Setpoint;

/// Milliseconds at rest before the current is ramped down.
const REST_MS: u32 = 100;
/// Rotor speed in rad/s below which it rests: twice its noise, less than half the closing speed.
const REST_SPEED: f32 = 2.0;
/// Closing speed in mm/s.
const CLOSING_MM_S: f32 = 5.0;
/// Timeout of gripping in milliseconds.
const GRIP_MS: u32 = 5_000;
/// Duration of the current ramp in milliseconds.
const RAMP_MS: u32 = 20;
/// Observation time in milliseconds.
const WATCH_MS: u32 = 2_000;
/// Backward rotation in radians above which the screw is backdrivable: 0.025 mm of screw A, 0.05 mm of screw B.
const BACK_RAD: f32 = 0.05;

/// Result of the test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BackdriveResult {
    /// The screw holds without current.
    SelfLocking,
    /// The load turns the rotor back.
    Backdrivable,
    /// Timeout without a grip.
    NothingGripped,
}

/// Result of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BackdriveStep {
    /// Set-point for the next millisecond.
    Drive(Setpoint),
    /// End of the test.
    Ended(BackdriveResult),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum BackdrivePhase {
    Grip { resting_ms: u32 },
    Ramp { from_rad: f32 },
    Watch { from_rad: f32 },
}

/// State of the test. A part of some stiffness must be between the fingers.
#[derive(Clone, Copy, Debug)]
pub struct BackdriveTest {
    grip_a: f32,
    phase: BackdrivePhase,
    elapsed_ms: u32,
}

impl BackdriveTest {
    /// Grips with a current in amperes, which must exceed what dry friction alone holds.
    pub const fn new(grip_a: f32) -> Self {
        Self { grip_a, phase: BackdrivePhase::Grip { resting_ms: 0 }, elapsed_ms: 0 }
    }

    /// One millisecond: rotor position in radians, closing positive, and speed in rad/s.
    pub fn tick(&mut self, rotor_rad: f32, speed: f32) -> BackdriveStep {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        match self.phase {
            BackdrivePhase::Grip { resting_ms } => self.grip(resting_ms, rotor_rad, speed),
            BackdrivePhase::Ramp { from_rad } => {
                let remaining_ms = RAMP_MS.saturating_sub(self.elapsed_ms);
                if remaining_ms == 0 {
                    self.enter(BackdrivePhase::Watch { from_rad });
                }
                let closing_a = self.grip_a * remaining_ms as f32 / RAMP_MS as f32;
                BackdriveStep::Drive(Setpoint::Current { closing_a })
            }
            BackdrivePhase::Watch { from_rad } => {
                if from_rad - rotor_rad > BACK_RAD {
                    BackdriveStep::Ended(BackdriveResult::Backdrivable)
                } else if self.elapsed_ms < WATCH_MS {
                    BackdriveStep::Drive(Setpoint::Off)
                } else {
                    BackdriveStep::Ended(BackdriveResult::SelfLocking)
                }
            }
        }
    }

    fn grip(&mut self, resting_ms: u32, rotor_rad: f32, speed: f32) -> BackdriveStep {
        // Before the motion begins, rest does not count.
        let is_resting = speed.abs() < REST_SPEED && self.elapsed_ms > REST_MS;
        let resting_ms = if is_resting { resting_ms.saturating_add(1) } else { 0 };
        self.phase = BackdrivePhase::Grip { resting_ms };
        if resting_ms >= REST_MS {
            self.enter(BackdrivePhase::Ramp { from_rad: rotor_rad });
        } else if self.elapsed_ms >= GRIP_MS {
            return BackdriveStep::Ended(BackdriveResult::NothingGripped);
        }
        // At rest against the part, the speed controller saturates at this current.
        BackdriveStep::Drive(Setpoint::Speed { closing_mm_s: CLOSING_MM_S, max_a: self.grip_a })
    }

    fn enter(&mut self, phase: BackdrivePhase) {
        self.phase = phase;
        self.elapsed_ms = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs the test on a rotor given as angle and speed for a current.
    fn result_of(mut rotor: impl FnMut(f32) -> (f32, f32)) -> (BackdriveResult, u32) {
        let mut test = BackdriveTest::new(3.0);
        let mut current = 0.0;
        for tick in 0..20_000 {
            let (angle, speed) = rotor(current);
            match test.tick(angle, speed) {
                BackdriveStep::Drive(
                    Setpoint::Current { closing_a: amperes }
                    | Setpoint::Speed { max_a: amperes, .. },
                ) => current = amperes,
                BackdriveStep::Drive(_) => current = 0.0,
                BackdriveStep::Ended(result) => return (result, tick),
            }
        }
        panic!("no end");
    }

    #[test]
    fn stationary_rotor_is_self_locking_after_two_seconds() {
        let (result, ticks) = result_of(|_| (7.0, 0.0));
        assert_eq!((result, ticks), (BackdriveResult::SelfLocking, 100 + 100 + 20 + 2000 - 1));
    }

    #[test]
    fn rotor_turned_by_its_load_is_backdrivable() {
        // A spring: the angle is proportional to the current.
        let (result, ticks) = result_of(|current| (0.02 * current, 0.0));
        assert_eq!(result, BackdriveResult::Backdrivable);
        assert!(ticks < 230, "{ticks}");
        // Just below the threshold.
        let (result, _) = result_of(|current| (0.0164 * current, 0.0));
        assert_eq!(result, BackdriveResult::SelfLocking);
    }

    #[test]
    fn endless_closing_times_out() {
        let mut angle = 0.0;
        let result = result_of(|_| {
            angle += 0.05;
            (angle, 50.0)
        });
        assert_eq!(result, (BackdriveResult::NothingGripped, GRIP_MS - 1));
    }
}
