//! Simulation of the gripper: sensors, fingers, drivetrain, board. It shares no mechanics with the fit.
//!
//! Random numbers come from one stream per purpose, so that adding an effect changes no other draw.
//!
//! - [`mountings`]: orientations of the sensors.
//! - [`finger`], [`flexure`], [`friction`], [`hall_sensor`], [`external_fields`], [`effects`], [`motion`]: one sensor and
//!   what acts on it; shared by all simulators.
//! - [`uncatalogued`]: physics of the effects outside the catalogue; all but one act in campaigns only.
//! - [`campaign`]: data sets of calibration recordings, written as files.
//! - [`drivetrain`]: motor, screw, fingers and object in time.
//! - [`board`]: buses, flash and tasks of the firmware in virtual time.
//! - [`closed_loop`]: firmware, board and drivetrain together.
//! - [`faults`]: fault injection campaigns on the closed loop.

pub mod board;
pub mod campaign;
pub mod closed_loop;
pub mod drivetrain;
pub mod effects;
pub mod external_fields;
pub mod faults;
pub mod finger;
pub mod flexure;
pub mod friction;
pub mod hall_sensor;
pub mod motion;
pub mod mountings;
pub mod random;
pub mod uncatalogued;
