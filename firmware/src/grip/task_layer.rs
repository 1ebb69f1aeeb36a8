//! Task layer: execution of commands, and the events of each state.

use crate::config::limits::GripLimits;
use crate::fixed_point::Force;
use crate::grip::commands::{GripCommand, MoveTarget, RefusalReason, flag};
use crate::grip::debounce::next_ms;
use crate::grip::fault_reactions::{Reaction, strongest_reaction};
use crate::grip::force_controller::StiffnessEstimator;
use crate::grip::hold_current::HoldCurrent;
use crate::grip::homing::{Homing, HomingForces, HomingStep};
use crate::grip::setpoint::RELAX_BAND;
use crate::grip::slip_detector::{ObjectState, SlipDetector};
use crate::grip::stall_detector::StallDetector;
use crate::grip::states::{GripPhase, PowerState, TaskState};
use crate::grip::transitions::{self, PowerEvent, TaskEvent};
use crate::grip::{ControlInputs, ControlOutputs, GripController};
use crate::math::greater;
use crate::motor::{MotorState, MotorStatus};
use crate::protocol::messages::Command;
use crate::system::faults::Fault;

/// Stopping time of the fingers in seconds: openings are predicted by this much.
const LOOK_AHEAD_S: f32 = 0.004;
/// A self-locking screw holds alone at the latest after this multiple of [`crate::config::limits::GripLimits::lock_ms`], whatever
/// the force error.
const LATEST: u32 = 5;
/// Share of its current limit with which a move without believed forces is stalled.
const STALL_SHARE: f32 = 0.9;
/// Millimetres before the window at which a fast approach slows down.
const SLOW_DOWN_MM: f32 = 2.0;

impl GripController {
    /// Executes a command unless it repeats the last one.
    ///
    /// # Errors
    /// Why it is refused.
    pub(super) fn handle_command(
        &mut self,
        command: &Command,
        inputs: &ControlInputs,
    ) -> Result<(), RefusalReason> {
        let decoded = GripCommand::of(command, &self.limits)?;
        let received = (decoded, command.flags & flag::AGAIN != 0);
        if self.last_command == Some(received) {
            return Ok(());
        }
        match decoded {
            GripCommand::Enable => self.enable(inputs)?,
            GripCommand::Disable => self.disable()?,
            GripCommand::Release(_) if self.power == PowerState::Armed => {
                self.release_disabled(decoded, inputs)?;
            }
            _ if self.power != PowerState::Enabled => return Err(RefusalReason::NotEnabled),
            command => self.start_task(command, inputs)?,
        }
        self.last_command = Some(received);
        Ok(())
    }

    fn enable(&mut self, inputs: &ControlInputs) -> Result<(), RefusalReason> {
        match self.power {
            PowerState::Enabled => return Ok(()),
            PowerState::Armed => {}
            _ => return Err(RefusalReason::NotEnabled),
        }
        self.check_ready(GripPhase::Moving, inputs)?;
        if self.first_fault.cause().is_some() {
            return Err(RefusalReason::FaultLatched);
        }
        if self.apply_power_event(PowerEvent::Enable) {
            self.enter_task(match (inputs.motor.opening_mm, self.task, self.is_gripped) {
                // What rests on the fingertips is not known to have gone.
                (_, TaskState::Foot, _) => TaskState::Foot,
                (None, ..) => TaskState::Unhomed,
                (Some(_), _, true) => TaskState::GripFailed,
                (Some(_), _, false) => TaskState::Idle,
            });
            // The target of a motion that was interrupted: the fingers stay where they rest.
            self.hold_mm = None;
        }
        Ok(())
    }

    /// Conditions for the drive to be enabled for a phase.
    fn check_ready(&self, phase: GripPhase, inputs: &ControlInputs) -> Result<(), RefusalReason> {
        if self.is_stopped {
            return Err(RefusalReason::Stopped);
        }
        let bits = inputs.faults | self.faults.bits();
        let worst = strongest_reaction(bits, phase, self.self_locking);
        if worst.is_some_and(|(reaction, _)| reaction >= Reaction::QuickStop) {
            return Err(RefusalReason::FaultActive);
        }
        if inputs.motor.state != MotorState::Armed {
            return Err(RefusalReason::MotorNotReady);
        }
        Ok(())
    }

    /// Opens while a fault, active or latched, prevents enabling.
    fn release_disabled(
        &mut self,
        command: GripCommand,
        inputs: &ControlInputs,
    ) -> Result<(), RefusalReason> {
        self.check_ready(GripPhase::Releasing, inputs)?;
        if !inputs.host.is_alive {
            return Err(RefusalReason::NotEnabled);
        }
        self.start_task(command, inputs)?;
        self.apply_power_event(PowerEvent::Enable);
        Ok(())
    }

    fn disable(&mut self) -> Result<(), RefusalReason> {
        if self.power != PowerState::Enabled {
            return Ok(());
        }
        match self.task {
            task if task.moves() || task.holds() => Err(RefusalReason::of(task)),
            task @ (TaskState::GripFailed
            | TaskState::Stopping
            | TaskState::ContactStop
            | TaskState::Foot) => Err(RefusalReason::of(task)),
            _ => {
                self.apply_power_event(PowerEvent::Disable);
                Ok(())
            }
        }
    }

    fn start_task(
        &mut self,
        command: GripCommand,
        inputs: &ControlInputs,
    ) -> Result<(), RefusalReason> {
        let event = match command {
            GripCommand::Home => TaskEvent::Home,
            GripCommand::Move(_) => TaskEvent::Move,
            GripCommand::Grip(_) => TaskEvent::Grip,
            GripCommand::Release(_) => TaskEvent::Release,
            GripCommand::Stop => TaskEvent::Stop,
            GripCommand::Foot { .. } => TaskEvent::Foot,
            GripCommand::LeaveFoot => TaskEvent::LeaveFoot,
            GripCommand::Enable | GripCommand::Disable => return Ok(()),
        };
        let to = transitions::next_task_state(self.task, event)?;
        self.check_preconditions(command, to, &inputs.motor)?;
        let restarts = match command {
            GripCommand::Grip(target) => {
                self.target = target;
                self.setpoint_n = target.setpoint_n;
                true
            }
            GripCommand::Move(target) | GripCommand::Release(target) => {
                self.start_move(target, &inputs.motor);
                true
            }
            _ => false,
        };
        if to != self.task || restarts {
            self.enter_task(to);
        }
        Ok(())
    }

    /// Conditions for a command beyond the transition table.
    fn check_preconditions(
        &self,
        command: GripCommand,
        to: TaskState,
        motor: &MotorStatus,
    ) -> Result<(), RefusalReason> {
        let opening_mm = motor.opening_mm.unwrap_or_default();
        let is_homed = motor.opening_mm.is_some();
        let needs_force = matches!(command, GripCommand::Home | GripCommand::Grip(_));
        match command {
            _ if needs_force && self.is_blind() => Err(RefusalReason::Blind),
            GripCommand::Release(target) if is_homed && target.opening_mm <= opening_mm => {
                Err(RefusalReason::OutOfRange)
            }
            GripCommand::Foot { on_line } if to != self.task => {
                let [line_contact_mm, tolerance_mm] = self.limits.line_contact_mm;
                let is_parked = if on_line {
                    (opening_mm - line_contact_mm).abs() <= tolerance_mm
                } else {
                    opening_mm <= self.limits.flat_contact_mm
                };
                match (is_parked && self.is_at_rest(), self.ground_contact.is_unloaded) {
                    (false, _) => Err(RefusalReason::NotParked),
                    (true, false) => Err(RefusalReason::Loaded),
                    (true, true) => Ok(()),
                }
            }
            GripCommand::LeaveFoot if self.unloaded_ms < self.limits.unloaded_ms => {
                Err(RefusalReason::Loaded)
            }
            _ => Ok(()),
        }
    }

    fn start_move(&mut self, target: MoveTarget, motor: &MotorStatus) {
        self.move_target = target;
        self.is_opening = motor.opening_mm.is_none_or(|mm| target.opening_mm > mm);
    }

    /// Detects and applies the event of this millisecond.
    pub(super) fn update_task(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        self.slipping_ms = self.slipping_ms.saturating_sub(1);
        self.since_slip_ms = self.since_slip_ms.saturating_add(1);
        let is_slipping = self.slipping_ms > 0;
        let detail = (self.setpoint_n * Force::PER_NEWTON as f32) as u32;
        self.set_fault(Fault::Slipping, is_slipping, detail, outputs);
        let event = match self.task {
            task if task.moves() && !inputs.host.is_alive => Some(TaskEvent::HostTimeout),
            TaskState::Homing => self.home(inputs, outputs),
            TaskState::Moving => self.moving_event(inputs, outputs),
            TaskState::Approach => self.approach_event(inputs, outputs),
            TaskState::Releasing => self.releasing_event(inputs),
            TaskState::ContactStop | TaskState::Stopping => self.stopping_event(inputs),
            TaskState::Force | TaskState::HoldActive | TaskState::HoldLatched => {
                self.grip_event(inputs)
            }
            TaskState::HoldFrozen => {
                (self.valid_ms >= self.limits.valid_again_ms).then_some(TaskEvent::ForceRestored)
            }
            TaskState::Unhomed
            | TaskState::Idle
            | TaskState::NoObject
            | TaskState::GripFailed
            | TaskState::Lost
            | TaskState::Foot
            | TaskState::TimeoutHold => None,
        };
        if let Some(event) = event {
            self.apply_task_event(event, inputs.host.is_alive);
        }
        if self.hold_mm.is_none() && self.is_at_rest() {
            self.hold_mm = inputs.motor.opening_mm;
        }
    }

    pub(super) fn apply_task_event(&mut self, event: TaskEvent, is_host_alive: bool) {
        let Ok(to) = transitions::next_task_state(self.task, event) else {
            return;
        };
        match event {
            TaskEvent::Slipped => {
                let raised_n = self.setpoint_n * self.limits.slip_factor;
                let cap_n = self.limits.slip_cap * self.target.setpoint_n;
                // Never below the present one: without a host it is not raised.
                let cap_n = if is_host_alive { cap_n.min(self.target.cap_n) } else { 0.0 };
                self.setpoint_n = greater(raised_n.min(cap_n), self.setpoint_n);
                self.slipping_ms = self.limits.slip_pause_ms;
                self.since_slip_ms = 0;
            }
            TaskEvent::SlipEnded => self.setpoint_n = self.target.setpoint_n,
            TaskEvent::ForceDropped => {
                let [newest, second, _] = self.regrips_ms;
                self.regrips_ms = [Some(self.now_ms), newest, second];
            }
            _ => {}
        }
        self.enter_task(to);
    }

    pub(super) fn enter_task(&mut self, to: TaskState) {
        let from = self.task;
        (self.task, self.task_ms) = (to, 0);
        (self.in_band_ms, self.low_force_ms) = (0, 0);
        self.hold_mm = None;
        self.stall = StallDetector::default();
        self.hold = HoldCurrent::default();
        self.was_touching = self.contact.is_confirmed();
        match to {
            TaskState::Homing => self.homing = Homing::default(),
            TaskState::Approach => {
                self.stiffness = StiffnessEstimator::default();
                self.slip = SlipDetector::default();
                (self.is_gripped, self.has_settled) = (false, false);
            }
            TaskState::Force | TaskState::GripFailed => self.is_gripped = true,
            TaskState::HoldActive => self.has_settled = true,
            TaskState::Idle if matches!(from, TaskState::Moving | TaskState::Releasing) => {
                self.hold_mm = Some(self.move_target.opening_mm);
                (self.is_gripped, self.has_settled) = (false, false);
            }
            TaskState::Idle | TaskState::Lost | TaskState::NoObject => {
                (self.is_gripped, self.has_settled) = (false, false);
            }
            TaskState::Releasing => {
                self.has_settled = false;
                // A repeated command does not loosen the screw again.
                if from != TaskState::Releasing {
                    self.opening_ms = 0;
                }
            }
            _ => {}
        }
    }

    fn home(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) -> Option<TaskEvent> {
        let forces = HomingForces {
            closing_n: greater(self.force_n, self.rise_n),
            outward_n: self.fingers.outward_n(),
        };
        self.homing_step = self.homing.tick(&inputs.motor, forces, &self.limits);
        match self.homing_step {
            HomingStep::Drive(_) => None,
            HomingStep::Zeroed(opening_mm) => {
                outputs.opening_mm = Some(opening_mm);
                self.is_provisional = true;
                None
            }
            HomingStep::Homed => {
                self.is_provisional = false;
                Some(TaskEvent::Homed)
            }
            HomingStep::Stalled => {
                self.set_stall_fault(inputs, outputs);
                Some(TaskEvent::HomingFailed)
            }
            HomingStep::Failed(opening_mm) => {
                outputs.opening_mm = Some(f32::NAN);
                let detail = (opening_mm * 1e3) as u32;
                self.set_fault(Fault::StrokeWrong, true, detail, outputs);
                Some(TaskEvent::HomingFailed)
            }
        }
    }

    fn set_stall_fault(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        let current_ma = (inputs.motor.current.q.abs() * 1e3) as u32;
        self.set_fault(Fault::Jammed, true, current_ma, outputs);
    }

    /// Sets the fault of a stall; the fault's reaction stops in the next millisecond.
    fn check_stall(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        if self.stall.update(&inputs.motor, self.force_n, &self.limits) {
            self.set_stall_fault(inputs, outputs);
        }
    }

    /// Arrival at the move target, else a check for a stall.
    fn arrival_event(
        &mut self,
        inputs: &ControlInputs,
        outputs: &mut ControlOutputs,
    ) -> Option<TaskEvent> {
        if self.has_arrived(&inputs.motor) {
            return Some(TaskEvent::Reached);
        }
        self.check_stall(inputs, outputs);
        None
    }

    fn has_arrived(&self, motor: &MotorStatus) -> bool {
        let reached_mm = self.limits.reached_mm;
        let target_mm = self.move_target.opening_mm;
        let is_near = |mm: f32| (mm - target_mm).abs() <= reached_mm;
        motor.opening_mm.is_some_and(is_near) && self.is_at_rest()
    }

    fn moving_event(
        &mut self,
        inputs: &ControlInputs,
        outputs: &mut ControlOutputs,
    ) -> Option<TaskEvent> {
        if self.move_target.is_uncalibrated {
            return self.uncalibrated_event(&inputs.motor);
        }
        if self.is_opening {
            if self.presses_outward() {
                return Some(TaskEvent::Contact);
            }
        } else if self.has_new_contact() || self.force_n.max(self.rise_n) > self.limits.move_n {
            return Some(TaskEvent::Contact);
        }
        self.arrival_event(inputs, outputs)
    }

    /// Arrival of a move without believed forces, or an obstacle: the current is at its limit, and nothing moves.
    fn uncalibrated_event(&mut self, motor: &MotorStatus) -> Option<TaskEvent> {
        let (_, max_a) = self.uncalibrated_limits(motor);
        let limits = GripLimits { stall_a: STALL_SHARE * max_a, ..self.limits };
        if self.has_arrived(motor) {
            Some(TaskEvent::Reached)
        } else {
            self.stall.update(motor, 0.0, &limits).then_some(TaskEvent::Contact)
        }
    }

    /// Whether a contact began after the state was entered: an offset of the sensors is none.
    fn has_new_contact(&mut self) -> bool {
        let in_contact = self.contact.is_confirmed();
        self.was_touching &= in_contact;
        in_contact && !self.was_touching
    }

    fn presses_outward(&self) -> bool {
        self.fingers.outward_n().is_some_and(|outward_n| outward_n > self.limits.outward_n)
    }

    /// Arrival at the target, or an obstacle around the fingers. Without valid forces, the current indicates it: it decreases
    /// while a load is released, and increases against an obstacle.
    fn releasing_event(&mut self, inputs: &ControlInputs) -> Option<TaskEvent> {
        let motor = &inputs.motor;
        let reached_mm = self.limits.reached_mm;
        let target_mm = self.move_target.opening_mm;
        let has_arrived = motor.opening_mm.is_some_and(|mm| mm >= target_mm - reached_mm);
        if has_arrived && self.is_at_rest() {
            return Some(TaskEvent::Reached);
        }
        self.opening_ms = self.opening_ms.saturating_add(1);
        let is_loosening = self.opening_ms < self.limits.loosening_ms;
        let is_stalled = !is_loosening && self.stall.update(motor, 0.0, &self.limits);
        let is_blocked = if self.opens_blind() {
            // A load that turns a backdrivable screw makes the motor brake: no obstacle.
            let opening_a = greater(self.opening_a, 0.0);
            let meets_obstacle =
                !is_loosening && self.current_rise.update(opening_a) > self.limits.blind_rise_a;
            if meets_obstacle || is_stalled {
                self.obstacle_rad.get_or_insert(motor.rotor_rad);
            }
            // Repeated openings would each press harder.
            self.obstacle_rad.is_some_and(|obstacle_rad| motor.rotor_rad <= obstacle_rad)
        } else {
            self.presses_outward()
        };
        let is_late = self.task_ms >= self.limits.release_ms;
        match motor.opening_mm {
            // The end of the stroke, as far as is known.
            None if is_blocked || is_stalled || is_late => Some(TaskEvent::ReachedUnhomed),
            _ if is_blocked || is_stalled || is_late => Some(TaskEvent::Contact),
            _ => None,
        }
    }

    /// Whether the fingers open without valid forces.
    pub(super) const fn opens_blind(&self) -> bool {
        self.invalid_ticks > 0
    }

    fn approach_event(
        &mut self,
        inputs: &ControlInputs,
        outputs: &mut ControlOutputs,
    ) -> Option<TaskEvent> {
        let motor = &inputs.motor;
        let opening_mm = motor.opening_mm?;
        let window = self.target.window;
        let is_pressed = self.was_touching && self.rise_n > 2.0 * self.limits.contact_n;
        if !is_pressed && self.rise_n > self.limits.move_n && !self.contact.is_suspected() {
            // The fingers press, but the forces have a large offset: no force could be controlled.
            return Some(TaskEvent::Failed);
        }
        if self.has_new_contact() || is_pressed {
            let is_too_wide = window.is_some_and(|window| opening_mm > window.max_mm);
            return Some(if is_too_wide { TaskEvent::Failed } else { TaskEvent::Contact });
        }
        let min_mm = window.map_or(self.limits.fingers_met_mm, |window| {
            window.min_mm.max(self.limits.fingers_met_mm)
        });
        if opening_mm - LOOK_AHEAD_S * motor.closing_mm_s <= min_mm {
            return Some(TaskEvent::NoObject);
        }
        if self.task_ms >= self.limits.approach_ms {
            return Some(TaskEvent::Failed);
        }
        self.check_stall(inputs, outputs);
        None
    }

    /// Whether a fast approach is still far from the width window.
    pub(super) fn is_far_from_window(&self, motor: &MotorStatus) -> bool {
        let window = self.target.window.filter(|_| self.target.is_fast);
        window.is_some_and(|window| {
            let opening_mm = motor.opening_mm.unwrap_or_default();
            opening_mm - LOOK_AHEAD_S * motor.closing_mm_s > window.max_mm + SLOW_DOWN_MM
        })
    }

    fn stopping_event(&self, inputs: &ControlInputs) -> Option<TaskEvent> {
        let is_over = self.is_at_rest() || self.task_ms >= self.limits.stop_ms;
        let is_releasing = self.is_gripped && self.task == TaskState::Stopping;
        let event = match (inputs.motor.opening_mm, inputs.host.is_alive) {
            (None, _) => TaskEvent::StoppedUnhomed,
            // The object may still be held.
            (Some(_), _) if is_releasing => TaskEvent::StoppedReleasing,
            (Some(_), true) => TaskEvent::Stopped,
            (Some(_), false) => TaskEvent::StoppedWithoutHost,
        };
        is_over.then_some(event)
    }

    fn grip_event(&mut self, inputs: &ControlInputs) -> Option<TaskEvent> {
        if self.is_blind() {
            return Some(TaskEvent::ForceLost);
        }
        if self.invalid_ticks > 0 {
            return None;
        }
        // Before the force has settled, closing is expected and no sign of a lost object.
        let closing_mm_s = if self.has_settled { inputs.motor.closing_mm_s } else { 0.0 };
        let object = match self.task == TaskState::Force && !self.has_settled {
            true if self.contact.is_confirmed() => ObjectState::Held,
            true => ObjectState::Lost,
            false => {
                let setpoint = (self.setpoint_n, closing_mm_s);
                self.slip.update(&self.fingers, setpoint, &self.limits)
            }
        };
        match object {
            ObjectState::Lost => Some(TaskEvent::ObjectLost),
            ObjectState::Slipping => Some(TaskEvent::Slipped),
            ObjectState::Held => self.force_event(),
        }
    }

    fn force_event(&mut self) -> Option<TaskEvent> {
        let limits = &self.limits;
        let error_n = self.setpoint_n - self.force_n;
        let band_n = limits.tolerance_n.max(limits.tolerance_ratio * self.setpoint_n);
        self.in_band_ms = next_ms(self.in_band_ms, error_n.abs() < band_n);
        let drop_n = limits.force_loss_n.max(limits.force_loss_ratio * self.setpoint_n);
        self.low_force_ms = next_ms(self.low_force_ms, error_n > drop_n);
        match self.task {
            TaskState::Force if self.in_band_ms >= limits.settle_ms => Some(TaskEvent::Settled),
            TaskState::Force if self.task_ms >= limits.grip_ms => Some(TaskEvent::Failed),
            TaskState::HoldActive | TaskState::HoldLatched
                if self.setpoint_n > self.target.setpoint_n
                    && self.since_slip_ms >= limits.slip_return_ms =>
            {
                Some(TaskEvent::SlipEnded)
            }
            TaskState::HoldActive if self.may_release_current() => Some(TaskEvent::ReleaseCurrent),
            TaskState::HoldLatched if self.low_force_ms >= limits.force_loss_ms => {
                Some(TaskEvent::ForceDropped)
            }
            _ => None,
        }
    }

    /// Whether the screw may hold alone: it is self-locking, and the force has not dropped too often lately.
    pub(super) fn may_release_current(&self) -> bool {
        let all = self.regrips_ms.iter().flatten();
        let recent = all.filter(|at_ms| self.now_ms.wrapping_sub(**at_ms) < self.limits.regrip_ms);
        let is_spent = recent.count() >= usize::from(self.limits.regrips);
        let deadband_n = self.limits.deadband_n.max(self.limits.deadband_ratio * self.setpoint_n);
        let is_near = (self.setpoint_n - self.mean_n).abs() < RELAX_BAND * deadband_n;
        let is_late = self.task_ms >= LATEST * self.limits.lock_ms;
        let is_due = self.task_ms >= self.limits.lock_ms && (is_near || is_late);
        self.self_locking && !is_spent && is_due && self.in_band_ms > 0
    }
}
