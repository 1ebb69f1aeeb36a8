//! What the paper says of magnets, sensitivity and materials, computed and judged.
//!
//! - [`curves`]: its figures as numbers.
//! - [`claims`]: its statements, each with what is found.

pub mod claims;
pub mod curves;

use super::design::Design;
use super::interference::Surroundings;
use super::sweep::{Candidate, Space, sweep};
use claims::Claim;
use curves::Curve;

/// The paper's gap, from its caption, in mm.
pub const GAP_MM: f64 = 1.5;
/// Length of the magnet in the paper's caption, in mm.
pub const HEIGHT_MM: f64 = 2.0;
/// Motion of the magnet in the paper's figures, either way, in mm.
pub const MOTION_MM: f64 = 3.0;
/// Materials of the paper's figure: one plastic, one metal.
pub const MATERIALS: [&str; 2] = ["ABS", "17-4PH"];

/// The paper's figures and statements.
#[derive(Clone, Debug)]
pub struct Paper {
    /// Field over motion of four shapes in a box of 2.5 mm.
    pub shapes: Vec<Curve>,
    /// S over motion, for several diameters.
    pub motion: Vec<Curve>,
    /// Greatest S over the magnet's length, for several diameters.
    pub length: Vec<Curve>,
    /// Greatest S over the magnet's diameter, for several lengths.
    pub diameter: Vec<Curve>,
    /// Greatest S over the gap.
    pub gap: Vec<Curve>,
    /// Field of the opposite magnet over its distance, for several magnets.
    pub neighbour: Vec<Curve>,
    /// Designs of each of [`MATERIALS`].
    pub designs: [Vec<Candidate>; 2],
    /// Its statements.
    pub claims: Vec<Claim>,
}

impl Paper {
    /// Computed, with `count` designs of each material; `done` is called after each of them.
    pub fn of(count: u32, around: &Surroundings, done: impl Fn() + Sync) -> Self {
        let base = Design::magpie();
        let designs = MATERIALS.map(|material| {
            let space = Space {
                materials: vec![material.to_owned()],
                ..Space::default()
            };
            sweep(&base, &space, count, around, &done)
        });
        Self {
            shapes: curves::shapes(),
            motion: curves::motion(),
            length: curves::length(),
            diameter: curves::diameter(),
            gap: curves::gap(),
            neighbour: curves::neighbour(),
            claims: claims::of(&designs),
            designs,
        }
    }
}
