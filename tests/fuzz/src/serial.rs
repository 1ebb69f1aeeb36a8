//! Bytes on the serial line into the receiver of its packets.

use firmware::compensation::covariates::{
    AccelerationSample, AttitudeSample, Covariates, MotorSample,
};
use firmware::protocol::messages::Message;
use firmware::protocol::serial::{
    MAX_PACKET_BYTES, Packet, PacketDecoder, SensorTick, Tick, encode,
};
use firmware::sensors::hall::SENSORS;

use super::bytes::Bytes;
use super::check::{crc16, stuffed, unstuffed};

/// What a story came to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Packets that were understood.
    pub packets: u32,
    /// Packets that were not.
    pub broken: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<2> {
        [("packets", self.packets), ("broken", self.broken)]
    }
}

/// A line on which anything may come.
pub fn receive(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let mut line = Line::default();
    while !bytes.is_empty() {
        let kind = bytes.byte();
        let length = usize::from(kind >> 3);
        match kind & 7 {
            0 => line.send(bytes.some(length)),
            // Well stuffed and checked, whatever it says.
            1 => {
                let mut payload = bytes.some(length).to_vec();
                let sum = crc16(payload.iter().copied());
                payload.extend_from_slice(&sum.to_le_bytes());
                line.send(&stuffed(&payload));
            }
            2 => line.send(&[length as u8 | 1; 16]),
            3 => line.lose(),
            4 if length & 1 == 1 => {
                let sent = sent(&packet(&mut bytes));
                line.lost_within(&sent, usize::from(bytes.byte()) % sent.len());
            }
            4 => {
                let packet = packet(&mut bytes);
                line.understands(&packet);
            }
            5 => {
                let mut sent = sent(&packet(&mut bytes));
                let at = usize::from(bytes.byte()) % sent.len();
                sent[at] ^= bytes.byte();
                line.send(&sent);
            }
            // More than a packet, or less.
            6 => {
                let mut payload = payload(&packet(&mut bytes));
                if bytes.byte() & 1 == 0 {
                    payload.pop();
                }
                payload.extend_from_slice(bytes.some(length));
                line.understands_only_if_checked(&payload);
            }
            _ => line.send(&[0]),
        }
    }
    line.recovers();
    Tally { packets: line.packets, broken: line.receiver.broken }
}

/// Some covariates.
fn covariates(bytes: &mut Bytes) -> Covariates {
    let present = bytes.byte();
    let has = |bit: u8| present >> bit & 1 != 0;
    Covariates {
        opening_um: has(0).then(|| i32::from_le_bytes(bytes.array())),
        motor: has(1).then(|| MotorSample {
            age_us: bytes.word() as i16,
            iq_ma: bytes.word() as i16,
            turn: bytes.word(),
        }),
        acceleration: has(2).then(|| AccelerationSample {
            age_us: bytes.word() as i16,
            mm_s2: [(); 3].map(|()| i32::from_le_bytes(bytes.array())),
        }),
        attitude: has(3).then(|| AttitudeSample {
            age_ms: bytes.byte(),
            euler: [(); 3].map(|()| bytes.word() as i16),
        }),
    }
}

/// Some packet.
fn packet(bytes: &mut Bytes) -> Packet {
    let kind = bytes.byte();
    if kind & 1 == 0 {
        let sensor = |_| SensorTick {
            field: [(); 3].map(|()| bytes.word() as i16),
            temperature: bytes.word() as i16,
            force: [(); 2].map(|()| i32::from_le_bytes(bytes.array())),
            validity: bytes.byte(),
        };
        let sensors: [SensorTick; SENSORS] = std::array::from_fn(sensor);
        let time_us = u32::from_le_bytes(bytes.array());
        let covariates = covariates(bytes);
        return Packet::Tick(Tick { time_us, sensors, covariates });
    }
    let number = bytes.byte() & 0x1F;
    let message = Message::from_frame(number, &bytes.array::<8>());
    let message = message.unwrap_or(Message::EStop(Default::default()));
    Packet::Message { copy: (kind >> 1) % message.layout().instances, message }
}

/// The bytes of a packet: no zero but the last, and no more than the line foresees.
fn sent(packet: &Packet) -> Vec<u8> {
    let mut buffer = [0; MAX_PACKET_BYTES];
    let bytes = encode(packet, &mut buffer).expect("every packet fits");
    let zero = bytes.iter().position(|byte| *byte == 0);
    assert_eq!(zero, Some(bytes.len() - 1));
    bytes.to_vec()
}

/// What its bytes say, with the checksum.
fn payload(packet: &Packet) -> Vec<u8> {
    match sent(packet).as_slice() {
        [stuffed @ .., 0] => unstuffed(stuffed),
        other => panic!("no zero at the end: {other:x?}"),
    }
}

#[derive(Default)]
struct Line {
    receiver: PacketDecoder,
    /// Packets that were understood.
    packets: u32,
    /// Zeros that ended something.
    ended: u32,
    /// Something came since the last zero.
    begun: bool,
}

impl Line {
    fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.take(*byte);
        }
    }

    fn take(&mut self, byte: u8) -> Option<Packet> {
        self.ended += u32::from(byte == 0 && self.begun);
        self.begun = byte != 0;
        let packet = self.receiver.push(byte);
        if let Some(packet) = &packet {
            self.packets += 1;
            if let Packet::Message { copy, message } = packet {
                assert!(*copy < message.layout().instances);
            }
            // What was understood can be sent, and is understood as the same.
            let mut other = PacketDecoder::default();
            let back = sent(packet).into_iter().find_map(|byte| other.push(byte));
            assert_eq!(back.as_ref(), Some(packet));
        }
        assert_eq!(self.packets + self.receiver.broken, self.ended);
        packet
    }

    fn lose(&mut self) {
        self.receiver.discard();
    }

    /// A packet within which the line lost bytes is none, though all of its own came.
    fn lost_within(&mut self, sent: &[u8], at: usize) {
        self.end();
        let before = self.packets;
        self.send(&sent[..at]);
        self.lose();
        self.send(&sent[at..]);
        assert_eq!(self.packets, before);
    }

    /// Ends whatever was begun.
    fn end(&mut self) {
        self.take(0);
    }

    /// A sound packet after the end of another is understood.
    fn understands(&mut self, packet: &Packet) {
        self.end();
        let bytes = sent(packet);
        let all: Vec<Packet> = bytes.iter().filter_map(|byte| self.take(*byte)).collect();
        assert_eq!(all, [*packet]);
    }

    /// Bytes whose last two are not the checksum of all before them are no packet.
    fn understands_only_if_checked(&mut self, payload: &[u8]) {
        self.end();
        let before = self.packets;
        self.send(&stuffed(payload));
        let checked = payload
            .split_last_chunk()
            .is_some_and(|(said, sum)| u16::from_le_bytes(*sum) == crc16(said.iter().copied()));
        assert!(checked || self.packets == before, "{payload:x?}");
    }

    /// Whatever came before: of two sound packets in a row the second is understood.
    fn recovers(&mut self) {
        let sound = Packet::Message { copy: 0, message: Message::EStop(Default::default()) };
        let bytes = sent(&sound);
        self.send(&bytes);
        let all: Vec<Packet> = bytes.iter().filter_map(|byte| self.take(*byte)).collect();
        assert_eq!(all, [sound]);
    }
}
