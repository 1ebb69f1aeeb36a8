//! How a gripper is made: every sensor departs a little from the nominal design.

use model_export::physics::Magnet;
use model_export::physics::sensor::{reach_mm, upright};
use model_export::recordings::description::Design;
use nalgebra::{Rotation3, Vector3};
use serde::Serialize;

use super::draw::{Purpose, normal, normals, stream};

/// One standard deviation of each, assumed of careful work by hand.
const STIFFNESS: f64 = 0.05;
const REMANENCE: f64 = 0.02;
const GAP_MM: f64 = 0.05;
const OFFSET_MM: f64 = 0.05;
const TILT_DEG: f64 = 1.0;
const ROTATION_DEG: f64 = 0.7;
const BIAS_G: f64 = 2.0;

/// One sensor as it was made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Made {
    /// Its number.
    pub number: u32,
    /// Stiffness of the lateral and the longitudinal flexure.
    pub stiffness_n_per_mm: [f64; 2],
    /// Remanence of the magnet.
    pub remanence_t: f64,
    /// Face of the magnet to the element.
    pub gap_mm: f64,
    /// Misplacement of the magnet along x and z.
    pub offset_mm: [f64; 2],
    /// Tilt of the magnet's axis about x and z.
    pub tilt_rad: [f64; 2],
    /// Rotation vector of the element against the gripper.
    pub rotation_rad: [f64; 3],
    /// The element's own offset, in its axes.
    pub bias_g: [f64; 3],
    /// Shape and size of the magnet, which are always nominal.
    #[serde(skip)]
    pub magnet: Magnet,
    /// From the magnet's own frame to the gripper's, before it is tilted.
    #[serde(skip)]
    pub upright: Rotation3<f64>,
    /// From its centre to its face, in mm.
    #[serde(skip)]
    pub reach_mm: f64,
}

impl Made {
    /// Draws a sensor; `scatter` multiplies all departures, 0 makes it perfect.
    pub fn draw(design: &Design, number: u32, seed: u64, scatter: f64) -> Self {
        let mut rng = stream(seed, Purpose::Scatter, number);
        let (magnet, axis) = (Magnet::of(&design.magnet), design.magnet.axis);
        let body_axis = design.magnet.body_axis.unwrap_or(axis);
        let mut depart = |deviation: f64| scatter * deviation * normal(&mut rng);
        Self {
            number,
            stiffness_n_per_mm: [
                design.stiffness_x_n_per_mm * (1.0 + depart(STIFFNESS)),
                design.stiffness_z_n_per_mm * (1.0 + depart(STIFFNESS)),
            ],
            remanence_t: design.magnet.remanence_t * (1.0 + depart(REMANENCE)),
            gap_mm: design.gap_mm + depart(GAP_MM),
            offset_mm: [depart(OFFSET_MM), depart(OFFSET_MM)],
            tilt_rad: [depart(TILT_DEG), depart(TILT_DEG)].map(f64::to_radians),
            rotation_rad: (normals(&mut rng) * (scatter * ROTATION_DEG).to_radians()).into(),
            bias_g: (normals(&mut rng) * scatter * BIAS_G).into(),
            upright: upright(&magnet, axis, body_axis),
            reach_mm: reach_mm(&magnet, axis, body_axis),
            magnet,
        }
    }

    /// The element's rotation vector.
    pub fn rotation(&self) -> Vector3<f64> {
        Vector3::from(self.rotation_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_scatter_every_sensor_is_nominal() {
        let made = Made::draw(&Design::magpie(), 2, 7, 0.0);
        assert_eq!(made.stiffness_n_per_mm, [500.0, 800.0]);
        assert_eq!((made.gap_mm, made.bias_g), (1.5, [0.0; 3]));
    }

    #[test]
    fn sensors_are_made_differently_and_repeatably() {
        let made = |number| Made::draw(&Design::magpie(), number, 7, 1.0);
        assert_eq!(made(0), made(0));
        assert_ne!(made(0).gap_mm, made(1).gap_mm);
    }
}
