//! Detection of sensors that stopped measuring: missing transfers, and readings that never change.
//!
//! The A31301 has no documented data-ready flag. Its noise of 0.35 G rms (2.8 counts) makes an axis repeat its word
//! with a probability of one in ten, three axes with one in a thousand. A saturated axis repeats by nature and is
//! not counted.

use crate::config::limits::DetectionLimits;
use crate::sensors::hall::{GripperHallSensor, HallReading, HallSample, HallSensor};

/// State of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorCondition {
    /// The reading is usable.
    Live,
    /// No new reading in this tick.
    Missed,
    /// The same words over too many ticks.
    Frozen,
    /// No new reading for too many ticks.
    Lost,
}

/// A reading with its age.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MonitoredReading {
    /// The reading if usable.
    pub reading: Option<HallReading>,
    /// Ticks since the last field that changed, saturating.
    pub age: u8,
    /// State of the sensor.
    pub condition: SensorCondition,
}

/// Liveness monitor of one sensor.
#[derive(Clone, Copy, Debug)]
pub struct LivenessMonitor {
    lost_ticks: u8,
    frozen_axes: Option<u8>,
    last: Option<HallReading>,
    /// Repeated words, summed over unsaturated axes and ticks.
    repeated: u8,
    missed: u8,
    age: u8,
}

impl LivenessMonitor {
    /// Monitor before the first reading.
    pub const fn new(limits: &DetectionLimits) -> Self {
        Self {
            lost_ticks: limits.lost_ticks,
            frozen_axes: limits.frozen_axes,
            last: None,
            repeated: 0,
            missed: 0,
            age: 0,
        }
    }

    /// Evaluates the transfer of one tick; `None` if it failed.
    pub fn update(&mut self, sample: Option<HallSample>) -> MonitoredReading {
        self.age = self.age.saturating_add(1);
        let Some(HallSample::New(reading)) = sample else {
            self.missed = self.missed.saturating_add(1);
            let is_lost = self.missed >= self.lost_ticks;
            return self.result(
                None,
                if is_lost { SensorCondition::Lost } else { SensorCondition::Missed },
            );
        };
        self.missed = 0;
        // The temperature is converted apart: its last bit flickers even if the field is frozen.
        if self.last.replace(reading).is_some_and(|last| last.field == reading.field) {
            self.repeated = self.repeated.saturating_add(unsaturated_axes(&reading));
        } else {
            (self.age, self.repeated) = (0, 0);
        }
        if self.frozen_axes.is_some_and(|frozen| self.repeated >= frozen) {
            self.result(None, SensorCondition::Frozen)
        } else {
            self.result(Some(reading), SensorCondition::Live)
        }
    }

    fn result(&self, reading: Option<HallReading>, condition: SensorCondition) -> MonitoredReading {
        MonitoredReading { reading, age: self.age, condition }
    }
}

fn unsaturated_axes(reading: &HallReading) -> u8 {
    let (min, max) = GripperHallSensor::FIELD_LIMITS;
    let is_inside = |counts: &&i16| **counts > min && **counts < max;
    reading.field.iter().filter(is_inside).count() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensors::hall::liveness::SensorCondition::Frozen;
    use crate::sensors::hall::liveness::SensorCondition::Live;
    use crate::sensors::hall::liveness::SensorCondition::Lost;
    use crate::sensors::hall::liveness::SensorCondition::Missed;

    fn at(x: i16) -> Option<HallSample> {
        Some(HallSample::New(HallReading { field: [x, 5, -7], temperature: 3 }))
    }

    #[test]
    fn conditions_follow_repeated_missed_and_stale_samples() {
        let stale = Some(HallSample::Stale);
        for (samples, expected) in [
            // Frozen after four repetitions of three axes, live again after the first change.
            (
                [at(1), at(2), at(2), at(2), at(2), at(2), at(3)],
                [Live, Live, Live, Live, Live, Frozen, Live],
            ),
            (
                [at(1), None, at(2), None, stale, None, at(3)],
                [Live, Missed, Live, Missed, Lost, Lost, Live],
            ),
        ] {
            let mut monitor = LivenessMonitor::new(&DetectionLimits::GRIPPER);
            assert_eq!(samples.map(|s| monitor.update(s).condition), expected);
        }
    }

    #[test]
    fn saturated_axes_do_not_count_as_frozen() {
        let mut monitor = LivenessMonitor::new(&DetectionLimits::GRIPPER);
        let (min, max) = GripperHallSensor::FIELD_LIMITS;
        let mut condition = |z| {
            let field = [max, min, z];
            monitor.update(Some(HallSample::New(HallReading { field, temperature: 3 }))).condition
        };
        assert!((0..1000).all(|_| condition(max) == Live));
        // One unsaturated axis needs twelve repetitions: four would occur by noise every five seconds.
        assert_eq!((0..20).take_while(|_| condition(12) == Live).count(), 12);
    }

    #[test]
    fn the_age_counts_from_the_last_change_and_saturates() {
        let mut monitor = LivenessMonitor::new(&DetectionLimits::GRIPPER);
        let ages = [at(1), at(1), None, at(1), at(2)].map(|s| monitor.update(s).age);
        assert_eq!(ages, [0, 1, 2, 3, 0]);
        let last = (0..300).map(|_| monitor.update(None).age).last();
        assert_eq!(last, Some(u8::MAX));
    }
}
