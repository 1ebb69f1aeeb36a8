//! The paper's figures of fields and sensitivity, as numbers.

use nalgebra::Vector3;

use super::{GAP_MM, HEIGHT_MM, MOTION_MM};
use crate::design::interference::neighbour;
use crate::design::sensitivity::slope;
use crate::physics::ForwardModel;
use crate::recordings::description::{Design, Shape};

/// Points of a curve.
const POINTS: u32 = 80;

/// Diameters of the curves in mm.
const DIAMETERS_MM: [f64; 4] = [2.0, 3.0, 5.0, 8.0];

/// A curve of a figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Whose it is.
    pub name: String,
    /// Its points.
    pub points: Vec<[f64; 2]>,
}

/// An axially magnetised magnet that faces the sensor.
pub fn facing(shape: Shape, gap_mm: f64) -> ForwardModel {
    let mut design = Design::magpie();
    design.magnet.shape = shape;
    design.gap_mm = gap_mm;
    ForwardModel::nominal(&design)
}

/// A cylinder that faces the sensor.
pub fn cylinder(diameter_mm: f64, length_mm: f64, gap_mm: f64) -> ForwardModel {
    let shape = Shape::Cylinder {
        diameter_mm,
        length_mm,
    };
    facing(shape, gap_mm)
}

/// S = dBx/dx in G/mm with the magnet displaced by `x_mm`.
pub fn sensitivity(model: &ForwardModel, x_mm: f64) -> f64 {
    slope(model, Vector3::x(), x_mm).x
}

/// Greatest size of S over the paper's motion in G/mm, and where in mm.
pub fn greatest(model: &ForwardModel) -> (f64, f64) {
    let sizes = steps(0.0, MOTION_MM).map(|x_mm| (sensitivity(model, x_mm).abs(), x_mm));
    sizes.fold(
        (0.0, 0.0),
        |most, one| if one.0 > most.0 { one } else { most },
    )
}

/// The four shapes in a box of 2.5 mm, the tube with a hole of 1 mm, by their names.
pub fn four_shapes() -> [(&'static str, Shape); 4] {
    let (diameter_mm, length_mm) = (2.5, 2.5);
    [
        (
            "cylinder",
            Shape::Cylinder {
                diameter_mm,
                length_mm,
            },
        ),
        (
            "tube",
            Shape::Tube {
                diameter_mm,
                hole_mm: 1.0,
                length_mm,
            },
        ),
        ("cube", Shape::Cube { side_mm: 2.5 }),
        ("sphere", Shape::Sphere { diameter_mm }),
    ]
}

/// Bx over the motion, of each shape.
pub fn shapes() -> Vec<Curve> {
    let curve = |(name, shape): (&str, Shape)| {
        let model = facing(shape, GAP_MM);
        let field = |x_mm| model.respond(Vector3::new(x_mm, 0.0, 0.0)).field_g.x;
        over(name.to_owned(), -MOTION_MM, MOTION_MM, field)
    };
    four_shapes().map(curve).to_vec()
}

/// S over the motion, for several diameters.
pub fn motion() -> Vec<Curve> {
    let curve = |diameter_mm: f64| {
        let model = cylinder(diameter_mm, HEIGHT_MM, GAP_MM);
        over(
            format!("diameter {diameter_mm} mm"),
            -MOTION_MM,
            MOTION_MM,
            |x_mm| sensitivity(&model, x_mm),
        )
    };
    DIAMETERS_MM.map(curve).to_vec()
}

/// Greatest S over the magnet's length, for several diameters.
pub fn length() -> Vec<Curve> {
    let curve = |diameter_mm: f64| {
        over(
            format!("diameter {diameter_mm} mm"),
            0.5,
            10.0,
            |length_mm| greatest(&cylinder(diameter_mm, length_mm, GAP_MM)).0,
        )
    };
    DIAMETERS_MM.map(curve).to_vec()
}

/// Greatest S over the magnet's diameter, for several lengths.
pub fn diameter() -> Vec<Curve> {
    let curve = |length_mm: f64| {
        over(format!("length {length_mm} mm"), 1.0, 10.0, |diameter_mm| {
            greatest(&cylinder(diameter_mm, length_mm, GAP_MM)).0
        })
    };
    [1.0, 2.0, 4.0, 8.0].map(curve).to_vec()
}

/// Greatest S over the gap, for several diameters.
pub fn gap() -> Vec<Curve> {
    let curve = |diameter_mm: f64| {
        over(format!("diameter {diameter_mm} mm"), 1.0, 5.0, |gap_mm| {
            greatest(&cylinder(diameter_mm, HEIGHT_MM, gap_mm)).0
        })
    };
    DIAMETERS_MM.map(curve).to_vec()
}

/// Field of the opposite finger's magnet over the distance of their centres, as the logarithm of gauss.
pub fn neighbour() -> Vec<Curve> {
    let curve = |diameter_mm: f64| {
        let model = cylinder(diameter_mm, HEIGHT_MM, GAP_MM);
        over(
            format!("diameter {diameter_mm} mm"),
            9.0,
            60.0,
            |distance_mm| libm::log10(neighbour::field(&model, distance_mm).norm()),
        )
    };
    DIAMETERS_MM.map(curve).to_vec()
}

fn over(name: String, from: f64, to: f64, of: impl Fn(f64) -> f64) -> Curve {
    Curve {
        name,
        points: steps(from, to).map(|x| [x, of(x)]).collect(),
    }
}

/// Evenly spread numbers with both ends.
pub fn steps(from: f64, to: f64) -> impl Iterator<Item = f64> {
    (0..=POINTS).map(move |i| from + (to - from) * f64::from(i) / f64::from(POINTS))
}
