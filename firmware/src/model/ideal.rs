//! The ideal model: from the field at one sensor to its two forces.

use super::grbf;
use super::table::{
    AxisScale, COORDINATE_LIMIT, GAIN_BITS, Linear, SLOPE_BITS, SensorTable, Tables,
};
use crate::units::{Field, Force};

/// The forces on one sensor, and whether the field lay in the box that the model was built for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inverse {
    /// Lateral and longitudinal.
    pub force: [Force; 2],
    /// False where a coordinate was clamped to the box's edge: the forces are then a bound only.
    pub inside: bool,
    /// The scaled coordinates.
    pub at: [i16; 3],
}

/// Evaluates the model of one sensor.
pub fn evaluate(tables: &Tables, sensor: &SensorTable, field: [Field; 3]) -> Inverse {
    let [x, y, z] = sensor.scale;
    let [bx, by, bz] = field;
    let (x, x_inside) = coordinate(x, bx);
    let (y, y_inside) = coordinate(y, by);
    let (z, z_inside) = coordinate(z, bz);
    let at = [x, y, z];
    let pairs = sensor
        .pairs
        .get(..usize::from(sensor.used_pairs))
        .unwrap_or(&[]);
    let [sum_x, sum_z] = grbf::sum(tables.exp, pairs, at);
    let [shift_x, shift_z] = sensor.shift;
    let [linear_x, linear_z] = linear(&sensor.linear, at);
    Inverse {
        force: [
            Force(linear_x.saturating_add(rounded_shift(sum_x, shift_x))),
            Force(linear_z.saturating_add(rounded_shift(sum_z, shift_z))),
        ],
        inside: x_inside && y_inside && z_inside,
        at,
    }
}

/// The scaled coordinate, clamped to the box, and whether it lay inside.
fn coordinate(scale: AxisScale, field: Field) -> (i16, bool) {
    let from_middle = i64::from(field.0) - i64::from(scale.offset);
    let half = 1 << (GAIN_BITS - 1);
    let scaled = (from_middle
        .saturating_mul(i64::from(scale.gain))
        .saturating_add(half))
        >> GAIN_BITS;
    let limit = i64::from(COORDINATE_LIMIT);
    let clamped = scaled.clamp(-limit, limit);
    (clamped as i16, clamped == scaled)
}

fn linear(linear: &Linear, at: [i16; 3]) -> [i32; 2] {
    let [bias_x, bias_z] = linear.bias;
    let [slope_x, slope_z] = linear.slope;
    [(bias_x, slope_x), (bias_z, slope_z)].map(|(bias, slope)| {
        let terms = slope
            .iter()
            .zip(at)
            .map(|(&slope, at)| i64::from(slope) * i64::from(at));
        let sum: i64 = terms.sum();
        bias.saturating_add(
            (sum >> SLOPE_BITS).clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32,
        )
    })
}

/// Arithmetic shift that rounds to the nearest, a half up; shifts beyond the word give zero.
fn rounded_shift(value: i32, shift: u8) -> i32 {
    let Some(before) = shift.checked_sub(1) else {
        return value;
    };
    // Twice the result, and its last bit rounds up.
    let twice = value >> before.min(31);
    (twice >> 1).saturating_add(twice & 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_rounds_to_the_nearest_and_a_half_up() {
        let values = [i32::MIN, i32::MIN + 1, -8, -7, -3, -1, 0, 1, 5, 6, i32::MAX];
        for (value, shift) in values.iter().flat_map(|v| (0..=62).map(move |s| (*v, s))) {
            // In 64 bits, where nothing is near the end.
            let half = (1_i64 << shift) >> 1;
            let expected = (i64::from(value) + half) >> shift;
            let told = rounded_shift(value, shift);
            assert_eq!(i64::from(told), expected, "{value} {shift}");
        }
        assert_eq!([5, 6, -6].map(|value| rounded_shift(value, 2)), [1, 2, -1]);
    }
}
