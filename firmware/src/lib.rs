//! What the gripper's firmware, the replay, the simulator and the tests share.
//!
//! The modules stand in the order in which data flows; each uses only those above it.
//!
//! - [`params`]: every design constant with its unit and source, assumptions marked.
//! - [`limits`]: where something counts as wrong.
//! - [`fixed`]: integer arithmetic that saturates.
//! - [`checksum`]: of what is kept.
//! - [`units`]: fixed-point quantities.
//! - [`clock`]: time as the loops see it.
//! - [`bus_timing`]: the clock of an I2C bus.
//! - [`hall`]: Hall sensors, from bytes on the bus to readings.
//! - [`imu`]: inertial sensors.
//! - [`frame`]: one millisecond of sensing.
//! - [`surroundings`]: what the board knows beside the fields.
//! - [`compensate`]: physical effects undone, one file each.
//! - [`model`]: tables, and the integer arithmetic that turns a field into forces.
//! - [`force`]: the estimate, with its validity.
//! - [`recurrent`]: networks over the estimates.
//! - [`foreign`]: a foreign magnet noticed.
//! - [`estimator`]: a frame in, forces out.
//! - [`astray`]: networks that say something else than the physics.
//! - [`balance`]: fingers that press alike.
//! - [`tare`]: what is told without a load, taken off.
//! - [`motor`]: current, speed and place of the motor.
//! - [`wire`]: the messages on the CAN bus and on the serial line.
//! - [`session`]: who may move the gripper.
//! - [`throttle`]: more frames than anybody may mean.
//! - [`parameters`]: what a host may change at run time.
//! - [`store`]: parameters in flash.
//! - [`crash`]: what is left of a crash.
//! - [`progress`]: whether every loop moves on.
//! - [`status`]: what is wrong, and where.
//! - [`grip`]: the grasp, and the gripper as a foot.
//! - [`events`]: what happened, for those below.
//! - [`loops`]: what runs, on the chip and in virtual time.
//! - `hardware`: only on the chip: the board.
//! - `tasks`: only on the chip: what runs, and every static with its one writer.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod checksum;
pub mod fixed;
pub mod limits;
pub mod params;
pub mod units;

pub mod clock;

pub mod bus_timing;

pub mod hall;

pub mod imu;

pub mod frame;
pub mod surroundings;

pub mod compensate;

pub mod model;

pub mod force;

pub mod recurrent;

pub mod foreign;

pub mod estimator;

pub mod astray;
pub mod balance;

pub mod tare;

pub mod motor;

pub mod wire;

pub mod session;
pub mod throttle;

pub mod parameters;

pub mod store;

pub mod crash;

pub mod progress;

pub mod status;

pub mod grip;

pub mod events;

#[cfg(target_os = "none")]
pub mod hardware;
pub mod loops;

#[cfg(target_os = "none")]
pub mod tasks;
