//! A gripper for tests: a motor that does at once what it is asked, and an object of some stiffness.

use std::vec::Vec;

use super::super::fixture::pressed;
use super::super::order::mode;
use super::super::reason::Reason;
use super::super::states::{Power, Task};
use super::super::{Arming, Grip, Host, Inputs, Outputs};
use crate::force::Estimate;
use crate::limits::Grasp;
use crate::motor::screw::Screw;
use crate::motor::{Setpoint, State, Telling};
use crate::status::{Fault, Faults};
use crate::wire::messages::Command;

/// The gripper.
pub struct Rig {
    pub grip: Grip,
    pub motor: Telling,
    pub host: Host,
    pub command: Option<Command>,
    pub stop: bool,
    pub clear: bool,
    pub is_sound: Option<bool>,
    pub is_calibrating: bool,
    pub others: Faults,
    /// Opening at which an object is touched, and newtons to the millimetre.
    pub object: Option<(f32, f32)>,
    /// Forces instead of the object's.
    pub estimates: Option<[Estimate; 4]>,
    /// Sensors that are not told.
    pub spoil: Option<fn(&mut [Estimate; 4])>,
    pub said: Option<Outputs>,
    pub refused: Vec<Reason>,
}

impl Rig {
    /// Just begun, its opening known.
    pub fn new(locks: bool) -> Self {
        Self {
            grip: Grip::new(
                Grasp::GRIPPER,
                if locks { Screw::A } else { Screw::B },
                locks,
            ),
            motor: Telling {
                opening_mm: Some(50.0),
                ..Telling::default()
            },
            host: Host::default(),
            command: None,
            stop: false,
            clear: false,
            is_sound: Some(true),
            is_calibrating: false,
            others: Faults::default(),
            object: None,
            estimates: None,
            spoil: None,
            said: None,
            refused: Vec::new(),
        }
    }

    /// Armed and enabled.
    pub fn enabled(locks: bool) -> Self {
        Self::enabled_at(locks, 50.0)
    }

    /// The same with the fingers so many millimetres apart.
    pub fn enabled_at(locks: bool, opening_mm: f32) -> Self {
        let mut rig = Self::new(locks);
        rig.motor.opening_mm = Some(opening_mm);
        rig.arm();
        rig.order(mode::ENABLE, |_| {});
        assert_eq!(rig.grip.power(), Power::Enabled);
        rig
    }

    /// Armed by a host that answers.
    pub fn arm(&mut self) {
        self.host.is_offered = true;
        self.run(4);
        self.host = Host {
            is_offered: false,
            is_open: true,
            is_alive: true,
        };
        self.run(3);
        assert_eq!(self.grip.power(), Power::Armed);
    }

    /// Holding an object 40 mm wide with 100 N; `latched` or with its current.
    pub fn holding(locks: bool) -> Self {
        let mut rig = Self::enabled(locks);
        rig.object = Some((40.0, 50.0));
        rig.order(mode::GRIP, |command| command.force = 1000);
        rig.run_until(Task::HoldActive);
        rig
    }

    /// A foot on closed fingers.
    pub fn foot(locks: bool) -> Self {
        let mut rig = Self::enabled_at(locks, 0.5);
        rig.run(20);
        rig.order(mode::FOOT, |_| {});
        assert_eq!(rig.grip.task(), Task::Foot);
        rig
    }

    /// A command, heard once.
    pub fn order(&mut self, mode: u8, with: impl Fn(&mut Command)) {
        let mut command = Command {
            mode,
            ..Command::default()
        };
        with(&mut command);
        self.command = Some(command);
        self.tick();
        self.command = None;
    }

    pub fn tick(&mut self) {
        let force_n = self.force_n();
        let half = f64::from(0.5 * force_n);
        let told = pressed([half, half, -half, -half], [0.0; 4]);
        let mut estimates = self.estimates.unwrap_or(told);
        if let Some(spoil) = self.spoil {
            spoil(&mut estimates);
        }
        assert!(self.grip.is_intact());
        let said = self.grip.tick(&Inputs {
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
        self.refused
            .extend(said.refused.map(|refused| refused.reason));
        match said.arming {
            Some(Arming::Arm) => self.motor.state = State::Armed,
            Some(Arming::Disarm) => self.motor.state = State::Disarmed,
            None => {}
        }
        if let Some(opening_mm) = said.opening_mm {
            self.motor.opening_mm = opening_mm.is_finite().then_some(opening_mm);
        }
        self.follow(said.setpoint);
        self.said = Some(said);
    }

    pub fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick();
        }
    }

    pub fn run_until(&mut self, task: Task) {
        for _ in 0..20_000 {
            if self.grip.task() == task {
                return;
            }
            self.tick();
        }
        panic!("{:?} instead of {task:?}", self.grip.task());
    }

    pub fn setpoint(&self) -> Setpoint {
        self.said.as_ref().unwrap().setpoint
    }

    pub fn force_n(&self) -> f32 {
        let opening_mm = self.motor.opening_mm.unwrap_or_default();
        self.object.map_or(0.0, |(width_mm, stiffness)| {
            (stiffness * (width_mm - opening_mm)).max(0.0)
        })
    }

    /// A fault that others found comes or goes.
    pub fn fault(&mut self, fault: Fault, active: bool) {
        self.others.note(fault, 0, active, 0);
    }

    /// The motor does at once what it is asked.
    fn follow(&mut self, setpoint: Setpoint) {
        const TICK_S: f32 = 1e-3;
        let Some(opening_mm) = self.motor.opening_mm else {
            return;
        };
        let closing_mm_s = match setpoint {
            Setpoint::Speed { closing_mm_s, .. } => closing_mm_s,
            Setpoint::Position {
                opening_mm: to,
                speed_mm_s,
                ..
            } => ((opening_mm - to) / TICK_S).clamp(-speed_mm_s, speed_mm_s),
            Setpoint::Off | Setpoint::Brake | Setpoint::Current { .. } => 0.0,
        };
        self.motor.closing_mm_s = closing_mm_s;
        self.motor.opening_mm = Some(opening_mm - closing_mm_s * TICK_S);
    }
}
