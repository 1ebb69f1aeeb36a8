//! Sensors: Hall sensors at the magnets, an inertial sensor on the gripper, thermistors at motor and power stage.

pub mod hall;
pub mod imu;
pub mod thermistor;
