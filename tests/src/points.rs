//! Points around magnets, drawn as `benches/magpylib_field.py` draws them, so that only the fields
//! need to be stored. Coordinates are whole numbers of 1/1024 mm: no language rounds them.

use model_export::physics::{Body, Cylinder, Magnet, Magnetised};
use nalgebra::Vector3;

/// Points in a millimetre.
const GRID: i64 = 1024;
/// Points around each shape, magnetised either way.
const DRAWN: usize = 1250;
/// Least distance from the surface, an eighth of a millimetre.
const ROOM: i64 = GRID / 8;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Cylinder,
    Tube,
    Cube,
    Sphere,
}

/// Diameter or side, hole and length in mm.
type Size = [i64; 3];

/// The sizes of cylinders in units of the grid: the paper's box, then others.
const CYLINDERS: [Size; 5] = [
    [2560, 0, 2560],
    [3072, 0, 2048],
    [3072, 0, 5120],
    [5120, 0, 2048],
    [3072, 0, 1024],
];
const TUBES: [Size; 5] = [
    [2560, 1024, 2560],
    [3072, 1024, 2048],
    [3072, 2048, 5120],
    [5120, 3072, 2048],
    [3072, 1024, 1024],
];
const BLOCKS: [Size; 5] = [
    [2560, 0, 2560],
    [1024, 0, 1024],
    [2048, 0, 2048],
    [3072, 0, 3072],
    [5120, 0, 5120],
];

/// All points in the order of the stored fields: the magnet, and the point in mm in its own frame.
pub fn around_magnets() -> Vec<(Magnet, Vector3<f64>)> {
    let kinds = [Kind::Cylinder, Kind::Tube, Kind::Cube, Kind::Sphere];
    let ways = kinds
        .into_iter()
        .flat_map(|kind| [(kind, Magnetised::Axial), (kind, Magnetised::Diametric)]);
    (0..)
        .zip(ways)
        .flat_map(|(seed, (kind, magnetised))| drawn(kind, magnetised, SplitMix64(seed)))
        .collect()
}

fn drawn(kind: Kind, magnetised: Magnetised, mut draw: SplitMix64) -> Vec<(Magnet, Vector3<f64>)> {
    let sizes = match kind {
        Kind::Cylinder => CYLINDERS,
        Kind::Tube => TUBES,
        Kind::Cube | Kind::Sphere => BLOCKS,
    };
    let mut points = Vec::new();
    while points.len() < DRAWN {
        let size = sizes[draw.below(sizes.len() as u64) as usize];
        let mut at = [(); 3].map(|()| draw.below(12 * GRID as u64 + 1) as i64 - 6 * GRID);
        if draw.below(50) == 0 {
            (at[0], at[1]) = (0, 0);
        }
        if outside(kind, size, at) {
            let body = body(kind, size.map(mm));
            points.push((Magnet { body, magnetised }, Vector3::from(at.map(mm))));
        }
    }
    points
}

fn mm(grid: i64) -> f64 {
    grid as f64 / GRID as f64
}

fn body(kind: Kind, [width_mm, hole_mm, length_mm]: [f64; 3]) -> Body {
    let outer = Cylinder {
        diameter_mm: width_mm,
        length_mm,
    };
    match kind {
        Kind::Cylinder => Body::Cylinder(outer),
        Kind::Tube => Body::Tube { outer, hole_mm },
        Kind::Cube => Body::Cube { side_mm: width_mm },
        Kind::Sphere => Body::Sphere {
            diameter_mm: width_mm,
        },
    }
}

/// A sphere's points lie outside its box.
fn outside(kind: Kind, [width, hole, length]: Size, [x, y, z]: [i64; 3]) -> bool {
    if matches!(kind, Kind::Cube | Kind::Sphere) {
        return 2 * x.abs().max(y.abs()).max(z.abs()) >= width + 2 * ROOM;
    }
    let across = 4 * (x * x + y * y);
    let beside = across >= (width + 2 * ROOM).pow(2);
    let within = hole > 2 * ROOM && across <= (hole - 2 * ROOM).pow(2);
    beside || within || 2 * z.abs() >= length + 2 * ROOM
}

/// A generator of a few lines in any language (Steele, Lea and Flood 2014).
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
