//! Exact fields of permanent magnets, and their gradients.
//!
//! Every field is a closed form: the cylinder magnetised along its axis (Derby and Olbert 2010), the cylinder magnetised across it
//! (Caciagli et al. 2018) and the cube from `magba`, the sphere as a dipole, the tube as its outer cylinder minus its hole. All are
//! verified against MagpyLib. Gradients are closed forms, or for magnetisation across a cylinder central differences combined with
//! curl B = 0 and div B = 0.

use magba::fields::{cuboid_B, sphere_B};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use crate::recordings::description::{MagnetShape, MagnetSpec};

pub mod cylinder;

pub use cylinder::Cylinder;

/// Gauss per tesla.
pub(crate) const GAUSS_PER_TESLA: f64 = 1e4;

/// A uniformly magnetised body in the body frame: origin at the centre, axis along `z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnet {
    /// Shape and dimensions.
    pub body: MagnetBody,
    /// Direction of the magnetisation in the body frame.
    pub magnetised: Magnetisation,
}

/// Shapes with a closed-form field; lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MagnetBody {
    /// Solid cylinder.
    Cylinder(Cylinder),
    /// Cylinder with a coaxial through hole.
    Tube {
        /// The cylinder without the hole.
        outer: Cylinder,
        /// Diameter of the hole.
        hole_mm: f64,
    },
    /// Cube.
    Cube {
        /// Length of an edge.
        side_mm: f64,
    },
    /// Sphere.
    Sphere {
        /// Diameter.
        diameter_mm: f64,
    },
}

/// Direction of the magnetisation in the body frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Magnetisation {
    /// Along the body's axis.
    Axial,
    /// Along `x`, across the body's axis.
    Diametric,
}

impl Magnet {
    /// The magnet that a design describes.
    pub fn of(magnet: &MagnetSpec) -> Self {
        let body = match magnet.shape {
            MagnetShape::Cylinder { diameter_mm, length_mm } => {
                MagnetBody::Cylinder(Cylinder { diameter_mm, length_mm })
            }
            MagnetShape::Tube { diameter_mm, hole_mm, length_mm } => {
                MagnetBody::Tube { outer: Cylinder { diameter_mm, length_mm }, hole_mm }
            }
            MagnetShape::Cube { side_mm } => MagnetBody::Cube { side_mm },
            MagnetShape::Sphere { diameter_mm } => MagnetBody::Sphere { diameter_mm },
        };
        let magnetised = if magnet.body_axis.is_none_or(|axis| axis == magnet.axis) {
            Magnetisation::Axial
        } else {
            Magnetisation::Diametric
        };
        Self { body, magnetised }
    }

    /// Field at `at_mm` (outside the magnet) in gauss per tesla of remanence.
    pub fn unit_field(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        match (self.body, self.magnetised) {
            (MagnetBody::Cylinder(cylinder), Magnetisation::Axial) => cylinder.unit_field(at_mm),
            (MagnetBody::Cylinder(cylinder), Magnetisation::Diametric) => cylinder.diametric(at_mm),
            (MagnetBody::Tube { outer, hole_mm }, magnetised) => {
                let of = |body| Self { body, magnetised }.unit_field(at_mm);
                of(MagnetBody::Cylinder(outer)) - of(hole(outer, hole_mm))
            }
            (MagnetBody::Cube { side_mm }, _) => cube_field(side_mm, self.direction(), at_mm),
            (MagnetBody::Sphere { diameter_mm }, _) => {
                sphere_field(diameter_mm, self.direction(), at_mm)
            }
        }
    }

    /// Field and gradient: `gradient[(i, j)]` = dB_i/dx_j in gauss per mm and tesla.
    pub fn unit_field_and_gradient(&self, at_mm: Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        match (self.body, self.magnetised) {
            (MagnetBody::Cylinder(cylinder), Magnetisation::Axial) => {
                cylinder.unit_field_and_gradient(at_mm)
            }
            (MagnetBody::Cylinder(cylinder), Magnetisation::Diametric) => {
                cylinder::field_and_gradient(at_mm, |at_mm| cylinder.diametric(at_mm))
            }
            (MagnetBody::Tube { outer, hole_mm }, magnetised) => {
                let of = |body| Self { body, magnetised }.unit_field_and_gradient(at_mm);
                let (full, full_gradient) = of(MagnetBody::Cylinder(outer));
                let (less, less_gradient) = of(hole(outer, hole_mm));
                (full - less, full_gradient - less_gradient)
            }
            (MagnetBody::Cube { side_mm }, _) => {
                (self.unit_field(at_mm), cube_gradient(side_mm, self.magnetised, at_mm))
            }
            (MagnetBody::Sphere { diameter_mm }, _) => {
                (self.unit_field(at_mm), sphere_gradient(diameter_mm, self.direction(), at_mm))
            }
        }
    }

    /// [`Magnet::unit_field`] at many points.
    pub fn unit_fields(&self, at_mm: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        match (self.body, self.magnetised) {
            (MagnetBody::Cylinder(cylinder), Magnetisation::Axial) => cylinder.unit_fields(at_mm),
            _ => at_mm.iter().map(|at_mm| self.unit_field(*at_mm)).collect(),
        }
    }

    /// [`Magnet::unit_field_and_gradient`] at many points.
    pub(crate) fn unit_fields_and_gradients(
        &self,
        at_mm: &[Vector3<f64>],
    ) -> Vec<(Vector3<f64>, Matrix3<f64>)> {
        match (self.body, self.magnetised) {
            (MagnetBody::Cylinder(cylinder), Magnetisation::Axial) => {
                cylinder.unit_fields_and_gradients(at_mm)
            }
            _ => at_mm.iter().map(|at_mm| self.unit_field_and_gradient(*at_mm)).collect(),
        }
    }

    /// Distance from the centre to the surface along the body axis in mm.
    pub(crate) fn half_length_mm(&self) -> f64 {
        match self.body {
            MagnetBody::Cylinder(cylinder) | MagnetBody::Tube { outer: cylinder, .. } => {
                0.5 * cylinder.length_mm
            }
            MagnetBody::Cube { .. } | MagnetBody::Sphere { .. } => self.half_width_mm(),
        }
    }

    /// Distance from the centre to the surface perpendicular to the body axis in mm.
    pub(crate) fn half_width_mm(&self) -> f64 {
        0.5 * match self.body {
            MagnetBody::Cylinder(cylinder) | MagnetBody::Tube { outer: cylinder, .. } => {
                cylinder.diameter_mm
            }
            MagnetBody::Cube { side_mm } => side_mm,
            MagnetBody::Sphere { diameter_mm } => diameter_mm,
        }
    }

    fn direction(&self) -> Vector3<f64> {
        match self.magnetised {
            Magnetisation::Axial => Vector3::z(),
            Magnetisation::Diametric => Vector3::x(),
        }
    }
}

/// The cylinder removed from a tube.
fn hole(outer: Cylinder, hole_mm: f64) -> MagnetBody {
    MagnetBody::Cylinder(Cylinder { diameter_mm: hole_mm, ..outer })
}

/// Field of a cube, magnetised along an edge, in gauss per tesla of remanence.
fn cube_field(side_mm: f64, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Vector3<f64> {
    let unit_field_t = cuboid_B(
        Point3::from(at_mm),
        Point3::origin(),
        UnitQuaternion::identity(),
        direction,
        Vector3::repeat(side_mm),
    );
    unit_field_t * GAUSS_PER_TESLA
}

/// Gradient of [`cube_field`]: with magnetic charges on two faces, a sum of fractions over the eight corners.
fn cube_gradient(side_mm: f64, magnetised: Magnetisation, at_mm: Vector3<f64>) -> Matrix3<f64> {
    match magnetised {
        Magnetisation::Axial => axial_cube_gradient(side_mm, at_mm),
        // Symmetric under exchange of x and z.
        Magnetisation::Diametric => {
            let swap = |v: Vector3<f64>| Vector3::new(v.z, v.y, v.x);
            let swapped = axial_cube_gradient(side_mm, swap(at_mm));
            Matrix3::from_fn(|i, j| swapped[(2 - i, 2 - j)])
        }
    }
}

fn axial_cube_gradient(side_mm: f64, at_mm: Vector3<f64>) -> Matrix3<f64> {
    // In the octant of positive coordinates all terms are regular outside the cube.
    let side = at_mm.map(|v| 1.0_f64.copysign(v));
    let at = at_mm.abs();
    let half = 0.5 * side_mm;
    let (mut xx, mut xy, mut xz, mut yy, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for corner in 0..8 {
        let [sx, sy, sz] = [0, 1, 2].map(|bit| if (corner >> bit) & 1 == 0 { 1.0 } else { -1.0 });
        let to = at - half * Vector3::new(sx, sy, sz);
        let r = to.norm();
        let weight = sx * sy * sz / r;
        xx -= weight * to.x / (r + to.y);
        xz -= weight * to.z / (r + to.y);
        yy -= weight * to.y / (r + to.x);
        yz -= weight * to.z / (r + to.x);
        xy -= weight;
    }
    let zz = -(xx + yy);
    let octant = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    // The potential is even in x and y and odd in z; each derivative inverts the parity.
    let scale = side.z * GAUSS_PER_TESLA / (4.0 * std::f64::consts::PI);
    Matrix3::from_fn(|i, j| octant[(i, j)] * side[i] * side[j] * scale)
}

/// Field of a sphere, that of a dipole at its centre, in gauss per tesla of remanence.
fn sphere_field(diameter_mm: f64, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Vector3<f64> {
    let unit_field_t = sphere_B(
        Point3::from(at_mm),
        Point3::origin(),
        UnitQuaternion::identity(),
        direction,
        diameter_mm,
    );
    unit_field_t * GAUSS_PER_TESLA
}

/// Gradient of [`sphere_field`] in gauss per mm and tesla.
fn sphere_gradient(diameter_mm: f64, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Matrix3<f64> {
    let r = at_mm.norm();
    let outward = at_mm / r;
    let along = direction.dot(&outward);
    let mixed = direction * outward.transpose();
    let moment = GAUSS_PER_TESLA * (0.5 * diameter_mm).powi(3) / 3.0;
    let gradient = mixed + mixed.transpose() + Matrix3::identity() * along
        - outward * outward.transpose() * (5.0 * along);
    gradient * (3.0 * moment / r.powi(4))
}

#[cfg(test)]
mod tests;
