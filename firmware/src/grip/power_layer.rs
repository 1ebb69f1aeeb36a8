//! Power layer: detection, reaction, latching and clearing of faults; session and arming.

use crate::config::constants;
use crate::fixed_point::Force;
use crate::grip::commands::{GripCommand, GripProfile};
use crate::grip::debounce::next_ms;
use crate::grip::fault_reactions::{
    FirstFault, Reaction, TRIP_FAULTS, fault_of, is_active, strongest_reaction, trip_bits,
};
use crate::grip::states::{GripPhase, PowerState, TaskState};
use crate::grip::transitions::{self, PowerEvent};
use crate::grip::{ArmingRequest, ControlInputs, ControlOutputs, GripController};
use crate::motor::calibration::{CalibrationFailure, CalibrationKind};
use crate::motor::state::SupplyState;
use crate::motor::{MotorState, MotorStatus, Trip};
use crate::system::faults::Fault;

/// Milliseconds for which a host's clear is in effect: a motor trip ends only once the motor is disarmed.
const CLEARING_MS: u8 = 5;

impl GripController {
    /// Updates the faults that this layer detects.
    pub(super) fn detect_faults(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        let tripped = match inputs.motor.state {
            MotorState::Tripped(trip) => 1 << fault_of(trip).index(),
            _ => 0,
        };
        if self.faults.bits() & trip_bits() != tripped {
            // Both are [`Fault::Runaway`]: the heartbeat has no bit left.
            let is_late = inputs.motor.state == MotorState::Tripped(Trip::CommandTimeout);
            for fault in TRIP_FAULTS {
                self.set_fault(fault, is_active(tripped, fault), is_late.into(), outputs);
            }
        }
        let is_armed = inputs.motor.state == MotorState::Armed;
        let is_out_of_range = is_armed && inputs.motor.supply != SupplyState::Sound;
        let detail = (inputs.motor.bus_v * 1e3) as u32;
        self.set_fault(Fault::Supply, is_out_of_range, detail, outputs);
        self.set_fault(Fault::Hot, is_armed && inputs.motor.is_hot, 0, outputs);
        self.check_opening(inputs, outputs);
        let is_blind = self.lost_ticks >= self.limits.invalid_ticks;
        self.set_fault(Fault::Blind, is_blind, 0, outputs);
        let is_over =
            self.beyond.is_over() || (self.invalid_ticks == 0 && self.force_n > self.limits.trip_n);
        let detail = (self.force_n * Force::PER_NEWTON as f32) as u32;
        self.set_fault(Fault::OverForce, is_over, detail, outputs);
        let is_foot = self.power == PowerState::Enabled && self.task == TaskState::Foot;
        let is_overloaded = is_foot && self.ground_contact.peak_n > self.limits.overload_n;
        // Latched until a host clears it.
        if is_overloaded || inputs.clear {
            let detail = self.ground_contact.peak_detail();
            self.set_fault(Fault::FootOverload, is_overloaded, detail, outputs);
        }
        let is_lost = self.power == PowerState::Enabled && self.task == TaskState::Lost;
        self.set_fault(Fault::ObjectLost, is_lost, 0, outputs);
        if inputs.clear {
            self.set_fault(Fault::Jammed, false, 0, outputs);
            self.set_fault(Fault::StrokeWrong, false, 0, outputs);
        }
    }

    /// Checks that the opening is within the stroke; closed fingers beyond zero must press on each other. An
    /// implausible opening becomes unknown.
    fn check_opening(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        let limits = &self.limits;
        let opening_mm = inputs.motor.opening_mm.filter(|_| self.task != TaskState::Homing);
        let is_implausible = opening_mm.is_some_and(|mm| {
            let is_beyond_closed = mm < -limits.overtravel_mm && self.force_n < limits.contact_n;
            is_beyond_closed || mm > constants::STROKE.value as f32 + limits.overtravel_mm
        });
        self.implausible_ms = next_ms(self.implausible_ms, is_implausible);
        if self.implausible_ms >= limits.overtravel_ms {
            let detail = (opening_mm.unwrap_or_default().abs() * 1e3) as u32;
            self.set_fault(Fault::StrokeWrong, true, detail, outputs);
            outputs.opening_mm = Some(f32::NAN);
            self.implausible_ms = 0;
        }
    }

    /// Reacts to faults and to the session, and advances the power state.
    pub(super) fn update_power(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        let bits = inputs.faults | self.faults.bits();
        self.clearing_ms =
            if inputs.clear { CLEARING_MS } else { self.clearing_ms.saturating_sub(1) };
        if self.is_clearing() {
            self.first_fault.clear(|fault| is_active(bits, fault));
        }
        self.react(bits);
        if inputs.stop {
            self.is_stopped = true;
            self.apply_power_event(PowerEvent::QuickStop);
        } else if inputs.clear && self.power != PowerState::QuickStop && self.is_at_rest() {
            self.is_stopped = false;
        }
        // Only opening is allowed while a fault is latched.
        let is_latched = self.first_fault.cause().is_some();
        if is_latched && self.power == PowerState::Enabled && self.task != TaskState::Releasing {
            self.apply_power_event(PowerEvent::QuickStop);
        }
        self.advance(inputs);
        let is_off = matches!(self.power, PowerState::FaultReaction | PowerState::Fault);
        let has_severe_fault = strongest_reaction(bits, GripPhase::Moving, self.self_locking)
            .is_some_and(|(reaction, _)| reaction > Reaction::QuickStop);
        let is_unsound = is_active(bits, Fault::TablesUnsound) || inputs.is_sound != Some(true);
        outputs.may_arm = !(is_off || has_severe_fault || is_unsound || inputs.is_calibrating);
        outputs.arming = match (self.power, inputs.motor.state) {
            (PowerState::Armed, MotorState::Disarmed) => Some(ArmingRequest::Arm),
            // The shorted windings let a load on a backdrivable screw down slowly.
            (PowerState::Fault, _) if self.reaction == Reaction::Brake && !self.is_clearing() => {
                None
            }
            (
                PowerState::Safe | PowerState::Fault,
                MotorState::Arming | MotorState::Armed | MotorState::Tripped(_),
            ) => Some(ArmingRequest::Disarm),
            _ => None,
        };
    }

    /// Why a calibration of the motor must end, given the faults of other tasks. To be called once in each of its
    /// milliseconds.
    pub fn calibration_failure(
        &mut self,
        kind: CalibrationKind,
        motor: &MotorStatus,
        faults: u32,
    ) -> Option<CalibrationFailure> {
        // The calibration itself reports a trip of the motor.
        let bits = (faults | self.faults.bits()) & !trip_bits();
        let worst = strongest_reaction(bits, GripPhase::Moving, self.self_locking);
        let max_n = match kind {
            CalibrationKind::Motor => self.limits.move_n,
            // The test grips with about 100 N.
            CalibrationKind::Screw => 2.0 * GripProfile::Normal.max_n(),
        };
        let outward_n = self.fingers.outward_n().unwrap_or_default();
        if worst.is_some_and(|(reaction, _)| reaction >= Reaction::QuickStop) {
            Some(CalibrationFailure::Fault)
        } else if self.force_n.max(self.rise_n) > max_n || outward_n > self.limits.outward_n {
            Some(CalibrationFailure::Force)
        } else if self.presses_soft_part(motor) {
            Some(CalibrationFailure::SoftPart)
        } else {
            None
        }
    }

    /// Whether the rise of the force over the rotor's travel since contact is that of something soft, such as a hand.
    fn presses_soft_part(&mut self, motor: &MotorStatus) -> bool {
        if self.rise_n < self.limits.contact_n {
            self.touched_rad = None;
            return false;
        }
        let touched_rad = *self.touched_rad.get_or_insert(motor.rotor_rad);
        let travel_mm = (motor.rotor_rad - touched_rad) * self.screw.ratio_mm;
        let stiff_n = self.limits.part_n_per_mm * travel_mm;
        self.rise_n > self.limits.part_n && self.rise_n - self.limits.contact_n < stiff_n
    }

    const fn is_clearing(&self) -> bool {
        self.clearing_ms > 0
    }

    /// Carries out the reaction to the worst active fault and latches the first fault.
    fn react(&mut self, bits: u32) {
        let phase = match self.power {
            PowerState::Enabled => self.task.phase(self.has_settled),
            _ if self.is_gripped => GripPhase::Holding,
            _ => GripPhase::Moving,
        };
        let Some((reaction, fault)) = strongest_reaction(bits, phase, self.self_locking) else {
            return;
        };
        let event = match (reaction, self.power) {
            (Reaction::Warn | Reaction::Hold, _) => return,
            (Reaction::QuickStop, PowerState::Enabled) => PowerEvent::QuickStop,
            (Reaction::QuickStop, _) => return,
            (Reaction::Brake | Reaction::Off, _) => PowerEvent::Fault,
        };
        let state = self.state();
        if self.apply_power_event(event) {
            self.reaction = reaction;
            self.backs_off = fault == Fault::OverForce;
            self.first_fault.record(FirstFault { fault, state, at_ms: self.now_ms });
        }
    }

    /// Applies the event that follows from the session, the self-test, or the end of the present state.
    fn advance(&mut self, inputs: &ControlInputs) {
        let host = &inputs.host;
        let event = match self.power {
            PowerState::Boot => Some(PowerEvent::Started),
            PowerState::SelfTest => inputs.is_sound.map(|is_sound| {
                if is_sound { PowerEvent::SelfTestPassed } else { PowerEvent::SelfTestFailed }
            }),
            PowerState::Safe if inputs.is_calibrating && !self.is_stopped => {
                Some(PowerEvent::CalibrationBegan)
            }
            PowerState::Calibrating => {
                (!inputs.is_calibrating).then_some(PowerEvent::CalibrationEnded)
            }
            PowerState::Safe => {
                (host.is_offered || host.is_open).then_some(PowerEvent::NonceOffered)
            }
            PowerState::ArmPending if host.is_open => Some(PowerEvent::SessionOpened),
            PowerState::ArmPending => (!host.is_offered).then_some(PowerEvent::NonceExpired),
            // A load on a backdrivable screw is held without a host.
            PowerState::Armed => {
                let is_loaded = self.is_gripped || self.task == TaskState::Foot;
                (!host.is_open && (self.self_locking || !is_loaded))
                    .then_some(PowerEvent::SessionClosed)
            }
            PowerState::Enabled => None,
            PowerState::QuickStop => self.has_stopped().then_some(PowerEvent::Stopped),
            PowerState::FaultReaction => {
                let is_over = self.has_come_to_rest() || self.power_ms >= self.limits.stop_ms;
                is_over.then_some(PowerEvent::ReactionDone)
            }
            PowerState::Fault => {
                let is_gone = self.first_fault.cause().is_none() && inputs.is_sound == Some(true);
                (self.is_clearing() && is_gone).then_some(PowerEvent::Cleared)
            }
        };
        if let Some(event) = event {
            self.apply_power_event(event);
        }
    }

    /// Whether the fingers have rested since the power state began.
    fn has_come_to_rest(&self) -> bool {
        self.is_at_rest() && self.power_ms >= u32::from(self.limits.resting_ms)
    }

    fn has_stopped(&self) -> bool {
        let has_backed_off =
            !self.backs_off || self.force_n < 1.2 * self.limits.overforce_release_n;
        let limit_ms = if self.backs_off { self.limits.back_off_ms } else { self.limits.stop_ms };
        (self.has_come_to_rest() && has_backed_off) || self.power_ms >= limit_ms
    }

    /// Applies an event to the power layer; whether the table lists a transition.
    pub(super) fn apply_power_event(&mut self, event: PowerEvent) -> bool {
        let Some(to) = transitions::next_power_state(self.power, event) else {
            return false;
        };
        if self.power == PowerState::Enabled {
            // A repeated RELEASE, which needs no ENABLE, must not start again.
            let is_release =
                |command: &(GripCommand, bool)| matches!(command, (GripCommand::Release(_), _));
            self.last_command = self.last_command.filter(is_release);
        }
        if matches!(to, PowerState::QuickStop | PowerState::Armed) {
            self.hold_mm = None;
        }
        if matches!(to, PowerState::Safe | PowerState::Fault) {
            // The motor is off: only a self-locking screw still holds the object.
            self.is_gripped &= self.self_locking;
        }
        self.power = to;
        self.power_ms = 0;
        true
    }
}
