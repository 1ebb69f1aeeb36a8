//! Motor set-point of each state.

use crate::config::constants;
use crate::grip::commands::MoveTarget;
use crate::grip::fault_reactions::Reaction;
use crate::grip::hold_current::MARGIN;
use crate::grip::homing::HomingStep;
use crate::grip::states::{PowerState, TaskState};
use crate::grip::{GripController, force_controller};
use crate::math::{lesser, within};
use crate::motor::settings::PEAK_A;
use crate::motor::{MotorStatus, Setpoint};

/// Minimum stiffness used by the force controller in N/mm: with less, force noise would shake the fingers.
const SOFTEST: f32 = 50.0;
/// Within the force band the controller uses the mean force and is slower by this factor.
const CALM: f32 = 4.0;
/// Maximum speed in mm/s back to a held position.
const HOLD_MM_S: f32 = 5.0;
/// The holding current decreases, and a self-locking screw may hold alone, while the mean force error is below this
/// multiple of the deadband.
pub(super) const RELAX_BAND: f32 = 1.5;
/// Distance from an end of the stroke in millimetres within which the screw may be jammed.
const END_MM: f32 = 1.0;
/// Stop at zero speed.
const STOP: Setpoint = Setpoint::Speed { closing_mm_s: 0.0, max_a: PEAK_A };

impl GripController {
    /// Motor set-point of the present state.
    pub(super) fn motor_setpoint(&mut self, motor: &MotorStatus) -> Setpoint {
        match self.power {
            PowerState::Boot
            | PowerState::SelfTest
            | PowerState::Safe
            | PowerState::ArmPending
            | PowerState::Calibrating => Setpoint::Off,
            PowerState::Armed if self.task == TaskState::Foot => self.hold_foot(motor),
            PowerState::Armed if self.is_gripped && !self.self_locking => {
                self.hold_position(motor, self.hold_a.max(self.holding_a() * MARGIN))
            }
            PowerState::Armed => Setpoint::Off,
            PowerState::QuickStop if self.task == TaskState::Foot => self.hold_foot(motor),
            // The stiffness of what causes the excessive force is unknown.
            PowerState::QuickStop if self.backs_off => self.back_off(),
            PowerState::QuickStop => STOP,
            PowerState::FaultReaction | PowerState::Fault => match self.reaction {
                Reaction::Brake => Setpoint::Brake,
                _ => Setpoint::Off,
            },
            PowerState::Enabled => self.task_setpoint(motor),
        }
    }

    fn task_setpoint(&mut self, motor: &MotorStatus) -> Setpoint {
        match self.task {
            TaskState::Unhomed => Setpoint::Off,
            TaskState::Homing => match self.homing_step {
                HomingStep::Drive(setpoint) => setpoint,
                _ => STOP,
            },
            TaskState::Moving => self.move_to_target(motor),
            TaskState::Releasing => self.release(motor),
            TaskState::Approach => self.approach(motor),
            TaskState::Force => self.press(self.setpoint_n, self.stiffness.value().max(SOFTEST)),
            TaskState::HoldActive => self.hold_active(motor),
            TaskState::HoldLatched => self.ramp_down(),
            TaskState::HoldFrozen if self.self_locking => Setpoint::Off,
            TaskState::HoldFrozen => self.hold_position(motor, self.hold_a),
            TaskState::Foot => self.hold_foot(motor),
            TaskState::ContactStop | TaskState::Stopping => STOP,
            TaskState::Idle
            | TaskState::NoObject
            | TaskState::GripFailed
            | TaskState::Lost
            | TaskState::TimeoutHold => self.hold_position(motor, PEAK_A),
        }
    }

    /// Moves; where the forces are not believed, the current limits them.
    fn move_to_target(&self, motor: &MotorStatus) -> Setpoint {
        let MoveTarget { opening_mm, speed_mm_s, is_uncalibrated } = self.move_target;
        let (max_mm_s, max_a) =
            if is_uncalibrated { self.uncalibrated_limits(motor) } else { (speed_mm_s, PEAK_A) };
        Setpoint::Position { opening_mm, speed_mm_s: lesser(speed_mm_s, max_mm_s), max_a }
    }

    /// Speed in mm/s and current in amperes of a move without believed forces. At an end of the stroke the screw may be
    /// jammed: away from it, slowly, it has the current that loosens it.
    pub(super) fn uncalibrated_limits(&self, motor: &MotorStatus) -> (f32, f32) {
        const STROKE_MM: f32 = constants::STROKE.value as f32;
        let limits = &self.limits;
        let leaves_end = motor.opening_mm.is_some_and(|opening_mm| {
            if self.is_opening { opening_mm < END_MM } else { opening_mm > STROKE_MM - END_MM }
        });
        if leaves_end {
            (limits.home_mm_s, limits.blind_a)
        } else {
            (limits.uncalibrated_mm_s, limits.uncalibrated_a)
        }
    }

    /// Opens; without valid forces slowly and with a limited current, with an unknown opening until an end.
    fn release(&self, motor: &MotorStatus) -> Setpoint {
        let MoveTarget { opening_mm, speed_mm_s, .. } = self.move_target;
        let (speed_mm_s, max_a) = if self.opens_blind() || motor.opening_mm.is_none() {
            (speed_mm_s.min(self.limits.blind_mm_s), self.limits.blind_a)
        } else {
            (speed_mm_s, PEAK_A)
        };
        match motor.opening_mm {
            Some(_) => Setpoint::Position { opening_mm, speed_mm_s, max_a },
            None => Setpoint::Speed { closing_mm_s: -speed_mm_s, max_a },
        }
    }

    /// Opens after excessive force, until the force is low; never closes.
    fn back_off(&self) -> Setpoint {
        match self.press(self.limits.overforce_release_n, force_controller::HARDEST) {
            Setpoint::Speed { closing_mm_s, max_a } => {
                // Without a valid force the last one is above the range of the model.
                let fastest = if self.invalid_ticks > 0 {
                    -self.limits.blind_mm_s
                } else {
                    f32::NEG_INFINITY
                };
                Setpoint::Speed { closing_mm_s: within(closing_mm_s, fastest, 0.0), max_a }
            }
            other => other,
        }
    }

    fn approach(&mut self, motor: &MotorStatus) -> Setpoint {
        let max_mm_s = if self.is_far_from_window(motor) {
            force_controller::FASTEST
        } else {
            force_controller::approach_mm_s(self.setpoint_n)
        };
        let max_mm_s = max_mm_s.min(self.target.max_mm_s);
        let closing_mm_s = if self.contact.is_suspected() {
            let error_n = self.setpoint_n - self.force_n;
            force_controller::closing_mm_s(error_n, force_controller::HARDEST, max_mm_s)
        } else {
            max_mm_s
        };
        Setpoint::Speed { closing_mm_s, max_a: PEAK_A }
    }

    /// Controls the force to a set-point in newtons at a contact stiffness in N/mm.
    fn press(&self, setpoint_n: f32, stiffness: f32) -> Setpoint {
        let max_mm_s = force_controller::approach_mm_s(setpoint_n).min(self.target.max_mm_s);
        let error_n = setpoint_n - self.force_n;
        Setpoint::Speed {
            closing_mm_s: force_controller::closing_mm_s(error_n, stiffness, max_mm_s),
            max_a: PEAK_A,
        }
    }

    fn hold_active(&mut self, motor: &MotorStatus) -> Setpoint {
        let deadband_n = self.limits.deadband_n.max(self.limits.deadband_ratio * self.setpoint_n);
        let band_n = self.limits.tolerance_n.max(self.limits.tolerance_ratio * self.setpoint_n);
        let raw_n = self.setpoint_n - self.force_n;
        let (error_n, slower) =
            if raw_n.abs() < band_n { (self.setpoint_n - self.mean_n, CALM) } else { (raw_n, 1.0) };
        let beyond_n = error_n - within(error_n, -deadband_n, deadband_n);
        let stiffness = self.stiffness.value().max(SOFTEST) * slower;
        let max_mm_s = force_controller::approach_mm_s(self.setpoint_n).min(self.target.max_mm_s);
        let present_a = motor.current_setpoint.q.abs();
        let is_in_band = error_n.abs() < RELAX_BAND * deadband_n;
        let max_a = self.hold.update(is_in_band, self.holding_a(), present_a);
        self.hold_a = present_a;
        Setpoint::Speed {
            closing_mm_s: force_controller::closing_mm_s(beyond_n, stiffness, max_mm_s),
            max_a,
        }
    }

    /// Ramps the current to zero; then the screw holds alone.
    fn ramp_down(&self) -> Setpoint {
        let ramp_ms = self.limits.ramp_ms;
        match ramp_ms.saturating_sub(self.task_ms) {
            0 => Setpoint::Off,
            remaining_ms => {
                Setpoint::Current { closing_a: self.hold_a * remaining_ms as f32 / ramp_ms as f32 }
            }
        }
    }

    /// Foot mode: off, or the position held with a small current.
    fn hold_foot(&self, motor: &MotorStatus) -> Setpoint {
        if self.self_locking {
            Setpoint::Off
        } else {
            self.hold_position(motor, self.limits.ground_hold_a)
        }
    }

    /// Holds the position where the fingers came to rest; until then stops them.
    fn hold_position(&self, motor: &MotorStatus, max_a: f32) -> Setpoint {
        match (self.hold_mm, motor.opening_mm) {
            (Some(opening_mm), Some(_)) => {
                Setpoint::Position { opening_mm, speed_mm_s: HOLD_MM_S, max_a }
            }
            _ => Setpoint::Speed { closing_mm_s: 0.0, max_a },
        }
    }

    /// Amperes that hold the force on a backdrivable screw, without the help of dry friction.
    fn holding_a(&self) -> f32 {
        self.screw.holding_nm(self.force_n, 0.0) / self.limits.torque_nm_a
    }
}
