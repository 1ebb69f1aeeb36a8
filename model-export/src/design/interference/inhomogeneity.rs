//! A magnet that is weaker than its grade: demagnetised, or not of one piece magnetically.
//!
//! A tare takes off what this does at rest. What is left grows with the load, so it is stated with both
//! forces at their greatest.

use firmware::params::{Constant, stated};

use super::{Inverse, Sensed, Shift, Surroundings, sizes};

/// Share of its strength that a magnet may lack.
pub const WEAKER: Constant = stated("magnet's inhomogeneity", 0.01, "", "paper IV-C, below 1 %");

/// Of a magnet so much weaker, at full load and after a tare.
pub fn shift(sensed: &Sensed, around: &Surroundings) -> Shift {
    let model = &sensed.model;
    let full = [model.force_range_n; 2];
    let moved = model.field(full) - model.field([0.0; 2]);
    let inverse = Inverse::at(model, full);
    Shift::new(
        ("inhomogeneity", "at full load, after a tare"),
        sizes(moved * around.weaker, &inverse),
        sensed,
    )
}
