//! The ideal model: from the compensated field at a sensor to its two forces, by scaling, a linear part and Gaussian
//! radial basis functions.

use crate::fixed_point::{Field, Force, mul_q, saturate};
use crate::model::formats::{
    AxisScale, COORDINATE_LIMIT, GAIN_BITS, Linear, SLOPE_BITS, SensorTable, Tables,
};
use crate::model::kernel::grbf;

/// Result of the ideal model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdealForce {
    /// Lateral and longitudinal force.
    pub force: [Force; 2],
    /// False if a coordinate was clamped to the design box: the forces are then only a bound.
    pub in_range: bool,
    /// Scaled coordinates, clamped to the box.
    pub coordinates: [i16; 3],
}

/// Evaluates the model of a sensor.
#[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
#[allow(unsafe_code)] // As of `estimate`.
pub fn evaluate(tables: &Tables, sensor: &SensorTable, field: [Field; 3]) -> IdealForce {
    let [x, y, z] = sensor.scale;
    let [bx, by, bz] = field;
    let (x, x_in_range) = coordinate(x, bx);
    let (y, y_in_range) = coordinate(y, by);
    let (z, z_in_range) = coordinate(z, bz);
    let coordinates = [x, y, z];
    let pairs = sensor.pairs.get(..usize::from(sensor.used_pairs)).unwrap_or(&[]);
    let [sum_x, sum_z] = grbf::sum(tables.exp, pairs, coordinates);
    let [shift_x, shift_z] = sensor.shift;
    let [linear_x, linear_z] = linear(&sensor.linear, coordinates);
    IdealForce {
        force: [
            Force(linear_x.saturating_add(rounded_shift(sum_x, shift_x))),
            Force(linear_z.saturating_add(rounded_shift(sum_z, shift_z))),
        ],
        in_range: x_in_range && y_in_range && z_in_range,
        coordinates,
    }
}

/// The scaled coordinate, clamped to the box, and whether it is inside.
fn coordinate(scale: AxisScale, field: Field) -> (i16, bool) {
    let scaled = mul_q(field.0.saturating_sub(scale.offset), scale.gain, GAIN_BITS);
    let limit = i32::from(COORDINATE_LIMIT);
    let clamped = scaled.clamp(-limit, limit);
    (clamped as i16, clamped == scaled)
}

fn linear(linear: &Linear, coordinates: [i16; 3]) -> [i32; 2] {
    let [bias_x, bias_z] = linear.bias;
    let [slope_x, slope_z] = linear.slope;
    [(bias_x, slope_x), (bias_z, slope_z)].map(|(bias, slope)| {
        let terms = slope.iter().zip(coordinates);
        let sum: i64 =
            terms.map(|(&slope, coordinate)| i64::from(slope) * i64::from(coordinate)).sum();
        bias.saturating_add(saturate(sum >> SLOPE_BITS))
    })
}

/// Arithmetic right shift, rounded to the nearest with halves up; shifts beyond the word give zero.
fn rounded_shift(value: i32, shift: u8) -> i32 {
    let Some(before) = shift.checked_sub(1) else {
        return value;
    };
    // The lowest bit of twice the result rounds.
    let twice = value >> before.min(31);
    (twice >> 1).saturating_add(twice & 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shift_rounds_to_nearest_with_halves_up() {
        let values = [i32::MIN, i32::MIN + 1, -8, -7, -3, -1, 0, 1, 5, 6, i32::MAX];
        for (value, shift) in values.iter().flat_map(|v| (0..=62).map(move |s| (*v, s))) {
            // In 64 bits, without overflow.
            let half = (1_i64 << shift) >> 1;
            let expected = (i64::from(value) + half) >> shift;
            let found = i64::from(rounded_shift(value, shift));
            assert_eq!(found, expected, "{value} {shift}");
        }
        assert_eq!([5, 6, -6].map(|value| rounded_shift(value, 2)), [1, 2, -1]);
    }
}
