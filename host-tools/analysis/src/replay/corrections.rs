//! What separates a recording from the conditions of the tables that replay it: errors of the reference, permanent changes of the
//! gripper since, and fields that no model of the device compensates.

use std::collections::BTreeMap;

use model_export::model_file::RowCorrection;
use nalgebra::Vector3;

/// Corrections of one sensor over one recording.
#[derive(Clone, Debug)]
pub struct SensorCorrections {
    pub sensor: u32,
    /// The board's clock in seconds, ascending.
    pub time_s: Vec<f64>,
    /// One for each time.
    pub rows: Vec<RowCorrection>,
}

/// Constant offsets of one sensor in a recording, to subtract.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorOffsets {
    /// Of the reference forces along x and z, in newtons.
    pub reference_n: [f64; 2],
    /// Of the reading in the sensor's axes, in gauss.
    pub field_g: [f64; 3],
}

pub type RecordingOffsets = BTreeMap<u32, SensorOffsets>;

pub fn add_offsets(corrections: &mut Vec<SensorCorrections>, offsets: &RecordingOffsets) {
    for (&sensor, offset) in offsets {
        if corrections.iter().all(|own| own.sensor != sensor) {
            let nothing = RowCorrection {
                reference_n: [0.0; 2],
                reading: (1.0, Vector3::zeros()),
                force: [1.0; 2],
                irreducible_g: Vector3::zeros(),
            };
            corrections.push(SensorCorrections { sensor, time_s: vec![0.0], rows: vec![nothing] });
        }
        let own = corrections.iter_mut().filter(|own| own.sensor == sensor);
        for row in own.flat_map(|own| &mut own.rows) {
            row.reference_n.iter_mut().zip(offset.reference_n).for_each(|(sum, n)| *sum += n);
            let (gain, reading) = &mut row.reading;
            *reading -= *gain * Vector3::from(offset.field_g);
        }
    }
}

/// What of the corrections a replay applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Irreducible {
    /// The field that no model of the device compensates stays in the readings, as on the device.
    Kept,
    /// It is subtracted: what is left of the error is that of the model.
    Subtracted,
}

/// Corrections of one row.
#[derive(Clone, Copy, Debug)]
pub struct SampleCorrection {
    reference_n: [f64; 2],
    gain: f64,
    offset_g: [f64; 3],
    force: [f64; 2],
}

impl SampleCorrection {
    /// The reading in gauss.
    pub fn field_g(&self, field_g: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.gain * field_g[axis] + self.offset_g[axis])
    }

    /// The estimated forces in newtons.
    pub fn estimate_n(&self, force_n: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| force_n[axis] * self.force[axis])
    }

    /// The reference forces in newtons.
    pub fn reference_n(&self, force_n: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| force_n[axis] - self.reference_n[axis])
    }
}

impl SensorCorrections {
    /// Corrections at a time, interpolated linearly; those of the first and last row beyond them. `None` without rows.
    pub fn at(&self, time_s: f64, irreducible: Irreducible) -> Option<SampleCorrection> {
        let next = self.time_s.partition_point(|time| *time <= time_s);
        let before = next.saturating_sub(1);
        let (from, to) = (self.rows.get(before)?, self.rows.get(next).or(self.rows.last())?);
        let (start_s, end_s) = (*self.time_s.get(before)?, self.time_s.get(next));
        let share =
            end_s.map_or(0.0, |end_s| ((time_s - start_s) / (end_s - start_s)).clamp(0.0, 1.0));
        let mix = |from: f64, to: f64| from + share * (to - from);
        let gain = mix(from.reading.0, to.reading.0);
        let subtracted = f64::from(u8::from(irreducible == Irreducible::Subtracted));
        Some(SampleCorrection {
            reference_n: [0, 1].map(|axis| mix(from.reference_n[axis], to.reference_n[axis])),
            gain,
            offset_g: [0, 1, 2].map(|axis| {
                let field_g = mix(from.irreducible_g[axis], to.irreducible_g[axis]);
                mix(from.reading.1[axis], to.reading.1[axis]) - subtracted * gain * field_g
            }),
            force: [0, 1].map(|axis| mix(from.force[axis], to.force[axis])),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(reference_n: f64, gain: f64) -> RowCorrection {
        RowCorrection {
            reference_n: [reference_n, 0.0],
            reading: (gain, Vector3::new(1.0, 0.0, 0.0)),
            force: [2.0, 1.0],
            irreducible_g: Vector3::new(0.0, 10.0, 0.0),
        }
    }

    #[test]
    fn corrections_are_interpolated_and_end_with_the_last_row() {
        let corrections = SensorCorrections {
            sensor: 0,
            time_s: vec![1.0, 2.0],
            rows: vec![row(0.0, 1.0), row(4.0, 0.5)],
        };
        let at = |time_s| corrections.at(time_s, Irreducible::Kept).unwrap();
        for (time_s, reference_n, gain) in
            [(0.0, 0.0, 1.0), (1.25, 1.0, 0.875), (2.0, 4.0, 0.5), (9.0, 4.0, 0.5)]
        {
            assert_eq!(at(time_s).reference_n([10.0, 3.0]), [10.0 - reference_n, 3.0]);
            assert_eq!(at(time_s).field_g([8.0, 0.0, 0.0]), [8.0 * gain + 1.0, 0.0, 0.0]);
        }
        assert_eq!(at(1.0).estimate_n([5.0, 5.0]), [10.0, 5.0]);
    }

    #[test]
    fn irreducible_field_is_subtracted_before_the_gain() {
        let corrections =
            SensorCorrections { sensor: 0, time_s: vec![0.0], rows: vec![row(0.0, 0.5)] };
        let field =
            |irreducible| corrections.at(3.0, irreducible).unwrap().field_g([0.0, 30.0, 0.0])[1];
        assert_eq!((field(Irreducible::Kept), field(Irreducible::Subtracted)), (15.0, 10.0));
    }

    #[test]
    fn offsets_are_subtracted_from_reference_and_reading() {
        let offset = SensorOffsets { reference_n: [4.0, 0.0], field_g: [0.0, 2.0, 0.0] };
        let mut all =
            vec![SensorCorrections { sensor: 0, time_s: vec![0.0], rows: vec![row(1.0, 0.5)] }];
        add_offsets(&mut all, &[(0, offset), (1, offset)].into());
        let at = |place: usize| all[place].at(3.0, Irreducible::Kept).unwrap();
        assert_eq!(at(0).reference_n([10.0, 3.0]), [5.0, 3.0]);
        assert_eq!(at(0).field_g([0.0, 30.0, 0.0]), [1.0, 14.0, 0.0]);
        assert_eq!((all[1].sensor, at(1).reference_n([10.0, 3.0])), (1, [6.0, 3.0]));
        assert_eq!(at(1).field_g([1.0, 30.0, 0.0]), [1.0, 28.0, 0.0]);
        assert_eq!(at(1).estimate_n([5.0, 5.0]), [5.0, 5.0]);
    }
}
