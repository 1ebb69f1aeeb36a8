//! The estimate: forces in fixed point, with what one must know before believing them.

use crate::frame::{Frame, SENSORS};
use crate::hall::Reading;
use crate::model::ideal;
use crate::model::table::Tables;
use crate::units::{Field, Force};

/// May the number be used?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// Inside the range of the sensor and of the model.
    Valid,
    /// An axis of the sensor is at the end of its range.
    Saturated,
    /// The field lies outside the box that the model was built for: the forces are a bound only.
    OutsideModel,
    /// The sensor did not answer, or the tables know no such sensor.
    Missing,
}

/// The forces at one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// Lateral and longitudinal; zero where missing.
    pub force: [Force; 2],
    /// May they be used?
    pub validity: Validity,
}

impl Estimate {
    /// No reading.
    pub const MISSING: Self = Self {
        force: [Force(0); 2],
        validity: Validity::Missing,
    };
}

/// The forces at the sensor with this number.
pub fn estimate(tables: &Tables, number: usize, reading: Option<Reading>) -> Estimate {
    let (Some(table), Some(reading)) = (tables.sensor(number), reading) else {
        return Estimate::MISSING;
    };
    let inverse = ideal::evaluate(tables, table, reading.field.map(Field::from_counts));
    let saturated = reading
        .field
        .iter()
        .any(|counts| counts.unsigned_abs() >= table.limit_counts.unsigned_abs());
    Estimate {
        force: inverse.force,
        validity: match (saturated, inverse.inside) {
            (true, _) => Validity::Saturated,
            (false, false) => Validity::OutsideModel,
            (false, true) => Validity::Valid,
        },
    }
}

/// The forces at every sensor of a frame.
///
/// Kept as a function of its own, so that a check of the image can follow every call from here and
/// find no panic.
#[inline(never)]
pub fn estimate_all(tables: &Tables, frame: &Frame) -> [Estimate; SENSORS] {
    let mut number = 0;
    frame.readings.map(|reading| {
        let estimate = estimate(tables, number, reading);
        number += 1;
        estimate
    })
}
