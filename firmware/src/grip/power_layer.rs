//! Power layer: session, arming and enabling, and the reactions to faults.

use crate::grip::commands::{GripCommand, RefusalReason, flag};
use crate::grip::fault_monitor::FaultMonitor;
use crate::grip::fault_reactions::{FirstFault, Reaction, is_active, strongest_reaction};
use crate::grip::hold_current::MARGIN;
use crate::grip::interface::{ArmingRequest, ControlInputs, ControlOutputs};
use crate::grip::states::{GripPhase, PowerState, TaskState, state_code};
use crate::grip::step::GripStep;
use crate::grip::task_layer::TaskLayer;
use crate::grip::task_layer::setpoint::{STOP, back_off, holding_a};
use crate::grip::transitions::{self, PowerEvent};
use crate::motor::{MotorState, Setpoint};
use crate::protocol::messages::Command;
use crate::system::faults::Fault;

/// Milliseconds for which a host's clear is in effect: a motor trip ends only once the motor is disarmed.
const CLEARING_MS: u8 = 5;

/// State of the power layer.
#[derive(Clone, Debug)]
pub(super) struct PowerLayer {
    state: PowerState,
    state_ms: u32,
    /// Last executed command and its repeat flag.
    last_command: Option<(GripCommand, bool)>,
    /// Reaction to the latched fault.
    reaction: Reaction,
    /// The fingers reduce an excessive force.
    backs_off: bool,
    /// A stop frame arrived, and no host has cleared it at rest since.
    is_stopped: bool,
    clearing_ms: u8,
}

impl Default for PowerLayer {
    fn default() -> Self {
        Self {
            state: PowerState::Boot,
            state_ms: 0,
            last_command: None,
            reaction: Reaction::Warn,
            backs_off: false,
            is_stopped: false,
            clearing_ms: 0,
        }
    }
}

impl PowerLayer {
    pub(super) const fn state(&self) -> PowerState {
        self.state
    }

    pub(super) const fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// Bits of [`super::redundant_copy`].
    pub(super) const fn copy_word(&self) -> u32 {
        self.state as u32 | (self.reaction as u32) << 16 | (self.backs_off as u32) << 27
    }

    /// Reacts to faults and to the session, and advances the state.
    pub(super) fn update(
        &mut self,
        step: GripStep,
        task: &mut TaskLayer,
        faults: &mut FaultMonitor,
        outputs: &mut ControlOutputs,
    ) {
        let GripStep { inputs, contact, settings, .. } = step;
        self.state_ms = self.state_ms.saturating_add(1);
        let bits = inputs.faults | faults.bits();
        self.clearing_ms =
            if inputs.clear { CLEARING_MS } else { self.clearing_ms.saturating_sub(1) };
        if self.is_clearing() {
            faults.clear_first(bits);
        }
        self.react(bits, step, task, faults);
        if inputs.stop {
            self.is_stopped = true;
            self.apply(PowerEvent::QuickStop, step, task);
        } else if inputs.clear
            && self.state != PowerState::QuickStop
            && contact.is_at_rest(settings)
        {
            self.is_stopped = false;
        }
        // Only opening is allowed while a fault is latched.
        if faults.is_latched()
            && self.state == PowerState::Enabled
            && task.state() != TaskState::Releasing
        {
            self.apply(PowerEvent::QuickStop, step, task);
        }
        if let Some(event) = self.next_event(step, task, faults) {
            self.apply(event, step, task);
        }
        let is_off = matches!(self.state, PowerState::FaultReaction | PowerState::Fault);
        let has_severe_fault = strongest_reaction(bits, GripPhase::Moving, settings.self_locking)
            .is_some_and(|(reaction, _)| reaction > Reaction::QuickStop);
        let is_unsound = is_active(bits, Fault::TablesUnsound) || inputs.is_sound != Some(true);
        outputs.may_arm = !(is_off || has_severe_fault || is_unsound || inputs.is_calibrating);
        outputs.arming = self.arming_request(inputs);
    }

    const fn arming_request(&self, inputs: &ControlInputs) -> Option<ArmingRequest> {
        match (self.state, inputs.motor.state) {
            (PowerState::Armed, MotorState::Disarmed) => Some(ArmingRequest::Arm),
            // The shorted windings let a load on a backdrivable screw down slowly.
            (PowerState::Fault, _)
                if matches!(self.reaction, Reaction::Brake) && !self.is_clearing() =>
            {
                None
            }
            (
                PowerState::Safe | PowerState::Fault,
                MotorState::Arming | MotorState::Armed | MotorState::Tripped(_),
            ) => Some(ArmingRequest::Disarm),
            _ => None,
        }
    }

    const fn is_clearing(&self) -> bool {
        self.clearing_ms > 0
    }

    /// Carries out the reaction to the worst active fault and latches the first fault.
    fn react(
        &mut self,
        bits: u32,
        step: GripStep,
        task: &mut TaskLayer,
        faults: &mut FaultMonitor,
    ) {
        let phase = match self.state {
            PowerState::Enabled => task.phase(),
            _ if task.is_gripped() => GripPhase::Holding,
            _ => GripPhase::Moving,
        };
        let Some((reaction, fault)) = strongest_reaction(bits, phase, step.settings.self_locking)
        else {
            return;
        };
        let event = match (reaction, self.state) {
            (Reaction::Warn | Reaction::Hold, _) => return,
            (Reaction::QuickStop, PowerState::Enabled) => PowerEvent::QuickStop,
            (Reaction::QuickStop, _) => return,
            (Reaction::Brake | Reaction::Off, _) => PowerEvent::Fault,
        };
        let state = state_code(self.state, task.state());
        if self.apply(event, step, task) {
            self.reaction = reaction;
            self.backs_off = fault == Fault::OverForce;
            faults.record(FirstFault { fault, state, at_ms: step.now_ms });
        }
    }

    /// The event that follows from the session, the self-test, or the end of the present state.
    fn next_event(
        &self,
        step: GripStep,
        task: &TaskLayer,
        faults: &FaultMonitor,
    ) -> Option<PowerEvent> {
        let GripStep { inputs, settings, .. } = step;
        let host = &inputs.host;
        match self.state {
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
            PowerState::Armed => (!host.is_open && (settings.self_locking || !task.is_loaded()))
                .then_some(PowerEvent::SessionClosed),
            PowerState::Enabled => None,
            PowerState::QuickStop => self.has_stopped(step).then_some(PowerEvent::Stopped),
            PowerState::FaultReaction => {
                let is_over =
                    self.has_come_to_rest(step) || self.state_ms >= settings.limits.stop_ms;
                is_over.then_some(PowerEvent::ReactionDone)
            }
            PowerState::Fault => {
                let is_gone = !faults.is_latched() && inputs.is_sound == Some(true);
                (self.is_clearing() && is_gone).then_some(PowerEvent::Cleared)
            }
        }
    }

    /// Whether the fingers have rested since the state began.
    fn has_come_to_rest(&self, step: GripStep) -> bool {
        let resting_ms = u32::from(step.settings.limits.resting_ms);
        step.contact.is_at_rest(step.settings) && self.state_ms >= resting_ms
    }

    fn has_stopped(&self, step: GripStep) -> bool {
        let limits = &step.settings.limits;
        let has_backed_off =
            !self.backs_off || step.contact.force_n() < 1.2 * limits.overforce_release_n;
        let limit_ms = if self.backs_off { limits.back_off_ms } else { limits.stop_ms };
        (self.has_come_to_rest(step) && has_backed_off) || self.state_ms >= limit_ms
    }

    /// Applies an event; whether the table lists a transition.
    fn apply(&mut self, event: PowerEvent, step: GripStep, task: &mut TaskLayer) -> bool {
        let Some(to) = transitions::next_power_state(self.state, event) else {
            return false;
        };
        if self.state == PowerState::Enabled {
            // A repeated RELEASE, which needs no ENABLE, must not start again.
            let is_release =
                |command: &(GripCommand, bool)| matches!(command, (GripCommand::Release(_), _));
            self.last_command = self.last_command.filter(is_release);
        }
        task.on_power_state(to, step.settings.self_locking);
        (self.state, self.state_ms) = (to, 0);
        true
    }

    /// Executes a command unless it repeats the last one.
    ///
    /// # Errors
    /// Why it is refused.
    pub(super) fn handle_command(
        &mut self,
        command: &Command,
        step: GripStep,
        task: &mut TaskLayer,
        faults: &FaultMonitor,
    ) -> Result<(), RefusalReason> {
        let decoded = GripCommand::of(command, &step.settings.limits)?;
        let received = (decoded, command.flags & flag::AGAIN != 0);
        if self.last_command == Some(received) {
            return Ok(());
        }
        match decoded {
            GripCommand::Enable => self.enable(step, task, faults)?,
            GripCommand::Disable => self.disable(step, task)?,
            GripCommand::Release(_) if self.state == PowerState::Armed => {
                // Opens while a fault, active or latched, prevents enabling.
                self.check_ready(GripPhase::Releasing, step, faults)?;
                if !step.inputs.host.is_alive {
                    return Err(RefusalReason::NotEnabled);
                }
                task.start(decoded, step)?;
                self.apply(PowerEvent::Enable, step, task);
            }
            _ if self.state != PowerState::Enabled => return Err(RefusalReason::NotEnabled),
            command => task.start(command, step)?,
        }
        self.last_command = Some(received);
        Ok(())
    }

    fn enable(
        &mut self,
        step: GripStep,
        task: &mut TaskLayer,
        faults: &FaultMonitor,
    ) -> Result<(), RefusalReason> {
        match self.state {
            PowerState::Enabled => return Ok(()),
            PowerState::Armed => {}
            _ => return Err(RefusalReason::NotEnabled),
        }
        self.check_ready(GripPhase::Moving, step, faults)?;
        if faults.is_latched() {
            return Err(RefusalReason::FaultLatched);
        }
        if self.apply(PowerEvent::Enable, step, task) {
            task.resume(step);
        }
        Ok(())
    }

    /// Conditions for the drive to be enabled for a phase.
    fn check_ready(
        &self,
        phase: GripPhase,
        step: GripStep,
        faults: &FaultMonitor,
    ) -> Result<(), RefusalReason> {
        if self.is_stopped {
            return Err(RefusalReason::Stopped);
        }
        let bits = step.inputs.faults | faults.bits();
        let worst = strongest_reaction(bits, phase, step.settings.self_locking);
        if worst.is_some_and(|(reaction, _)| reaction >= Reaction::QuickStop) {
            return Err(RefusalReason::FaultActive);
        }
        if step.inputs.motor.state != MotorState::Armed {
            return Err(RefusalReason::MotorNotReady);
        }
        Ok(())
    }

    fn disable(&mut self, step: GripStep, task: &mut TaskLayer) -> Result<(), RefusalReason> {
        if self.state != PowerState::Enabled {
            return Ok(());
        }
        match task.state() {
            task if task.moves() || task.holds() => Err(RefusalReason::of(task)),
            task @ (TaskState::GripFailed
            | TaskState::Stopping
            | TaskState::ContactStop
            | TaskState::Foot) => Err(RefusalReason::of(task)),
            _ => {
                self.apply(PowerEvent::Disable, step, task);
                Ok(())
            }
        }
    }

    /// Motor set-point of the present state.
    pub(super) fn setpoint(&self, step: GripStep, task: &mut TaskLayer) -> Setpoint {
        match self.state {
            PowerState::Boot
            | PowerState::SelfTest
            | PowerState::Safe
            | PowerState::ArmPending
            | PowerState::Calibrating => Setpoint::Off,
            PowerState::Armed if task.state() == TaskState::Foot => task.hold_foot(step),
            PowerState::Armed if task.is_gripped() && !step.settings.self_locking => {
                task.hold_position(step, task.hold_a().max(holding_a(step) * MARGIN))
            }
            PowerState::Armed => Setpoint::Off,
            PowerState::QuickStop if task.state() == TaskState::Foot => task.hold_foot(step),
            // The stiffness of what causes the excessive force is unknown.
            PowerState::QuickStop if self.backs_off => back_off(step),
            PowerState::QuickStop => STOP,
            PowerState::FaultReaction | PowerState::Fault => match self.reaction {
                Reaction::Brake => Setpoint::Brake,
                _ => Setpoint::Off,
            },
            PowerState::Enabled => task.setpoint(step),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copy_word_differs_for_each_state_reaction_and_flag() {
        let power = PowerLayer::default();
        let word = |change: &dyn Fn(&mut PowerLayer)| {
            let mut changed = power.clone();
            change(&mut changed);
            changed.copy_word()
        };
        for state in PowerState::ALL.iter().filter(|state| **state != power.state) {
            assert_ne!(word(&|power| power.state = *state), power.copy_word(), "{state:?}");
        }
        assert_ne!(word(&|power| power.reaction = Reaction::Off), power.copy_word());
        assert_ne!(word(&|power| power.backs_off = true), power.copy_word());
    }
}
