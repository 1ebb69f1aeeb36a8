//! The loads that a model is built for, and where their fields lie.

use firmware::model::table::COORDINATE_LIMIT;
use firmware::units::Field;
use nalgebra::Vector3;

use super::at_rest::AtRest;

/// Room around the fields of the box in the plane of motion, as a share of their span: what bias
/// and drift may add before the device calls the field foreign to the model.
const MARGIN: f64 = 0.10;
/// Room along the gap, as a share of the field at rest and at most so many gauss: a quarter of a
/// millimetre of gap or of the magnet stays inside. The load hardly moves this axis, and a wide box keeps
/// it from counting much in the distances.
const GAP_MARGIN: (f64, f64) = (0.25, 300.0);

/// Loads of up to `force_n` either way on both axes, and the fields that they give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesignBox {
    /// Greatest force of each axis in newtons, either way.
    pub force_n: [f64; 2],
    /// Middle of the fields in gauss.
    pub middle_g: Vector3<f64>,
    /// Half their span with the margin, in gauss.
    pub half_g: Vector3<f64>,
}

impl DesignBox {
    /// The box of the design's force range around the fields of `model`.
    pub fn of(at_rest: &AtRest) -> Self {
        let force_n = [at_rest.model.force_range_n; 2];
        let (mut low, mut high) = (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        );
        for force in lattice(force_n, 21) {
            let field = at_rest.field(force);
            (low, high) = (low.inf(&field), high.sup(&field));
        }
        let half = 0.5 * (high - low);
        let (share, most_g) = GAP_MARGIN;
        let gap_g = (share * at_rest.field([0.0; 2]).norm()).min(most_g);
        Self {
            force_n,
            middle_g: 0.5 * (high + low),
            half_g: Vector3::new(
                half.x * (1.0 + 2.0 * MARGIN),
                half.y + gap_g,
                half.z * (1.0 + 2.0 * MARGIN),
            ),
        }
    }

    /// A field as coordinates of -1 to 1 inside the box.
    pub fn coordinates(&self, field_g: &Vector3<f64>) -> Vector3<f64> {
        (field_g - self.middle_g).component_div(&self.half_g)
    }

    /// The device's scaling, offset and gain of each axis, and the box that it stands for exactly.
    pub fn device_scale(&self, gauss_per_lsb: f64) -> ([(f64, f64); 3], Self) {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let limit = f64::from(COORDINATE_LIMIT);
        let bits = f64::from(1_u32 << firmware::model::table::GAIN_BITS);
        let scale: [(f64, f64); 3] = std::array::from_fn(|axis| {
            let offset = (self.middle_g[axis] * units).round();
            let gain = (limit / (self.half_g[axis] * units) * bits).round();
            (offset, gain)
        });
        let exact = Self {
            middle_g: Vector3::from_fn(|axis, _| scale[axis].0 / units),
            half_g: Vector3::from_fn(|axis, _| limit * bits / scale[axis].1 / units),
            ..*self
        };
        (scale, exact)
    }
}

/// A square lattice of `n` by `n` loads up to `force_n`.
pub fn lattice(force_n: [f64; 2], n: usize) -> impl Iterator<Item = [f64; 2]> {
    let at = move |i: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
    (0..n * n).map(move |i| [force_n[0] * at(i % n), force_n[1] * at(i / n)])
}
