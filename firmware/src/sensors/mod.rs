//! Drivers of the sensors: Hall sensors at the magnets, an inertial sensor on the gripper.

pub mod hall;
pub mod imu;
