//! The design of a sensor: flexure, magnet, gap, material; what it can measure, and what it cannot.
//!
//! - [`beam`]: a flexure under large deflections.
//! - [`material`]: what flexures are made of.
//! - [`assumed`]: what a design rests on where its file does not say otherwise.
//! - [`design`](mod@design): `design.toml`.
//! - [`axis`]: what a force does to an axis.
//! - [`sensitivity`]: how the field answers to a motion.
//! - [`limits`]: what ends the range of forces.
//! - [`judge`]: all of it, of one design.
//! - [`points`]: where a sweep looks, evenly by [`sobol`] or on a grid; [`pareto`]: what no other beats.
//! - [`sweep`]: many designs at once; [`pick`]: one for a force.
//! - [`paper`]: what the paper says of designs, computed.
//! - [`interference`]: what moves the field beside the forces.

pub mod assumed;
pub mod axis;
pub mod beam;
#[allow(clippy::module_inception)] // It is the design itself.
pub mod design;
pub mod interference;
pub mod judge;
pub mod limits;
pub mod material;
pub mod paper;
pub mod pareto;
pub mod pick;
pub mod points;
pub mod sensitivity;
pub mod sobol;
pub mod sweep;

pub use beam::{Beam, Bent, Support};
pub use design::Design;
pub use judge::Judged;
