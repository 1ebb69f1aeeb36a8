//! The serial line: the same messages, and every tick's raw and estimated values.
//!
//! A packet is postcard's bytes and their checksum, stuffed so that zero occurs nowhere (COBS), and a
//! zero. Whoever joins late or loses bytes waits for the next zero.

use crc::{CRC_16_IBM_3740, Crc};
use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::messages::Message;
use crate::force::{Estimate, Validity};
use crate::frame::{Frame, SENSORS};
use crate::hall::Reading;

/// The checksum of packets and of commands: polynomial 0x1021, from all ones.
pub static CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);
/// Bits per second on the line: 8N1, 200 bytes in a millisecond. A tick takes at most [`LONGEST`] of them, so that every
/// tick arrives and 98 bytes are left for messages: the CAN bus brings eight at the most in that time, of 10 to 15 bytes
/// each. What has no place is dropped and counted, messages first (`loops/telemetry.rs`).
pub const BAUD: u32 = 2_000_000;
/// Greatest length of a packet on the line, its zero included: that of [`Tick`] where every number takes
/// the most bytes.
pub const LONGEST: usize = 102;

/// Bytes of the checksum, the lower first.
const CHECK_BYTES: usize = 2;
/// Greatest length before stuffing, which adds a byte, and the zero another.
const PLAIN: usize = LONGEST - 2;

/// What travels on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Packet {
    /// A message of the CAN bus.
    Message {
        /// Which of its copies: the sensor, where there is one message for each.
        copy: u8,
        /// The message.
        message: Message,
    },
    /// One tick of sensing.
    Tick(Tick),
}

/// Everything about one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tick {
    /// When it began, in microseconds since boot; turns over.
    pub time_us: u32,
    /// The sensors.
    pub sensors: [Sensor; SENSORS],
}

/// One sensor in a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sensor {
    /// What it read in counts; zero where it did not answer.
    pub field: [i16; 3],
    /// Its temperature in counts.
    pub temperature: i16,
    /// The forces in 1/1024 N, lateral and longitudinal.
    pub force: [i32; 2],
    /// Whether they may be used, as a place in [`VALIDITIES`].
    pub validity: u8,
}

/// What a sensor's validity on the line means.
pub const VALIDITIES: [Validity; 4] = [
    Validity::Valid,
    Validity::Saturated,
    Validity::OutsideModel,
    Validity::Missing,
];

impl Tick {
    /// The tick of a frame and of what was estimated from it.
    pub fn of(frame: &Frame, estimates: &[Estimate; SENSORS]) -> Self {
        let mut estimates = estimates.iter();
        Self {
            time_us: frame.time_us,
            sensors: frame
                .readings
                .map(|reading| Sensor::of(reading, estimates.next().unwrap_or(&Estimate::MISSING))),
        }
    }
}

impl Sensor {
    fn of(reading: Option<Reading>, estimate: &Estimate) -> Self {
        let reading = reading.unwrap_or_default();
        Self {
            field: reading.field,
            temperature: reading.temperature,
            force: estimate.force.map(|force| force.0),
            validity: VALIDITIES
                .iter()
                .position(|validity| *validity == estimate.validity)
                .unwrap_or(VALIDITIES.len()) as u8,
        }
    }

    /// Whether the forces may be used; a number that means nothing is no permission.
    pub fn validity(&self) -> Validity {
        let known = VALIDITIES.get(usize::from(self.validity));
        known.copied().unwrap_or(Validity::Missing)
    }

    /// What it read, for the host. All words zero say that it did not answer: a sensor that works dithers
    /// about a magnet's field.
    pub fn reading(&self) -> Option<Reading> {
        let reading = Reading {
            field: self.field,
            temperature: self.temperature,
        };
        (reading != Reading::default()).then_some(reading)
    }
}

/// The bytes of a packet with its zero; `None` where they do not fit, which no packet does.
pub fn encode<'b>(packet: &Packet, buffer: &'b mut [u8; LONGEST]) -> Option<&'b [u8]> {
    // One after the other, each over all bytes: byte by byte through all three takes twice as long.
    let mut plain = [0; PLAIN];
    let length = postcard::to_slice(packet, &mut plain).ok()?.len();
    let check = CHECKSUM.checksum(plain.get(..length)?);
    let end = length.saturating_add(CHECK_BYTES);
    plain
        .get_mut(length..end)?
        .copy_from_slice(&check.to_le_bytes());
    let [into @ .., _] = buffer;
    let stuffed = cobs::try_encode(plain.get(..end)?, into).ok()?;
    *buffer.get_mut(stuffed)? = 0;
    buffer.get(..=stuffed)
}

/// Gathers packets out of bytes.
#[derive(Debug, Default)]
pub struct Receiver {
    bytes: Vec<u8, LONGEST>,
    /// More bytes came than a packet has: nothing counts until the next zero.
    overrun: bool,
    /// Packets that were not understood.
    pub broken: u32,
}

impl Receiver {
    /// Takes a byte; returns the packet that it ends. Whatever is no packet is counted and forgotten.
    pub fn take(&mut self, byte: u8) -> Option<Packet> {
        if byte != 0 {
            self.overrun |= self.bytes.push(byte).is_err();
            return None;
        }
        let packet = match self.overrun {
            true => None,
            false => decode(&mut self.bytes),
        };
        // Two zeros in a row are no packet, and nothing is lost.
        if packet.is_none() && !self.bytes.is_empty() {
            self.broken = self.broken.saturating_add(1);
        }
        self.bytes.clear();
        self.overrun = false;
        packet
    }

    /// The line lost bytes: what was begun is given up.
    pub fn lost(&mut self) {
        self.overrun = true;
    }
}

/// The packet in stuffed bytes without their zero.
fn decode(bytes: &mut [u8]) -> Option<Packet> {
    let length = cobs::decode_in_place(bytes).ok()?;
    let bytes = bytes.get(..length)?;
    let (packet, left) =
        postcard::de_flavors::crc::take_from_bytes_u16(bytes, CHECKSUM.digest()).ok()?;
    // Where a zero was lost, the next packet follows: one of the two would be lost without being counted.
    (left.is_empty() && is_sound(&packet)).then_some(packet)
}

/// Whether a message has the copy that the packet names: another one would be a message of another number.
const fn is_sound(packet: &Packet) -> bool {
    match packet {
        Packet::Message { copy, message } => *copy < message.copies(),
        Packet::Tick(_) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::super::messages::{EStop, Force, Power};
    use super::*;

    fn packet() -> Packet {
        Packet::Message {
            copy: 0,
            message: Message::Power(Power {
                bus: 2400,
                current: -12,
                ..Power::default()
            }),
        }
    }

    fn sent(packet: &Packet) -> std::vec::Vec<u8> {
        encode(packet, &mut [0; LONGEST]).unwrap().to_vec()
    }

    fn received(receiver: &mut Receiver, bytes: &[u8]) -> std::vec::Vec<Packet> {
        bytes
            .iter()
            .filter_map(|byte| receiver.take(*byte))
            .collect()
    }

    #[test]
    fn a_packet_comes_back_from_its_bytes_and_holds_one_zero_only() {
        let bytes = sent(&packet());
        assert_eq!(
            bytes.iter().position(|byte| *byte == 0),
            Some(bytes.len() - 1)
        );
        assert_eq!(received(&mut Receiver::default(), &bytes), [packet()]);
    }

    #[test]
    fn the_longest_tick_just_fits() {
        let sensor = Sensor {
            field: [i16::MIN; 3],
            temperature: i16::MIN,
            force: [i32::MIN; 2],
            validity: u8::MAX,
        };
        let tick = Packet::Tick(Tick {
            time_us: u32::MAX,
            sensors: [sensor; SENSORS],
        });
        let bytes = sent(&tick);
        // A tag, 5 for the time, 4 times (4 * 3 + 2 * 5 + 1), 2 of checksum, 1 of stuffing, and the zero.
        assert_eq!(bytes.len(), LONGEST);
        assert_eq!(received(&mut Receiver::default(), &bytes), [tick]);
    }

    #[test]
    fn a_tick_says_which_sensor_answered_and_what_its_forces_are_worth() {
        let reading = Reading {
            field: [1, -2, 3],
            temperature: 4,
        };
        for validity in VALIDITIES {
            let estimate = Estimate {
                validity,
                ..Estimate::MISSING
            };
            let told = Sensor::of(Some(reading), &estimate);
            assert_eq!((told.validity(), told.reading()), (validity, Some(reading)));
        }
        let silent = Sensor::of(None, &Estimate::MISSING);
        assert_eq!(
            (silent.validity(), silent.reading()),
            (Validity::Missing, None)
        );
        let strange = Sensor {
            validity: 4,
            ..silent
        };
        assert_eq!(strange.validity(), Validity::Missing);
    }

    #[test]
    fn any_bit_that_flips_loses_that_packet_and_no_other() {
        let bytes = sent(&packet());
        for bit in 0..8 * (bytes.len() - 1) {
            let mut spoilt = bytes.clone();
            spoilt[bit / 8] ^= 1 << (bit % 8);
            let mut receiver = Receiver::default();
            let line = [&spoilt[..], &bytes[..]].concat();
            assert_eq!(received(&mut receiver, &line), [packet()], "bit {bit}");
            assert!(receiver.broken >= 1, "bit {bit}");
        }
    }

    #[test]
    fn bytes_beyond_the_checksum_make_it_no_packet() {
        let mut payload = [0; LONGEST];
        let stuffed = sent(&packet());
        let length = cobs::decode(&stuffed[..stuffed.len() - 1], &mut payload).unwrap();
        for beyond in 0..4 {
            let mut line = [0; LONGEST + 2];
            let stuffed = cobs::encode(&payload[..length + beyond], &mut line);
            let line = [&line[..stuffed], &[0]].concat();
            let mut receiver = Receiver::default();
            let understood = received(&mut receiver, &line).len();
            assert_eq!(
                (understood, receiver.broken),
                if beyond == 0 { (1, 0) } else { (0, 1) }
            );
        }
    }

    #[test]
    fn a_copy_that_a_message_has_not_is_no_packet() {
        let understood = |message, copy| {
            let bytes = sent(&Packet::Message { copy, message });
            received(&mut Receiver::default(), &bytes).len()
        };
        let force = Message::Force(Force::default());
        assert_eq!([3, 4, 255].map(|copy| understood(force, copy)), [1, 0, 0]);
        // The next number is a command's.
        let stop = Message::EStop(EStop::default());
        assert_eq!([0, 1].map(|copy| understood(stop, copy)), [1, 0]);
    }

    #[test]
    fn after_garbage_without_end_the_next_packet_is_understood() {
        let mut receiver = Receiver::default();
        assert!(received(&mut receiver, &[0x55; 10_000]).is_empty());
        assert!(received(&mut receiver, &[0]).is_empty());
        assert_eq!(receiver.broken, 1);
        assert_eq!(received(&mut receiver, &sent(&packet())), [packet()]);
    }
}
