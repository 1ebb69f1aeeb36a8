//! Packets of the serial line: the messages of the CAN bus, and readings and forces of every tick.
//!
//! A packet is postcard data and a CRC-16, COBS-encoded, with a terminating zero. A receiver synchronises at the next
//! zero.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::checksum::CRC16;
use crate::compensation::covariates::Covariates;
use crate::estimator::{Estimate, Validity};
use crate::protocol::messages::Message;
use crate::sensors::hall::{HallFrame, HallReading, SENSORS};

/// Bits per second, 8N1: 300 bytes in a millisecond. A tick takes at most [`MAX_PACKET_BYTES`] of them and always fits, with
/// all covariates; 152 bytes remain for messages of 10 to 15 bytes each, of which the gripper sends about five in ten
/// milliseconds by default. Excess messages are dropped and counted ([`crate::tasks::transmit_serial`]).
pub const BAUD_RATE: u32 = 3_000_000;
/// Longest packet including the zero: a [`Tick`] with every number at its longest encoding.
pub const MAX_PACKET_BYTES: usize = 148;

/// Bytes of the checksum, little-endian.
const CRC_BYTES: usize = 2;
/// Longest packet before COBS encoding, which adds a byte, and the zero.
const PLAIN_BYTES: usize = MAX_PACKET_BYTES - 2;

/// A packet on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Packet {
    /// A message of the CAN bus.
    Message {
        /// Instance of the message: the sensor, for messages sent for each sensor.
        copy: u8,
        /// The message.
        message: Message,
    },
    /// One tick of sensing.
    Tick(Tick),
}

/// Readings and forces of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tick {
    /// Start of the tick in microseconds since boot; wraps around.
    pub time_us: u32,
    /// All sensors.
    pub sensors: [SensorTick; SENSORS],
    /// Covariates that the compensation had.
    pub covariates: Covariates,
}

/// One sensor in a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SensorTick {
    /// Field in counts; all zero without a reading.
    pub field: [i16; 3],
    /// Temperature in counts.
    pub temperature: i16,
    /// The forces in 1/1024 N, lateral and longitudinal.
    pub force: [i32; 2],
    /// Validity of the forces, as an index into [`VALIDITIES`].
    pub validity: u8,
}

/// Encoding of the validity.
pub const VALIDITIES: [Validity; 5] = [
    Validity::Valid,
    Validity::Saturated,
    Validity::OutsideModel,
    Validity::Missing,
    Validity::MissingInputs,
];

impl Tick {
    /// The tick of a frame, its estimates and the covariates.
    pub fn of(frame: &HallFrame, estimates: &[Estimate; SENSORS], covariates: Covariates) -> Self {
        let mut estimates = estimates.iter();
        Self {
            time_us: frame.time_us,
            sensors: frame.readings.map(|reading| {
                SensorTick::of(reading, estimates.next().unwrap_or(&Estimate::MISSING))
            }),
            covariates,
        }
    }
}

impl SensorTick {
    fn of(reading: Option<HallReading>, estimate: &Estimate) -> Self {
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

    /// Validity of the forces; an unknown index gives [`Validity::Missing`].
    pub fn validity(&self) -> Validity {
        let validity = VALIDITIES.get(usize::from(self.validity));
        validity.copied().unwrap_or(Validity::Missing)
    }

    /// The reading. `None` if all words are zero: a working sensor always shows noise and the field of its magnet.
    pub fn reading(&self) -> Option<HallReading> {
        let reading = HallReading { field: self.field, temperature: self.temperature };
        (reading != HallReading::default()).then_some(reading)
    }
}

/// Encodes a packet including its zero. `None` if it does not fit, which never happens.
pub fn encode<'b>(packet: &Packet, buffer: &'b mut [u8; MAX_PACKET_BYTES]) -> Option<&'b [u8]> {
    // Three passes over all bytes: a combined pass byte by byte takes twice as long.
    let mut plain = [0; PLAIN_BYTES];
    let length = postcard::to_slice(packet, &mut plain).ok()?.len();
    let check = CRC16.checksum(plain.get(..length)?);
    let end = length.saturating_add(CRC_BYTES);
    plain.get_mut(length..end)?.copy_from_slice(&check.to_le_bytes());
    let [into @ .., _] = buffer;
    let stuffed = cobs::try_encode(plain.get(..end)?, into).ok()?;
    *buffer.get_mut(stuffed)? = 0;
    buffer.get(..=stuffed)
}

/// Decodes packets from a stream of bytes.
#[derive(Debug, Default)]
pub struct PacketDecoder {
    bytes: Vec<u8, MAX_PACKET_BYTES>,
    /// Too many or lost bytes: all is discarded until the next zero.
    is_discarding: bool,
    /// Invalid packets.
    pub broken: u32,
}

impl PacketDecoder {
    /// Appends a byte; returns the packet that it completes. Invalid packets are counted.
    pub fn push(&mut self, byte: u8) -> Option<Packet> {
        if byte != 0 {
            self.is_discarding |= self.bytes.push(byte).is_err();
            return None;
        }
        let packet = if self.is_discarding { None } else { decode(&mut self.bytes) };
        // Two zeros in a row are not an error.
        if packet.is_none() && !self.bytes.is_empty() {
            self.broken = self.broken.saturating_add(1);
        }
        self.bytes.clear();
        self.is_discarding = false;
        packet
    }

    /// Discards the packet in progress after a loss of bytes.
    pub fn discard(&mut self) {
        self.is_discarding = true;
    }
}

/// Decodes COBS in place and returns the length, as [`cobs::decode_in_place`] does, which indexes without a check.
fn unstuff(bytes: &mut [u8]) -> Option<usize> {
    let (mut from, mut to) = (0_usize, 0_usize);
    while let Some(code) = bytes.get(from).copied() {
        // A group: its length, itself included, and its bytes.
        let end = from.saturating_add(code.into());
        if code == 0 || end > bytes.len() {
            return None;
        }
        for index in from.saturating_add(1)..end {
            let byte = *bytes.get(index)?;
            *bytes.get_mut(to)? = byte;
            to = to.saturating_add(1);
        }
        from = end;
        // A zero is between two groups, except after one of full length.
        if code != u8::MAX && from < bytes.len() {
            *bytes.get_mut(to)? = 0;
            to = to.saturating_add(1);
        }
    }
    Some(to)
}

/// Decodes a packet without its zero.
fn decode(bytes: &mut [u8]) -> Option<Packet> {
    let length = unstuff(bytes)?;
    let bytes = bytes.get(..length)?;
    let (packet, left) =
        postcard::de_flavors::crc::take_from_bytes_u16(bytes, CRC16.digest()).ok()?;
    // Trailing bytes are a second packet after a lost zero, which would be lost uncounted.
    (left.is_empty() && is_valid(&packet)).then_some(packet)
}

/// Whether the instance exists: otherwise the number would be that of another message.
const fn is_valid(packet: &Packet) -> bool {
    match packet {
        Packet::Message { copy, message } => *copy < message.instances(),
        Packet::Tick(_) => true,
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::super::messages::{EStop, Force, Power};
    use super::*;
    use crate::compensation::covariates::{AccelerationSample, AttitudeSample, MotorSample};

    fn packet() -> Packet {
        Packet::Message {
            copy: 0,
            message: Message::Power(Power { bus: 2400, current: -12, ..Power::default() }),
        }
    }

    fn encoded(packet: &Packet) -> std::vec::Vec<u8> {
        encode(packet, &mut [0; MAX_PACKET_BYTES]).unwrap().to_vec()
    }

    fn received(receiver: &mut PacketDecoder, bytes: &[u8]) -> std::vec::Vec<Packet> {
        bytes.iter().filter_map(|byte| receiver.push(*byte)).collect()
    }

    #[test]
    fn packet_round_trips_and_contains_one_zero() {
        let bytes = encoded(&packet());
        assert_eq!(bytes.iter().position(|byte| *byte == 0), Some(bytes.len() - 1));
        assert_eq!(received(&mut PacketDecoder::default(), &bytes), [packet()]);
    }

    #[test]
    fn longest_tick_has_max_packet_bytes() {
        let sensor = SensorTick {
            field: [i16::MIN; 3],
            temperature: i16::MIN,
            force: [i32::MIN; 2],
            validity: u8::MAX,
        };
        let longest = MotorSample { age_us: i16::MIN, iq_ma: i16::MIN, turn: u16::MAX };
        let covariates = Covariates {
            opening_um: Some(i32::MIN),
            motor: Some(longest),
            acceleration: Some(AccelerationSample { age_us: i16::MIN, mm_s2: [i32::MIN; 3] }),
            attitude: Some(AttitudeSample { age_ms: u8::MAX, euler: [i16::MIN; 3] }),
        };
        let tick = Packet::Tick(Tick { time_us: u32::MAX, sensors: [sensor; SENSORS], covariates });
        let bytes = encoded(&tick);
        // A tag, 5 for the time, 4 times (4 * 3 + 2 * 5 + 1); covariates: 1 + 5, 1 + 3 * 3, 1 + 3 + 3 * 5, 1 + 1 + 3 * 3;
        // 2 of checksum, 1 of stuffing, and the zero.
        assert_eq!(bytes.len(), MAX_PACKET_BYTES);
        assert_eq!(received(&mut PacketDecoder::default(), &bytes), [tick]);
    }

    #[test]
    fn tick_encodes_missing_readings_and_validity() {
        let reading = HallReading { field: [1, -2, 3], temperature: 4 };
        for validity in VALIDITIES {
            let estimate = Estimate { validity, ..Estimate::MISSING };
            let sample = SensorTick::of(Some(reading), &estimate);
            assert_eq!((sample.validity(), sample.reading()), (validity, Some(reading)));
        }
        let silent = SensorTick::of(None, &Estimate::MISSING);
        assert_eq!((silent.validity(), silent.reading()), (Validity::Missing, None));
        let unknown = SensorTick { validity: 5, ..silent };
        assert_eq!(unknown.validity(), Validity::Missing);
    }

    #[test]
    fn bit_error_loses_exactly_one_packet() {
        let bytes = encoded(&packet());
        for bit in 0..8 * (bytes.len() - 1) {
            let mut corrupt = bytes.clone();
            corrupt[bit / 8] ^= 1 << (bit % 8);
            let mut receiver = PacketDecoder::default();
            let line = [&corrupt[..], &bytes[..]].concat();
            assert_eq!(received(&mut receiver, &line), [packet()], "bit {bit}");
            assert!(receiver.broken >= 1, "bit {bit}");
        }
    }

    proptest! {
        #[test]
        fn unstuffing_agrees_with_the_library(
            bytes in vec(prop_oneof![1_u8..=6, 1_u8..=u8::MAX, Just(u8::MAX)], 1..600)
        ) {
            let (mut ours, mut theirs) = (bytes.clone(), bytes);
            let length = cobs::decode_in_place(&mut theirs).ok();
            prop_assert_eq!(unstuff(&mut ours), length);
            let length = length.unwrap_or(0);
            prop_assert_eq!(ours.get(..length), theirs.get(..length));
        }

        #[test]
        fn stuffed_bytes_are_restored(bytes in vec(prop_oneof![Just(0_u8), 0..=u8::MAX], 0..600)) {
            let mut stuffed = std::vec![0; cobs::max_encoding_length(bytes.len())];
            let length = cobs::try_encode(&bytes, &mut stuffed).unwrap();
            stuffed.truncate(length);
            let length = unstuff(&mut stuffed);
            prop_assert_eq!(length.and_then(|length| stuffed.get(..length)), Some(&bytes[..]));
        }
    }

    #[test]
    fn packet_with_trailing_bytes_is_rejected() {
        let mut payload = [0; MAX_PACKET_BYTES];
        let stuffed = encoded(&packet());
        let length = cobs::decode(&stuffed[..stuffed.len() - 1], &mut payload).unwrap();
        for beyond in 0..4 {
            let mut line = [0; MAX_PACKET_BYTES + 2];
            let stuffed = cobs::encode(&payload[..length + beyond], &mut line);
            let line = [&line[..stuffed], &[0]].concat();
            let mut receiver = PacketDecoder::default();
            let decoded = received(&mut receiver, &line).len();
            assert_eq!((decoded, receiver.broken), if beyond == 0 { (1, 0) } else { (0, 1) });
        }
    }

    #[test]
    fn packet_with_invalid_instance_is_rejected() {
        let decoded = |message, copy| {
            let bytes = encoded(&Packet::Message { copy, message });
            received(&mut PacketDecoder::default(), &bytes).len()
        };
        let force = Message::Force(Force::default());
        assert_eq!([3, 4, 255].map(|copy| decoded(force, copy)), [1, 0, 0]);
        // The next number is that of a command.
        let stop = Message::EStop(EStop::default());
        assert_eq!([0, 1].map(|copy| decoded(stop, copy)), [1, 0]);
    }

    #[test]
    fn decoder_recovers_after_garbage() {
        let mut receiver = PacketDecoder::default();
        assert!(received(&mut receiver, &[0x55; 10_000]).is_empty());
        assert!(received(&mut receiver, &[0]).is_empty());
        assert_eq!(receiver.broken, 1);
        assert_eq!(received(&mut receiver, &encoded(&packet())), [packet()]);
    }
}
