//! Test rig: the grip controller with an ideal motor and an elastic object.

use crate::config::limits::GripLimits;
use crate::estimator::{Estimate, Validity};
use crate::fixed_point::Force;
use crate::grip::commands::{RefusalReason, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::{ArmingRequest, ControlInputs, ControlOutputs, GripController, SessionStatus};
use crate::motor::screw::Screw;
use crate::motor::{MotorState, MotorStatus, Setpoint};
use crate::protocol::messages::Command;
use crate::sensors::hall::SENSORS;
use crate::system::faults::{Fault, FaultSet};
use std::vec::Vec;

/// Current of the ideal motor against friction, and per newton of load.
const FRICTION_A: f32 = 0.3;
const AMPERES_PER_N: f32 = 0.017;

/// The rig.
#[derive(Clone)]
pub struct GripRig {
    pub grip: GripController,
    pub motor: MotorStatus,
    pub host: SessionStatus,
    pub command: Option<Command>,
    pub stop: bool,
    pub clear: bool,
    pub is_sound: Option<bool>,
    pub is_calibrating: bool,
    pub others: FaultSet,
    /// Width of the object in millimetres, and its stiffness in N/mm.
    pub object: Option<(f32, f32)>,
    /// Opening in millimetres at which something around the fingers begins, and its stiffness in N/mm.
    pub tube: Option<(f32, f32)>,
    /// Error of the forces of both fingers in newtons.
    pub offset_n: f32,
    /// Estimates instead of those of the object.
    pub estimates: Option<[Estimate; 4]>,
    /// Opening in millimetres, also while the motor does not know it, and its end.
    pub true_mm: f32,
    pub end_mm: f32,
    /// True opening where the motor's is zero.
    zero_mm: f32,
    /// Modification of the estimates.
    pub corrupt: Option<fn(&mut [Estimate; 4])>,
    pub outputs: Option<ControlOutputs>,
    pub refused: Vec<RefusalReason>,
}

impl GripRig {
    /// After start, with a known opening.
    pub fn new(self_locking: bool) -> Self {
        Self::with_limits(self_locking, GripLimits::GRIPPER)
    }

    /// As [`Self::new`], with other limits.
    pub fn with_limits(self_locking: bool, limits: GripLimits) -> Self {
        let screw = if self_locking { Screw::A } else { Screw::B };
        Self {
            grip: GripController::new(limits, screw, self_locking),
            motor: MotorStatus { opening_mm: Some(50.0), ..MotorStatus::default() },
            host: SessionStatus::default(),
            command: None,
            stop: false,
            clear: false,
            is_sound: Some(true),
            is_calibrating: false,
            others: FaultSet::default(),
            object: None,
            tube: None,
            offset_n: 0.0,
            estimates: None,
            true_mm: 50.0,
            end_mm: f32::INFINITY,
            zero_mm: 0.0,
            corrupt: None,
            outputs: None,
            refused: Vec::new(),
        }
    }

    /// Armed and enabled.
    pub fn enabled(self_locking: bool) -> Self {
        Self::enabled_at(self_locking, 50.0)
    }

    /// As [`Self::enabled`], at an opening in millimetres.
    pub fn enabled_at(self_locking: bool, opening_mm: f32) -> Self {
        let mut rig = Self::new(self_locking);
        (rig.motor.opening_mm, rig.true_mm) = (Some(opening_mm), opening_mm);
        rig.enable();
        rig
    }

    /// Opens a session and enables the drive.
    pub fn enable(&mut self) {
        self.arm();
        self.send(mode::ENABLE, |_| {});
        assert_eq!(self.grip.power(), PowerState::Enabled);
    }

    /// Opens a session.
    pub fn arm(&mut self) {
        self.host.is_offered = true;
        self.run(4);
        self.host = SessionStatus { is_offered: false, is_open: true, is_alive: true };
        self.run(3);
        assert_eq!(self.grip.power(), PowerState::Armed);
    }

    /// Holding an object of 40 mm with 100 N.
    pub fn holding(self_locking: bool) -> Self {
        let mut rig = Self::enabled(self_locking);
        rig.object = Some((40.0, 50.0));
        rig.send(mode::GRIP, |command| command.force = 1000);
        rig.run_until(TaskState::HoldActive);
        rig
    }

    /// In foot mode on closed fingers.
    pub fn foot(self_locking: bool) -> Self {
        let mut rig = Self::enabled_at(self_locking, 0.5);
        rig.run(20);
        rig.send(mode::FOOT, |_| {});
        assert_eq!(rig.grip.task(), TaskState::Foot);
        rig
    }

    /// In any task state, brought about by commands and by what surrounds the fingers.
    pub fn in_task(task: TaskState, self_locking: bool) -> Self {
        let mut rig = Self::enabled(self_locking);
        let to = |rig: &mut Self, mode, position| {
            rig.send(mode, |command| {
                (command.position, command.speed, command.force) = (position, 40, 1000);
            });
        };
        match task {
            TaskState::Unhomed => {
                rig = Self::new(self_locking);
                rig.motor.opening_mm = None;
                rig.enable();
            }
            TaskState::Homing => to(&mut rig, mode::HOME, 0),
            TaskState::Idle => {}
            TaskState::Moving => to(&mut rig, mode::MOVE, 200),
            TaskState::Approach => to(&mut rig, mode::GRIP, 0),
            TaskState::Releasing => to(&mut rig, mode::RELEASE, 1400),
            TaskState::ContactStop => {
                rig.object = Some((40.0, 50.0));
                to(&mut rig, mode::MOVE, 200);
            }
            TaskState::Force
            | TaskState::HoldActive
            | TaskState::HoldLatched
            | TaskState::HoldFrozen
            | TaskState::Lost => {
                rig.object = Some((40.0, 50.0));
                to(&mut rig, mode::GRIP, 0);
                rig.run_until(if task == TaskState::Force { task } else { TaskState::HoldActive });
                if task == TaskState::HoldFrozen {
                    rig.corrupt = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
                }
                if task == TaskState::Lost {
                    rig.object = None;
                }
            }
            TaskState::NoObject => to(&mut rig, mode::GRIP, 0),
            TaskState::GripFailed => {
                rig.object = Some((40.0, 50.0));
                // 10 mm, 1 mm on either side.
                rig.send(mode::GRIP, |command| {
                    (command.position, command.force, command.flags) = (200, 1000, 1 << 2);
                });
            }
            TaskState::Foot => rig = Self::foot(self_locking),
            TaskState::Stopping | TaskState::TimeoutHold => {
                to(&mut rig, mode::MOVE, 200);
                rig.run(20);
                rig.host.is_alive = task == TaskState::Stopping;
                to(&mut rig, mode::STOP, 0);
            }
        }
        rig.run_until(task);
        rig.host.is_alive = true;
        rig
    }

    /// Gripping with a force in newtons until a state; the fingers rest at 40 mm, and their force is given.
    pub fn gripped(force_n: f32, self_locking: bool, task: TaskState) -> Self {
        let mut rig = Self::enabled_at(self_locking, 40.0);
        rig.send(mode::GRIP, |command| {
            // Strong: up to 350 N.
            (command.force, command.flags) = ((10.0 * force_n) as u16, 2);
        });
        rig.press(force_n.into());
        rig.rest_until(|now| now == task);
        rig
    }

    /// Sets the estimates to equal forces on both fingers.
    pub fn press(&mut self, newtons: f64) {
        let half = (0.5 * newtons * Force::PER_NEWTON).round() / Force::PER_NEWTON;
        self.estimates = Some(pressed([half, half, -half, -half], [0.0; 4]));
    }

    /// Three milliseconds of fingers that rest at 40 mm with a force, which then is exactly their mean: the mean of a finger begins
    /// anew after an invalid force.
    pub fn settle(&mut self, newtons: f64) {
        for lost in [Some(0), Some(2), None] {
            self.press(newtons);
            if let (Some(at), Some(estimates)) = (lost, &mut self.estimates) {
                estimates[at] = Estimate::MISSING;
            }
            self.rest(40.0, 0.0);
        }
    }

    /// One millisecond in which both fingers press with a force.
    pub fn tick_pressed(&mut self, newtons: f64) {
        self.press(newtons);
        self.tick();
    }

    /// One millisecond of fingers that rest at an opening, with a current.
    pub fn rest(&mut self, opening_mm: impl Into<Option<f32>>, current_a: f32) {
        self.moving(opening_mm, 0.0, current_a);
    }

    /// One millisecond of fingers at an opening with a speed and a current.
    pub fn moving(
        &mut self,
        opening_mm: impl Into<Option<f32>>,
        closing_mm_s: f32,
        current_a: f32,
    ) {
        self.motor.opening_mm = opening_mm.into();
        self.true_mm = self.motor.opening_mm.unwrap_or(50.0);
        self.motor.closing_mm_s = closing_mm_s;
        self.motor.current.q = current_a;
        self.tick();
    }

    /// A stop frame.
    pub fn stop_all(&mut self) {
        self.stop = true;
        self.tick();
        self.stop = false;
    }

    /// A host clears the faults.
    pub fn clear_faults(&mut self) {
        self.clear = true;
        self.tick();
        self.clear = false;
    }

    pub fn is_active(&self, fault: Fault) -> bool {
        self.grip.fault_bits() & 1 << fault.index() != 0
    }

    /// Detail of a fault that became active in the last tick.
    pub fn new_fault(&self, fault: Fault) -> Option<u32> {
        let events = &self.outputs.as_ref().unwrap().events;
        let mut of_fault = events.iter().filter(|event| event.code == fault as u16);
        of_fault.find_map(|event| (event.active == 1).then_some(event.detail))
    }

    /// Closing speed and current limit of the set-point.
    pub fn speed(&self) -> (f32, f32) {
        match self.setpoint() {
            Setpoint::Speed { closing_mm_s, max_a } => (closing_mm_s, max_a),
            other => panic!("{other:?}"),
        }
    }

    /// Sends a command once.
    pub fn send(&mut self, mode: u8, with: impl Fn(&mut Command)) {
        let mut command = Command { mode, ..Command::default() };
        with(&mut command);
        self.command = Some(command);
        self.tick();
        self.command = None;
    }

    pub fn tick(&mut self) {
        let force_n = self.force_n();
        let half = f64::from(0.5 * (force_n + self.offset_n));
        let of_object = pressed([half, half, -half, -half], [0.0; 4]);
        let mut estimates = self.estimates.unwrap_or(of_object);
        if let Some(corrupt) = self.corrupt {
            corrupt(&mut estimates);
        }
        assert!(self.grip.is_intact());
        let outputs = self.grip.tick(&ControlInputs {
            estimates: &estimates,
            motor: self.motor,
            host: self.host,
            command: self.command,
            stop: self.stop,
            clear: self.clear,
            faults: self.others.bits(),
            is_sound: self.is_sound,
            is_calibrating: self.is_calibrating,
            acceleration: None,
        });
        self.refused.extend(outputs.refused.map(|refused| refused.reason));
        match outputs.arming {
            Some(ArmingRequest::Arm) => self.motor.state = MotorState::Armed,
            Some(ArmingRequest::Disarm) => self.motor.state = MotorState::Disarmed,
            None => {}
        }
        if let Some(opening_mm) = outputs.opening_mm {
            self.zero_mm = self.true_mm - if opening_mm.is_finite() { opening_mm } else { 0.0 };
            self.motor.opening_mm = opening_mm.is_finite().then_some(opening_mm);
        }
        self.follow(outputs.setpoint);
        self.outputs = Some(outputs);
    }

    pub fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick();
        }
    }

    pub fn run_until(&mut self, task: TaskState) {
        self.until(|now| now == task, Self::tick);
    }

    /// Runs until another task state.
    pub fn run_while(&mut self, task: TaskState) {
        self.until(|now| now != task, Self::tick);
    }

    /// Fingers that rest at 40 mm until a task state.
    pub fn rest_until(&mut self, is_reached: impl Fn(TaskState) -> bool) {
        self.until(is_reached, |rig| rig.rest(40.0, 0.0));
    }

    fn until(&mut self, is_reached: impl Fn(TaskState) -> bool, wait: impl Fn(&mut Self)) {
        for _ in 0..20_000 {
            if is_reached(self.grip.task()) {
                return;
            }
            wait(self);
        }
        panic!("{:?} after 20 s", self.grip.task());
    }

    pub fn setpoint(&self) -> Setpoint {
        self.outputs.as_ref().unwrap().setpoint
    }

    pub fn force_n(&self) -> f32 {
        let opening_mm = self.true_mm;
        let inward_n = self
            .object
            .map_or(0.0, |(width_mm, stiffness)| (stiffness * (width_mm - opening_mm)).max(0.0));
        let outward_n = self
            .tube
            .map_or(0.0, |(width_mm, stiffness)| (stiffness * (opening_mm - width_mm)).max(0.0));
        inward_n - outward_n
    }

    /// Sets or clears an external fault.
    pub fn fault(&mut self, fault: Fault, active: bool) {
        self.others.update(fault, 0, active, 0);
    }

    /// Moves the ideal motor.
    fn follow(&mut self, setpoint: Setpoint) {
        const TICK_S: f32 = 1e-3;
        if let Some(opening_mm) = self.motor.opening_mm {
            self.true_mm = opening_mm + self.zero_mm;
        }
        let opening_mm = self.true_mm;
        let closing_mm_s = match setpoint {
            Setpoint::Speed { closing_mm_s, .. } => closing_mm_s,
            Setpoint::Position { opening_mm: to, speed_mm_s, .. } => {
                ((opening_mm - self.zero_mm - to) / TICK_S).clamp(-speed_mm_s, speed_mm_s)
            }
            Setpoint::Off | Setpoint::Brake | Setpoint::Current { .. } => 0.0,
        };
        self.motor.closing_mm_s = closing_mm_s;
        self.true_mm = (opening_mm - closing_mm_s * TICK_S).min(self.end_mm);
        if self.true_mm == self.end_mm {
            self.motor.closing_mm_s = 0.0;
        }
        self.motor.opening_mm = self.motor.opening_mm.map(|_| self.true_mm - self.zero_mm);
        // Friction, and the load of what is around the fingers.
        let closing_a = FRICTION_A.copysign(closing_mm_s) + AMPERES_PER_N * self.force_n();
        self.motor.current.q = match setpoint {
            Setpoint::Off | Setpoint::Brake => 0.0,
            _ => closing_a,
        };
    }
}

/// Valid estimates from lateral and longitudinal forces in newtons.
pub fn pressed(lateral: [f64; SENSORS], longitudinal: [f64; SENSORS]) -> [Estimate; SENSORS] {
    let force = |newtons: f64| Force((newtons * Force::PER_NEWTON) as i32);
    let mut estimates = [Estimate::MISSING; SENSORS];
    let forces = lateral.into_iter().zip(longitudinal);
    for (estimate, (x, z)) in estimates.iter_mut().zip(forces) {
        estimate.force = [force(x), force(z)];
        estimate.validity = Validity::Valid;
    }
    estimates
}
