//! Boards that run an image.

use std::cell::RefCell;
use std::rc::Rc;

use host_tools::board::emulated::{Conditions, EmulatedBoard};
use host_tools::board::pressed::Pressed;
use host_tools::board::world::World;
use host_tools::drive::Rig;
use host_tools::drive::world::{Gripper, Shared};
use host_tools::plant::hall::Fingertips;
use host_tools::plant::parameters::{Lead, Parameters};
use host_tools::plant::sensing::Sensors;
use libtest_mimic::Failed;
use model_export::inverse::build::Built;
use sim_board::Kind;

use crate::images::{self, Made, Variant};

pub const CONDITIONS: [(&str, Conditions); 3] = [
    ("fast", Conditions::FAST),
    ("typical", Conditions::TYPICAL),
    ("slow", Conditions::SLOW),
];

/// A gripper at rest with fingers this far apart.
pub fn gripper(parameters: Parameters, opening_mm: f64, seed: u64) -> Shared {
    let rig = Rig::new(Lead::A, parameters, opening_mm, seed);
    let tips = Fingertips::new(seed, 0.0, &[]).unwrap();
    Rc::new(RefCell::new(Gripper::new(rig, tips, seed)))
}

/// Currents and angle are measured without noise: what the image knows of its motor is then that nothing flows.
pub fn at_rest(seed: u64) -> Shared {
    let parameters = Parameters {
        sensors: Sensors::ideal(),
        ..Parameters::nominal(Lead::A)
    };
    gripper(parameters, 40.0, seed)
}

/// Fingers that press with 100 N.
pub fn pressed(built: &Built) -> Box<dyn World> {
    let newtons = [[50.0, 0.0], [50.0, 0.0], [-50.0, 0.0], [-50.0, 0.0]];
    Box::new(Pressed::new(&built.model, 1, move |_| newtons))
}

/// A board with an image.
pub fn board(made: &Made, conditions: Conditions, world: Box<dyn World>) -> EmulatedBoard {
    EmulatedBoard::start(
        made.image.clone(),
        conditions,
        world,
        at_rest(conditions.seed),
    )
    .unwrap()
}

/// The image, or why there is none.
pub fn image(variant: Variant) -> Result<Made, Failed> {
    images::get(variant).map_err(Failed::from)
}

/// Misuse of the chip that is known, with the reason.
const KNOWN: [(Kind, &str); 0] = [];

/// Whatever no sound program does.
pub fn violations(board: &EmulatedBoard) -> Vec<String> {
    let image = board.chip.image();
    let found = board.chip.soc.violations.iter();
    let unknown = found.filter(|violation| !KNOWN.contains(&(violation.kind, violation.detail)));
    unknown
        .map(|violation| format!("{violation}, {}", image.place(violation.pc)))
        .collect()
}
