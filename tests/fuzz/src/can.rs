//! Frames on the CAN bus, with their times, into a session and the table of messages.

use std::collections::VecDeque;

use firmware::parameters::schema::PARAMETERS;
use firmware::parameters::{Parameters, handle_request};
use firmware::protocol::ESTOP_ALL_ID;
use firmware::protocol::layout::FrameError;
use firmware::protocol::messages::{LAYOUTS, Message, ParamRequest};
use firmware::protocol::session::{SERVICE_MAGIC, Session, SessionEvent, op, status};

use super::bytes::Bytes;
use super::check::crc16;

/// Numbers of the messages that a host sends, by the table of the protocol.
const STOP: u16 = 2;
const COMMAND: u16 = 3;
const SERVICE: u16 = 4;
const PARAM_REQUEST: u16 = 5;
const HOST_ATTITUDE: u16 = 0x12;
const HOST_ACCELERATION: u16 = 0x13;
const CALIBRATION_CHUNK: u16 = 0x14;
/// Messages of the protocol.
const MESSAGES: u16 = 0x15;
/// Milliseconds between two frames: both sides of every limit.
const WAITS: [u32; 16] = [0, 0, 0, 1, 2, 5, 10, 20, 50, 99, 100, 101, 500, 501, 1000, 1001];
/// Longest data of a frame, were it one of CAN FD.
const LONGEST: usize = 64;

/// What a story came to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Sessions that began.
    pub armed: u32,
    /// Commands that counted.
    pub commands: u32,
    /// Frames that were dropped.
    pub dropped: u32,
}

/// A bus with a gripper, and a reference who knows the rules.
pub fn receive(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let mut now = u32::from_le_bytes(bytes.array());
    let node = 1 + u16::from(bytes.byte()) % 63;
    let mut session = Session::new(node, 100);
    let mut reference = Reference::new(node);
    let mut parameters = Parameters::DEFAULT;
    let mut tally = Tally::default();
    while !bytes.is_empty() {
        let kind = bytes.byte();
        let waited = match bytes.byte() {
            // A minute at most, so that no story lasts until the clock comes round.
            choice @ 0xF0.. => u32::from(choice & 1) * u32::from(bytes.word()),
            choice => WAITS[usize::from(choice & 0xF)],
        };
        now = now.wrapping_add(waited);
        // The gripper's own doing.
        match kind {
            0x47 => {
                session.close();
                reference.close();
                continue;
            }
            0x87 | 0x8F => {
                reference.allow(kind == 0x87);
                session.set_may_arm(kind == 0x87);
                continue;
            }
            _ => {}
        }
        let (id, data) = frame(kind, &mut bytes, &reference);
        let random = bytes.word();
        message(id, &data);
        let event = session.receive(now, id, &data, random);
        let expected = reference.receive(now, id, &data, random);
        assert_eq!(Verdict::of(&event, &data), expected, "{id:#x} {data:x?}");
        assert_eq!(session.is_open(), reference.open.is_some());
        assert_eq!(session.is_alive(now), reference.is_alive(now));
        assert_eq!(session.is_silent(now), reference.is_silent(now));
        assert_eq!(session.is_flooded(now), reference.is_flooded(now));
        if let SessionEvent::Other(Message::ParamRequest(request)) = event {
            answered_rightly(&mut parameters, &request, session.is_open());
        }
        match expected {
            Verdict::Armed(_) => tally.armed += 1,
            Verdict::Command => tally.commands += 1,
            _ => {}
        }
    }
    tally.dropped = session.dropped().all();
    assert_eq!(tally.dropped, reference.dropped);
    tally
}

/// A host's request changes one parameter within its range, or none; and none that moves while somebody is
/// armed.
fn answered_rightly(parameters: &mut Parameters, request: &ParamRequest, is_armed: bool) {
    let before = *parameters;
    let reply = handle_request(parameters, request, is_armed);
    assert_eq!((reply.op, reply.id), (request.op, request.id));
    let now = parameters.get(request.id);
    assert_eq!(reply.value, now.unwrap_or(0) as u32);
    let mut expected = before;
    let row = PARAMETERS.iter().find(|row| row.id == request.id);
    let may = row.is_some_and(|row| {
        request.op == 1
            && row.range.contains(request.value as i32)
            && !(row.affects_motion && is_armed)
    });
    if may {
        assert_eq!(expected.set(request.id, request.value as i32), Ok(()));
    }
    assert_eq!(*parameters, expected);
    assert_eq!(reply.status == 0, may || (row.is_some() && request.op == 0));
}

/// The next frame of a sequence: random, or of a host that follows the protocol.
fn frame(kind: u8, bytes: &mut Bytes, reference: &Reference) -> (u16, Vec<u8>) {
    let of = |number: u16| (reference.node << 5) | number;
    let service = |op: u8, nonce: u16| {
        let mut data = [op, 0, 0, 0, 0, 0, 0, 0];
        data[1..3].copy_from_slice(&SERVICE_MAGIC.to_le_bytes());
        data[3..5].copy_from_slice(&nonce.to_le_bytes());
        (of(SERVICE), data.to_vec())
    };
    let offered = reference.offer.map_or(0, |(nonce, _)| nonce);
    match kind & 7 {
        0 => {
            let id = bytes.word();
            let length = usize::from(bytes.byte()) % (LONGEST + 1);
            (id, bytes.some(length).to_vec())
        }
        1 => {
            let number = u16::from(bytes.byte()) & 0x1F;
            (of(number), bytes.array::<8>().to_vec())
        }
        2 => service(op::ARM, 0),
        3 => service(op::ARM, offered),
        4 if kind & 0x40 != 0 => {
            let mut data = bytes.array::<8>();
            let row = PARAMETERS[usize::from(data[1]) % PARAMETERS.len()];
            data[1..3].copy_from_slice(&row.id.to_le_bytes());
            (of(PARAM_REQUEST), data.to_vec())
        }
        4 => {
            let (op, nonce) = (bytes.byte() % 16, bytes.word());
            let own = reference.open.filter(|_| op == op::END && nonce & 1 == 0);
            service(op, own.unwrap_or(nonce))
        }
        5 | 6 => {
            let mut data = bytes.array::<8>();
            if kind & 7 == 5 {
                // A counter that goes on, or nearly.
                let last = reference.last.map_or(0, |(counter, _)| counter);
                let counter = last.wrapping_add(data[0] & 3);
                data[0] = (data[0] & 0xF) | (counter << 4);
            }
            let nonce = reference.open.unwrap_or(offered);
            let seal = seal(nonce, of(COMMAND), &data);
            data[6..].copy_from_slice(&seal.to_le_bytes());
            // A bit may flip on the way.
            if kind & 0x40 != 0 {
                let bit = bytes.byte() & 63;
                data[usize::from(bit >> 3)] ^= 1 << (bit & 7);
            }
            (of(COMMAND), data.to_vec())
        }
        _ => (ESTOP_ALL_ID, bytes.some(usize::from((kind >> 3) & 7)).to_vec()),
    }
}

/// Checksum of a command: over the nonce, the identifier and the bytes before it.
fn seal(nonce: u16, id: u16, data: &[u8]) -> u16 {
    let head = [nonce.to_le_bytes(), id.to_le_bytes()].into_iter().flatten();
    crc16(head.chain(data[..6].iter().copied()))
}

/// A message that is understood is these bytes and no others, and what is not says why.
fn message(id: u16, data: &[u8]) {
    let number = (id & 0x1F) as u8;
    let layout = LAYOUTS.iter().find(|l| l.numbers().contains(&number));
    let own = |layout: &firmware::protocol::layout::MessageLayout| {
        let bits = |f: &firmware::protocol::layout::SignalLayout| {
            (f.first_bit..f.end_bit).map(|bit| 1_u64 << bit)
        };
        layout.signals.iter().flat_map(bits).sum::<u64>()
    };
    let whole: Option<[u8; 8]> = data.try_into().ok();
    let spare = |bytes, layout| u64::from_le_bytes(bytes) & !own(layout);
    let expected = match (whole, layout) {
        (_, None) => Err(FrameError::Unknown),
        (None, Some(_)) => Err(FrameError::Length),
        (Some(bytes), Some(layout)) if spare(bytes, layout) != 0 => Err(FrameError::Reserved),
        (Some(bytes), Some(layout)) => Ok((bytes, layout)),
    };
    let understood = Message::from_frame(number, data);
    assert_eq!(understood.map(|m| (m.to_bytes(), m.layout())), expected, "{number:#x} {data:x?}");
}

/// What a frame was good for, as far as anybody may rely on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Nothing,
    Stop,
    /// Say this number back.
    Offered(u16),
    Refused,
    /// Nobody may arm now.
    Faulty,
    Armed(u16),
    /// The session ended.
    Ended,
    /// The command of these very bytes.
    Command,
    Other,
}

impl Verdict {
    fn of(event: &SessionEvent, data: &[u8]) -> Self {
        match event {
            SessionEvent::Ignored => Self::Nothing,
            SessionEvent::Stop => Self::Stop,
            SessionEvent::Command(command) => {
                assert_eq!(command.to_bytes(), data);
                Self::Command
            }
            SessionEvent::Other(message) => {
                assert_eq!(message.to_bytes(), data);
                Self::Other
            }
            SessionEvent::Reply { reply, armed } => {
                assert_eq!(reply.detail, 0);
                match (reply.op, reply.status, armed) {
                    (op::ARM, status::CHALLENGE, false) => Self::Offered(reply.nonce),
                    (op::ARM | op::END, status::REFUSED, false) => Self::Refused,
                    (op::ARM, status::FAULTY, false) => Self::Faulty,
                    (op::ARM, status::DONE, true) => Self::Armed(reply.nonce),
                    (op::END, status::DONE, false) => Self::Ended,
                    other => panic!("a reply of no kind: {other:?}"),
                }
            }
        }
    }
}

/// The rules of a session, implemented from its documentation.
struct Reference {
    node: u16,
    may_arm: bool,
    /// A nonce that was offered, and when.
    offer: Option<(u16, u32)>,
    /// The nonce of the session.
    open: Option<u16>,
    /// Counter and time of the last command that counted.
    last: Option<(u8, u32)>,
    dropped: u32,
    /// When frames of a broken sender were dropped: the latest sixteen.
    latest: VecDeque<u32>,
}

impl Reference {
    fn new(node: u16) -> Self {
        Self {
            node,
            may_arm: true,
            offer: None,
            open: None,
            last: None,
            dropped: 0,
            latest: VecDeque::new(),
        }
    }

    fn close(&mut self) {
        (self.offer, self.open, self.last) = (None, None, None);
    }

    fn allow(&mut self, may_arm: bool) {
        self.may_arm = may_arm;
        if !may_arm {
            self.close();
        }
    }

    fn receive(&mut self, now: u32, id: u16, data: &[u8], random: u16) -> Verdict {
        let number = id & 0x1F;
        match (id >> 5 == self.node, data.len()) {
            _ if id == ESTOP_ALL_ID => Verdict::Stop,
            (false, _) => Verdict::Nothing,
            // Whatever it carries.
            _ if number == STOP => Verdict::Stop,
            // What is no message takes nobody's place, however long it is.
            _ if number >= MESSAGES => {
                self.dropped += 1;
                Verdict::Nothing
            }
            (true, 8) => match number {
                COMMAND => self.command(now, id, data),
                SERVICE => self.service(now, data, random),
                PARAM_REQUEST => Verdict::Other,
                // Reserved bits are zero.
                HOST_ATTITUDE if data[7] & !1 == 0 => Verdict::Other,
                HOST_ACCELERATION if data[7] == 0 => Verdict::Other,
                CALIBRATION_CHUNK => Verdict::Other,
                _ => self.drop(now),
            },
            _ => self.drop(now),
        }
    }

    fn service(&mut self, now: u32, data: &[u8], random: u16) -> Verdict {
        let nonce = u16::from_le_bytes([data[3], data[4]]);
        if data[1..3] != *b"MG" {
            return self.drop(now);
        }
        if data[0] == op::END {
            if self.open == Some(nonce) {
                self.close();
                return Verdict::Ended;
            }
            self.drop(now);
            return Verdict::Refused;
        }
        if data[0] != 5 {
            return Verdict::Other;
        }
        if !self.may_arm {
            self.close();
            return Verdict::Faulty;
        }
        if nonce == 0 {
            // Whoever asks has proved nothing: a host that is alive keeps its session.
            if !self.is_alive(now) {
                self.close();
            }
            let nonce = if random == 0 { 1 } else { random };
            self.offer = Some((nonce, now));
            return Verdict::Offered(nonce);
        }
        match self.offer.take() {
            Some((offered, at)) if offered == nonce && now.wrapping_sub(at) <= 500 => {
                (self.open, self.last) = (Some(nonce), None);
                Verdict::Armed(nonce)
            }
            _ => {
                self.drop(now);
                Verdict::Refused
            }
        }
    }

    fn command(&mut self, now: u32, id: u16, data: &[u8]) -> Verdict {
        let Some(nonce) = self.open else {
            return self.drop(now);
        };
        let counter = data[0] >> 4;
        let goes_on =
            self.last.is_none_or(|(last, _)| [(last + 1) % 16, (last + 2) % 16].contains(&counter));
        if data[6..] != seal(nonce, id, data).to_le_bytes() || !goes_on {
            return self.drop(now);
        }
        self.last = Some((counter, now));
        Verdict::Command
    }

    fn drop(&mut self, now: u32) -> Verdict {
        self.dropped += 1;
        self.latest.push_back(now);
        if self.latest.len() > 16 {
            self.latest.pop_front();
        }
        Verdict::Nothing
    }

    fn is_alive(&self, now: u32) -> bool {
        let event = |(_, at): (u8, u32)| now.wrapping_sub(at) <= 100;
        self.open.is_some() && self.last.is_some_and(event)
    }

    fn is_silent(&self, now: u32) -> bool {
        self.open.is_some() && self.last.is_some() && !self.is_alive(now)
    }

    fn is_flooded(&self, now: u32) -> bool {
        let lately = |at: &u32| now.wrapping_sub(*at) <= 1000;
        self.latest.len() == 16 && self.latest.front().is_some_and(lately)
    }
}
