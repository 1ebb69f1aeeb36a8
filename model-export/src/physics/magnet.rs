//! Exact fields of permanent magnets, and their gradients.
//!
//! Every field is a closed form: that of `magba` for the cylinder (axial: Derby and Olbert 2010;
//! diametric: Caciagli et al. 2018) and the cube, a dipole's for the sphere, and for the tube that of
//! its outer cylinder less that of its hole. All are checked here against MagpyLib. Gradients are
//! closed forms for cube and sphere, else differences completed by what a static field obeys.
//!
//! - [`cylinder`]: along its axis or across it, and a tube.
//! - [`cube`]: along an edge.
//! - [`sphere`]: a dipole, exactly.
//! - [`difference`]: a gradient from four fields.

pub mod cube;
pub mod cylinder;
pub mod difference;
pub mod sphere;

use nalgebra::{Matrix3, Vector3};

pub use cylinder::Cylinder;

use crate::recordings::description::{self, Shape};

/// Gauss in a tesla.
pub const GAUSS_PER_TESLA: f64 = 1e4;

/// A uniformly magnetised body in its own frame: its centre is the origin, its axis `z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnet {
    /// Shape and size.
    pub body: Body,
    /// Direction of its magnetisation in the body.
    pub magnetised: Magnetised,
}

/// Shapes whose field is known in closed form. Lengths are in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body {
    /// Full, round.
    Cylinder(Cylinder),
    /// With a round hole all along its axis.
    Tube {
        /// The cylinder that the hole is in.
        outer: Cylinder,
        /// Diameter of the hole.
        hole_mm: f64,
    },
    /// All edges alike.
    Cube {
        /// Length of an edge.
        side_mm: f64,
    },
    /// A ball.
    Sphere {
        /// Diameter.
        diameter_mm: f64,
    },
}

/// Direction of the magnetisation in the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Magnetised {
    /// Along the body's axis.
    Axial,
    /// Along `x`, across the body's axis.
    Diametric,
}

impl Magnet {
    /// The magnet that a design describes.
    pub fn of(magnet: &description::Magnet) -> Self {
        let body = match magnet.shape {
            Shape::Cylinder {
                diameter_mm,
                length_mm,
            } => Body::Cylinder(Cylinder {
                diameter_mm,
                length_mm,
            }),
            Shape::Tube {
                diameter_mm,
                hole_mm,
                length_mm,
            } => Body::Tube {
                outer: Cylinder {
                    diameter_mm,
                    length_mm,
                },
                hole_mm,
            },
            Shape::Cube { side_mm } => Body::Cube { side_mm },
            Shape::Sphere { diameter_mm } => Body::Sphere { diameter_mm },
        };
        let magnetised = match magnet.body_axis == Some(magnet.axis) || magnet.body_axis.is_none() {
            true => Magnetised::Axial,
            false => Magnetised::Diametric,
        };
        Self { body, magnetised }
    }

    /// Field in gauss for each tesla of remanence at `at_mm`, outside the magnet.
    pub fn unit_field(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        match (self.body, self.magnetised) {
            (Body::Cylinder(cylinder), Magnetised::Axial) => cylinder.unit_field(at_mm),
            (Body::Cylinder(cylinder), Magnetised::Diametric) => cylinder.diametric(at_mm),
            (Body::Tube { outer, hole_mm }, magnetised) => {
                let of = |body| Self { body, magnetised }.unit_field(at_mm);
                of(Body::Cylinder(outer)) - of(hole(outer, hole_mm))
            }
            (Body::Cube { side_mm }, _) => cube::unit_field(side_mm, self.direction(), at_mm),
            (Body::Sphere { diameter_mm }, _) => {
                sphere::unit_field(diameter_mm, self.direction(), at_mm)
            }
        }
    }

    /// The field and its gradient, `gradient[(i, j)]` = dB_i/dx_j in gauss per mm and tesla.
    pub fn unit_field_and_gradient(&self, at_mm: Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        match (self.body, self.magnetised) {
            (Body::Cylinder(cylinder), Magnetised::Axial) => {
                cylinder.unit_field_and_gradient(at_mm)
            }
            (Body::Cylinder(cylinder), Magnetised::Diametric) => {
                difference::field_and_gradient(at_mm, |at_mm| cylinder.diametric(at_mm))
            }
            (Body::Tube { outer, hole_mm }, magnetised) => {
                let of = |body| Self { body, magnetised }.unit_field_and_gradient(at_mm);
                let (full, full_gradient) = of(Body::Cylinder(outer));
                let (less, less_gradient) = of(hole(outer, hole_mm));
                (full - less, full_gradient - less_gradient)
            }
            (Body::Cube { side_mm }, _) => (
                self.unit_field(at_mm),
                cube::unit_gradient(side_mm, self.magnetised, at_mm),
            ),
            (Body::Sphere { diameter_mm }, _) => (
                self.unit_field(at_mm),
                sphere::unit_gradient(diameter_mm, self.direction(), at_mm),
            ),
        }
    }

    /// From the centre to the surface along the body's axis, in mm.
    pub fn half_length_mm(&self) -> f64 {
        match self.body {
            Body::Cylinder(cylinder)
            | Body::Tube {
                outer: cylinder, ..
            } => 0.5 * cylinder.length_mm,
            Body::Cube { .. } | Body::Sphere { .. } => self.half_width_mm(),
        }
    }

    /// From the centre to the surface across the body's axis, in mm.
    pub fn half_width_mm(&self) -> f64 {
        0.5 * match self.body {
            Body::Cylinder(cylinder)
            | Body::Tube {
                outer: cylinder, ..
            } => cylinder.diameter_mm,
            Body::Cube { side_mm } => side_mm,
            Body::Sphere { diameter_mm } => diameter_mm,
        }
    }

    /// Volume in mm^3; with the remanence it is all that counts from afar.
    pub fn volume_mm3(&self) -> f64 {
        match self.body {
            Body::Cylinder(cylinder) => cylinder.volume_mm3(),
            Body::Tube { outer, hole_mm } => {
                let hole = Cylinder {
                    diameter_mm: hole_mm,
                    ..outer
                };
                outer.volume_mm3() - hole.volume_mm3()
            }
            Body::Cube { side_mm } => side_mm.powi(3),
            Body::Sphere { diameter_mm } => std::f64::consts::PI / 6.0 * diameter_mm.powi(3),
        }
    }

    fn direction(&self) -> Vector3<f64> {
        match self.magnetised {
            Magnetised::Axial => Vector3::z(),
            Magnetised::Diametric => Vector3::x(),
        }
    }
}

/// What a tube's hole lacks.
fn hole(outer: Cylinder, hole_mm: f64) -> Body {
    Body::Cylinder(Cylinder {
        diameter_mm: hole_mm,
        ..outer
    })
}

#[cfg(test)]
mod tests;
