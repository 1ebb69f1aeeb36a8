//! Random points around magnets, generated as in `benches/magpylib_field.py`, so that only the fields are stored.
//! Coordinates are integer multiples of 1/1024 mm, exact in every language.

use model_export::physics::{Cylinder, Magnet, MagnetBody, Magnetisation};
use nalgebra::Vector3;

/// Grid points per millimetre.
const GRID: i64 = 1024;
/// Points per shape and magnetisation.
const POINTS: usize = 1250;
/// Minimum distance from the surface: 1/8 mm.
const CLEARANCE: i64 = GRID / 8;

#[derive(Clone, Copy, PartialEq)]
enum Shape {
    Cylinder,
    Tube,
    Cube,
    Sphere,
}

/// Diameter or side, hole and length in mm.
type Size = [i64; 3];

/// Sizes of cylinders in grid units: the paper's, then others.
const CYLINDERS: [Size; 5] =
    [[2560, 0, 2560], [3072, 0, 2048], [3072, 0, 5120], [5120, 0, 2048], [3072, 0, 1024]];
const TUBES: [Size; 5] = [
    [2560, 1024, 2560],
    [3072, 1024, 2048],
    [3072, 2048, 5120],
    [5120, 3072, 2048],
    [3072, 1024, 1024],
];
const BLOCKS: [Size; 5] =
    [[2560, 0, 2560], [1024, 0, 1024], [2048, 0, 2048], [3072, 0, 3072], [5120, 0, 5120]];

/// Magnet and point in mm in its frame, in the order of the stored fields.
pub fn points_around_magnets() -> Vec<(Magnet, Vector3<f64>)> {
    let shapes = [Shape::Cylinder, Shape::Tube, Shape::Cube, Shape::Sphere];
    let magnets = shapes
        .into_iter()
        .flat_map(|shape| [(shape, Magnetisation::Axial), (shape, Magnetisation::Diametric)]);
    (0..)
        .zip(magnets)
        .flat_map(|(seed, (shape, magnetised))| random_points(shape, magnetised, SplitMix64(seed)))
        .collect()
}

fn random_points(
    shape: Shape,
    magnetised: Magnetisation,
    mut random: SplitMix64,
) -> Vec<(Magnet, Vector3<f64>)> {
    let sizes = match shape {
        Shape::Cylinder => CYLINDERS,
        Shape::Tube => TUBES,
        Shape::Cube | Shape::Sphere => BLOCKS,
    };
    let mut points = Vec::new();
    while points.len() < POINTS {
        let size = sizes[random.below(sizes.len() as u64) as usize];
        let mut at = [(); 3].map(|()| random.below(12 * GRID as u64 + 1) as i64 - 6 * GRID);
        if random.below(50) == 0 {
            (at[0], at[1]) = (0, 0);
        }
        if outside(shape, size, at) {
            let body = body(shape, size.map(mm));
            points.push((Magnet { body, magnetised }, Vector3::from(at.map(mm))));
        }
    }
    points
}

fn mm(grid: i64) -> f64 {
    grid as f64 / GRID as f64
}

fn body(shape: Shape, [width_mm, hole_mm, length_mm]: [f64; 3]) -> MagnetBody {
    let outer = Cylinder { diameter_mm: width_mm, length_mm };
    match shape {
        Shape::Cylinder => MagnetBody::Cylinder(outer),
        Shape::Tube => MagnetBody::Tube { outer, hole_mm },
        Shape::Cube => MagnetBody::Cube { side_mm: width_mm },
        Shape::Sphere => MagnetBody::Sphere { diameter_mm: width_mm },
    }
}

/// For a sphere, outside its bounding box.
fn outside(shape: Shape, [width, hole, length]: Size, [x, y, z]: [i64; 3]) -> bool {
    if matches!(shape, Shape::Cube | Shape::Sphere) {
        return 2 * x.abs().max(y.abs()).max(z.abs()) >= width + 2 * CLEARANCE;
    }
    let across = 4 * (x * x + y * y);
    let is_outside = across >= (width + 2 * CLEARANCE).pow(2);
    let is_in_hole = hole > 2 * CLEARANCE && across <= (hole - 2 * CLEARANCE).pow(2);
    is_outside || is_in_hole || 2 * z.abs() >= length + 2 * CLEARANCE
}

/// Random generator that is simple in any language (Steele, Lea and Flood 2014).
struct SplitMix64(u64);

impl SplitMix64 {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % limit
    }
}
