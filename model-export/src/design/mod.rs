//! Mechanical and magnetic design of a sensor: what a design can measure, and what limits it.
//!
//! - [`beam`]: flexures at large deflections.
//! - [`material`]: stiffness, yield and fatigue of flexure materials.
//! - [`design_file`]: `design.toml` and its assumed defaults.
//! - [`axis`]: response and sensitivity of one axis.
//! - [`evaluation`]: range, its limits and resolution of a design.
//! - [`interference`]: field changes that are not caused by forces.
//! - [`sampling`]: points of the design space, by Sobol's sequence or on a grid.
//! - [`sweep`]: many designs and their Pareto front.
//! - [`optimise`]: the best design for a force.

pub mod axis;
pub mod beam;
pub mod design_file;
pub mod evaluation;
pub mod interference;
pub mod material;
pub mod optimise;
pub mod sampling;
pub mod sweep;

pub use beam::{Beam, BeamResponse, Support};
pub use design_file::SensorDesign;
pub use evaluation::DesignEvaluation;
