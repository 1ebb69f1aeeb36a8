//! What a host has the device measure of itself, a millisecond at a time, while nobody is armed: the motor
//! ([`super::commission`]), or whether the screw locks itself ([`super::selflock`]).

use super::commission::{Found, Refusal};
use super::selflock::{SelfLockTest, Step, Verdict};
use super::state::{Order, Setpoint, State, Telling, Trip};

/// Milliseconds within which the motor has begun what it was ordered.
const BEGINS_MS: u32 = 100;
/// Current in amperes that grips for the test of the screw: some 100 N with the screws that are assumed.
const GRIP_A: f32 = 2.0;
/// Speed in mm/s, and milliseconds for which, the fingers open after the test: what was gripped is let go.
const OPEN: (f32, u32) = (5.0, 400);

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// Windings, phases, sensor: nothing may be gripped, and the fingers need room.
    Motor,
    /// Whether the screw locks itself: a part of some stiffness lies between the fingers, no more than 20 mm
    /// narrower than they are apart.
    Screw,
}

impl Measure {
    /// By the argument of [`crate::session::op::MEASURE`].
    pub const fn of(argument: u32) -> Option<Self> {
        match argument {
            0 => Some(Self::Motor),
            1 => Some(Self::Screw),
            _ => None,
        }
    }
}

/// Why there is no result; the number goes on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Failure {
    /// Somebody is armed, a fault is latched, or a tare is under way.
    NotNow = 1,
    /// The motor does not begin.
    NotReady = 2,
    /// The motor tripped.
    Tripped = 3,
    /// A host says stop.
    Stopped = 4,
    /// Nothing was gripped in time.
    NothingGripped = 5,
    /// See [`Refusal::NoCurrent`].
    NoCurrent = 6,
    /// See [`Refusal::Resistance`].
    Resistance = 7,
    /// See [`Refusal::Inductance`].
    Inductance = 8,
    /// See [`Refusal::Stuck`].
    Stuck = 9,
    /// See [`Refusal::PolePairs`].
    PolePairs = 10,
    /// See [`Refusal::Slipped`].
    Slipped = 11,
}

impl Failure {
    const fn of(refusal: Refusal) -> Self {
        match refusal {
            Refusal::NoCurrent { .. } => Self::NoCurrent,
            Refusal::Resistance { .. } => Self::Resistance,
            Refusal::Inductance { .. } => Self::Inductance,
            Refusal::Stuck => Self::Stuck,
            Refusal::PolePairs { .. } => Self::PolePairs,
            Refusal::Slipped => Self::Slipped,
        }
    }
}

/// How it ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// The motor, which goes by it from now on.
    Motor(Found),
    /// Whether the screw locks itself.
    Screw {
        /// The grasp holds without current.
        locks: bool,
    },
    /// There is no result.
    Failed(Failure),
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// Ordered, not begun.
    Begins,
    Measures,
    Tests(SelfLockTest),
    Opens(Outcome),
}

/// A measurement under way.
#[derive(Clone, Copy, Debug)]
pub struct Calibration {
    measure: Measure,
    phase: Phase,
    elapsed_ms: u32,
}

impl Calibration {
    /// Just begun.
    pub const fn new(measure: Measure) -> Self {
        Self {
            measure,
            phase: Phase::Begins,
            elapsed_ms: 0,
        }
    }

    /// Takes a millisecond: an order, none while the motor is busy.
    ///
    /// # Errors
    /// No error: how it ended. The motor is to be disarmed.
    pub fn tick(&mut self, motor: &Telling) -> Result<Option<Order>, Outcome> {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        let failed = |failure| Err(Outcome::Failed(failure));
        if let State::Tripped(trip) = motor.state {
            // What it tripped on before is forgotten first.
            return match self.elapsed_ms {
                1..=3 if trip != Trip::PowerStage => Ok(Some(Order::Disarm)),
                _ => failed(Failure::Tripped),
            };
        }
        match (&mut self.phase, self.measure) {
            (Phase::Begins, _) if self.elapsed_ms > BEGINS_MS => failed(Failure::NotReady),
            (Phase::Begins, Measure::Motor) => Ok(match motor.state {
                State::Commissioning => {
                    self.enter(Phase::Measures);
                    None
                }
                State::Arming => None,
                _ => Some(Order::Commission),
            }),
            (Phase::Begins, Measure::Screw) => Ok(match motor.state {
                State::Armed => {
                    self.enter(Phase::Tests(SelfLockTest::new(GRIP_A)));
                    None
                }
                State::Arming => None,
                _ => Some(Order::Arm),
            }),
            (Phase::Measures, _) => match (motor.state, motor.found) {
                (State::Commissioning, _) => Ok(None),
                (State::Refused(refusal), _) => failed(Failure::of(refusal)),
                (_, Some(found)) => Err(Outcome::Motor(found)),
                _ => failed(Failure::NotReady),
            },
            (Phase::Tests(test), _) => match test.tick(motor.turned_rad, motor.speed) {
                Step::Drive(setpoint) => Ok(Some(Order::Do(setpoint))),
                Step::Ended(verdict) => {
                    self.enter(Phase::Opens(match verdict {
                        Verdict::Locks => Outcome::Screw { locks: true },
                        Verdict::BackDrives => Outcome::Screw { locks: false },
                        Verdict::NothingGripped => Outcome::Failed(Failure::NothingGripped),
                    }));
                    Ok(None)
                }
            },
            (Phase::Opens(outcome), _) => {
                let (speed_mm_s, length_ms) = OPEN;
                match self.elapsed_ms > length_ms {
                    true => Err(*outcome),
                    false => Ok(Some(Order::Do(Setpoint::Speed {
                        closing_mm_s: -speed_mm_s,
                        most_a: GRIP_A,
                    }))),
                }
            }
        }
    }

    fn enter(&mut self, phase: Phase) {
        (self.phase, self.elapsed_ms) = (phase, 0);
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;
    use crate::motor::settings::Wiring;

    const FOUND: Found = Found {
        resistance_ohm: 0.4,
        inductance_h: 0.0004,
        pole_pairs: 7,
        wiring: Wiring {
            offset: 1,
            is_swapped: false,
        },
    };

    fn telling(state: State) -> Telling {
        Telling {
            state,
            ..Telling::default()
        }
    }

    #[test]
    fn the_motor_is_commissioned_and_what_it_found_is_told() {
        let mut calibration = Calibration::new(Measure::Motor);
        let mut tick = |state, found| {
            let motor = Telling {
                found,
                ..telling(state)
            };
            calibration.tick(&motor)
        };
        // What an earlier one found is no result.
        let disarmed = tick(State::Disarmed, Some(FOUND));
        assert_eq!(disarmed, Ok(Some(Order::Commission)));
        assert_eq!(tick(State::Arming, Some(FOUND)), Ok(None));
        for _ in 0..3000 {
            assert_eq!(tick(State::Commissioning, None), Ok(None));
        }
        let ended = tick(State::Disarmed, Some(FOUND));
        assert_eq!(ended, Err(Outcome::Motor(FOUND)));
    }

    #[test]
    fn a_motor_that_refuses_trips_or_does_not_begin_says_so() {
        let mut refused = Calibration::new(Measure::Motor);
        refused.tick(&telling(State::Commissioning)).unwrap();
        let ended = refused.tick(&telling(State::Refused(Refusal::Stuck)));
        assert_eq!(ended, Err(Outcome::Failed(Failure::Stuck)));
        let mut tripped = Calibration::new(Measure::Screw);
        (0..5).for_each(|_| assert!(tripped.tick(&telling(State::Arming)).is_ok()));
        let ended = tripped.tick(&telling(State::Tripped(Trip::Encoder)));
        assert_eq!(ended, Err(Outcome::Failed(Failure::Tripped)));
        let mut silent = Calibration::new(Measure::Screw);
        let ended = (0..=BEGINS_MS).find_map(|_| silent.tick(&telling(State::Disarmed)).err());
        assert_eq!(ended, Some(Outcome::Failed(Failure::NotReady)));
    }

    #[test]
    fn a_screw_whose_rotor_stays_locks_itself_and_lets_go_in_the_end() {
        let mut calibration = Calibration::new(Measure::Screw);
        assert_eq!(
            calibration.tick(&telling(State::Disarmed)),
            Ok(Some(Order::Arm))
        );
        let mut orders = Vec::new();
        let ended = (0..5000).find_map(|_| match calibration.tick(&telling(State::Armed)) {
            Ok(order) => {
                orders.extend(order);
                None
            }
            Err(outcome) => Some(outcome),
        });
        assert_eq!(ended, Some(Outcome::Screw { locks: true }));
        let last = Order::Do(Setpoint::Speed {
            closing_mm_s: -5.0,
            most_a: GRIP_A,
        });
        assert_eq!(orders.last(), Some(&last));
    }
}
