//! Motor set-point of each state of the task layer.

use crate::config::constants;
use crate::grip::commands::MoveTarget;
use crate::grip::force_controller;
use crate::grip::homing::HomingStep;
use crate::grip::states::TaskState;
use crate::grip::step::GripStep;
use crate::grip::task_layer::TaskLayer;
use crate::math::{lesser, within};
use crate::motor::Setpoint;
use crate::motor::settings::PEAK_A;

/// Minimum stiffness used by the force controller in N/mm: with less, force noise would shake the fingers.
const SOFTEST: f32 = 50.0;
/// Within the force band the controller uses the mean force and is slower by this factor.
const CALM: f32 = 4.0;
/// Maximum speed in mm/s back to a held position.
const HOLD_MM_S: f32 = 5.0;
/// Distance from an end of the stroke in millimetres within which the screw may be jammed.
const END_MM: f32 = 1.0;
/// Stop at zero speed.
pub(in crate::grip) const STOP: Setpoint = Setpoint::Speed { closing_mm_s: 0.0, max_a: PEAK_A };

impl TaskLayer {
    /// Motor set-point of the present state.
    pub(in crate::grip) fn setpoint(&mut self, step: GripStep) -> Setpoint {
        match self.state {
            TaskState::Unhomed => Setpoint::Off,
            TaskState::Homing => match self.homing_step {
                HomingStep::Drive(setpoint) => setpoint,
                _ => STOP,
            },
            TaskState::Moving => self.move_to_target(step),
            TaskState::Releasing => self.release(step),
            TaskState::Approach => self.approach(step),
            TaskState::Force => self.press(step),
            TaskState::HoldActive => self.hold_active(step),
            TaskState::HoldLatched => self.ramp_down(step),
            TaskState::HoldFrozen if step.settings.self_locking => Setpoint::Off,
            TaskState::HoldFrozen => self.hold_position(step, self.hold_a),
            TaskState::Foot => self.hold_foot(step),
            TaskState::ContactStop | TaskState::Stopping => STOP,
            TaskState::Idle
            | TaskState::NoObject
            | TaskState::GripFailed
            | TaskState::Lost
            | TaskState::TimeoutHold => self.hold_position(step, PEAK_A),
        }
    }

    /// Moves; where the forces are not believed, the current limits them.
    fn move_to_target(&self, step: GripStep) -> Setpoint {
        let MoveTarget { opening_mm, speed_mm_s, is_uncalibrated } = self.move_target;
        let (max_mm_s, max_a) =
            if is_uncalibrated { self.uncalibrated_limits(step) } else { (speed_mm_s, PEAK_A) };
        Setpoint::Position { opening_mm, speed_mm_s: lesser(speed_mm_s, max_mm_s), max_a }
    }

    /// Speed in mm/s and current in amperes of a move without believed forces. At an end of the stroke the screw may be
    /// jammed: away from it, slowly, it has the current that loosens it.
    pub(super) fn uncalibrated_limits(&self, step: GripStep) -> (f32, f32) {
        const STROKE_MM: f32 = constants::STROKE.value as f32;
        let limits = &step.settings.limits;
        let leaves_end = step.inputs.motor.opening_mm.is_some_and(|opening_mm| {
            if self.is_opening { opening_mm < END_MM } else { opening_mm > STROKE_MM - END_MM }
        });
        if leaves_end {
            (limits.home_mm_s, limits.blind_a)
        } else {
            (limits.uncalibrated_mm_s, limits.uncalibrated_a)
        }
    }

    /// Opens; without valid forces slowly and with a limited current, with an unknown opening until an end.
    fn release(&self, step: GripStep) -> Setpoint {
        let MoveTarget { opening_mm, speed_mm_s, .. } = self.move_target;
        let known_mm = step.inputs.motor.opening_mm;
        let (speed_mm_s, max_a) = if !step.contact.is_valid() || known_mm.is_none() {
            let limits = &step.settings.limits;
            (speed_mm_s.min(limits.blind_mm_s), limits.blind_a)
        } else {
            (speed_mm_s, PEAK_A)
        };
        match known_mm {
            Some(_) => Setpoint::Position { opening_mm, speed_mm_s, max_a },
            None => Setpoint::Speed { closing_mm_s: -speed_mm_s, max_a },
        }
    }

    fn approach(&self, step: GripStep) -> Setpoint {
        let setpoint_n = self.grasp.setpoint_n;
        let max_mm_s = if self.is_far_from_window(&step.inputs.motor) {
            force_controller::FASTEST
        } else {
            force_controller::approach_mm_s(setpoint_n)
        };
        let max_mm_s = max_mm_s.min(self.grasp.target.max_mm_s);
        let closing_mm_s = if step.contact.detector().is_suspected() {
            let error_n = setpoint_n - step.contact.force_n();
            force_controller::closing_mm_s(error_n, force_controller::HARDEST, max_mm_s)
        } else {
            max_mm_s
        };
        Setpoint::Speed { closing_mm_s, max_a: PEAK_A }
    }

    /// Controls the force to the set-point.
    fn press(&self, step: GripStep) -> Setpoint {
        let error_n = self.grasp.setpoint_n - step.contact.force_n();
        Setpoint::Speed { closing_mm_s: self.closing_mm_s(error_n, 1.0), max_a: PEAK_A }
    }

    /// Closing speed in mm/s for a force error in newtons, slower by a factor.
    fn closing_mm_s(&self, error_n: f32, slower: f32) -> f32 {
        let max_mm_s = force_controller::approach_mm_s(self.grasp.setpoint_n);
        let stiffness = self.stiffness().max(SOFTEST) * slower;
        let max_mm_s = max_mm_s.min(self.grasp.target.max_mm_s);
        force_controller::closing_mm_s(error_n, stiffness, max_mm_s)
    }

    fn hold_active(&mut self, step: GripStep) -> Setpoint {
        let limits = &step.settings.limits;
        let deadband_n = self.grasp.deadband_n(limits);
        let raw_n = self.grasp.setpoint_n - step.contact.force_n();
        let (error_n, slower) = if raw_n.abs() < self.grasp.tolerance_n(limits) {
            (self.grasp.setpoint_n - step.contact.mean_n(), CALM)
        } else {
            (raw_n, 1.0)
        };
        let beyond_n = error_n - within(error_n, -deadband_n, deadband_n);
        let present_a = step.inputs.motor.current_setpoint.q.abs();
        let is_in_band = self.grasp.may_relax(error_n, limits);
        let max_a = self.hold.update(is_in_band, holding_a(step), present_a);
        self.hold_a = present_a;
        Setpoint::Speed { closing_mm_s: self.closing_mm_s(beyond_n, slower), max_a }
    }

    /// Ramps the current to zero; then the screw holds alone.
    fn ramp_down(&self, step: GripStep) -> Setpoint {
        let ramp_ms = step.settings.limits.ramp_ms;
        match ramp_ms.saturating_sub(self.state_ms) {
            0 => Setpoint::Off,
            remaining_ms => {
                Setpoint::Current { closing_a: self.hold_a * remaining_ms as f32 / ramp_ms as f32 }
            }
        }
    }

    /// Foot mode: off, or the position held with a small current.
    pub(in crate::grip) fn hold_foot(&self, step: GripStep) -> Setpoint {
        if step.settings.self_locking {
            Setpoint::Off
        } else {
            self.hold_position(step, step.settings.limits.ground_hold_a)
        }
    }

    /// Holds the position where the fingers came to rest; until then stops them.
    pub(in crate::grip) fn hold_position(&self, step: GripStep, max_a: f32) -> Setpoint {
        match (self.hold_mm, step.inputs.motor.opening_mm) {
            (Some(opening_mm), Some(_)) => {
                Setpoint::Position { opening_mm, speed_mm_s: HOLD_MM_S, max_a }
            }
            _ => Setpoint::Speed { closing_mm_s: 0.0, max_a },
        }
    }
}

/// Opens after excessive force, until the force is low; never closes.
pub(in crate::grip) fn back_off(step: GripStep) -> Setpoint {
    let limits = &step.settings.limits;
    let error_n = limits.overforce_release_n - step.contact.force_n();
    let closing_mm_s = force_controller::closing_mm_s(error_n, force_controller::HARDEST, 0.0);
    // Without a valid force the last one is above the range of the model.
    let fastest = if step.contact.is_valid() { f32::NEG_INFINITY } else { -limits.blind_mm_s };
    Setpoint::Speed { closing_mm_s: within(closing_mm_s, fastest, 0.0), max_a: PEAK_A }
}

/// Amperes that hold the force on a backdrivable screw, without the help of dry friction.
pub(in crate::grip) fn holding_a(step: GripStep) -> f32 {
    let settings = step.settings;
    settings.screw.holding_nm(step.contact.force_n(), 0.0) / settings.limits.torque_nm_a
}
