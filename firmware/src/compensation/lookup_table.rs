//! A user-defined effect as a lookup table over one or two covariates, with linear interpolation.

use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::fixed_point::saturate;

/// Independent variable of a lookup table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Covariate {
    /// Opening in micrometres.
    Opening,
    /// Quadrature current in milliamperes.
    MotorIq,
    /// Mechanical angle of the motor in microradians.
    MotorAngle,
    /// Specific force along an axis of the gripper in mm/s^2.
    Acceleration(u8),
    /// Temperature in counts with [`super::thermal::TEMPERATURE_BITS`] fractional bits.
    Temperature,
}

impl Covariate {
    fn value(self, temperature: i32, inputs: &AuxiliaryInputs) -> Option<i32> {
        match self {
            Self::Opening => inputs.opening_um,
            Self::MotorIq => inputs.motor.map(|motor| motor.iq_ma),
            Self::MotorAngle => inputs.motor.map(|motor| motor.angle_urad),
            Self::Acceleration(axis) => inputs.acceleration?.get(usize::from(axis)).copied(),
            Self::Temperature => Some(temperature),
        }
    }
}

/// One dimension of a table, with equidistant knots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LookupAxis {
    /// Independent variable.
    pub covariate: Covariate,
    /// Value at the first knot.
    pub from: i32,
    /// Distance of two knots; positive.
    pub step: i32,
    /// Number of knots.
    pub knots: u16,
}

impl LookupAxis {
    /// Index of the knot below the value and the fraction to the next with 15 bits, clamped to the ends.
    fn locate(&self, temperature: i32, inputs: &AuxiliaryInputs) -> Option<(usize, i64)> {
        let value = self.covariate.value(temperature, inputs)?;
        let step = i64::from(self.step.max(1));
        let cells = i64::from(self.knots.max(2)) - 1;
        let distance = (i64::from(value) - i64::from(self.from)).clamp(0, cells * step - 1);
        Some(((distance / step) as usize, ((distance % step) << 15) / step))
    }
}

/// Table of an effect in the unit of the field or force it is subtracted from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LookupTable<'a> {
    /// One or two dimensions; with none the effect is zero.
    pub sides: [Option<LookupAxis>; 2],
    /// Values in the order of the first dimension's knots, for each knot of the second.
    pub values: &'a [i32],
}

impl LookupTable<'_> {
    /// A table without an effect.
    pub const NONE: LookupTable<'static> = LookupTable { sides: [None; 2], values: &[] };

    /// Interpolated effect; `None` if an input is missing.
    pub fn value(&self, temperature: i32, inputs: &AuxiliaryInputs) -> Option<i32> {
        let [Some(first), second] = self.sides else {
            return Some(0);
        };
        let (column, fraction) = first.locate(temperature, inputs)?;
        let width = usize::from(first.knots);
        let row_value = |row: usize| {
            let at = row * width + column;
            let (before, after) = (*self.values.get(at)?, *self.values.get(at + 1)?);
            Some(interpolate(before, after, fraction))
        };
        let Some(second) = second else {
            return row_value(0);
        };
        let (row, fraction) = second.locate(temperature, inputs)?;
        Some(interpolate(row_value(row)?, row_value(row + 1)?, fraction))
    }
}

fn interpolate(before: i32, after: i32, fraction: i64) -> i32 {
    let scaled = (i64::from(after) - i64::from(before)) * fraction + (1 << 14);
    saturate(i64::from(before) + (scaled >> 15))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opening(from: i32, step: i32, knots: u16) -> Option<LookupAxis> {
        Some(LookupAxis { covariate: Covariate::Opening, from, step, knots })
    }

    fn inputs(opening_um: i32) -> AuxiliaryInputs {
        AuxiliaryInputs { opening_um: Some(opening_um), ..Default::default() }
    }

    #[test]
    fn one_dimension_interpolates_and_clamps() {
        let table = LookupTable { sides: [opening(1000, 500, 3), None], values: &[0, 100, 400] };
        let at = |um| table.value(0, &inputs(um)).unwrap();
        assert_eq!([0, 1250, 1500, 1750].map(at), [0, 50, 100, 250]);
        assert!((399..=400).contains(&at(99_999)));
    }

    #[test]
    fn two_dimensions_interpolate_and_report_a_missing_input() {
        let warm = LookupAxis { covariate: Covariate::Temperature, from: 0, step: 10, knots: 2 };
        let table =
            LookupTable { sides: [opening(0, 10, 2), Some(warm)], values: &[0, 100, 200, 300] };
        assert_eq!(table.value(5, &inputs(5)), Some(150));
        assert_eq!(table.value(5, &AuxiliaryInputs::default()), None);
    }
}
