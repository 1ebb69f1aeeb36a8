//! A word of known content is read from one sensor in each tick: the word of its configuration. It shows whether the sensor
//! is still configured as it was, and whether the bytes of the bus are those that the sensors send.
//!
//! A reading of the A31301 has nothing by which a shifted byte could be noticed: no status, no counter, no checksum that is
//! known. Where a bus shifts all bytes by one, the first word that is read from it afterwards is another: on either bus
//! within two ticks ([`TURNS`]), and then the bus is initialised anew.
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

/// Whose turn it is in successive ticks: the buses take turns, two sensors on each.
pub const TURNS: [usize; SENSORS] = [0, 2, 1, 3];

/// Readings at which the word must be the first before it counts: 40 ms for all sensors.
pub const SETTLES: u8 = 10;

/// What is known of all sensors' configurations.
#[derive(Clone, Copy, Debug)]
pub struct ReadBack {
    strange_looks: u8,
    sensors: [Seen; SENSORS],
    /// Place in [`TURNS`].
    turn: usize,
}

/// What a word that was read back says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// It is the first, or none was read, or nothing is known of this sensor's word.
    Expected,
    /// It is another: the sensor or its bus is not in the state in which it was.
    Unexpected,
}

/// What is known of one.
#[derive(Clone, Copy, Debug)]
struct Seen {
    first: Option<[u8; 2]>,
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
        }
    }

    /// The sensor whose turn it is, until [`Self::update`].
    pub fn turn(&self) -> usize {
        TURNS.get(self.turn).copied().unwrap_or(0)
    }

    /// Takes the word of the sensor whose turn it is; none where it was not read. After an unexpected one it has the next
    /// turn as well: a byte may have been disturbed on its way.
    pub fn update(&mut self, word: Option<[u8; 2]>) -> Word {
        let turn = self.turn();
        if let (Some(word), Some(seen)) = (word, self.sensors.get_mut(turn)) {
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
                return Word::Unexpected;
            }
        }
        self.turn = (self.turn + 1) % SENSORS;
        Word::Expected
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
        let mut ticks = 1;
        while read_back.turn() != sensor {
            read_back.update(Some([0x12, 0x34]));
            ticks += 1;
        }
        ticks
    }

    fn kept(read_back: &ReadBack) -> [bool; SENSORS] {
        let mut samples = [READING; SENSORS];
        read_back.sift(&mut samples);
        samples.map(|sample| sample.is_some())
    }

    fn begun() -> ReadBack {
        let mut read_back = ReadBack::new(&Limits::GRIPPER);
        for _ in 0..SENSORS * usize::from(SETTLES) {
            read_back.update(Some([0x12, 0x34]));
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
            assert_eq!(read_back.update(Some(word.to_be_bytes())), Word::Expected);
            assert_eq!(kept(&read_back), [true; 4]);
        }
    }

    #[test]
    fn each_bus_has_its_turn_every_2_ms_and_each_sensor_every_4_ms() {
        let mut read_back = begun();
        let turns = [(); 8].map(|()| {
            let turn = read_back.turn();
            read_back.update(Some([0x12, 0x34]));
            turn
        });
        assert_eq!(turns, [0, 2, 1, 3, 0, 2, 1, 3]);
    }

    #[test]
    fn an_unexpected_word_twice_takes_its_sensor_and_no_other_until_it_is_back() {
        let mut read_back = begun();
        wait(&mut read_back, 2);
        assert_eq!(read_back.update(Some([0, 0])), Word::Unexpected);
        assert_eq!(kept(&read_back), [true; 4]);
        // It is read again at once; the bus has been initialised anew by then, and that has not helped.
        assert_eq!(wait(&mut read_back, 2), 1);
        assert_eq!(read_back.update(Some([0, 0])), Word::Expected);
        assert_eq!(kept(&read_back), [true, true, false, true]);
        // One that does not answer is no better.
        assert_eq!(wait(&mut read_back, 2), 4);
        read_back.update(None);
        assert_eq!(kept(&read_back), [true, true, false, true]);
        assert_eq!(wait(&mut read_back, 2), 4);
        read_back.update(Some([0x12, 0x34]));
        assert_eq!(kept(&read_back), [true; 4]);
    }

    #[test]
    fn bytes_shifted_by_one_are_an_unexpected_word_whatever_the_byte_before() {
        for before in 0..=255 {
            let mut read_back = begun();
            assert_eq!(read_back.update(Some([before, 0x12])), Word::Unexpected);
        }
    }

    #[test]
    fn a_word_that_was_disturbed_once_takes_nothing() {
        let mut read_back = begun();
        wait(&mut read_back, 1);
        assert_eq!(read_back.update(Some([0x12, 0x35])), Word::Unexpected);
        wait(&mut read_back, 1);
        assert_eq!(read_back.update(Some([0x12, 0x34])), Word::Expected);
        assert_eq!(kept(&read_back), [true; 4]);
    }

    #[test]
    fn any_bit_of_the_word_counts() {
        for bit in 0..16 {
            let mut read_back = begun();
            for _ in 0..2 {
                wait(&mut read_back, 3);
                read_back.update(Some((0x1234_u16 ^ (1 << bit)).to_be_bytes()));
            }
            assert_eq!(kept(&read_back), [true, true, true, false], "{bit}");
        }
    }
}
