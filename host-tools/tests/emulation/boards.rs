//! Boards that run an image.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use emulator::Kind;
use emulator::chip::Profile;
use libtest_mimic::Failed;
use model_export::inverse::build::DeviceModel;
use sim::board::world::{PressedWorld, World};
use sim::closed_loop::coupling::{SharedGripper, SimulatedGripper};
use sim::closed_loop::emulated_board::{ChipConditions, EmulatedBoard};
use sim::closed_loop::motor_rig::MotorRig;
use sim::drivetrain::fingertips::Fingertips;
use sim::drivetrain::parameters::{Lead, PlantParameters};
use sim::drivetrain::sensors::MotorSensors;

use crate::images::{self, Made, Variant};

/// Typical execution times with the slowest sensor buses: those under which the deadlines are to be kept.
pub const TYPICAL: ChipConditions =
    ChipConditions { i2c_delay: ChipConditions::SLOW.i2c_delay, ..ChipConditions::TYPICAL };

/// Both ends of execution times, and their middle.
pub const CONDITIONS: [(&str, ChipConditions); 3] =
    [("fast", ChipConditions::FAST), ("typical", TYPICAL), ("slow", ChipConditions::SLOW)];

/// A gripper at rest with fingers this far apart.
pub fn gripper(parameters: PlantParameters, opening_mm: f64, seed: u64) -> SharedGripper {
    let rig = MotorRig::new(Lead::A, parameters, opening_mm, seed);
    let tips = Fingertips::new(seed, 0.0, &[]).unwrap();
    Rc::new(RefCell::new(SimulatedGripper::new(rig, tips, seed)))
}

/// Currents and angle are measured without noise: what the image knows of its motor is then that nothing flows.
pub fn at_rest(seed: u64) -> SharedGripper {
    let parameters =
        PlantParameters { sensors: MotorSensors::ideal(), ..PlantParameters::nominal(Lead::A) };
    gripper(parameters, 40.0, seed)
}

/// Fingers that press with 100 N.
pub fn pressed(built: &DeviceModel) -> Box<dyn World> {
    let newtons = [[50.0, 0.0], [50.0, 0.0], [-50.0, 0.0], [-50.0, 0.0]];
    Box::new(PressedWorld::new(&built.model, 1, move |_| newtons))
}

/// Limits at one of [`CONDITIONS`].
#[derive(Clone, Copy, Debug)]
pub struct TimeLimits {
    /// Greatest share of the core's time at rest, after the start.
    pub load: f64,
    /// Longest time from the beginning of a tick to its estimate.
    pub estimate_us: u16,
    /// Longest time from there to the end of the first CAN frame with its forces, which takes 135 us; another frame may be on
    /// the bus.
    pub frame_us: u64,
}

/// Limits at each of [`CONDITIONS`].
pub const TIME_LIMITS: [TimeLimits; 3] = [
    TimeLimits { load: 0.44, estimate_us: 370, frame_us: 700 },
    TimeLimits { load: 0.48, estimate_us: 475, frame_us: 800 },
    TimeLimits { load: 0.56, estimate_us: 515, frame_us: 950 },
];

/// Longest tick of sensing and estimating at typical execution times.
pub const WORST_TICK_US: u16 = 420;
/// The same without hits in the caches of the flash.
pub const WORST_TICK_WITHOUT_CACHES_US: u16 = 600;
/// Greatest shares of the core's time from the start, in motion at typical execution times, and in motion or a flood of frames
/// without caches of the flash; and of the stack.
pub const LOAD: f64 = 0.6;
pub const LOAD_WITHOUT_CACHES: f64 = 0.75;
pub const STACK: f64 = 0.75;

/// What of a profile is beyond the limits; `busy` is the share of the core's time.
pub fn overload(profile: &Profile, busy: f64, load: f64) -> Vec<String> {
    let mut wrong = Vec::new();
    if busy > load {
        wrong.push(format!("core {:.1} % busy", 100.0 * busy));
    }
    let share = |[used, available]: [u32; 2]| f64::from(used) / f64::from(available);
    if !profile.stack.map(share).is_some_and(|share| share <= STACK) {
        wrong.push(format!("stack {:?}", profile.stack));
    }
    wrong
}

/// A board with an image.
pub fn board(made: &Made, conditions: ChipConditions, world: Box<dyn World>) -> EmulatedBoard {
    EmulatedBoard::start(made.image.clone(), conditions, world, at_rest(conditions.seed)).unwrap()
}

/// The image, or why there is none.
pub fn image(variant: Variant) -> Result<Arc<Made>, Failed> {
    images::get(variant).map_err(Failed::from)
}

/// Misuse of the chip that is known, with the reason.
const KNOWN: [(Kind, &str); 0] = [];

/// Accesses that indicate a firmware bug.
pub fn violations(board: &EmulatedBoard) -> Vec<String> {
    let image = board.chip.image();
    let found = board.chip.soc.violations.iter();
    let unknown = found.filter(|violation| !KNOWN.contains(&(violation.kind, violation.detail)));
    unknown.map(|violation| format!("{violation}, {}", image.place(violation.pc))).collect()
}
