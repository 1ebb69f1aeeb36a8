//! Periodic read-back of each sensor's configuration word: one sensor per tick. It detects a lost configuration and
//! bytes shifted on the bus.
//!
//! The A31301's data carry no status, counter or documented checksum that reveals a shifted byte. A bus that shifts
//! all bytes changes the next configuration word as well, on either bus within two ticks ([`TURNS`]); the bus is then
//! re-initialised.
//!
//! The firmware configures no sensor: each loads its own EEPROM at power-up. No public source states the resulting
//! range, so the reference is the first word read. A sensor with another word is treated as lost: after a brown-out
//! it may run with defaults, and its counts have another scale. Nothing is written to repair it: the register's
//! address is unverified, and a write to a wrong one may end in the EEPROM.
//!
//! For the same reason the word counts only if it was constant over the first [`SETTLES`] reads: if the register
//! holds a measurement, which dithers, the check is disabled until the next start. A replaced sensor with another
//! word is accepted at the next start, which hosts can request while nothing is driven.

use crate::config::limits::DetectionLimits;
use crate::sensors::hall::{HallSample, SENSORS};

/// Sensors of successive ticks: the buses alternate, two sensors on each.
pub const TURNS: [usize; SENSORS] = [0, 2, 1, 3];

/// Reads of each sensor that must agree before its word counts: 40 ms for all sensors.
pub const SETTLES: u8 = 10;

/// Reference words and state of all sensors.
#[derive(Clone, Copy, Debug)]
pub struct ConfigReadback {
    /// Successive deviations after which a sensor is lost; `None`: never.
    max_deviations: Option<u8>,
    sensors: [ReferenceWord; SENSORS],
    /// Index in [`TURNS`].
    turn: usize,
    /// Deviations of all sensors.
    deviations: u16,
}

/// Result of one read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadbackResult {
    /// The word equals the reference, was not read, or is not checked.
    Unchanged,
    /// The word deviates: the sensor or its bus has changed state.
    Changed,
}

#[derive(Clone, Copy, Debug)]
struct ReferenceWord {
    first: Option<[u8; 2]>,
    /// Reads equal to the first; `None` if the word was not constant and is never checked.
    settled: Option<u8>,
    /// Successive deviations.
    deviations: u8,
}

impl ConfigReadback {
    /// State before the first read.
    pub const fn new(limits: &DetectionLimits) -> Self {
        let unread = ReferenceWord { first: None, settled: Some(0), deviations: 0 };
        Self {
            max_deviations: limits.config_mismatches,
            sensors: [unread; SENSORS],
            turn: 0,
            deviations: 0,
        }
    }

    /// Sensor to read next.
    pub fn next_sensor(&self) -> usize {
        TURNS.get(self.turn).copied().unwrap_or(0)
    }

    /// Checks the word of [`Self::next_sensor`]; `None` if the read failed. After a deviation the same sensor is next
    /// again: a byte may have been disturbed in transit.
    pub fn update(&mut self, word: Option<[u8; 2]>) -> ReadbackResult {
        let sensor = self.next_sensor();
        if let (Some(word), Some(reference)) = (word, self.sensors.get_mut(sensor)) {
            let is_first = *reference.first.get_or_insert(word) == word;
            reference.deviations = match (is_first, reference.settled) {
                (false, Some(SETTLES..)) => {
                    self.deviations = self.deviations.saturating_add(1);
                    reference.deviations.saturating_add(1)
                }
                (false, _) => {
                    reference.settled = None;
                    0
                }
                (true, settled) => {
                    reference.settled = settled.map(|reads| reads.saturating_add(1));
                    0
                }
            };
            if reference.deviations == 1 && self.max_deviations.is_some() {
                return ReadbackResult::Changed;
            }
        }
        self.turn = (self.turn + 1) % SENSORS;
        ReadbackResult::Unchanged
    }

    /// See [`crate::parameters::schema::counter::CONFIGURATIONS`].
    pub fn summary(&self) -> u32 {
        let is_constant = |word: &ReferenceWord| matches!(word.settled, Some(SETTLES..));
        let bits = (0_u32..).zip(&self.sensors).filter(|(_, word)| is_constant(word));
        bits.fold(u32::from(self.deviations) << 16, |bits, (sensor, _)| bits | 1 << sensor)
    }

    /// The samples without those of sensors with a lost configuration.
    pub fn without_changed(
        &self,
        mut samples: [Option<HallSample>; SENSORS],
    ) -> [Option<HallSample>; SENSORS] {
        for (sample, reference) in samples.iter_mut().zip(&self.sensors) {
            if self.max_deviations.is_some_and(|most| reference.deviations >= most) {
                *sample = None;
            }
        }
        samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensors::hall::HallReading;

    const WORD: Option<[u8; 2]> = Some([0x12, 0x34]);

    /// Ticks up to this sensor's turn; the others' words are unchanged.
    fn wait(readback: &mut ConfigReadback, sensor: usize) -> u32 {
        let mut ticks = 1;
        while readback.next_sensor() != sensor {
            readback.update(WORD);
            ticks += 1;
        }
        ticks
    }

    fn usable(readback: &ConfigReadback) -> [bool; SENSORS] {
        let samples =
            readback.without_changed([Some(HallSample::New(HallReading::default())); SENSORS]);
        samples.map(|sample| sample.is_some())
    }

    fn settled() -> ConfigReadback {
        let mut readback = ConfigReadback::new(&DetectionLimits::GRIPPER);
        for _ in 0..SENSORS * usize::from(SETTLES) {
            readback.update(WORD);
        }
        readback
    }

    #[test]
    fn a_word_that_varies_at_the_start_is_never_checked() {
        let mut readback = ConfigReadback::new(&DetectionLimits::GRIPPER);
        // A measurement: it dithers, then a magnet moves.
        for read in 0..200_u16 {
            wait(&mut readback, 1);
            let word = if read < 8 { 7 } else { 7 + read % 3 };
            let result = readback.update(Some(word.to_be_bytes()));
            assert_eq!(result, ReadbackResult::Unchanged);
            assert_eq!(usable(&readback), [true; 4]);
        }
    }

    #[test]
    fn each_bus_is_read_every_2_ms_and_each_sensor_every_4_ms() {
        let mut readback = settled();
        let turns = [(); 8].map(|()| {
            let turn = readback.next_sensor();
            readback.update(WORD);
            turn
        });
        assert_eq!(turns, [0, 2, 1, 3, 0, 2, 1, 3]);
    }

    #[test]
    fn two_deviations_discard_a_sensor_until_its_word_returns() {
        let lost = [true, true, false, true];
        let mut readback = settled();
        wait(&mut readback, 2);
        assert_eq!(readback.update(Some([0, 0])), ReadbackResult::Changed);
        assert_eq!(usable(&readback), [true; 4]);
        // Read again in the next tick, after re-initialising the bus had no effect.
        for (ticks, word, expected) in
            [(1, Some([0, 0]), lost), (4, None, lost), (4, WORD, [true; 4])]
        {
            assert_eq!(wait(&mut readback, 2), ticks);
            assert_eq!(readback.update(word), ReadbackResult::Unchanged);
            assert_eq!(usable(&readback), expected);
        }
    }

    #[test]
    fn bytes_shifted_by_one_change_the_word() {
        for before in 0..=255 {
            let result = settled().update(Some([before, 0x12]));
            assert_eq!(result, ReadbackResult::Changed);
        }
    }

    #[test]
    fn a_single_disturbed_word_discards_nothing() {
        let mut readback = settled();
        wait(&mut readback, 1);
        assert_eq!(readback.update(Some([0x12, 0x35])), ReadbackResult::Changed);
        wait(&mut readback, 1);
        assert_eq!(readback.update(WORD), ReadbackResult::Unchanged);
        assert_eq!(usable(&readback), [true; 4]);
    }

    #[test]
    fn any_flipped_bit_of_the_word_is_detected() {
        for bit in 0..16 {
            let mut readback = settled();
            for _ in 0..2 {
                wait(&mut readback, 3);
                readback.update(Some((0x1234_u16 ^ (1 << bit)).to_be_bytes()));
            }
            assert_eq!(usable(&readback), [true, true, true, false], "{bit}");
        }
    }
}
