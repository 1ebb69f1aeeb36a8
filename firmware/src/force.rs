//! The estimate: forces in fixed point, with what one must know before believing them.

use crate::compensate::{Memory, Undone};
use crate::frame::{Frame, SENSORS};
use crate::hall::Reading;
use crate::model::table::Tables;
use crate::model::{ideal, parity};
use crate::surroundings::Surroundings;
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

/// How far a field lies beside the surface of its sensor's fields ([`parity`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Beside {
    /// Along the axis that the other two foretell.
    pub departure: Field,
    /// One standard deviation of it in a fit, with [`parity::SPREAD_BITS`] more bits.
    pub spread: i32,
}

/// The forces at one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Estimate {
    /// Lateral and longitudinal; zero where missing.
    pub force: [Force; 2],
    /// Their standard deviations, where a recurrent network tells them, grown by what lies beyond all
    /// that it has learned from ([`crate::model::network::Guard`]).
    pub sigma: Option<[Force; 2]>,
    /// The same before they were grown.
    pub told_sigma: Option<[Force; 2]>,
    /// May they be used?
    pub validity: Validity,
    /// The field without the effects that were undone: what the ideal model was given.
    pub field: [Field; 3],
    /// The forces that the deflection shows, before the effects of the flexures were undone.
    pub shown: [Force; 2],
    /// True where the model holds an effect whose input the board does not know: it is not undone.
    pub lacking: bool,
    /// The field beside the surface on which the finger's own magnet brings it.
    pub parity: Beside,
    /// True while a foreign magnet is to be assumed ([`crate::foreign`]): the forces may be its own.
    pub disturbed: bool,
}

impl Estimate {
    /// No reading.
    pub const MISSING: Self = Self {
        force: [Force(0); 2],
        sigma: None,
        told_sigma: None,
        validity: Validity::Missing,
        field: [Field(0); 3],
        shown: [Force(0); 2],
        lacking: false,
        parity: Beside {
            departure: Field(0),
            spread: 0,
        },
        disturbed: false,
    };
}

/// The forces at the sensor with this number; `memory` is that sensor's own.
pub fn estimate(
    tables: &Tables,
    number: usize,
    reading: Option<Reading>,
    around: &Surroundings,
    memory: &mut Memory,
) -> Estimate {
    let (Some(table), Some(reading)) = (tables.sensor(number), reading) else {
        return Estimate::MISSING;
    };
    let measured = reading.field.map(Field::from_counts);
    let saturated = reading
        .field
        .iter()
        .any(|counts| counts.unsigned_abs() >= table.limit_counts.unsigned_abs());
    let effects = tables.compensation(number);
    let field = match effects {
        Some(effects) => effects.field(measured, reading.temperature, around, memory),
        None => Undone {
            left: measured,
            lacking: false,
        },
    };
    let inverse = ideal::evaluate(tables, table, field.left);
    let force = match effects {
        Some(effects) => effects.force(inverse.force, around, memory),
        None => Undone {
            left: inverse.force,
            lacking: false,
        },
    };
    Estimate {
        force: force.left,
        sigma: None,
        told_sigma: None,
        validity: match (saturated, inverse.inside) {
            (true, _) => Validity::Saturated,
            (false, false) => Validity::OutsideModel,
            (false, true) => Validity::Valid,
        },
        field: field.left,
        shown: inverse.force,
        lacking: field.lacking || force.lacking,
        parity: Beside {
            departure: parity::departure(table, field.left, inverse.at),
            spread: table.parity.spread,
        },
        disturbed: false,
    }
}

/// The forces at every sensor of a frame, each with its own memory.
///
/// Kept as a function of its own, so that a check of the image can follow every call from here and
/// find no panic.
#[inline(never)]
pub fn estimate_all(
    tables: &Tables,
    frame: &Frame,
    around: &Surroundings,
    memories: &mut [Memory; SENSORS],
) -> [Estimate; SENSORS] {
    let mut memories = memories.iter_mut();
    let mut number = 0;
    frame.readings.map(|reading| {
        let estimate = match memories.next() {
            Some(memory) => estimate(tables, number, reading, around, memory),
            None => Estimate::MISSING,
        };
        number += 1;
        estimate
    })
}
