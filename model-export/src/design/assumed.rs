//! What a design rests on where its file does not say otherwise.

use firmware::params::{Constant, assumed, stated};

/// Width of the paper's beam.
pub const BEAM_WIDTH: Constant = stated("beam width", 15.0, "mm", "paper V-B");
/// Thickness of the paper's beam.
pub const BEAM_THICKNESS: Constant = stated("beam thickness", 5.0, "mm", "paper V-B");
/// Motion at which a stop takes over.
pub const STROKE: Constant = stated("stroke of a flexure", 0.5, "mm", "paper V-B");
/// Reversed cycles of the full range.
pub const LIFE: Constant = assumed("life", 1e7, "cycles", "a step a second for four months");
/// Stress borne by stress allowed.
pub const SAFETY: Constant = assumed("safety", 1.5, "", "smooth specimens, no notches");
/// From the Hall element to the surface of its package.
pub const PACKAGE: Constant = assumed(
    "depth of the Hall element",
    0.4,
    "mm",
    "half a DFN of 0.75 mm",
);

/// All of them; tolerances of manufacture stand with the parameters of a fit.
pub const ALL: [Constant; 6] = [BEAM_WIDTH, BEAM_THICKNESS, STROKE, LIFE, SAFETY, PACKAGE];
