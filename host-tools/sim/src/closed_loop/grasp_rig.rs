//! The firmware's grasp on the plant with ideal force sensing: the true force with noise, a millisecond late.
//! Errors of the Hall sensors are not included.

use crate::closed_loop::motor_rig::{MotorRig, periods};
use crate::drivetrain::fingertips::distribute_forces;
use crate::drivetrain::mechanics::{Object, PulledObject};
use crate::drivetrain::parameters::{Lead, PlantParameters};
use crate::random::{Purpose, normal, stream};
use firmware::config::limits::GripLimits;
use firmware::estimator::{Estimate, Validity};
use firmware::fixed_point::Force;
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::PowerState;
use firmware::grip::{ArmingRequest, ControlInputs, ControlOutputs, GripController, SessionStatus};
use firmware::motor::{MotorCommand, MotorState};
use firmware::protocol::messages::Command;
use firmware::sensors::hall::SENSORS;
use rand_chacha::ChaCha8Rng;

/// RMS noise of a finger's force in newtons (assumed).
pub const NOISE_N: f64 = 0.5;
/// Period of the grasp controller in seconds.
pub const TICK_S: f64 = 1e-3;

/// Drivetrain, motor control and grasp controller.
pub struct GraspRig {
    /// Drivetrain and motor control.
    pub rig: MotorRig,
    /// Controller with a current limit only.
    pub grip: GripController,
    /// Its last outputs.
    pub outputs: Option<ControlOutputs>,
    /// State of the host.
    pub host: SessionStatus,
    /// Sensors without a valid force.
    pub lost: [bool; SENSORS],
    /// Active faults of other components.
    pub faults: u32,
    /// An object in the grip that is pulled along the fingers.
    pub pulled: Option<PulledObject>,
    /// Ground force on each fingertip, in newtons.
    pub ground_n: [f64; SENSORS],
    /// Measured specific force of the fingertips in mm/s^2, where available.
    pub acceleration: Option<[i32; 3]>,
    command: Option<Command>,
    /// Forces for the next tick.
    sensed: Sensed,
    rng: ChaCha8Rng,
}

/// Forces of one tick, in newtons.
#[derive(Clone, Copy, Debug, Default)]
struct Sensed {
    grip_n: f64,
    along_n: [f64; SENSORS],
}

impl GraspRig {
    /// Enabled and homed at an opening; the screw is commissioned.
    pub fn new(lead: Lead, parameters: PlantParameters, opening_mm: f64, seed: u64) -> Self {
        let rig = MotorRig::armed(lead, parameters, opening_mm, seed);
        Self::of(lead, rig, seed)
    }

    /// From an armed rig, homed or not.
    pub fn of(lead: Lead, rig: MotorRig, seed: u64) -> Self {
        Self::with_limits(GripLimits::GRIPPER, lead, rig, seed)
    }

    /// From an armed rig, with other limits of the grasp.
    pub fn with_limits(limits: GripLimits, lead: Lead, rig: MotorRig, seed: u64) -> Self {
        let screw = lead.screw();
        let mut bench = Self {
            rig,
            grip: GripController::new(limits, screw, screw.self_locking),
            outputs: None,
            host: SessionStatus::default(),
            lost: [false; SENSORS],
            faults: 0,
            pulled: None,
            ground_n: [0.0; SENSORS],
            acceleration: None,
            command: None,
            sensed: Sensed::default(),
            rng: stream(seed, Purpose::Fingertips, 1),
        };
        bench.host = SessionStatus { is_offered: false, is_open: true, is_alive: true };
        bench.command = Some(Command { mode: mode::ENABLE, ..Command::default() });
        for _ in 0..100 {
            bench.tick();
            if bench.grip.power() == PowerState::Enabled {
                bench.command = None;
                break;
            }
        }
        bench
    }

    /// Sets the command that the host repeats.
    pub fn order(&mut self, command: Command) {
        self.command = Some(command);
    }

    /// Advances by a millisecond.
    pub fn tick(&mut self) {
        let estimates = self.estimates();
        let outputs = self.grip.tick(&ControlInputs {
            estimates: &estimates,
            motor: self.rig.motor.status(),
            host: self.host,
            command: self.command.filter(|_| self.host.is_alive),
            stop: false,
            clear: false,
            faults: self.faults,
            is_sound: Some(true),
            is_calibrating: false,
            acceleration: self.acceleration,
        });
        match outputs.arming {
            Some(ArmingRequest::Arm) => self.rig.motor.handle_command(MotorCommand::Arm),
            Some(ArmingRequest::Disarm) => self.rig.motor.handle_command(MotorCommand::Disarm),
            None => {}
        }
        if let Some(opening_mm) = outputs.opening_mm {
            self.rig.motor.handle_command(MotorCommand::SetOpening { opening_mm });
        }
        if self.rig.motor.status().state == MotorState::Armed {
            self.rig.motor.handle_command(MotorCommand::Setpoint(outputs.setpoint));
        }
        self.outputs = Some(outputs);
        for _ in 0..periods(TICK_S) {
            self.rig.period();
        }
    }

    /// Runs until a condition is true; returns the time in seconds, none on timeout.
    pub fn until(&mut self, seconds: f64, condition: impl Fn(&Self) -> bool) -> Option<f64> {
        let start_s = self.rig.plant.time_s();
        let ticks = (seconds / TICK_S) as u32;
        for _ in 0..ticks {
            if condition(self) {
                return Some(self.rig.plant.time_s() - start_s);
            }
            self.tick();
        }
        None
    }

    /// Runs for a time.
    pub fn run(&mut self, seconds: f64) {
        self.until(seconds, |_| false);
    }

    /// Force estimates of the previous tick, with noise.
    fn estimates(&mut self) -> [Estimate; SENSORS] {
        let now = self.sense();
        let delayed = std::mem::replace(&mut self.sensed, now);
        let mut estimates = [Estimate::MISSING; SENSORS];
        let forces_n = distribute_forces(delayed.grip_n, 0.0, 0.0).into_iter().zip(delayed.along_n);
        let sensors = estimates.iter_mut().zip(self.lost).zip(forces_n);
        for ((estimate, is_lost), ([lateral_n, _], along_n)) in sensors {
            let [lateral, along] = [0, 1].map(|_| NOISE_N / 2_f64.sqrt() * normal(&mut self.rng));
            if !is_lost {
                let newtons = [lateral_n + lateral, along_n + along];
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
        Sensed { grip_n, along_n: self.ground_n.map(|ground_n| ground_n + drag_n / SENSORS as f64) }
    }
}

/// Command of a grip force in newtons, for any width.
pub fn grip_command(set_n: f64) -> Command {
    let profile = if set_n > 100.0 { 2 } else { 0 };
    Command {
        mode: mode::GRIP,
        force: (set_n * 10.0).round() as u16,
        flags: profile & flag::PROFILE,
        ..Command::default()
    }
}

/// Default width of an object in mm.
const WIDTH_MM: f64 = 40.0;
/// Opening that remains after a soft object deforms, in mm.
const MIN_OPENING_MM: f64 = 5.0;

/// Width in mm of an object that is gripped with `set_n`, wide enough for its deformation.
pub fn object_width_mm(set_n: f64, contact_n_per_mm: f64) -> f64 {
    WIDTH_MM.max(set_n / contact_n_per_mm + MIN_OPENING_MM)
}

/// Object whose contact, in series with these flexures, has this stiffness.
pub fn contact_object(
    parameters: &PlantParameters,
    width_mm: f64,
    contact_n_per_mm: f64,
) -> Object {
    let flexures = 1e-3 * parameters.fingers.flexures_n_per_m;
    let own = contact_n_per_mm * flexures / (flexures - contact_n_per_mm);
    Object::new(1e-3 * width_mm, own)
}
