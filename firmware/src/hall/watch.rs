//! Whether a sensor still measures: the age of its last reading, and readings that do not move.
//!
//! The A31301 has no sign for new data that is known. A living sensor dithers, though: with its noise of
//! 0.35 G rms (2.8 counts) an axis repeats its word once in ten times, three axes once in a thousand. An
//! axis at the end of its range repeats for ever and says nothing, so it does not count.

use super::a31301::FIELD_LIMITS;
use super::{Reading, Sample};
use crate::limits::Limits;

/// What one tick brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// A reading that may be used.
    Live,
    /// No reading this time.
    Missed,
    /// The same words again and again.
    Frozen,
    /// No reading for so long that the sensor counts as gone.
    Lost,
}

/// A reading with its age.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Watched {
    /// Present where it may be used.
    pub reading: Option<Reading>,
    /// Ticks since the last reading that moved; stays at the end of its range.
    pub age: u8,
    /// What it is worth.
    pub condition: Condition,
}

/// The watch over one sensor.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    lost_ticks: u8,
    frozen_axes: u8,
    last: Option<Reading>,
    repeated: u8,
    missed: u8,
    age: u8,
}

impl Watch {
    /// Nothing has been read yet.
    pub const fn new(limits: &Limits) -> Self {
        Self {
            lost_ticks: limits.lost_ticks,
            frozen_axes: limits.frozen_axes,
            last: None,
            repeated: 0,
            missed: 0,
            age: 0,
        }
    }

    /// Takes what this tick's transfer gave; `None` where it failed.
    pub fn note(&mut self, sample: Option<Sample>) -> Watched {
        self.age = self.age.saturating_add(1);
        let Some(Sample::New(reading)) = sample else {
            self.missed = self.missed.saturating_add(1);
            let condition = match self.missed >= self.lost_ticks {
                true => Condition::Lost,
                false => Condition::Missed,
            };
            return self.watched(None, condition);
        };
        self.missed = 0;
        self.repeated = match self.last.replace(reading) {
            Some(last) if last == reading => self.repeated.saturating_add(moving_axes(&reading)),
            _ => {
                self.age = 0;
                0
            }
        };
        match self.repeated >= self.frozen_axes {
            true => self.watched(None, Condition::Frozen),
            false => self.watched(Some(reading), Condition::Live),
        }
    }

    fn watched(&self, reading: Option<Reading>, condition: Condition) -> Watched {
        Watched {
            reading,
            age: self.age,
            condition,
        }
    }
}

/// Axes within the range: the others cannot move.
fn moving_axes(reading: &Reading) -> u8 {
    let (least, greatest) = FIELD_LIMITS;
    let moves = |counts: &&i16| **counts > least && **counts < greatest;
    reading.field.iter().filter(moves).count() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: i16) -> Option<Sample> {
        Some(Sample::New(Reading {
            field: [x, 5, -7],
            temperature: 3,
        }))
    }

    fn conditions(watch: &mut Watch, samples: &[Option<Sample>]) -> std::vec::Vec<Condition> {
        samples.iter().map(|s| watch.note(*s).condition).collect()
    }

    #[test]
    fn three_readings_after_the_last_that_moved_a_sensor_is_frozen_and_it_thaws_at_once() {
        use Condition::{Frozen, Live};
        let samples = [at(1), at(2), at(2), at(2), at(2), at(2), at(3)];
        let seen = conditions(&mut Watch::new(&Limits::GRIPPER), &samples);
        assert_eq!(seen, [Live, Live, Live, Live, Frozen, Frozen, Live]);
    }

    #[test]
    fn a_sensor_at_the_end_of_its_range_is_not_frozen_while_another_axis_moves_or_can_not() {
        let mut watch = Watch::new(&Limits::GRIPPER);
        for _ in 0..1000 {
            let full = Reading {
                field: [16383, -16384, 16383],
                temperature: 3,
            };
            assert_eq!(
                watch.note(Some(Sample::New(full))).condition,
                Condition::Live
            );
        }
        // One axis that can move needs nine repetitions: three would happen by noise every second.
        let one = Reading {
            field: [16383, -16384, 12],
            temperature: 3,
        };
        let mut live = 0;
        while watch.note(Some(Sample::New(one))).condition == Condition::Live {
            live += 1;
        }
        assert_eq!(live, 9);
    }

    #[test]
    fn one_missed_reading_is_missed_and_two_are_lost_also_where_the_part_says_that_nothing_is_new()
    {
        use Condition::{Live, Lost, Missed};
        let mut watch = Watch::new(&Limits::GRIPPER);
        let samples = [at(1), None, at(2), None, Some(Sample::Old), None, at(3)];
        let seen = conditions(&mut watch, &samples);
        assert_eq!(seen, [Live, Missed, Live, Missed, Lost, Lost, Live]);
    }

    #[test]
    fn the_age_counts_from_the_last_reading_that_moved() {
        let mut watch = Watch::new(&Limits::GRIPPER);
        let ages = [at(1), at(1), None, at(1), at(2)].map(|s| watch.note(s).age);
        assert_eq!(ages, [0, 1, 2, 3, 0]);
        for _ in 0..300 {
            watch.note(None);
        }
        assert_eq!(watch.note(None).age, u8::MAX);
    }
}
