//! A recording's row as the readings of the device's sensors.

use firmware::frame::SENSORS;
use firmware::hall::{Reading, a31301};
use firmware::params;
use model_export::effects::REFERENCE_C;
use model_export::recordings::columns::{Axis, ForceColumn, HallColumn};
use model_export::recordings::raw::{RawRow, RawStream};

/// Where a sensor's columns are in a row.
pub struct Wiring {
    /// Place of the sensor among the tables.
    pub table: usize,
    /// Its number.
    pub number: u32,
    /// Channels of its field.
    pub field: [usize; 3],
    /// Channel of its temperature.
    pub temperature: Option<usize>,
    /// Places of its forces, Fx and Fz.
    pub forces: [usize; 2],
}

/// The sensors of the tables, `numbers`, whose field and both forces are in the recording.
pub fn wire(numbers: &[u32], stream: &RawStream) -> Vec<Wiring> {
    let layout = stream.layout();
    let force = |number: u32, axis: Axis| {
        layout.forces.iter().position(|column| {
            *column
                == ForceColumn::Force {
                    place: number,
                    axis,
                }
        })
    };
    let wires = numbers.iter().enumerate().filter_map(|(table, &number)| {
        Some(Wiring {
            table,
            number,
            field: layout.field_channels(number)?,
            temperature: layout.hall.iter().position(
                |column| matches!(column, HallColumn::Temperature { sensor } if *sensor == number),
            ),
            forces: [force(number, Axis::X)?, force(number, Axis::Z)?],
        })
    });
    wires.collect()
}

/// The sensor's word of a field in gauss: one beyond the range stays at its end, as the sensor itself.
pub fn counts(gauss: f64, gauss_per_lsb: f64) -> i16 {
    let (least, greatest) = a31301::FIELD_LIMITS;
    let counts = (gauss / gauss_per_lsb).round();
    counts.clamp(f64::from(least), f64::from(greatest)) as i16
}

/// The sensor's word of its temperature in this row.
pub fn temperature(row: &RawRow, wires: &Wiring) -> i16 {
    // Degrees were made of counts by the same scale, so that what it really is does not matter.
    wires.temperature.map_or(0, |channel| {
        let warmer = row.hall[channel] - REFERENCE_C;
        (warmer * params::TEMPERATURE_SCALE.value).round() as i16
    })
}

/// What the sensor's registers would hold in this row.
pub fn reading(row: &RawRow, wires: &Wiring, gauss_per_lsb: f64) -> Reading {
    Reading {
        field: wires
            .field
            .map(|channel| counts(row.hall[channel], gauss_per_lsb)),
        temperature: temperature(row, wires),
    }
}

/// What the board reads of its own sensors in this row, from the bytes on their buses.
pub fn readings(row: &RawRow, wiring: &[Wiring], gauss_per_lsb: f64) -> [Option<Reading>; SENSORS] {
    let mut readings = [None; SENSORS];
    for wires in wiring {
        if let Some(place) = readings.get_mut(wires.number as usize) {
            let bytes = a31301::encode(reading(row, wires, gauss_per_lsb));
            *place = Some(a31301::decode(bytes));
        }
    }
    readings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_beyond_the_sensor_s_word_stays_at_its_end_and_does_not_wrap() {
        let wires = Wiring {
            table: 0,
            number: 0,
            field: [0, 1, 2],
            temperature: None,
            forces: [0, 1],
        };
        let row = RawRow {
            time_s: 0.0,
            hall: vec![2100.0, -2100.0, 0.25],
            forces: Vec::new(),
        };
        let seen = a31301::decode(a31301::encode(reading(&row, &wires, 0.125)));
        assert_eq!(seen.field, [16383, -16384, 2]);
    }
}
