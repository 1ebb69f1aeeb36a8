//! The firmware's control in closed loop with the simulated drivetrain.

mod faults;
mod grasp;
mod gripper;
