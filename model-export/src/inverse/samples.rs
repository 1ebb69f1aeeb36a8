//! Fields with the forces that explain them best: what an inverse is fitted to and judged by.
//!
//! Without noise all fields of a sensor lie on a surface, and a model of three axes could do
//! anything off it. So samples also lie beside the surface, along the gap axis, and their forces are
//! those of the nearest point on it. The gap axis counts little in that distance: it is where
//! temperature, a changed gap and a neighbour's magnet show first, and the in-plane axes tell the
//! forces without it.

use nalgebra::{Matrix2, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::at_rest::AtRest;
use super::design_box::{DesignBox, lattice};
use crate::physics::sensor::GAP_WEIGHT;

/// How far beside the surface samples lie, in gauss.
const BESIDE_G: f64 = 15.0;
/// Fitted loads go this far beyond the box, so that its edge is not the edge of what was seen.
const BEYOND: f64 = 1.08;

/// A field and its forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Gauss.
    pub field_g: Vector3<f64>,
    /// Newtons, lateral and longitudinal.
    pub force_n: [f64; 2],
}

/// Samples to fit: a lattice of loads, on the surface and beside it on both sides.
pub fn training(model: &AtRest, design: &DesignBox) -> Vec<Sample> {
    let loads: Vec<[f64; 2]> = lattice(design.force_n.map(|f| f * BEYOND), 25).collect();
    let beside = [-BESIDE_G, 0.0, BESIDE_G];
    loads
        .iter()
        .flat_map(|load| beside.map(|by| sample(model, *load, by)))
        .collect()
}

/// Samples to judge: random loads in the box, on the surface or up to that far beside it.
pub fn held_out(model: &AtRest, design: &DesignBox, count: usize, seed: u64) -> Vec<Sample> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let load = design
                .force_n
                .map(|limit| limit * rng.random_range(-1.0..=1.0));
            sample(model, load, BESIDE_G * rng.random_range(-1.0..=1.0))
        })
        .collect()
}

fn sample(model: &AtRest, load_n: [f64; 2], beside_g: f64) -> Sample {
    let mut field_g = model.field(load_n);
    field_g.y += beside_g;
    Sample {
        field_g,
        force_n: nearest(model, &field_g, load_n),
    }
}

/// The forces whose field is nearest to `field_g`, from a start close by.
pub fn nearest(model: &AtRest, field_g: &Vector3<f64>, start_n: [f64; 2]) -> [f64; 2] {
    let weight = Vector3::new(1.0, GAP_WEIGHT, 1.0);
    let mut force = Vector2::from(start_n);
    for _ in 0..6 {
        let [gx, gz] = model.per_newton(force.into());
        let (wx, wz) = (gx.component_mul(&weight), gz.component_mul(&weight));
        let residual = field_g - model.field(force.into());
        let normal = Matrix2::new(wx.dot(&gx), wx.dot(&gz), wz.dot(&gx), wz.dot(&gz));
        let right = Vector2::new(wx.dot(&residual), wz.dot(&residual));
        let Some(inverse) = normal.try_inverse() else {
            break;
        };
        force += inverse * right;
    }
    force.into()
}
