//! Fields of other sources at the sensor: the motor, the Earth, the opposing finger's magnet.

use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::fixed_point::{Field, mul_q};

/// Fractional bits of [`MotorLeakageTable::per_ma`].
pub const LEAKAGE_BITS: u32 = 20;

/// Field of the motor's currents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotorLeakageTable {
    /// Per sensor axis: field units per milliampere of alpha, beta and quadrature current.
    pub per_ma: [[i32; 3]; 3],
}

impl MotorLeakageTable {
    /// Subtracts the motor's field; `None` without motor inputs.
    pub fn compensate(&self, field: [Field; 3], inputs: &AuxiliaryInputs) -> Option<[Field; 3]> {
        let currents = inputs.motor?.currents();
        let [x, y, z] = self.per_ma;
        let [bx, by, bz] = field;
        Some([(bx, x), (by, y), (bz, z)].map(|(field, row)| {
            let terms = row.iter().zip(currents);
            terms.fold(field, |field, (per_ma, ma)| {
                field.saturating_sub(mul_q(*per_ma, ma, LEAKAGE_BITS))
            })
        }))
    }
}

/// Fractional bits of [`EarthFieldTable::world`] and [`EarthFieldTable::element`].
pub const EARTH_FIELD_BITS: u32 = 14;

/// Ambient field, constant in world axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EarthFieldTable {
    /// Field in world axes, in field units.
    pub world: [i32; 3],
    /// Rotation from gripper to sensor axes, by rows.
    pub element: [[i32; 3]; 3],
}

impl EarthFieldTable {
    /// Subtracts the ambient field; `None` without an attitude.
    pub fn compensate(&self, field: [Field; 3], inputs: &AuxiliaryInputs) -> Option<[Field; 3]> {
        let body = inputs.attitude?.to_body(self.world);
        let [x, y, z] = self.element;
        let [bx, by, bz] = field;
        Some([(bx, x), (by, y), (bz, z)].map(|(field, row)| {
            let ambient = row.iter().zip(body).fold(0_i32, |sum, (factor, b)| {
                // Both factors have fractional bits: removed in two steps to avoid an overflow.
                sum.saturating_add(mul_q(*factor, b, EARTH_FIELD_BITS))
            });
            field.saturating_sub(mul_q(ambient, 1, EARTH_FIELD_BITS))
        }))
    }
}

/// Knots of [`NeighbourMagnetTable`]: openings of 0 to 80 mm, the whole stroke.
pub const KNOTS: usize = 161;
/// Distance of two knots in micrometres.
pub const STEP_UM: i32 = 500;

/// Field of the opposing finger's magnet over the opening: piecewise linear, constant beyond the ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NeighbourMagnetTable<'a> {
    /// Field at [`KNOTS`] openings, in field units and sensor axes.
    pub knots: &'a [[i32; 3]],
}

impl NeighbourMagnetTable<'_> {
    /// Subtracts the opposing magnet's field; `None` without an opening.
    pub fn compensate(&self, field: [Field; 3], inputs: &AuxiliaryInputs) -> Option<[Field; 3]> {
        let last = (KNOTS as i32 - 1) * STEP_UM;
        let opening = inputs.opening_um?.clamp(0, last - 1);
        let index = (opening / STEP_UM) as usize;
        let fraction = opening % STEP_UM;
        let (before, after) = (self.knots.get(index)?, self.knots.get(index + 1)?);
        let [bx, by, bz] = field;
        let [x0, y0, z0] = *before;
        let [x1, y1, z1] = *after;
        Some([(bx, x0, x1), (by, y0, y1), (bz, z0, z1)].map(|(field, from, to)| {
            let change = to.saturating_sub(from).saturating_mul(fraction) / STEP_UM;
            field.saturating_sub(from.saturating_add(change))
        }))
    }
}
