//! A millisecond of the task layer: orders heard, events found.

use super::drive::RELAXED;
use super::home::{Homing, Step};
use super::jam::Jam;
use super::object::{Seen, Watch};
use super::order::{Order, Way, flag};
use super::react::{Reaction, strongest};
use super::reason::Reason;
use super::states::{Phase, Power, Task};
use super::stiffness::Stiffness;
use super::table::{self, PowerEvent, TaskEvent};
use super::{Grip, Inputs, Outputs};
use crate::motor::{State, Telling};
use crate::status::Fault;
use crate::units::Force;
use crate::wire::messages::Command;

/// Seconds in which the fingers stop: how far ahead an opening is looked for.
const AHEAD_S: f32 = 0.004;
/// A screw that locks itself holds alone after so many times [`crate::limits::Grasp::lock_ms`], however near the
/// force is.
const LATE: u32 = 5;
/// Millimetres before the window at which a fast approach slows down.
const SLOW_DOWN_MM: f32 = 2.0;

impl Grip {
    /// Takes a command.
    ///
    /// # Errors
    /// Why it is not done.
    pub(super) fn hear(&mut self, command: &Command, inputs: &Inputs) -> Result<(), Reason> {
        let order = Order::of(command, &self.limits)?;
        let heard = (order, command.flags & flag::AGAIN != 0);
        if self.seen == Some(heard) {
            return Ok(());
        }
        match order {
            Order::Enable => self.enable(inputs)?,
            Order::Disable => self.disable()?,
            _ if self.power != Power::Enabled => return Err(Reason::NotEnabled),
            order => self.obey(order, inputs)?,
        }
        self.seen = Some(heard);
        Ok(())
    }

    fn enable(&mut self, inputs: &Inputs) -> Result<(), Reason> {
        match self.power {
            Power::Enabled => return Ok(()),
            Power::Armed => {}
            _ => return Err(Reason::NotEnabled),
        }
        let bits = inputs.faults | self.faults.bits();
        let worst = strongest(bits, Phase::Moving, self.locks);
        if worst.is_some_and(|(reaction, _)| reaction >= Reaction::QuickStop) {
            return Err(Reason::Faulty);
        }
        if self.latch.cause().is_some() {
            return Err(Reason::Latched);
        }
        if inputs.motor.state != State::Armed {
            return Err(Reason::MotorNotReady);
        }
        if self.happens(PowerEvent::Enable) {
            let begins = match (inputs.motor.opening_mm, self.is_gripped) {
                (None, _) => Task::Unhomed,
                (Some(_), true) => Task::GripFailed,
                (Some(_), false) => Task::Idle,
            };
            self.enter(begins);
        }
        Ok(())
    }

    fn disable(&mut self) -> Result<(), Reason> {
        if self.power != Power::Enabled {
            return Ok(());
        }
        match self.task {
            task if task.moves() || task.holds() => Err(Reason::of(task)),
            task @ (Task::GripFailed | Task::Stopping | Task::ContactStop | Task::Foot) => {
                Err(Reason::of(task))
            }
            _ => {
                self.happens(PowerEvent::Disable);
                Ok(())
            }
        }
    }

    fn obey(&mut self, order: Order, inputs: &Inputs) -> Result<(), Reason> {
        let event = match order {
            Order::Home => TaskEvent::Home,
            Order::Move(_) => TaskEvent::Move,
            Order::Grip(_) => TaskEvent::Grip,
            Order::Release(_) => TaskEvent::Release,
            Order::Stop => TaskEvent::Stop,
            Order::Foot { .. } => TaskEvent::Foot,
            Order::Leave => TaskEvent::Leave,
            Order::Enable | Order::Disable => return Ok(()),
        };
        let to = table::task(self.task, event)?;
        self.allow(order, to, &inputs.motor)?;
        match order {
            Order::Grip(grip) => {
                self.grip = grip;
                self.set_n = grip.set_n;
            }
            Order::Move(way) | Order::Release(way) => self.set_out(way, &inputs.motor),
            _ => {}
        }
        if to != self.task || matches!(order, Order::Grip(_) | Order::Move(_) | Order::Release(_)) {
            self.enter(to);
        }
        Ok(())
    }

    /// What the table cannot say: whether this is the moment for it.
    fn allow(&self, order: Order, to: Task, motor: &Telling) -> Result<(), Reason> {
        let opening_mm = motor.opening_mm.unwrap_or_default();
        let needs_force = matches!(order, Order::Home | Order::Grip(_));
        match order {
            _ if needs_force && self.is_blind() => Err(Reason::Blind),
            Order::Release(way) if way.opening_mm <= opening_mm => Err(Reason::OutOfRange),
            Order::Foot { on_line } if to != self.task => {
                let [line_mm, off_mm] = self.limits.line_mm;
                let is_parked = match on_line {
                    true => (opening_mm - line_mm).abs() <= off_mm,
                    false => opening_mm <= self.limits.flat_mm,
                };
                match (is_parked && self.rests(), self.standing.is_unloaded) {
                    (false, _) => Err(Reason::NotParked),
                    (true, false) => Err(Reason::Loaded),
                    (true, true) => Ok(()),
                }
            }
            Order::Leave if self.unloaded_ms < self.limits.unloaded_ms => Err(Reason::Loaded),
            _ => Ok(()),
        }
    }

    fn set_out(&mut self, way: Way, motor: &Telling) {
        self.way = way;
        self.is_opening = motor.opening_mm.is_some_and(|mm| way.opening_mm > mm);
        self.was_touching = self.contact.is_believed();
    }

    /// Finds what has happened, and follows it.
    pub(super) fn follow_task(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.slipping_ms = self.slipping_ms.saturating_sub(1);
        let slips = self.slipping_ms > 0;
        let detail = (self.set_n * Force::PER_NEWTON as f32) as u32;
        self.note(Fault::Slipping, slips, detail, outputs);
        let event = match self.task {
            task if task.moves() && !inputs.host.is_alive => Some(TaskEvent::Silent),
            Task::Homing => self.home(inputs, outputs),
            Task::Moving => self.seen_on_the_way(inputs, outputs),
            Task::Approach => self.seen_in_approach(inputs, outputs),
            Task::Releasing => match self.has_arrived(&inputs.motor) {
                true => Some(TaskEvent::Reached),
                false => self.jams(inputs, outputs),
            },
            Task::ContactStop | Task::Stopping => self.seen_in_stop(inputs),
            Task::Force | Task::HoldActive | Task::HoldLatched => self.seen_in_grip(inputs),
            Task::HoldFrozen => {
                (self.believed_ms >= self.limits.sighted_ms).then_some(TaskEvent::Sighted)
            }
            Task::Unhomed
            | Task::Idle
            | Task::NoObject
            | Task::GripFailed
            | Task::Lost
            | Task::Foot
            | Task::TimeoutHold => None,
        };
        if let Some(event) = event {
            self.follow(event);
        }
        if self.place_mm.is_none() && self.rests() {
            self.place_mm = inputs.motor.opening_mm;
        }
    }

    /// Takes an event of the task layer.
    fn follow(&mut self, event: TaskEvent) {
        let Ok(to) = table::task(self.task, event) else {
            return;
        };
        match event {
            TaskEvent::Slipped => {
                let more = self.set_n * self.limits.slip_factor;
                self.set_n = more.min(self.grip.cap_n);
                self.slipping_ms = self.limits.slip_pause_ms;
            }
            TaskEvent::Weak => {
                let [newest, second, _] = self.regrips;
                self.regrips = [Some(self.now_ms), newest, second];
            }
            _ => {}
        }
        self.enter(to);
    }

    /// Begins a state.
    fn enter(&mut self, to: Task) {
        let from = self.task;
        (self.task, self.task_ms) = (to, 0);
        (self.right_ms, self.weak_ms) = (0, 0);
        self.place_mm = None;
        self.jam = Jam::default();
        self.hold = super::drive::Hold::default();
        match to {
            Task::Homing => self.homing = Homing::default(),
            Task::Approach => {
                self.stiffness = Stiffness::default();
                self.watch = Watch::default();
                (self.is_gripped, self.has_settled) = (false, false);
            }
            Task::Force => self.is_gripped = true,
            Task::HoldActive => self.has_settled = true,
            Task::Idle if matches!(from, Task::Moving | Task::Releasing) => {
                self.place_mm = Some(self.way.opening_mm);
                (self.is_gripped, self.has_settled) = (false, false);
            }
            Task::Idle | Task::Lost | Task::NoObject => {
                (self.is_gripped, self.has_settled) = (false, false);
            }
            Task::GripFailed => self.is_gripped = true,
            Task::Releasing => self.has_settled = false,
            _ => {}
        }
    }

    fn home(&mut self, inputs: &Inputs, outputs: &mut Outputs) -> Option<TaskEvent> {
        let presses = self.contact.is_believed();
        let limits = self.limits;
        self.home_step = self
            .homing
            .tick(&inputs.motor, self.force_n, presses, &limits);
        match self.home_step {
            Step::Drive(_) => None,
            Step::Closed(opening_mm) => {
                outputs.opening_mm = Some(opening_mm);
                None
            }
            Step::Homed => Some(TaskEvent::Homed),
            Step::Jammed => {
                self.note_jam(inputs, outputs);
                Some(TaskEvent::NotHomed)
            }
            Step::Wrong(opening_mm) => {
                outputs.opening_mm = Some(f32::NAN);
                let detail = (opening_mm * 1e3) as u32;
                self.note(Fault::StrokeWrong, true, detail, outputs);
                Some(TaskEvent::NotHomed)
            }
        }
    }

    fn note_jam(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let current_ma = (inputs.motor.current.q.abs() * 1e3) as u32;
        self.note(Fault::Jammed, true, current_ma, outputs);
    }

    /// Notes a jam; the fault's reaction stops in the next millisecond.
    fn jams(&mut self, inputs: &Inputs, outputs: &mut Outputs) -> Option<TaskEvent> {
        if self.jam.note(&inputs.motor, self.force_n, &self.limits) {
            self.note_jam(inputs, outputs);
        }
        None
    }

    fn has_arrived(&self, motor: &Telling) -> bool {
        let reached_mm = self.limits.reached_mm;
        let is_there = |mm: f32| (mm - self.way.opening_mm).abs() <= reached_mm;
        motor.opening_mm.is_some_and(is_there) && self.rests()
    }

    fn seen_on_the_way(&mut self, inputs: &Inputs, outputs: &mut Outputs) -> Option<TaskEvent> {
        let touches = self.contact.is_believed();
        self.was_touching &= touches;
        if touches && !self.was_touching {
            return Some(TaskEvent::Contact);
        }
        match self.has_arrived(&inputs.motor) {
            true => Some(TaskEvent::Reached),
            false => self.jams(inputs, outputs),
        }
    }

    fn seen_in_approach(&mut self, inputs: &Inputs, outputs: &mut Outputs) -> Option<TaskEvent> {
        let motor = &inputs.motor;
        let opening_mm = motor.opening_mm?;
        let window = self.grip.window;
        if self.contact.is_believed() {
            let is_too_wide = window.is_some_and(|window| opening_mm > window.most_mm);
            return Some(match is_too_wide {
                true => TaskEvent::Failed,
                false => TaskEvent::Contact,
            });
        }
        let nothing_mm = window.map_or(self.limits.met_mm, |window| {
            window.least_mm.max(self.limits.met_mm)
        });
        if opening_mm - AHEAD_S * motor.closing_mm_s <= nothing_mm {
            return Some(TaskEvent::NothingThere);
        }
        match self.task_ms >= self.limits.approach_ms {
            true => Some(TaskEvent::Failed),
            false => self.jams(inputs, outputs),
        }
    }

    /// Whether a fast approach is still far from where the object is expected.
    pub(super) fn is_far(&self, motor: &Telling) -> bool {
        let window = self.grip.window.filter(|_| self.grip.is_fast);
        let far = |most_mm: f32| {
            let there_mm = motor.opening_mm.unwrap_or_default();
            there_mm - AHEAD_S * motor.closing_mm_s > most_mm + SLOW_DOWN_MM
        };
        window.is_some_and(|window| far(window.most_mm))
    }

    fn seen_in_stop(&self, inputs: &Inputs) -> Option<TaskEvent> {
        let is_over = self.rests() || self.task_ms >= self.limits.stop_ms;
        let event = match (inputs.motor.opening_mm, inputs.host.is_alive) {
            (None, _) => TaskEvent::AtRestUnhomed,
            (Some(_), true) => TaskEvent::AtRest,
            (Some(_), false) => TaskEvent::AtRestAlone,
        };
        is_over.then_some(event)
    }

    fn seen_in_grip(&mut self, inputs: &Inputs) -> Option<TaskEvent> {
        if self.is_blind() {
            return Some(TaskEvent::Blind);
        }
        if self.unbelieved_ticks > 0 {
            return None;
        }
        let closing_mm_s = match self.has_settled {
            true => inputs.motor.closing_mm_s,
            // On the way to its force it is not there yet.
            false => 0.0,
        };
        let asked = (self.set_n, closing_mm_s);
        let seen = match self.task == Task::Force && !self.has_settled {
            true if self.contact.is_believed() => Seen::Held,
            true => Seen::Gone,
            false => self.watch.note(&self.fingers, asked, &self.limits),
        };
        match seen {
            Seen::Gone => Some(TaskEvent::Gone),
            Seen::Slipping => Some(TaskEvent::Slipped),
            Seen::Held => self.seen_of_force(),
        }
    }

    fn seen_of_force(&mut self) -> Option<TaskEvent> {
        let limits = &self.limits;
        let missing_n = self.set_n - self.force_n;
        let step = |ms: &mut u16, counts: bool| {
            *ms = if counts { ms.saturating_add(1) } else { 0 };
        };
        let right_n = limits.right_n.max(limits.right * self.set_n);
        step(&mut self.right_ms, missing_n.abs() < right_n);
        let weak_n = limits.weak_n.max(limits.weak * self.set_n);
        step(&mut self.weak_ms, missing_n > weak_n);
        match self.task {
            Task::Force if self.right_ms >= limits.settle_ms => Some(TaskEvent::Settled),
            Task::Force if self.task_ms >= limits.grip_ms => Some(TaskEvent::Failed),
            Task::HoldActive if self.may_lock() => Some(TaskEvent::Lock),
            Task::HoldLatched if self.weak_ms >= limits.weak_ms => Some(TaskEvent::Weak),
            _ => None,
        }
    }

    /// Whether the screw may hold alone: it is known to, and has not failed too often lately.
    fn may_lock(&self) -> bool {
        let lately = self.regrips.iter().flatten();
        let lately =
            lately.filter(|at_ms| self.now_ms.wrapping_sub(**at_ms) < self.limits.regrip_ms);
        let is_spent = lately.count() >= usize::from(self.limits.regrips);
        let dead_n = self.limits.dead_n.max(self.limits.dead * self.set_n);
        let is_near = (self.set_n - self.mean_n).abs() < RELAXED * dead_n;
        // A force that comes no nearer is kept as it is.
        let is_late = self.task_ms >= LATE * self.limits.lock_ms;
        let is_due = self.task_ms >= self.limits.lock_ms && (is_near || is_late);
        self.locks && !is_spent && is_due && self.right_ms > 0
    }
}
