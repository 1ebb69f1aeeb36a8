//! The firmware's grasp on the plant, with perfect sensing of the force: its true value, a millisecond old, with
//! noise. What a grasp with the Hall sensors adds is not in this.

use firmware::force::{Estimate, Validity};
use firmware::frame::SENSORS;
use firmware::grip::order::{flag, mode};
use firmware::grip::states::{Power, Task};
use firmware::grip::{Arming, Grip, Host, Inputs, Outputs};
use firmware::limits::Grasp;
use firmware::motor::{Order, State};
use firmware::units::Force;
use firmware::wire::messages::Command;
use rand_chacha::ChaCha8Rng;

use super::{Rig, periods};
use crate::bench::draw::{Purpose, normal, stream};
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};

/// Noise of a finger's force in newtons, root mean square (assumed).
pub const NOISE_N: f64 = 0.5;
/// Seconds of a tick of the grasp.
const TICK_S: f64 = 1e-3;

/// A gripper with its grasp.
pub struct Bench {
    /// Plant and motor.
    pub rig: Rig,
    /// The grasp.
    pub grip: Grip,
    /// What it last said.
    pub said: Option<Outputs>,
    /// Whether the host is there.
    pub host: Host,
    /// Sensors whose force is not told.
    pub lost: [bool; SENSORS],
    /// Active faults that others found.
    pub faults: u32,
    command: Option<Command>,
    /// What the next tick sees.
    force_n: f64,
    rng: ChaCha8Rng,
}

impl Bench {
    /// Enabled, homed, with the fingers this far apart. The screw is commissioned: it is known whether it locks.
    pub fn new(lead: Lead, parameters: Parameters, opening_mm: f64, seed: u64) -> Self {
        let rig = Rig::armed(lead, parameters, opening_mm, seed);
        Self::of(lead, rig, seed)
    }

    /// The same with a rig that is armed, its opening known or not.
    pub fn of(lead: Lead, rig: Rig, seed: u64) -> Self {
        let screw = lead.screw();
        let mut bench = Self {
            rig,
            grip: Grip::new(Grasp::GRIPPER, screw, screw.self_locking),
            said: None,
            host: Host::default(),
            lost: [false; SENSORS],
            faults: 0,
            command: None,
            force_n: 0.0,
            rng: stream(seed, Purpose::Fingertips, 1),
        };
        bench.host = Host {
            is_offered: false,
            is_open: true,
            is_alive: true,
        };
        bench.command = Some(Command {
            mode: mode::ENABLE,
            ..Command::default()
        });
        for _ in 0..100 {
            bench.tick();
            if bench.grip.power() == Power::Enabled {
                bench.command = None;
                break;
            }
        }
        bench
    }

    /// What a host says, again and again.
    pub fn order(&mut self, command: Command) {
        self.command = Some(command);
    }

    /// A millisecond.
    pub fn tick(&mut self) {
        let told_n = self.force_n;
        self.force_n = self.rig.plant.grip_n();
        let estimates = self.estimates(told_n);
        let said = self.grip.tick(&Inputs {
            estimates: &estimates,
            motor: self.rig.motor.telling(),
            host: self.host,
            command: self.command.filter(|_| self.host.is_alive),
            stop: false,
            clear: false,
            faults: self.faults,
            is_sound: Some(true),
            is_calibrating: false,
            acceleration: None,
        });
        match said.arming {
            Some(Arming::Arm) => self.rig.motor.obey(Order::Arm),
            Some(Arming::Disarm) => self.rig.motor.obey(Order::Disarm),
            None => {}
        }
        if let Some(opening_mm) = said.opening_mm {
            self.rig.motor.obey(Order::Opening { opening_mm });
        }
        if self.rig.motor.telling().state == State::Armed {
            self.rig.motor.obey(Order::Do(said.setpoint));
        }
        self.said = Some(said);
        for _ in 0..periods(TICK_S) {
            self.rig.period();
        }
    }

    /// Goes on until something is so; the seconds that it took, none where it was not within the time.
    pub fn until(&mut self, seconds: f64, is_so: impl Fn(&Self) -> bool) -> Option<f64> {
        let start_s = self.rig.plant.time_s();
        let ticks = (seconds / TICK_S) as u32;
        for _ in 0..ticks {
            if is_so(self) {
                return Some(self.rig.plant.time_s() - start_s);
            }
            self.tick();
        }
        None
    }

    /// Goes on so long.
    pub fn run(&mut self, seconds: f64) {
        self.until(seconds, |_| false);
    }

    fn estimates(&mut self, told_n: f64) -> [Estimate; SENSORS] {
        let mut estimates = [Estimate::MISSING; SENSORS];
        for (estimate, is_lost) in estimates.iter_mut().zip(self.lost) {
            let noise_n = NOISE_N / 2_f64.sqrt() * normal(&mut self.rng);
            if !is_lost {
                let lateral_n = 0.5 * told_n + noise_n;
                estimate.force = [Force((lateral_n * Force::PER_NEWTON) as i32), Force(0)];
                estimate.validity = Validity::Valid;
            }
        }
        estimates
    }
}

/// A command to grip with a force in newtons, whatever the width.
pub fn grip_command(set_n: f64) -> Command {
    let profile = if set_n > 100.0 { 2 } else { 0 };
    Command {
        mode: mode::GRIP,
        force: (set_n * 10.0).round() as u16,
        flags: profile & flag::PROFILE,
        ..Command::default()
    }
}

/// How a grasp went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// Greatest true force in newtons until it was held, and a while after.
    pub peak_n: f64,
    /// Seconds from the contact to 95 % of the force; none where it did not get there.
    pub rise_s: Option<f64>,
    /// Seconds from the contact to the hold; none where there was none.
    pub hold_s: Option<f64>,
    /// Mean force in newtons of the last tenth of a second.
    pub end_n: f64,
    /// Root mean square of its error in newtons.
    pub error_n: f64,
    /// Mean current in amperes meanwhile.
    pub current_a: f64,
    /// State at the end.
    pub task: Task,
}

/// The object that makes a contact of so many newtons to the millimetre with these flexures behind it.
pub fn object(parameters: &Parameters, width_mm: f64, contact_n_per_mm: f64) -> Object {
    let flexures = 1e-3 * parameters.fingers.flexures_n_per_m;
    let own = contact_n_per_mm * flexures / (flexures - contact_n_per_mm);
    Object::new(1e-3 * width_mm, own)
}

/// Grips an object from 2 mm before it, and holds it for so long. It is 40 mm wide, or as much wider as it gives
/// way.
pub fn grasp(
    lead: Lead,
    parameters: Parameters,
    (contact_n_per_mm, set_n): (f64, f64),
    hold_s: f64,
    seed: u64,
) -> Course {
    let width_mm = f64::max(40.0, set_n / contact_n_per_mm + 5.0);
    let mut bench = Bench::new(lead, parameters, width_mm + 2.0, seed);
    let object = object(&parameters, width_mm, contact_n_per_mm);
    bench.rig.plant.hold(Some(&object));
    bench.order(grip_command(set_n));
    bench.until(10.0, |bench| bench.rig.plant.grip_n() > 0.5);
    let contact_s = bench.rig.plant.time_s();
    let (mut peak_n, mut rise_s, mut held_s) = (0.0_f64, None, None);
    let (mut sum, mut squares, mut current_a, mut counted) = (0.0, 0.0, 0.0, 0.0);
    let mut left = (hold_s / TICK_S) as u32;
    let mut waits = 10_000_u32;
    while left > 0 && waits > 0 {
        bench.tick();
        let (force_n, now_s) = (
            bench.rig.plant.grip_n(),
            bench.rig.plant.time_s() - contact_s,
        );
        peak_n = peak_n.max(force_n);
        if force_n >= 0.95 * set_n {
            rise_s = rise_s.or(Some(now_s));
        }
        let task = bench.grip.task();
        let is_held = matches!(task, Task::HoldActive | Task::HoldLatched);
        if is_held {
            held_s = held_s.or(Some(now_s));
        }
        match held_s {
            Some(_) => left -= 1,
            None => waits -= 1,
        }
        if held_s.is_some() && left < 100 {
            sum += force_n;
            squares += (force_n - set_n).powi(2);
            current_a += f64::from(bench.rig.motor.telling().current.q);
            counted += 1.0;
        }
    }
    Course {
        peak_n,
        rise_s,
        hold_s: held_s,
        end_n: sum / counted,
        error_n: (squares / counted).sqrt(),
        current_a: current_a / counted,
        task: bench.grip.task(),
    }
}
