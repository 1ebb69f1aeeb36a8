//! Frames on the CAN bus and the serial line, with their times, into a session and the table of messages.

use std::collections::VecDeque;

use aes::Aes128;
use cmac::{Cmac, KeyInit, Mac};
use firmware::parameters::schema::PARAMETERS;
use firmware::parameters::{self, Parameters, handle_request};
use firmware::protocol::ESTOP_ALL_ID;
use firmware::protocol::authentication::Key;
use firmware::protocol::layout::FrameError;
use firmware::protocol::messages::{LAYOUTS, Message, ParamRequest};
use firmware::protocol::session::{Session, SessionEvent, op, status};

use super::bytes::Bytes;

/// Numbers of the messages that a host sends, by the table of the protocol.
const AUTHENTICATION: u16 = 0;
const STOP: u16 = 2;
const COMMAND: u16 = 3;
const SERVICE: u16 = 4;
const PARAM_REQUEST: u16 = 5;
const HOST_ATTITUDE: u16 = 0x12;
const HOST_ACCELERATION: u16 = 0x13;
const CALIBRATION_CHUNK: u16 = 0x14;
const KEY_PART: u16 = 0x16;
/// Messages of the protocol.
const MESSAGES: u16 = 0x17;
/// Lines.
const CAN: u8 = 0;
const SERIAL: u8 = 1;
/// Milliseconds between two frames: both sides of every limit.
const WAITS: [u64; 16] =
    [0, 0, 0, 1, 2, 5, 20, 50, 100, 101, 1000, 1001, 2000, 2001, 10_000, 10_001];
/// Longest data of a frame, were it one of CAN FD.
const LONGEST: usize = 64;
/// The key of gripper and honest hosts, and one that is guessed.
const KEY: [u8; 16] = *b"sixteen byte key";
const GUESSED: [u8; 16] = [0; 16];

/// What a sequence came to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Sessions that began.
    pub armed: u32,
    /// Commands that counted.
    pub commands: u32,
    /// Frames that were dropped.
    pub dropped: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<3> {
        [("armed", self.armed), ("commands", self.commands), ("dropped", self.dropped)]
    }
}

/// A bus with a gripper, and a reference that knows the rules.
pub fn receive(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    // Around the overflow of 32 bits as well, which is after 49.7 days.
    let mut now = u64::from(u32::from_le_bytes(bytes.array())) << (bytes.byte() % 12);
    let node = 1 + u16::from(bytes.byte()) % 63;
    let mut session = Session::new(node, Key(KEY), 100);
    let mut reference = Reference::new(node);
    let mut parameters = Parameters::DEFAULT;
    let mut tally = Tally::default();
    while !bytes.is_empty() {
        let kind = bytes.byte();
        now += match bytes.byte() {
            choice @ 0xF0.. => u64::from(choice & 1) * u64::from(bytes.word()),
            choice => WAITS[usize::from(choice & 0xF)],
        };
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
            0xC7 | 0xCF => {
                reference.is_moving = kind == 0xC7;
                session.set_is_moving(kind == 0xC7);
                continue;
            }
            0xD7 | 0xDF => {
                reference.is_present = kind == 0xD7;
                session.set_is_present(kind == 0xD7);
                continue;
            }
            _ => {}
        }
        session.expire(now);
        reference.expire(now);
        let source = if kind & 0x20 == 0 { CAN } else { SERIAL };
        for (id, data) in frames(kind, &mut bytes, &reference) {
            let random = u64::from(bytes.word()).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            message(id, &data);
            let event = session.receive(now, source, (id, &data), || Some(random));
            let expected = reference.receive(now, source, id, &data, random);
            assert_eq!(Verdict::of(&event, &data), expected, "{id:#x} {data:x?}");
            assert_eq!(session.is_armed(), reference.open.as_ref().is_some_and(|o| o.is_armed));
            assert_eq!(session.is_alive(now), reference.is_alive(now));
            assert_eq!(session.is_silent(now), reference.is_silent(now));
            assert_eq!(session.is_flooded(now), reference.is_flooded(now));
            if let SessionEvent::Other(Message::ParamRequest(request)) = event {
                answered_rightly(&mut parameters, &request);
            }
            match expected {
                Verdict::Opened(op::ARM) => tally.armed += 1,
                Verdict::Command => tally.commands += 1,
                _ => {}
            }
        }
    }
    tally.dropped = session.dropped().all();
    assert_eq!(tally.dropped, reference.dropped);
    tally
}

/// A host's request changes one parameter within its range, or none.
fn answered_rightly(parameters: &mut Parameters, request: &ParamRequest) {
    let before = *parameters;
    let reply = handle_request(parameters, request);
    assert_eq!((reply.op, reply.id), (request.op, request.id));
    let now = parameters.get(request.id);
    assert_eq!(reply.value, now.unwrap_or(0) as u32);
    let mut expected = before;
    let row = PARAMETERS.iter().find(|row| row.id == request.id);
    let may = row.is_some_and(|row| request.op == 1 && row.range.contains(request.value as i32));
    if may {
        assert_eq!(expected.set(request.id, request.value as i32), Ok(()));
    }
    assert_eq!(*parameters, expected);
    assert_eq!(reply.status == 0, may || (row.is_some() && request.op == 0));
}

/// The next frames of a sequence: random, or of a host that follows the protocol.
fn frames(kind: u8, bytes: &mut Bytes, reference: &Reference) -> Vec<(u16, Vec<u8>)> {
    let of = |number: u16| (reference.node << 5) | number;
    let service = |op: u8| (of(SERVICE), vec![op, 0, 0, 0, 0, 0, 0, 0]);
    let begin = if kind & 0x40 == 0 { op::ARM } else { op::OPEN };
    let plain = match kind & 7 {
        0 => {
            let id = bytes.word();
            let length = usize::from(bytes.byte()) % (LONGEST + 1);
            return vec![(id, bytes.some(length).to_vec())];
        }
        1 => {
            let number = u16::from(bytes.byte()) & 0x1F;
            return vec![(of(number), bytes.array::<8>().to_vec())];
        }
        2 => return vec![service(begin)],
        3 => service(begin),
        4 if kind & 0x40 != 0 => {
            let mut data = bytes.array::<8>();
            let row = PARAMETERS[usize::from(data[1]) % PARAMETERS.len()];
            data[0] &= 3;
            data[1..3].copy_from_slice(&row.id.to_le_bytes());
            (of(PARAM_REQUEST), data.to_vec())
        }
        4 => service(bytes.byte() % 20),
        5 | 6 => {
            let mut data = bytes.array::<8>();
            data[0] &= 0xF;
            (data[6], data[7]) = (0, 0);
            (of(COMMAND), data.to_vec())
        }
        _ => return vec![(ESTOP_ALL_ID, bytes.some(usize::from((kind >> 3) & 7)).to_vec())],
    };
    let choice = bytes.byte();
    if choice == 0 {
        // Without a code.
        return vec![plain];
    }
    let (key, last) = match (kind & 7, &reference.open, &reference.offer) {
        (3, _, Some((number, ..))) => (session_key(&KEY, reference.node, *number), 0),
        (_, Some(open), _) => (open.key, open.counter),
        (_, None, Some((number, ..))) => (session_key(&GUESSED, reference.node, *number), 0),
        (_, None, None) => (GUESSED, 0),
    };
    let counter = match choice {
        // A counter that was used already.
        1..4 => last.saturating_sub(u64::from(choice - 1)),
        4..8 => last + (u64::from(choice) << 20),
        8..16 => last + 1 + u64::from(choice & 1),
        // One of the next that its owner uses.
        _ => (0..=choice % 6).fold(last, |counter, _| following(&key, counter)),
    };
    let (id, data) = plain;
    let mut tag = code(&key, counter, id, &data);
    // A bit may flip on the way.
    if choice & 0xF0 == 0xF0 {
        tag[0] ^= 1;
    }
    let mut authentication = [0; 8];
    authentication[..3].copy_from_slice(&counter.to_le_bytes()[..3]);
    authentication[3..].copy_from_slice(&tag);
    vec![(of(AUTHENTICATION), authentication.to_vec()), (id, data)]
}

/// Counter that follows another one: 13 bits of the code of no message, under an identifier that no message has.
fn following(key: &[u8; 16], counter: u64) -> u64 {
    let tag = code(key, counter, 0xFFFF, &[0; 8]);
    counter + 1 + u64::from(u16::from_le_bytes([tag[0], tag[1]]) & 0x1FFF)
}

/// Key of a session: over a label, the node and the challenge.
pub(super) fn session_key(key: &[u8; 16], node: u16, challenge: u64) -> [u8; 16] {
    let label = b"session".iter().copied();
    cmac(key, label.chain(node.to_le_bytes()).chain(challenge.to_le_bytes()))
}

/// Code of a message: over its identifier, six bytes of the counter, and its bytes.
fn code(key: &[u8; 16], counter: u64, id: u16, data: &[u8]) -> [u8; 5] {
    let counter = counter.to_le_bytes().into_iter().take(6);
    let all = cmac(key, id.to_le_bytes().into_iter().chain(counter).chain(data.iter().copied()));
    [all[0], all[1], all[2], all[3], all[4]]
}

pub(super) fn cmac(key: &[u8; 16], data: impl Iterator<Item = u8>) -> [u8; 16] {
    let mut mac = Cmac::<Aes128>::new(key.into());
    mac.update(&data.collect::<Vec<u8>>());
    mac.finalize().into_bytes().into()
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

/// Effect of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Nothing,
    Stop,
    Challenge(u64),
    /// A session by this operation.
    Opened(u8),
    /// The session ended.
    Ended,
    /// It goes on.
    Renewed,
    /// A refused service, with its status.
    Refused(u8),
    ParameterRefused,
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
            SessionEvent::Reply(Message::ParamReply(reply)) => {
                assert_eq!(reply.status, parameters::status::UNAUTHENTICATED);
                Self::ParameterRefused
            }
            SessionEvent::Reply(Message::ServiceReply(reply)) => match (reply.op, reply.status) {
                (op::ARM | op::OPEN, status::CHALLENGE) => {
                    Self::Challenge(u64::from(reply.extra) << 32 | u64::from(reply.detail))
                }
                (op::ARM | op::OPEN, status::DONE) => Self::Opened(reply.op),
                (op::END, status::DONE) => Self::Ended,
                (op::RENEW, status::DONE) => Self::Renewed,
                (_, status) => Self::Refused(status),
            },
            SessionEvent::Reply(other) => panic!("no reply: {other:?}"),
        }
    }
}

/// Line, counter and code of an authentication, and how many requests were tried with it.
type Expected = (u8, u32, [u8; 5], u32);

/// An open session.
struct Open {
    key: [u8; 16],
    counter: u64,
    active: u64,
    is_armed: bool,
    commanded: Option<u64>,
}

/// The rules of a session, implemented from its documentation.
struct Reference {
    node: u16,
    may_arm: bool,
    is_moving: bool,
    is_present: bool,
    /// A challenge, and when it was drawn.
    offer: Option<(u64, u64)>,
    open: Option<Open>,
    is_abandoned: bool,
    /// Authentications with one of the next four counters, of the session and of an answer to the challenge.
    expected: [Option<Expected>; 2],
    /// Counter and code of the last other one of each line.
    codes: [Option<(u32, [u8; 5])>; 2],
    /// Codes of the others that were checked in the present ten milliseconds of each line, and when these began.
    checked: [(u32, u64); 2],
    dropped: u32,
    /// When frames of a broken sender were dropped: the latest sixteen.
    latest: VecDeque<u64>,
}

impl Reference {
    fn new(node: u16) -> Self {
        Self {
            node,
            may_arm: true,
            is_moving: false,
            is_present: false,
            offer: None,
            open: None,
            is_abandoned: false,
            expected: [None; 2],
            codes: [None; 2],
            checked: [(0, 0); 2],
            dropped: 0,
            latest: VecDeque::new(),
        }
    }

    fn close(&mut self) {
        (self.offer, self.open) = (None, None);
        self.expected = [None; 2];
    }

    /// The challenge ends two seconds after it was drawn.
    fn end_offer(&mut self, now: u64) {
        if self.offer.is_some_and(|(_, at)| now - at > 2000) {
            self.offer = None;
            self.expected[1] = None;
        }
    }

    /// Keys and last counters of the session and of an answer to the challenge.
    fn keys(&self) -> [Option<([u8; 16], u64)>; 2] {
        let open = self.open.as_ref().map(|open| (open.key, open.counter));
        let offer = self.offer.map(|(number, _)| (session_key(&KEY, self.node, number), 0));
        [open, offer]
    }

    fn receive_code(&mut self, now: u64, source: u8, counter: u32, tag: [u8; 5]) {
        self.end_offer(now);
        for (expected, key) in self.keys().into_iter().enumerate() {
            let Some((key, mut next)) = key else { continue };
            let there = self.expected[expected];
            if there.is_some_and(|(line, known, ..)| (line, known) == (source, counter)) {
                continue;
            }
            for _ in 0..4 {
                next = following(&key, next);
                if next & 0xFF_FFFF == u64::from(counter) {
                    self.expected[expected] = Some((source, counter, tag, 0));
                    return;
                }
            }
        }
        self.codes[usize::from(source)] = Some((counter, tag));
    }

    /// The counter of a request, if its code is valid; none where no code preceded it.
    fn check(
        &mut self,
        now: u64,
        source: u8,
        (index, key, last): (usize, [u8; 16], u64),
        (id, data): (u16, &[u8]),
    ) -> Option<Option<u64>> {
        let counter_of = |low: u32, tag: [u8; 5]| {
            let mut counter = (last & !0xFF_FFFF) + u64::from(low);
            if counter <= last {
                counter += 1 << 24;
            }
            (code(&key, counter, id, data) == tag).then_some(counter)
        };
        let mut result = None;
        if let Some((line, low, tag, tries)) = self.expected[index]
            && line == source
        {
            self.expected[index] = (tries < 7).then_some((line, low, tag, tries + 1));
            result = Some(counter_of(low, tag));
        }
        if !matches!(result, Some(Some(_)))
            && let Some((low, tag)) = self.codes[usize::from(source)].take()
        {
            let may_check = self.may_check(now, source);
            result = Some(counter_of(low, tag).filter(|_| may_check));
        }
        if matches!(result, Some(Some(_))) {
            self.expected[index] = None;
        }
        result
    }

    fn allow(&mut self, may_arm: bool) {
        self.may_arm = may_arm;
        if !may_arm && self.open.as_ref().is_some_and(|open| open.is_armed) {
            self.close();
        }
    }

    fn expire(&mut self, now: u64) {
        if self.open.as_ref().is_some_and(|open| now - open.active > 10_000) {
            self.is_abandoned |= self.open.as_ref().is_some_and(|open| open.commanded.is_some());
            self.close();
        }
    }

    fn receive(&mut self, now: u64, source: u8, id: u16, data: &[u8], random: u64) -> Verdict {
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
                // Reserved bits are zero.
                COMMAND if data[0] >> 4 == 0 && data[6..] == [0; 2] => {
                    if !self.is_owner(now, source, id, data) {
                        return self.drop(now);
                    }
                    match &mut self.open {
                        Some(open) if open.is_armed => {
                            open.commanded = Some(now);
                            Verdict::Command
                        }
                        _ => Verdict::Nothing,
                    }
                }
                SERVICE if data[5..] == [0; 3] => self.service(now, source, id, data, random),
                PARAM_REQUEST if data[0] != 1 => Verdict::Other,
                PARAM_REQUEST => {
                    if self.is_owner(now, source, id, data) {
                        return Verdict::Other;
                    }
                    self.drop(now);
                    Verdict::ParameterRefused
                }
                HOST_ATTITUDE if data[7] & !1 == 0 => Verdict::Other,
                HOST_ACCELERATION if data[7] == 0 => Verdict::Other,
                CALIBRATION_CHUNK => Verdict::Other,
                AUTHENTICATION => {
                    let counter = u32::from_le_bytes([data[0], data[1], data[2], 0]);
                    let tag = [data[3], data[4], data[5], data[6], data[7]];
                    self.receive_code(now, source, counter, tag);
                    Verdict::Nothing
                }
                KEY_PART if data[5..] == [0; 3] => match self.writes_key(now, source, id, data) {
                    Verdict::Refused(_) => Verdict::Nothing,
                    verdict => verdict,
                },
                _ => self.drop(now),
            },
            _ => self.drop(now),
        }
    }

    fn service(&mut self, now: u64, source: u8, id: u16, data: &[u8], random: u64) -> Verdict {
        match data[0] {
            op::VERSION | op::DESCRIPTION => Verdict::Other,
            op::ARM | op::OPEN => self.begin(now, source, id, data, random),
            op::WRITE_KEY | op::ERASE_KEY => self.writes_key(now, source, id, data),
            op::COMMAND | 0 | 17.. => Verdict::Refused(status::UNKNOWN),
            op => {
                if !self.is_owner(now, source, id, data) {
                    self.drop(now);
                    return Verdict::Refused(status::UNAUTHENTICATED);
                }
                if op == op::END {
                    self.close();
                    return Verdict::Ended;
                }
                if op == op::RENEW {
                    return Verdict::Renewed;
                }
                Verdict::Other
            }
        }
    }

    fn begin(&mut self, now: u64, source: u8, id: u16, data: &[u8], random: u64) -> Verdict {
        // The owner has been silent for a second, and nothing moves.
        let is_owned = self
            .open
            .as_ref()
            .is_some_and(|open| now - open.active <= 1000 || (open.is_armed && self.is_moving));
        if is_owned {
            return Verdict::Refused(status::ARMED);
        }
        if data[0] == op::ARM && !self.may_arm {
            return Verdict::Refused(status::FAULTY);
        }
        self.end_offer(now);
        let (number, _) = *self.offer.get_or_insert((random & 0xFFFF_FFFF_FFFF, now));
        let key = session_key(&KEY, self.node, number);
        let counter = match self.check(now, source, (1, key, 0), (id, data)) {
            None => return Verdict::Challenge(number),
            Some(None) => {
                self.drop(now);
                return Verdict::Refused(status::REFUSED);
            }
            Some(Some(counter)) => counter,
        };
        self.expected = [None; 2];
        let is_armed = data[0] == op::ARM;
        self.offer = None;
        self.is_abandoned &= !is_armed;
        self.open = Some(Open { key, counter, active: now, is_armed, commanded: None });
        Verdict::Opened(data[0])
    }

    fn writes_key(&mut self, now: u64, source: u8, id: u16, data: &[u8]) -> Verdict {
        if source == SERIAL && self.is_present {
            return Verdict::Other;
        }
        if source == SERIAL {
            if self.is_owner(now, source, id, data) {
                return Verdict::Other;
            }
            self.drop(now);
        }
        Verdict::Refused(status::NOT_PRESENT)
    }

    /// Whether a code before it is that of the message, and its counter is new.
    fn is_owner(&mut self, now: u64, source: u8, id: u16, data: &[u8]) -> bool {
        let Some(Open { key, counter, .. }) = self.open else {
            self.codes[usize::from(source)] = None;
            return false;
        };
        let checked = self.check(now, source, (0, key, counter), (id, data));
        if let (Some(Some(counter)), Some(open)) = (checked, &mut self.open) {
            (open.counter, open.active) = (counter, now);
        }
        matches!(checked, Some(Some(_)))
    }

    /// Two codes of other counters are checked in ten milliseconds on a line.
    fn may_check(&mut self, now: u64, source: u8) -> bool {
        let checked = &mut self.checked[usize::from(source)];
        if now - checked.1 >= 10 {
            *checked = (0, now);
        }
        checked.0 += 1;
        checked.0 <= 2
    }

    fn drop(&mut self, now: u64) -> Verdict {
        self.dropped += 1;
        self.latest.push_back(now);
        if self.latest.len() > 16 {
            self.latest.pop_front();
        }
        Verdict::Nothing
    }

    fn is_alive(&self, now: u64) -> bool {
        let commanded = self.open.as_ref().and_then(|open| open.commanded);
        commanded.is_some_and(|at| now - at <= 100)
    }

    fn is_silent(&self, now: u64) -> bool {
        let commanded = self.open.as_ref().and_then(|open| open.commanded);
        self.is_abandoned || (commanded.is_some() && !self.is_alive(now))
    }

    fn is_flooded(&self, now: u64) -> bool {
        let lately = |at: &u64| now - at <= 1000;
        self.latest.len() == 16 && self.latest.front().is_some_and(lately)
    }
}
