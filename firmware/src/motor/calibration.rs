//! Calibrations that a host requests while disarmed: identification of the motor ([`super::commissioning`]), or the
//! backdrive test of the screw ([`super::backdrive_test`]). One step per millisecond.

use core::ops::ControlFlow;

use crate::motor::backdrive_test::{BackdriveResult, BackdriveStep, BackdriveTest};
use crate::motor::commissioning::CommissioningError;
use crate::motor::settings::IdentifiedMotor;
use crate::motor::state::{MotorCommand, MotorState, MotorStatus, Setpoint, Trip};

/// Timeout in milliseconds for the motor to begin.
const START_MS: u32 = 100;
/// Grip torque in N m of the backdrive test: about 100 N with the assumed screws.
const GRIP_NM: f32 = 0.2;
/// Speed in mm/s and duration in milliseconds of the release after the test.
const RELEASE: (f32, u32) = (5.0, 400);

/// What to calibrate; the number is the argument of the service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationKind {
    /// Windings, phases and rotor sensor. Nothing may be gripped, and the fingers need room.
    Motor = 0,
    /// Whether the screw is self-locking. A part of at least [`crate::config::limits::GripLimits::part_n_per_mm`] is
    /// between the fingers, at most 20 mm narrower than their opening.
    Screw = 1,
}

impl CalibrationKind {
    /// From the argument of [`crate::protocol::session::op::MEASURE`].
    pub const fn of(argument: u32) -> Option<Self> {
        const MOTOR: u32 = CalibrationKind::Motor as u32;
        const SCREW: u32 = CalibrationKind::Screw as u32;
        match argument {
            MOTOR => Some(Self::Motor),
            SCREW => Some(Self::Screw),
            _ => None,
        }
    }
}

/// Why a calibration failed; the number is sent to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CalibrationFailure {
    /// A session is armed, a fault is latched, or a tare is in progress.
    NotAllowed = 1,
    /// The motor does not begin.
    NotReady = 2,
    /// The motor tripped.
    Tripped = 3,
    /// A stop frame arrived, or a stop is latched.
    Stopped = 4,
    /// Timeout without a grip.
    NothingGripped = 5,
    /// See [`CommissioningError::NoCurrent`].
    NoCurrent = 6,
    /// See [`CommissioningError::Resistance`].
    Resistance = 7,
    /// See [`CommissioningError::Inductance`].
    Inductance = 8,
    /// See [`CommissioningError::Stuck`].
    Stuck = 9,
    /// See [`CommissioningError::PolePairs`].
    PolePairs = 10,
    /// See [`CommissioningError::Slipped`].
    Slipped = 11,
    /// A fault that stops a motion.
    Fault = 12,
    /// A force that the calibration does not need: something is between or around the fingers.
    Force = 13,
    /// The part between the fingers is too soft for the backdrive test; it might be a hand.
    SoftPart = 14,
    /// See [`CommissioningError::CurrentSense`].
    CurrentSense = 15,
    /// See [`CommissioningError::TorqueConstant`].
    TorqueConstant = 16,
    /// See [`CommissioningError::Inertia`].
    Inertia = 17,
}

impl CalibrationFailure {
    /// All reasons.
    pub const ALL: [Self; 17] = [
        Self::NotAllowed,
        Self::NotReady,
        Self::Tripped,
        Self::Stopped,
        Self::NothingGripped,
        Self::NoCurrent,
        Self::Resistance,
        Self::Inductance,
        Self::Stuck,
        Self::PolePairs,
        Self::Slipped,
        Self::Fault,
        Self::Force,
        Self::SoftPart,
        Self::CurrentSense,
        Self::TorqueConstant,
        Self::Inertia,
    ];

    const fn of(error: CommissioningError) -> Self {
        match error {
            CommissioningError::NoCurrent { .. } => Self::NoCurrent,
            CommissioningError::Resistance { .. } => Self::Resistance,
            CommissioningError::Inductance { .. } => Self::Inductance,
            CommissioningError::CurrentSense => Self::CurrentSense,
            CommissioningError::Stuck => Self::Stuck,
            CommissioningError::PolePairs { .. } => Self::PolePairs,
            CommissioningError::Slipped => Self::Slipped,
            CommissioningError::TorqueConstant { .. } => Self::TorqueConstant,
            CommissioningError::Inertia { .. } => Self::Inertia,
        }
    }
}

/// End of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CalibrationOutcome {
    /// The identified motor, already in use.
    Motor(IdentifiedMotor),
    /// The backdrive test succeeded.
    Screw {
        /// The screw is self-locking.
        locks: bool,
    },
    /// No result.
    Failed(CalibrationFailure),
}

#[derive(Clone, Copy, Debug)]
enum CalibrationPhase {
    Start,
    Commissioning,
    BackdriveTest(BackdriveTest),
    Release(CalibrationOutcome),
}

/// A calibration in progress.
#[derive(Clone, Copy, Debug)]
pub struct Calibration {
    kind: CalibrationKind,
    phase: CalibrationPhase,
    elapsed_ms: u32,
    /// Current in amperes of [`GRIP_NM`].
    grip_a: f32,
}

impl Calibration {
    /// Begins a calibration of a motor with a torque constant in N m per ampere.
    pub const fn new(kind: CalibrationKind, torque_nm_a: f32) -> Self {
        let grip_a = GRIP_NM / torque_nm_a;
        Self { kind, phase: CalibrationPhase::Start, elapsed_ms: 0, grip_a }
    }

    /// What is calibrated.
    pub const fn kind(&self) -> CalibrationKind {
        self.kind
    }

    /// One millisecond: the next motor command, none while the motor is busy.
    /// `Break` is the end of the calibration, successful or not; the motor must then be disarmed.
    pub fn tick(
        &mut self,
        motor: &MotorStatus,
    ) -> ControlFlow<CalibrationOutcome, Option<MotorCommand>> {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        let failed = |failure| ControlFlow::Break(CalibrationOutcome::Failed(failure));
        if let MotorState::Tripped(trip) = motor.state {
            // An earlier trip is cleared first.
            return match self.elapsed_ms {
                1..=3 if trip != Trip::PowerStage => {
                    ControlFlow::Continue(Some(MotorCommand::Disarm))
                }
                _ => failed(CalibrationFailure::Tripped),
            };
        }
        match (&mut self.phase, self.kind) {
            (CalibrationPhase::Start, _) if self.elapsed_ms > START_MS => {
                failed(CalibrationFailure::NotReady)
            }
            (CalibrationPhase::Start, CalibrationKind::Motor) => {
                ControlFlow::Continue(match motor.state {
                    MotorState::Commissioning => {
                        self.enter(CalibrationPhase::Commissioning);
                        None
                    }
                    MotorState::Arming => None,
                    _ => Some(MotorCommand::Commission),
                })
            }
            (CalibrationPhase::Start, CalibrationKind::Screw) => ControlFlow::Continue(match motor
                .state
            {
                MotorState::Armed => {
                    self.enter(CalibrationPhase::BackdriveTest(BackdriveTest::new(self.grip_a)));
                    None
                }
                MotorState::Arming => None,
                _ => Some(MotorCommand::Arm),
            }),
            (CalibrationPhase::Commissioning, _) => match (motor.state, motor.identification) {
                (MotorState::Commissioning, _) => ControlFlow::Continue(None),
                (MotorState::CommissioningFailed(error), _) => {
                    failed(CalibrationFailure::of(error))
                }
                (_, Some(identified)) => ControlFlow::Break(CalibrationOutcome::Motor(identified)),
                _ => failed(CalibrationFailure::NotReady),
            },
            (CalibrationPhase::BackdriveTest(test), _) => {
                match test.tick(motor.rotor_rad, motor.speed) {
                    BackdriveStep::Drive(setpoint) => {
                        ControlFlow::Continue(Some(MotorCommand::Setpoint(setpoint)))
                    }
                    BackdriveStep::Ended(result) => {
                        self.enter(CalibrationPhase::Release(match result {
                            BackdriveResult::SelfLocking => {
                                CalibrationOutcome::Screw { locks: true }
                            }
                            BackdriveResult::Backdrivable => {
                                CalibrationOutcome::Screw { locks: false }
                            }
                            BackdriveResult::NothingGripped => {
                                CalibrationOutcome::Failed(CalibrationFailure::NothingGripped)
                            }
                        }));
                        ControlFlow::Continue(None)
                    }
                }
            }
            (CalibrationPhase::Release(outcome), _) => {
                let (speed_mm_s, length_ms) = RELEASE;
                if self.elapsed_ms > length_ms {
                    return ControlFlow::Break(*outcome);
                }
                ControlFlow::Continue(Some(MotorCommand::Setpoint(Setpoint::Speed {
                    closing_mm_s: -speed_mm_s,
                    max_a: self.grip_a,
                })))
            }
        }
    }

    fn enter(&mut self, phase: CalibrationPhase) {
        (self.phase, self.elapsed_ms) = (phase, 0);
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;
    use crate::motor::settings::MotorWiring;

    const IDENTIFIED: IdentifiedMotor = IdentifiedMotor {
        resistance_ohm: 0.4,
        inductance_h: 0.0004,
        pole_pairs: 7,
        wiring: MotorWiring { offset: 1, is_swapped: false },
        ..IdentifiedMotor::ASSUMED
    };

    fn status(state: MotorState) -> MotorStatus {
        MotorStatus { state, ..MotorStatus::default() }
    }

    #[test]
    fn commissioning_returns_the_new_identification() {
        let mut calibration = Calibration::new(CalibrationKind::Motor, 0.1);
        let mut tick = |state, found| {
            let motor = MotorStatus { identification: found, ..status(state) };
            calibration.tick(&motor)
        };
        // An earlier identification is no result.
        let disarmed = tick(MotorState::Disarmed, Some(IDENTIFIED));
        assert_eq!(disarmed, ControlFlow::Continue(Some(MotorCommand::Commission)));
        assert_eq!(tick(MotorState::Arming, Some(IDENTIFIED)), ControlFlow::Continue(None));
        for _ in 0..3000 {
            assert_eq!(tick(MotorState::Commissioning, None), ControlFlow::Continue(None));
        }
        let ended = tick(MotorState::Disarmed, Some(IDENTIFIED));
        assert_eq!(ended, ControlFlow::Break(CalibrationOutcome::Motor(IDENTIFIED)));
    }

    #[test]
    fn failing_motor_ends_the_calibration_with_its_reason() {
        let mut refused = Calibration::new(CalibrationKind::Motor, 0.1);
        refused.tick(&status(MotorState::Commissioning)).continue_value().unwrap();
        let ended =
            refused.tick(&status(MotorState::CommissioningFailed(CommissioningError::Stuck)));
        assert_eq!(
            ended,
            ControlFlow::Break(CalibrationOutcome::Failed(CalibrationFailure::Stuck))
        );
        let mut tripped = Calibration::new(CalibrationKind::Screw, 0.1);
        (0..5).for_each(|_| assert!(tripped.tick(&status(MotorState::Arming)).is_continue()));
        let ended = tripped.tick(&status(MotorState::Tripped(Trip::Encoder)));
        assert_eq!(
            ended,
            ControlFlow::Break(CalibrationOutcome::Failed(CalibrationFailure::Tripped))
        );
        let mut silent = Calibration::new(CalibrationKind::Screw, 0.1);
        let ended =
            (0..=START_MS).find_map(|_| silent.tick(&status(MotorState::Disarmed)).break_value());
        assert_eq!(ended, Some(CalibrationOutcome::Failed(CalibrationFailure::NotReady)));
    }

    #[test]
    fn backdrive_test_reports_self_locking_and_releases() {
        let mut calibration = Calibration::new(CalibrationKind::Screw, 0.1);
        assert_eq!(
            calibration.tick(&status(MotorState::Disarmed)),
            ControlFlow::Continue(Some(MotorCommand::Arm))
        );
        let mut commands = Vec::new();
        let ended = (0..5000).find_map(|_| match calibration.tick(&status(MotorState::Armed)) {
            ControlFlow::Continue(command) => {
                commands.extend(command);
                None
            }
            ControlFlow::Break(outcome) => Some(outcome),
        });
        assert_eq!(ended, Some(CalibrationOutcome::Screw { locks: true }));
        let last = MotorCommand::Setpoint(Setpoint::Speed { closing_mm_s: -5.0, max_a: 2.0 });
        assert_eq!(commands.last(), Some(&last));
    }
}
