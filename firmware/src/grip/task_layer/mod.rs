//! Task layer: what the fingers do while the drive is enabled. Commands and the events of each state.

mod blind_opening;
mod grasp;
pub(super) mod setpoint;

use crate::config::limits::GripLimits;
use crate::grip::COPY_WORDS;
use crate::grip::commands::{GripCommand, MoveTarget, RefusalReason};
use crate::grip::fault_monitor::FaultMonitor;
use crate::grip::hold_current::HoldCurrent;
use crate::grip::homing::{Homing, HomingForces, HomingStep};
use crate::grip::interface::ControlOutputs;
use crate::grip::stall_detector::StallDetector;
use crate::grip::states::{GripPhase, PowerState, TaskState};
use crate::grip::step::GripStep;
use crate::grip::task_layer::blind_opening::BlindOpening;
use crate::grip::task_layer::grasp::Grasp;
use crate::grip::transitions::{self, TaskEvent};
use crate::math::greater;
use crate::motor::{MotorStatus, Setpoint};
use crate::system::faults::Fault;

/// Stopping time of the fingers in seconds: openings are predicted by this much.
const LOOK_AHEAD_S: f32 = 0.004;
/// Share of its current limit with which a move without believed forces is stalled.
const STALL_SHARE: f32 = 0.9;
/// Millimetres before the window at which a fast approach slows down.
const SLOW_DOWN_MM: f32 = 2.0;

/// State of the task layer.
#[derive(Clone, Debug)]
pub(super) struct TaskLayer {
    state: TaskState,
    state_ms: u32,
    move_target: MoveTarget,
    is_opening: bool,
    /// The fingers were in contact when the state was entered, and still are.
    was_touching: bool,
    grasp: Grasp,
    blind: BlindOpening,
    homing: Homing,
    homing_step: HomingStep,
    /// The opening was set by a homing that has not found the far end yet.
    is_provisional: bool,
    stall: StallDetector,
    /// Last current while holding, in amperes.
    hold_a: f32,
    hold: HoldCurrent,
    /// Position to be held in millimetres; none until the fingers rest.
    hold_mm: Option<f32>,
}

impl Default for TaskLayer {
    fn default() -> Self {
        Self {
            state: TaskState::Unhomed,
            state_ms: 0,
            move_target: MoveTarget::default(),
            is_opening: false,
            was_touching: false,
            grasp: Grasp::default(),
            blind: BlindOpening::default(),
            homing: Homing::default(),
            homing_step: HomingStep::Drive(Setpoint::Off),
            is_provisional: false,
            stall: StallDetector::default(),
            hold_a: 0.0,
            hold: HoldCurrent::default(),
            hold_mm: None,
        }
    }
}

impl TaskLayer {
    pub(super) const fn state(&self) -> TaskState {
        self.state
    }

    /// Column of the reaction table.
    pub(super) const fn phase(&self) -> GripPhase {
        self.state.phase(self.grasp.has_settled)
    }

    /// An object is, or may be, between the fingers.
    pub(super) const fn is_gripped(&self) -> bool {
        self.grasp.is_gripped
    }

    /// Whether an object is, or may be, gripped, or the gripper is a foot.
    pub(super) const fn is_loaded(&self) -> bool {
        self.grasp.is_gripped || matches!(self.state, TaskState::Foot)
    }

    /// Whether the last move opens.
    pub(super) const fn is_opening(&self) -> bool {
        self.is_opening
    }

    /// Estimated contact stiffness in N/mm.
    pub(super) const fn stiffness(&self) -> f32 {
        self.grasp.stiffness.value()
    }

    /// Last current while holding, in amperes.
    pub(super) const fn hold_a(&self) -> f32 {
        self.hold_a
    }

    /// Words of [`super::redundant_copy`].
    pub(super) fn copy_words(&self) -> [u32; COPY_WORDS] {
        let bit = |place: u32, is_set: bool| u32::from(is_set) << place;
        let hold_mm = self.hold_mm.unwrap_or_default();
        [
            (self.state as u32) << 8
                | bit(25, self.grasp.is_gripped)
                | bit(26, self.grasp.has_settled)
                | bit(28, self.is_opening)
                | bit(29, self.hold_mm.is_some()),
            self.grasp.setpoint_n.to_bits(),
            self.grasp.target.setpoint_n.to_bits(),
            self.grasp.target.cap_n.to_bits(),
            self.grasp.target.max_mm_s.to_bits(),
            // A single bit error in either value changes the combination.
            self.move_target.opening_mm.to_bits() ^ hold_mm.to_bits(),
            self.move_target.speed_mm_s.to_bits(),
            self.hold_a.to_bits(),
        ]
    }

    /// Flips a bit of one of the words from the second on, for simulations.
    pub(super) fn flip_bit(&mut self, bit: u32) {
        let value = match bit / 32 {
            1 => &mut self.grasp.setpoint_n,
            2 => &mut self.grasp.target.setpoint_n,
            3 => &mut self.grasp.target.cap_n,
            4 => &mut self.grasp.target.max_mm_s,
            5 => &mut self.move_target.opening_mm,
            6 => &mut self.move_target.speed_mm_s,
            _ => &mut self.hold_a,
        };
        *value = f32::from_bits(value.to_bits() ^ (1 << (bit % 32)));
    }

    /// Begins a millisecond, also while the drive is not enabled.
    pub(super) fn observe(&mut self, step: GripStep) {
        self.state_ms = self.state_ms.saturating_add(1);
        self.grasp.observe(step, self.state);
        self.blind.observe(step);
    }

    /// The power layer enters a state.
    pub(super) fn on_power_state(&mut self, to: PowerState, self_locking: bool) {
        if matches!(to, PowerState::QuickStop | PowerState::Armed) {
            self.hold_mm = None;
        }
        if matches!(to, PowerState::Safe | PowerState::Fault) {
            // The motor is off: only a self-locking screw still holds the object.
            self.grasp.is_gripped &= self_locking;
        }
    }

    /// Whether the opening that a homing has set becomes unknown, since the homing has not found the far end.
    pub(super) fn withdraws_opening(&mut self, is_enabled: bool) -> bool {
        let is_homing = is_enabled && self.state == TaskState::Homing;
        let withdraws = self.is_provisional && !is_homing;
        self.is_provisional &= is_homing;
        withdraws
    }

    /// First state after the drive is enabled.
    pub(super) fn resume(&mut self, step: GripStep) {
        let opening_mm = step.inputs.motor.opening_mm;
        let to = match (opening_mm, self.state, self.grasp.is_gripped) {
            // What rests on the fingertips is not known to have gone.
            (_, TaskState::Foot, _) => TaskState::Foot,
            (None, ..) => TaskState::Unhomed,
            (Some(_), _, true) => TaskState::GripFailed,
            (Some(_), _, false) => TaskState::Idle,
        };
        self.enter(to, step);
        // The target of a motion that was interrupted: the fingers stay where they rest.
        self.hold_mm = None;
    }

    /// Starts a command of the task layer.
    ///
    /// # Errors
    /// Why it is refused.
    pub(super) fn start(
        &mut self,
        command: GripCommand,
        step: GripStep,
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
        let to = transitions::next_task_state(self.state, event)?;
        self.check_preconditions(command, to, step)?;
        let restarts = match command {
            GripCommand::Grip(target) => {
                self.grasp.request(target);
                true
            }
            GripCommand::Move(target) | GripCommand::Release(target) => {
                let opening_mm = step.inputs.motor.opening_mm;
                self.move_target = target;
                self.is_opening = opening_mm.is_none_or(|mm| target.opening_mm > mm);
                true
            }
            _ => false,
        };
        if to != self.state || restarts {
            self.enter(to, step);
        }
        Ok(())
    }

    /// Conditions for a command beyond the transition table.
    fn check_preconditions(
        &self,
        command: GripCommand,
        to: TaskState,
        step: GripStep,
    ) -> Result<(), RefusalReason> {
        let GripStep { inputs, contact, settings, .. } = step;
        let opening_mm = inputs.motor.opening_mm.unwrap_or_default();
        let is_homed = inputs.motor.opening_mm.is_some();
        let needs_force = matches!(command, GripCommand::Home | GripCommand::Grip(_));
        match command {
            _ if needs_force && contact.is_blind(settings) => Err(RefusalReason::Blind),
            GripCommand::Release(target) if is_homed && target.opening_mm <= opening_mm => {
                Err(RefusalReason::OutOfRange)
            }
            GripCommand::Foot { on_line } if to != self.state => {
                let [line_contact_mm, tolerance_mm] = settings.limits.line_contact_mm;
                let is_parked = if on_line {
                    (opening_mm - line_contact_mm).abs() <= tolerance_mm
                } else {
                    opening_mm <= settings.limits.flat_contact_mm
                };
                match (is_parked && contact.is_at_rest(settings), contact.ground().is_unloaded) {
                    (false, _) => Err(RefusalReason::NotParked),
                    (true, false) => Err(RefusalReason::Loaded),
                    (true, true) => Ok(()),
                }
            }
            GripCommand::LeaveFoot if !contact.is_unloaded(settings) => Err(RefusalReason::Loaded),
            _ => Ok(()),
        }
    }

    /// Detects and applies the event of this millisecond.
    pub(super) fn update(
        &mut self,
        step: GripStep,
        faults: &mut FaultMonitor,
        outputs: &mut ControlOutputs,
    ) {
        let GripStep { inputs, contact, settings, .. } = step;
        let (is_slipping, detail) = self.grasp.slipping();
        faults.set(Fault::Slipping, is_slipping, detail, outputs);
        let event = match self.state {
            task if task.moves() && !inputs.host.is_alive => Some(TaskEvent::HostTimeout),
            TaskState::Homing => self.homing_event(step, faults, outputs),
            TaskState::Moving => self.moving_event(step, faults, outputs),
            TaskState::Approach => self.approach_event(step, faults, outputs),
            TaskState::Releasing => self.releasing_event(step),
            TaskState::ContactStop | TaskState::Stopping => self.stopping_event(step),
            TaskState::Force | TaskState::HoldActive | TaskState::HoldLatched => {
                self.grasp.event(step, (self.state, self.state_ms))
            }
            TaskState::HoldFrozen => (contact.valid_ms() >= settings.limits.valid_again_ms)
                .then_some(TaskEvent::ForceRestored),
            TaskState::Unhomed
            | TaskState::Idle
            | TaskState::NoObject
            | TaskState::GripFailed
            | TaskState::Lost
            | TaskState::Foot
            | TaskState::TimeoutHold => None,
        };
        if let Some(event) = event
            && let Ok(to) = transitions::next_task_state(self.state, event)
        {
            self.grasp.apply(event, step);
            self.enter(to, step);
        }
        if self.hold_mm.is_none() && contact.is_at_rest(settings) {
            self.hold_mm = inputs.motor.opening_mm;
        }
    }

    fn enter(&mut self, to: TaskState, step: GripStep) {
        let from = self.state;
        (self.state, self.state_ms) = (to, 0);
        self.stall = StallDetector::default();
        self.hold = HoldCurrent::default();
        self.was_touching = step.contact.detector().is_confirmed();
        self.grasp.enter(to);
        let has_moved = matches!(from, TaskState::Moving | TaskState::Releasing);
        self.hold_mm = (to == TaskState::Idle && has_moved).then_some(self.move_target.opening_mm);
        match to {
            TaskState::Homing => self.homing = Homing::default(),
            TaskState::Releasing if from != TaskState::Releasing => self.blind.begin(),
            _ => {}
        }
    }

    fn homing_event(
        &mut self,
        step: GripStep,
        faults: &mut FaultMonitor,
        outputs: &mut ControlOutputs,
    ) -> Option<TaskEvent> {
        let GripStep { inputs, contact, settings, .. } = step;
        let forces = HomingForces {
            closing_n: greater(contact.force_n(), contact.rise_n()),
            outward_n: contact.fingers().outward_n(),
        };
        self.homing_step = self.homing.tick(&inputs.motor, forces, &settings.limits);
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
                set_stall_fault(&inputs.motor, faults, outputs);
                Some(TaskEvent::HomingFailed)
            }
            HomingStep::Failed(opening_mm) => {
                outputs.opening_mm = Some(f32::NAN);
                faults.set(Fault::StrokeWrong, true, (opening_mm * 1e3) as u32, outputs);
                Some(TaskEvent::HomingFailed)
            }
        }
    }

    /// Sets the fault of a stall; the fault's reaction stops in the next millisecond.
    fn check_stall(
        &mut self,
        step: GripStep,
        faults: &mut FaultMonitor,
        outputs: &mut ControlOutputs,
    ) {
        let motor = &step.inputs.motor;
        if self.stall.update(motor, step.contact.force_n(), &step.settings.limits) {
            set_stall_fault(motor, faults, outputs);
        }
    }

    fn has_arrived(&self, step: GripStep) -> bool {
        let reached_mm = step.settings.limits.reached_mm;
        let target_mm = self.move_target.opening_mm;
        let is_near = |mm: f32| (mm - target_mm).abs() <= reached_mm;
        step.inputs.motor.opening_mm.is_some_and(is_near) && step.contact.is_at_rest(step.settings)
    }

    fn moving_event(
        &mut self,
        step: GripStep,
        faults: &mut FaultMonitor,
        outputs: &mut ControlOutputs,
    ) -> Option<TaskEvent> {
        let GripStep { contact, settings, .. } = step;
        if self.move_target.is_uncalibrated {
            return self.uncalibrated_event(step);
        }
        let is_blocked = if self.is_opening {
            contact.presses_outward(settings)
        } else {
            self.has_new_contact(step)
                || contact.force_n().max(contact.rise_n()) > settings.limits.move_n
        };
        if is_blocked {
            return Some(TaskEvent::Contact);
        }
        if self.has_arrived(step) {
            return Some(TaskEvent::Reached);
        }
        self.check_stall(step, faults, outputs);
        None
    }

    /// Arrival of a move without believed forces, or an obstacle: the current is at its limit, and nothing moves.
    fn uncalibrated_event(&mut self, step: GripStep) -> Option<TaskEvent> {
        let (_, max_a) = self.uncalibrated_limits(step);
        let limits = GripLimits { stall_a: STALL_SHARE * max_a, ..step.settings.limits };
        if self.has_arrived(step) {
            Some(TaskEvent::Reached)
        } else {
            let is_stalled = self.stall.update(&step.inputs.motor, 0.0, &limits);
            is_stalled.then_some(TaskEvent::Contact)
        }
    }

    /// Whether a contact began after the state was entered: an offset of the sensors is none.
    const fn has_new_contact(&mut self, step: GripStep) -> bool {
        let in_contact = step.contact.detector().is_confirmed();
        self.was_touching &= in_contact;
        in_contact && !self.was_touching
    }

    /// Arrival at the target, or an obstacle around the fingers.
    fn releasing_event(&mut self, step: GripStep) -> Option<TaskEvent> {
        let GripStep { inputs, contact, settings, .. } = step;
        let (motor, limits) = (&inputs.motor, &settings.limits);
        let target_mm = self.move_target.opening_mm;
        let has_arrived = motor.opening_mm.is_some_and(|mm| mm >= target_mm - limits.reached_mm);
        if has_arrived && contact.is_at_rest(settings) {
            return Some(TaskEvent::Reached);
        }
        let is_loosening = self.blind.is_loosening(limits);
        let is_stalled = !is_loosening && self.stall.update(motor, 0.0, limits);
        let is_blocked = if contact.is_valid() {
            contact.presses_outward(settings)
        } else {
            self.blind.is_blocked(motor, limits, (is_loosening, is_stalled))
        };
        let is_late = self.state_ms >= limits.release_ms;
        match motor.opening_mm {
            // The end of the stroke, as far as is known.
            None if is_blocked || is_stalled || is_late => Some(TaskEvent::ReachedUnhomed),
            _ if is_blocked || is_stalled || is_late => Some(TaskEvent::Contact),
            _ => None,
        }
    }

    fn approach_event(
        &mut self,
        step: GripStep,
        faults: &mut FaultMonitor,
        outputs: &mut ControlOutputs,
    ) -> Option<TaskEvent> {
        let GripStep { inputs, contact, settings, .. } = step;
        let limits = &settings.limits;
        let motor = &inputs.motor;
        let opening_mm = motor.opening_mm?;
        let window = self.grasp.target.window;
        let rise_n = contact.rise_n();
        let is_pressed = self.was_touching && rise_n > 2.0 * limits.contact_n;
        if !is_pressed && rise_n > limits.move_n && !contact.detector().is_suspected() {
            // The fingers press, but the forces have a large offset: no force could be controlled.
            return Some(TaskEvent::Failed);
        }
        if self.has_new_contact(step) || is_pressed {
            let is_too_wide = window.is_some_and(|window| opening_mm > window.max_mm);
            return Some(if is_too_wide { TaskEvent::Failed } else { TaskEvent::Contact });
        }
        let min_mm =
            window.map_or(limits.fingers_met_mm, |window| window.min_mm.max(limits.fingers_met_mm));
        if opening_mm - LOOK_AHEAD_S * motor.closing_mm_s <= min_mm {
            return Some(TaskEvent::NoObject);
        }
        if self.state_ms >= limits.approach_ms {
            return Some(TaskEvent::Failed);
        }
        self.check_stall(step, faults, outputs);
        None
    }

    /// Whether a fast approach is still far from the width window.
    fn is_far_from_window(&self, motor: &MotorStatus) -> bool {
        let target = &self.grasp.target;
        target.window.filter(|_| target.is_fast).is_some_and(|window| {
            let opening_mm = motor.opening_mm.unwrap_or_default();
            opening_mm - LOOK_AHEAD_S * motor.closing_mm_s > window.max_mm + SLOW_DOWN_MM
        })
    }

    fn stopping_event(&self, step: GripStep) -> Option<TaskEvent> {
        let GripStep { inputs, contact, settings, .. } = step;
        let is_over = contact.is_at_rest(settings) || self.state_ms >= settings.limits.stop_ms;
        let is_releasing = self.grasp.is_gripped && self.state == TaskState::Stopping;
        let event = match (inputs.motor.opening_mm, inputs.host.is_alive) {
            (None, _) => TaskEvent::StoppedUnhomed,
            // The object may still be held.
            (Some(_), _) if is_releasing => TaskEvent::StoppedReleasing,
            (Some(_), true) => TaskEvent::Stopped,
            (Some(_), false) => TaskEvent::StoppedWithoutHost,
        };
        is_over.then_some(event)
    }
}

fn set_stall_fault(motor: &MotorStatus, faults: &mut FaultMonitor, outputs: &mut ControlOutputs) {
    faults.set(Fault::Jammed, true, (motor.current.q.abs() * 1e3) as u32, outputs);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copy_words_differ_for_each_state_flag_and_held_position() {
        type Change = fn(&mut TaskLayer);
        let changes: [Change; 5] = [
            |task| task.grasp.is_gripped ^= true,
            |task| task.grasp.has_settled ^= true,
            |task| task.is_opening ^= true,
            |task| task.hold_mm = task.hold_mm.xor(Some(0.0)),
            |task| task.hold_mm = Some(task.hold_mm.map_or(1e-3, |mm| mm + 1e-3)),
        ];
        for hold_mm in [None, Some(40.0)] {
            let task = TaskLayer { hold_mm, ..TaskLayer::default() };
            for (place, change) in changes.iter().enumerate() {
                let mut changed = task.clone();
                change(&mut changed);
                assert_ne!(changed.copy_words(), task.copy_words(), "{place}");
            }
            for state in TaskState::ALL.iter().filter(|state| **state != task.state) {
                let changed = TaskLayer { state: *state, ..task.clone() };
                assert_ne!(changed.copy_words(), task.copy_words(), "{state:?}");
            }
        }
    }
}
