//! Faults of motor and grip: detection, and the first one until a host clears it.

use crate::config::constants;
use crate::fixed_point::Force;
use crate::grip::debounce::next_ms;
use crate::grip::fault_reactions::{
    FirstFault, FirstFaultLatch, Reaction, TRIP_FAULTS, fault_of, is_active, strongest_reaction,
    trip_bits,
};
use crate::grip::interface::{ControlOutputs, GripSettings};
use crate::grip::states::{GripPhase, PowerState, TaskState};
use crate::grip::step::GripStep;
use crate::motor::state::SupplyState;
use crate::motor::{MotorState, Trip};
use crate::system::faults::{Fault, FaultSet};

/// Active faults and the first cause.
#[derive(Clone, Debug, Default)]
pub(super) struct FaultMonitor {
    active: FaultSet,
    first: FirstFaultLatch,
    implausible_ms: u16,
}

impl FaultMonitor {
    /// Active faults as heartbeat bits.
    pub(super) fn bits(&self) -> u32 {
        self.active.bits()
    }

    /// First fault since a host last cleared the faults.
    pub(super) const fn first_cause(&self) -> Option<FirstFault> {
        self.first.cause()
    }

    /// Whether only opening is allowed until a host clears the faults.
    pub(super) const fn is_latched(&self) -> bool {
        self.first.cause().is_some()
    }

    pub(super) fn record(&mut self, cause: FirstFault) {
        self.first.record(cause);
    }

    /// Clears the first fault unless it is among the active ones.
    pub(super) fn clear_first(&mut self, bits: u32) {
        self.first.clear(|fault| is_active(bits, fault));
    }

    /// Sets or clears a fault.
    pub(super) fn set(
        &mut self,
        fault: Fault,
        active: bool,
        detail: u32,
        outputs: &mut ControlOutputs,
    ) {
        if self.active.has(fault, 0) != active {
            self.change(fault, active, detail, outputs);
        }
    }

    #[inline(never)] // Called in many places, and seldom.
    fn change(&mut self, fault: Fault, active: bool, detail: u32, outputs: &mut ControlOutputs) {
        if let Some(event) = self.active.update(fault, 0, active, detail) {
            // There is room for each kind; an event that does not fit is still in the heartbeat's bits.
            let _ = outputs.events.push(event);
        }
    }

    /// Detects the faults that do not depend on the execution of a task.
    pub(super) fn detect(
        &mut self,
        step: GripStep,
        (power, task): (PowerState, TaskState),
        outputs: &mut ControlOutputs,
    ) {
        let GripStep { inputs, contact, settings, .. } = step;
        let motor = &inputs.motor;
        let tripped = match motor.state {
            MotorState::Tripped(trip) => 1 << fault_of(trip).index(),
            _ => 0,
        };
        if self.bits() & trip_bits() != tripped {
            // Both are [`Fault::Runaway`]: the heartbeat has no bit left.
            let is_late = motor.state == MotorState::Tripped(Trip::CommandTimeout);
            for fault in TRIP_FAULTS {
                self.set(fault, is_active(tripped, fault), is_late.into(), outputs);
            }
        }
        let is_armed = motor.state == MotorState::Armed;
        let is_out_of_range = is_armed && motor.supply != SupplyState::Sound;
        self.set(Fault::Supply, is_out_of_range, (motor.bus_v * 1e3) as u32, outputs);
        self.set(Fault::Hot, is_armed && motor.is_hot, 0, outputs);
        self.check_opening(step, task, outputs);
        self.set(Fault::Blind, contact.is_lost(settings), 0, outputs);
        let detail = (contact.force_n() * Force::PER_NEWTON as f32) as u32;
        self.set(Fault::OverForce, contact.is_over(settings), detail, outputs);
        let is_enabled = power == PowerState::Enabled;
        let ground = contact.ground();
        let is_foot = is_enabled && task == TaskState::Foot;
        let is_overloaded = is_foot && ground.peak_n > settings.limits.overload_n;
        // Latched until a host clears it.
        if is_overloaded || inputs.clear {
            self.set(Fault::FootOverload, is_overloaded, ground.peak_detail(), outputs);
        }
        self.set(Fault::ObjectLost, is_enabled && task == TaskState::Lost, 0, outputs);
        if inputs.clear {
            self.set(Fault::Jammed, false, 0, outputs);
            self.set(Fault::StrokeWrong, false, 0, outputs);
        }
    }

    /// Checks that the opening is within the stroke; closed fingers beyond zero must press on each other. An
    /// implausible opening becomes unknown.
    fn check_opening(&mut self, step: GripStep, task: TaskState, outputs: &mut ControlOutputs) {
        let limits = &step.settings.limits;
        let opening_mm = step.inputs.motor.opening_mm.filter(|_| task != TaskState::Homing);
        let is_implausible = opening_mm.is_some_and(|mm| {
            let is_beyond_closed =
                mm < -limits.overtravel_mm && step.contact.force_n() < limits.contact_n;
            is_beyond_closed || mm > constants::STROKE.value as f32 + limits.overtravel_mm
        });
        self.implausible_ms = next_ms(self.implausible_ms, is_implausible);
        if self.implausible_ms >= limits.overtravel_ms {
            let detail = (opening_mm.unwrap_or_default().abs() * 1e3) as u32;
            self.set(Fault::StrokeWrong, true, detail, outputs);
            outputs.opening_mm = Some(f32::NAN);
            self.implausible_ms = 0;
        }
    }

    /// Whether a fault, of other tasks as well, ends a calibration of the motor.
    pub(super) fn ends_calibration(&self, others: u32, settings: &GripSettings) -> bool {
        // The calibration itself reports a trip of the motor.
        let bits = (others | self.bits()) & !trip_bits();
        let worst = strongest_reaction(bits, GripPhase::Moving, settings.self_locking);
        worst.is_some_and(|(reaction, _)| reaction >= Reaction::QuickStop)
    }
}
