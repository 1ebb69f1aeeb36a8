//! The firmware's grasp on the plant, with perfect sensing of the force: its true value, a millisecond old, with
//! noise. What a grasp with the Hall sensors adds is not in this.

use firmware::force::{Estimate, Validity};
use firmware::frame::SENSORS;
use firmware::grip::order::{flag, mode};
use firmware::grip::states::Power;
use firmware::grip::{Arming, Grip, Host, Inputs, Outputs};
use firmware::limits::Grasp;
use firmware::motor::State;
use firmware::units::Force;
use firmware::wire::messages::Command;
use rand_chacha::ChaCha8Rng;

use super::{Rig, periods};
use crate::bench::draw::{Purpose, normal, stream};
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};
use crate::plant::pulled::Pulled;

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
    /// What is held is pulled along the fingers.
    pub pulled: Option<Pulled>,
    /// What the ground pushes each fingertip with, in newtons.
    pub ground_n: [f64; SENSORS],
    /// Of the fingertips in mm/s^2, gravity included, where the board knows it.
    pub acceleration: Option<[i32; 3]>,
    command: Option<Command>,
    /// What the next tick sees: the grip, and what pushes each fingertip along.
    sensed: Sensed,
    rng: ChaCha8Rng,
}

/// Forces of a millisecond, in newtons.
#[derive(Clone, Copy, Debug, Default)]
struct Sensed {
    grip_n: f64,
    along_n: [f64; SENSORS],
}

impl Bench {
    /// Enabled, homed, with the fingers this far apart. The screw is commissioned: it is known whether it locks.
    pub fn new(lead: Lead, parameters: Parameters, opening_mm: f64, seed: u64) -> Self {
        let rig = Rig::armed(lead, parameters, opening_mm, seed);
        Self::of(lead, rig, seed)
    }

    /// The same with a rig that is armed, its opening known or not.
    pub fn of(lead: Lead, rig: Rig, seed: u64) -> Self {
        Self::within(Grasp::GRIPPER, lead, rig, seed)
    }

    /// The same with other limits.
    pub fn within(limits: Grasp, lead: Lead, rig: Rig, seed: u64) -> Self {
        let screw = lead.screw();
        let mut bench = Self {
            rig,
            grip: Grip::new(limits, screw, screw.self_locking),
            said: None,
            host: Host::default(),
            lost: [false; SENSORS],
            faults: 0,
            pulled: None,
            ground_n: [0.0; SENSORS],
            acceleration: None,
            command: None,
            sensed: Sensed::default(),
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
        let estimates = self.estimates();
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
            acceleration: self.acceleration,
        });
        match said.arming {
            Some(Arming::Arm) => self.rig.motor.arm(),
            Some(Arming::Disarm) => self.rig.motor.disarm(),
            None => {}
        }
        if let Some(opening_mm) = said.opening_mm {
            self.rig.motor.set_opening(opening_mm);
        }
        if self.rig.motor.telling().state == State::Armed {
            self.rig.motor.command(said.setpoint);
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

    /// Forces as they were a millisecond ago, with noise.
    fn estimates(&mut self) -> [Estimate; SENSORS] {
        let now = self.sense();
        let told = std::mem::replace(&mut self.sensed, now);
        let mut estimates = [Estimate::MISSING; SENSORS];
        let sensors = estimates.iter_mut().zip(self.lost).zip(told.along_n);
        for ((estimate, is_lost), along_n) in sensors {
            let [lateral, along] = [0, 1].map(|_| NOISE_N / 2_f64.sqrt() * normal(&mut self.rng));
            if !is_lost {
                let newtons = [0.5 * told.grip_n + lateral, along_n + along];
                estimate.force = newtons.map(|newtons| Force((newtons * Force::PER_NEWTON) as i32));
                estimate.validity = Validity::Valid;
            }
        }
        estimates
    }

    fn sense(&mut self) -> Sensed {
        let grip_n = self.rig.plant.grip_n();
        let drag_n = match &mut self.pulled {
            Some(pulled) => pulled.step(grip_n, TICK_S),
            None => 0.0,
        };
        Sensed {
            grip_n,
            along_n: self
                .ground_n
                .map(|ground_n| ground_n + drag_n / SENSORS as f64),
        }
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

/// The object that makes a contact of so many newtons to the millimetre with these flexures behind it.
pub fn object(parameters: &Parameters, width_mm: f64, contact_n_per_mm: f64) -> Object {
    let flexures = 1e-3 * parameters.fingers.flexures_n_per_m;
    let own = contact_n_per_mm * flexures / (flexures - contact_n_per_mm);
    Object::new(1e-3 * width_mm, own)
}
