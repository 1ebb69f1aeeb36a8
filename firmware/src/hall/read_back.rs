//! Whether sensors are still configured as they were: a word of each one's configuration is read back in turn.
//!
//! The firmware configures none of them: each takes what its own memory says as its power comes. Which range that
//! gives no public source tells, so what counts is the first word that was read, and a sensor whose word is another
//! is lost: after too little voltage it may have come back with its defaults, and its counts mean other fields.
//!
//! The A31301's place of the word is unverified. So the word must have stood still for the first [`SETTLES`] looks
//! before it counts: where a reading stands instead, which dithers, nothing is judged until the next start.
//!
//! It is lost until the word is the first again, as after a power-up of its own that goes well. Nothing is written
//! to bring that about: the word's place is unverified, and what is written to a wrong one may end in the sensor's
//! memory for ever. A sensor that was exchanged for one of another kind is taken up at the next start, which hosts
//! can ask for while nothing is driven.

use super::Sample;
use crate::frame::SENSORS;
use crate::limits::Limits;

/// Ticks from one sensor's turn to the next: each has its turn every 80 ms.
pub const TURN_TICKS: u8 = 20;

/// Looks at which the word must be the first before it counts: one a tick, 40 ms for all sensors.
pub const SETTLES: u8 = 10;

/// A word of a configuration.
pub type Word = [u8; 2];

/// What is known of all sensors' configurations.
#[derive(Clone, Copy, Debug)]
pub struct ReadBack {
    strange_looks: u8,
    sensors: [Seen; SENSORS],
    turn: usize,
    /// Ticks until it.
    wait: u8,
}

/// What is known of one.
#[derive(Clone, Copy, Debug)]
struct Seen {
    first: Option<Word>,
    /// Looks at which it was the first, until it counts; none where it never will.
    settled: Option<u8>,
    /// Looks in a row at which it was another.
    strange: u8,
}

impl ReadBack {
    /// Nothing has been read yet.
    pub const fn new(limits: &Limits) -> Self {
        let nothing = Seen {
            first: None,
            settled: Some(0),
            strange: 0,
        };
        Self {
            strange_looks: limits.strange_looks,
            sensors: [nothing; SENSORS],
            turn: 0,
            wait: 0,
        }
    }

    /// A tick: the sensor whose turn it is, in this tick and the next ones until [`Self::note`].
    pub const fn turn(&mut self) -> Option<usize> {
        self.wait = self.wait.saturating_sub(1);
        match self.wait {
            0 => Some(self.turn),
            _ => None,
        }
    }

    /// Takes the word of the sensor whose turn it was; none where it was not read.
    pub fn note(&mut self, word: Option<Word>) {
        self.wait = TURN_TICKS;
        if let (Some(word), Some(seen)) = (word, self.sensors.get_mut(self.turn)) {
            let is_first = *seen.first.get_or_insert(word) == word;
            seen.strange = match (is_first, seen.settled) {
                (false, Some(SETTLES..)) => seen.strange.saturating_add(1),
                (false, _) => {
                    seen.settled = None;
                    0
                }
                (true, settled) => {
                    seen.settled = settled.map(|looks| looks.saturating_add(1));
                    0
                }
            };
            if seen.strange == 1 {
                // A byte may have been disturbed on its way: the next tick looks again.
                self.wait = 0;
                return;
            }
            if seen.settled.is_some_and(|looks| looks < SETTLES) {
                self.wait = 0;
            }
        }
        self.turn = (self.turn + 1) % SENSORS;
    }

    /// Takes the samples away that are of sensors whose configuration is lost.
    pub fn sift(&self, samples: &mut [Option<Sample>; SENSORS]) {
        for (sample, seen) in samples.iter_mut().zip(&self.sensors) {
            if seen.strange >= self.strange_looks {
                *sample = None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hall::Reading;

    const READING: Option<Sample> = Some(Sample::New(Reading {
        field: [1, 2, 3],
        temperature: 4,
    }));

    /// Ticks until it is this sensor's turn; others' words are what they were.
    fn wait(read_back: &mut ReadBack, sensor: usize) -> u32 {
        let mut ticks = 0;
        loop {
            ticks += 1;
            match read_back.turn() {
                Some(turn) if turn == sensor => return ticks,
                Some(_) => read_back.note(Some([0x12, 0x34])),
                None => {}
            }
        }
    }

    fn kept(read_back: &ReadBack) -> [bool; SENSORS] {
        let mut samples = [READING; SENSORS];
        read_back.sift(&mut samples);
        samples.map(|sample| sample.is_some())
    }

    fn begun() -> ReadBack {
        let mut read_back = ReadBack::new(&Limits::GRIPPER);
        for sensor in (0..SENSORS).cycle().take(SENSORS * usize::from(SETTLES)) {
            wait(&mut read_back, sensor);
            read_back.note(Some([0x12, 0x34]));
        }
        read_back
    }

    #[test]
    fn a_word_that_does_not_stand_still_at_first_is_never_judged() {
        let mut read_back = ReadBack::new(&Limits::GRIPPER);
        // A reading: it dithers, then a magnet moves.
        for look in 0..200_u16 {
            wait(&mut read_back, 1);
            let word = if look < 8 { 7 } else { 7 + look % 3 };
            read_back.note(Some(word.to_be_bytes()));
            assert_eq!(kept(&read_back), [true; 4]);
        }
    }

    #[test]
    fn every_sensor_has_its_turn_once_in_80_ms() {
        let mut read_back = begun();
        let waits: [u32; 8] = core::array::from_fn(|turn| {
            let ticks = wait(&mut read_back, turn % SENSORS);
            read_back.note(Some([0x12, 0x34]));
            ticks
        });
        assert_eq!(waits, [20; 8]);
    }

    #[test]
    fn a_turn_for_which_a_tick_has_no_time_comes_in_the_next() {
        let mut read_back = begun();
        wait(&mut read_back, 2);
        assert_eq!([(); 3].map(|()| read_back.turn()), [Some(2); 3]);
    }

    #[test]
    fn a_word_that_is_another_twice_takes_its_sensor_and_no_other_until_it_is_back() {
        let mut read_back = begun();
        wait(&mut read_back, 2);
        read_back.note(Some([0, 0]));
        assert_eq!(kept(&read_back), [true; 4]);
        assert_eq!(wait(&mut read_back, 2), 1);
        read_back.note(Some([0, 0]));
        assert_eq!(kept(&read_back), [true, true, false, true]);
        // One that does not answer is no better.
        assert_eq!(wait(&mut read_back, 2), 80);
        read_back.note(None);
        assert_eq!(kept(&read_back), [true, true, false, true]);
        assert_eq!(wait(&mut read_back, 2), 80);
        read_back.note(Some([0x12, 0x34]));
        assert_eq!(kept(&read_back), [true; 4]);
    }

    #[test]
    fn a_word_that_was_disturbed_once_takes_nothing() {
        let mut read_back = begun();
        wait(&mut read_back, 1);
        read_back.note(Some([0x12, 0x35]));
        wait(&mut read_back, 1);
        read_back.note(Some([0x12, 0x34]));
        assert_eq!(kept(&read_back), [true; 4]);
        assert_eq!(wait(&mut read_back, 1), 80);
    }

    #[test]
    fn any_bit_of_the_word_counts() {
        for bit in 0..16 {
            let mut read_back = begun();
            for _ in 0..2 {
                wait(&mut read_back, 3);
                read_back.note(Some((0x1234_u16 ^ (1 << bit)).to_be_bytes()));
            }
            assert_eq!(kept(&read_back), [true, true, true, false], "{bit}");
        }
    }
}
