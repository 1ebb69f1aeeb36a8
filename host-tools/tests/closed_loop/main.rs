//! The firmware's control in closed loop with the simulated drivetrain.

mod faults;
mod grasp;
mod gripper;
mod hazards;
mod long_life;

use std::sync::LazyLock;

use model_export::inverse::quantise::TableSet;
use sim::closed_loop;

/// Tables of the nominal design. To be called before a parallel loop and not in it: they are made by parallel loops, whose
/// threads would wait for each other.
fn nominal_tables() -> &'static TableSet {
    static TABLES: LazyLock<TableSet> = LazyLock::new(|| closed_loop::nominal_tables().unwrap());
    &TABLES
}
