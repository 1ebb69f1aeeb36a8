//! Whether the screw locks itself, tested by the device: it grips slowly, ramps the current to zero, and watches
//! whether the rotor turns back.

use super::state::Setpoint;

/// Milliseconds of gripping at rest before the current falls.
const REST_MS: u32 = 100;
/// Below this speed in rad/s, either way, the rotor rests: its noise is up to half of it, closing
/// more than twice.
const REST_SPEED: f32 = 2.0;
/// Speed of closing in mm/s until something is gripped.
const CLOSING_MM_S: f32 = 5.0;
/// Milliseconds within which something must be gripped.
const GRIP_MS: u32 = 5_000;
/// Milliseconds in which the current falls to zero.
const RAMP_MS: u32 = 20;
/// Milliseconds of watching.
const WATCH_MS: u32 = 2_000;
/// A rotor that turns back further than this, in radians, is driven by its load: 0.025 mm of screw A,
/// 0.05 mm of screw B.
const BACK_RAD: f32 = 0.05;

/// What the test found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The grasp holds without current.
    Locks,
    /// The load turns the rotor back.
    BackDrives,
    /// Nothing was gripped in time.
    NothingGripped,
}

/// What to do in the next millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Drive so.
    Drive(Setpoint),
    /// It is over.
    Ended(Verdict),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Grips { rests_ms: u32 },
    Ramps { from_rad: f32 },
    Watches { from_rad: f32 },
}

/// The test; a part of some stiffness must lie between the fingers.
#[derive(Clone, Copy, Debug)]
pub struct SelfLockTest {
    grip_a: f32,
    phase: Phase,
    elapsed_ms: u32,
}

impl SelfLockTest {
    /// Grips with a current in amperes; the force must be beyond what dry friction alone holds.
    pub const fn new(grip_a: f32) -> Self {
        Self {
            grip_a,
            phase: Phase::Grips { rests_ms: 0 },
            elapsed_ms: 0,
        }
    }

    /// Takes a millisecond: the rotor's angle in radians, closing positive, and its speed in rad/s.
    pub fn tick(&mut self, turned_rad: f32, speed: f32) -> Step {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        match self.phase {
            Phase::Grips { rests_ms } => self.grip(rests_ms, turned_rad, speed),
            Phase::Ramps { from_rad } => {
                let left = RAMP_MS.saturating_sub(self.elapsed_ms);
                if left == 0 {
                    self.enter(Phase::Watches { from_rad });
                }
                let closing_a = self.grip_a * left as f32 / RAMP_MS as f32;
                Step::Drive(Setpoint::Current { closing_a })
            }
            Phase::Watches { from_rad } => {
                if from_rad - turned_rad > BACK_RAD {
                    return Step::Ended(Verdict::BackDrives);
                }
                match self.elapsed_ms < WATCH_MS {
                    true => Step::Drive(Setpoint::Off),
                    false => Step::Ended(Verdict::Locks),
                }
            }
        }
    }

    fn grip(&mut self, rests_ms: u32, turned_rad: f32, speed: f32) -> Step {
        // At the start the rotor rests because it has not begun.
        let rests_ms = match speed.abs() < REST_SPEED && self.elapsed_ms > REST_MS {
            true => rests_ms.saturating_add(1),
            false => 0,
        };
        self.phase = Phase::Grips { rests_ms };
        if rests_ms >= REST_MS {
            self.enter(Phase::Ramps {
                from_rad: turned_rad,
            });
        } else if self.elapsed_ms >= GRIP_MS {
            return Step::Ended(Verdict::NothingGripped);
        }
        // Against what it grips the speed is missing, and the current is all of this.
        Step::Drive(Setpoint::Speed {
            closing_mm_s: CLOSING_MM_S,
            most_a: self.grip_a,
        })
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.elapsed_ms = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs the test against a rotor: its angle and speed for the current that drives it.
    fn judged(mut rotor: impl FnMut(f32) -> (f32, f32)) -> (Verdict, u32) {
        let mut test = SelfLockTest::new(3.0);
        let mut current = 0.0;
        for tick in 0..20_000 {
            let (angle, speed) = rotor(current);
            match test.tick(angle, speed) {
                Step::Drive(
                    Setpoint::Current { closing_a: amperes }
                    | Setpoint::Speed {
                        most_a: amperes, ..
                    },
                ) => current = amperes,
                Step::Drive(_) => current = 0.0,
                Step::Ended(verdict) => return (verdict, tick),
            }
        }
        panic!("no end");
    }

    #[test]
    fn a_rotor_that_stays_is_locked_after_two_seconds() {
        let (verdict, ticks) = judged(|_| (7.0, 0.0));
        assert_eq!(
            (verdict, ticks),
            (Verdict::Locks, 100 + 100 + 20 + 2000 - 1)
        );
    }

    #[test]
    fn a_rotor_that_follows_its_load_is_driven_back() {
        // A spring: the angle is what the current holds.
        let (verdict, ticks) = judged(|current| (0.02 * current, 0.0));
        assert_eq!(verdict, Verdict::BackDrives);
        assert!(ticks < 230, "{ticks}");
        // Two thirds of a milliradian less than the bound.
        let (verdict, _) = judged(|current| (0.0164 * current, 0.0));
        assert_eq!(verdict, Verdict::Locks);
    }

    #[test]
    fn closing_without_end_is_no_grasp() {
        let mut angle = 0.0;
        let verdict = judged(|_| {
            angle += 0.05;
            (angle, 50.0)
        });
        assert_eq!(verdict, (Verdict::NothingGripped, GRIP_MS - 1));
    }
}
