//! Sessions of hosts: opening by challenge and response, one owner, authentication of requests.
//!
//! A host requests a session without a code, and receives a challenge. It repeats the request with the code that only a
//! holder of the key can compute ([`crate::protocol::authentication`]), and owns the session from then on. There are sessions with motion
//! ([`op::ARM`]) and without ([`op::OPEN`], for services and parameters). A request that needs a code is preceded by an
//! [`Authentication`] on the same line. What needs one is in [`crate::protocol::rules`].
//!
//! A session ends by [`op::END`], after [`EXPIRY_MS`] without a valid request, and, if it is armed, when a fault forbids it. Another host
//! can open one once the owner was silent for [`TAKEOVER_MS`] and nothing moves.

use crate::parameters;
use crate::protocol::authentication::{
    CHALLENGE_MASK, COUNTER_MASK, Key, SessionMac, Tag, next_counter,
};
use crate::protocol::frame_id;
use crate::protocol::layout::{Direction, FrameError};
use crate::protocol::messages::{
    Authentication, Command, EStop, Message, ParamReply, Service, ServiceReply,
};
use crate::protocol::rules::{Authority, RequestKind};
use crate::protocol::{ESTOP_ALL_ID, SERIAL, SOURCES};

/// Validity of a challenge after its last request.
pub const CHALLENGE_TIMEOUT_MS: u64 = 500;
/// Silence of the owner after which another host can open a session.
pub const TAKEOVER_MS: u64 = 1000;
/// Silence of the owner that ends the session.
pub const EXPIRY_MS: u64 = 10_000;
/// Codes that are checked in [`CODE_WINDOW_MS`]: a flood of forged messages takes at most 2 % of the processor.
const MAX_CODES: u8 = 4;
const CODE_WINDOW_MS: u64 = 10;
/// Rejected frames within `FLOOD_MS` that are a fault of a sender.
const FLOOD: usize = 16;
/// Time window of [`FLOOD`].
const FLOOD_MS: u64 = 1000;

/// Argument of [`op::TARE`]: the host has made sure that nothing is gripped, although both fingers seem to press.
pub const UNLOADED: u32 = 1;

/// Operations of a service request.
pub mod op {
    /// Clear latched faults whose cause is gone.
    pub const CLEAR_FAULTS: u8 = 1;
    /// Tare: define the present forces as zero. Argument: 0, or [`super::UNLOADED`].
    pub const TARE: u8 = 2;
    /// Write parameters to flash.
    pub const SAVE: u8 = 3;
    /// Reset the chip.
    pub const REBOOT: u8 = 4;
    /// Open a session with motion, in two steps.
    pub const ARM: u8 = 5;
    /// Request the version.
    pub const VERSION: u8 = 6;
    /// Not a service: marks the reply to a rejected command ([`crate::grip::commands::CommandRefusal`]).
    pub const COMMAND: u8 = 7;
    /// Calibrate while disarmed; the argument is a [`crate::motor::calibration::CalibrationKind`]. The result takes effect at once,
    /// and is stored by [`SAVE`].
    pub const MEASURE: u8 = 8;
    /// Begin the upload of a calibration while disarmed; the argument is its length in bytes. Replies with this operation also
    /// acknowledge [`crate::protocol::messages::CalibrationChunk`]: the detail is the number of the next chunk, or, if it
    /// failed, a [`crate::system::nv_storage::calibration::UploadError`].
    pub const UPLOAD: u8 = 9;
    /// Verify and activate the uploaded calibration; it runs after a reboot. The argument is the session's code of all its
    /// bytes ([`crate::protocol::authentication::DataMac`]).
    pub const FINISH_UPLOAD: u8 = 10;
    /// Read the description of the running calibration, four bytes at a time: argument 0 asks for its length in bits 0 to 15
    /// and its origin in bits 16 to 23 (0: linked, 1 and 2: the slot in flash, plus one), n for the bytes from 4 (n - 1).
    pub const DESCRIPTION: u8 = 11;
    /// End the session.
    pub const END: u8 = 12;
    /// Open a session without motion, in two steps.
    pub const OPEN: u8 = 13;
    /// Store the key whose parts were sent in [`crate::protocol::messages::KeyPart`]; it is valid at once, and ends the session. Argument:
    /// [`crate::protocol::authentication::Key::check_number`].
    pub const WRITE_KEY: u8 = 14;
    /// Erase the key, which ends the session.
    pub const ERASE_KEY: u8 = 15;
    /// Prove that the owner is still there, and nothing else: an upload and a measurement take longer than a session lasts
    /// without a valid request.
    pub const RENEW: u8 = 16;
}

/// Status of a service reply.
pub mod status {
    /// Done.
    pub const DONE: u8 = 0;
    /// The reply carries the challenge.
    pub const CHALLENGE: u8 = 1;
    /// Wrong code for the challenge, or no challenge was requested in time.
    pub const REFUSED: u8 = 2;
    /// Prevented by a fault, by a stored key that nobody has accepted, or by the source of random numbers for challenges.
    pub const FAULTY: u8 = 3;
    /// Not allowed while armed, while another host owns the session, or while a tare or a calibration is in progress.
    pub const ARMED: u8 = 4;
    /// Failed; the detail has the reason.
    pub const FAILED: u8 = 5;
    /// Unknown operation.
    pub const UNKNOWN: u8 = 6;
    /// Not allowed while an object is, or may be, gripped.
    pub const GRIPPING: u8 = 7;
    /// Not from the owner of a session: no code, a wrong one, or one that was used before.
    pub const UNAUTHENTICATED: u8 = 8;
    /// Only on the serial line, by the owner of a session or with the button pressed.
    pub const NOT_PRESENT: u8 = 9;
}

/// Rejected frames since boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DroppedFrames {
    /// Unknown message number.
    pub unknown: u32,
    /// Invalid content.
    pub malformed: u32,
    /// No session, or no code, or a wrong or repeated one.
    pub unauthenticated: u32,
}

impl DroppedFrames {
    /// Their sum.
    pub const fn all(self) -> u32 {
        self.unknown.saturating_add(self.malformed).saturating_add(self.unauthenticated)
    }
}

/// Effect of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionEvent {
    /// None: for another node, or rejected and counted.
    Ignored,
    /// Emergency stop.
    Stop,
    /// A reply to send.
    Reply(Message),
    /// A command of the owner.
    Command(Command),
    /// Another request; it has the authority that it needs.
    Other(Message),
}

/// State of the session.
#[derive(Clone, Debug)]
pub struct Session {
    node: u16,
    key: Key,
    timeout_ms: u64,
    may_arm: bool,
    is_moving: bool,
    is_present: bool,
    challenge: Option<Challenge>,
    open: Option<OpenSession>,
    /// An armed host fell silent until its session expired.
    is_abandoned: bool,
    /// Latest [`Authentication`] of each line that no request has used.
    authentications: [Option<Authentication>; SOURCES],
    /// Checked codes in the present window, and its begin.
    checked: (u8, u64),
    dropped: DroppedFrames,
    /// Ring of the times of the latest rejected frames.
    rejected_ms: [Option<u64>; FLOOD],
    /// Index of the oldest of them.
    oldest: usize,
}

#[derive(Clone, Debug)]
struct Challenge {
    number: u64,
    /// Computed for the first answer: forged ones must not cost it again.
    mac: Option<SessionMac>,
    /// Time and operation of its last request.
    at_ms: u64,
    op: u8,
}

#[derive(Clone, Debug)]
struct OpenSession {
    mac: SessionMac,
    /// Counter of the last valid request, and its time.
    counter: u64,
    active_ms: u64,
    is_armed: bool,
    /// Time of the last command.
    commanded_ms: Option<u64>,
}

impl Session {
    /// No session. A host counts as silent after `timeout_ms` without a command.
    pub const fn new(node: u16, key: Key, timeout_ms: u32) -> Self {
        Self {
            node,
            key,
            timeout_ms: timeout_ms as u64,
            may_arm: true,
            is_moving: false,
            is_present: false,
            challenge: None,
            open: None,
            is_abandoned: false,
            authentications: [None; SOURCES],
            checked: (0, 0),
            dropped: DroppedFrames { unknown: 0, malformed: 0, unauthenticated: 0 },
            rejected_ms: [None; FLOOD],
            oldest: 0,
        }
    }

    /// Processes a frame of a line. `random` gives a fresh random number for a challenge; without one the request fails.
    pub fn receive(
        &mut self,
        now_ms: u64,
        source: u8,
        (id, bytes): (u16, &[u8]),
        random: impl FnOnce() -> Option<u64>,
    ) -> SessionEvent {
        if is_stop(self.node, id) {
            return SessionEvent::Stop;
        }
        if id >> 5 != self.node {
            return SessionEvent::Ignored;
        }
        let message = match Message::from_frame((id & 0x1F) as u8, bytes) {
            Ok(message) => message,
            Err(FrameError::Unknown) => {
                self.dropped.unknown = self.dropped.unknown.saturating_add(1);
                return SessionEvent::Ignored;
            }
            Err(FrameError::Length | FrameError::Reserved) => return self.reject_malformed(now_ms),
        };
        if let Message::Authentication(authentication) = message {
            if let Some(last) = self.authentications.get_mut(usize::from(source)) {
                *last = Some(authentication);
            }
            return SessionEvent::Ignored;
        }
        // A message that only this node sends.
        if message.direction() == Direction::Out {
            return self.reject_malformed(now_ms);
        }
        let Some(kind) = RequestKind::of(&message) else {
            return reply(&message, status::UNKNOWN);
        };
        match (kind.rule().authority, message) {
            (Authority::Anyone, _) => SessionEvent::Other(message),
            (Authority::KeyHolder, Message::Service(service)) => {
                self.open(now_ms, source, service, random)
            }
            (Authority::OwnerOrPresence, _) if source != SERIAL => {
                reply(&message, status::NOT_PRESENT)
            }
            (Authority::OwnerOrPresence, _) if self.is_present => SessionEvent::Other(message),
            // A session by the key that everybody knows proves nothing.
            (Authority::OwnerOrPresence, _) if self.key == Key::NONE => {
                reply(&message, status::NOT_PRESENT)
            }
            (authority, _) => {
                if self.is_of_owner(now_ms, source, &message) {
                    return self.accept(now_ms, message);
                }
                self.reject_unauthenticated(now_ms);
                match authority {
                    Authority::OwnerOrPresence => reply(&message, status::NOT_PRESENT),
                    _ => reply(&message, status::UNAUTHENTICATED),
                }
            }
        }
    }

    /// Ends a session that has expired.
    pub fn expire(&mut self, now_ms: u64) {
        if let Some(open) = &self.open
            && now_ms.saturating_sub(open.active_ms) > EXPIRY_MS
        {
            self.is_abandoned |= open.commanded_ms.is_some();
            self.close();
        }
    }

    /// Allows or forbids arming; forbidding closes an armed session.
    pub fn set_may_arm(&mut self, may_arm: bool) {
        self.may_arm = may_arm;
        if !may_arm && self.is_armed() {
            self.close();
        }
    }

    /// While the fingers move, nobody takes over an armed session.
    pub const fn set_is_moving(&mut self, is_moving: bool) {
        self.is_moving = is_moving;
    }

    /// Whether somebody is physically present, who may write the key.
    pub const fn set_is_present(&mut self, is_present: bool) {
        self.is_present = is_present;
    }

    /// Replaces the key; closes the session.
    pub fn set_key(&mut self, key: Key) {
        self.key = key;
        self.close();
    }

    /// Sets the time without a command after which a host counts as silent.
    pub const fn set_timeout_ms(&mut self, timeout_ms: u32) {
        self.timeout_ms = timeout_ms as u64;
    }

    /// Closes the session; only a new challenge opens another.
    pub fn close(&mut self) {
        self.open = None;
        self.challenge = None;
    }

    /// The key.
    pub const fn key(&self) -> Key {
        self.key
    }

    /// Codes of the open session.
    pub fn mac(&self) -> Option<&SessionMac> {
        self.open.as_ref().map(|open| &open.mac)
    }

    /// Whether a host is armed.
    pub fn is_armed(&self) -> bool {
        self.open.as_ref().is_some_and(|open| open.is_armed)
    }

    /// Whether a challenge for arming is pending and not expired.
    pub fn is_arming(&self, now_ms: u64) -> bool {
        self.challenge
            .as_ref()
            .is_some_and(|challenge| challenge.op == op::ARM && challenge.is_valid(now_ms))
    }

    /// Whether the last command arrived in time.
    pub fn is_alive(&self, now_ms: u64) -> bool {
        let last = self.open.as_ref().and_then(|open| open.commanded_ms);
        last.is_some_and(|at_ms| now_ms.saturating_sub(at_ms) <= self.timeout_ms)
    }

    /// Whether commands have stopped arriving.
    pub fn is_silent(&self, now_ms: u64) -> bool {
        let has_commanded = self.open.as_ref().is_some_and(|open| open.commanded_ms.is_some());
        self.is_abandoned || (has_commanded && !self.is_alive(now_ms))
    }

    /// Whether `FLOOD` frames were rejected within `FLOOD_MS`.
    pub fn is_flooded(&self, now_ms: u64) -> bool {
        let oldest = self.rejected_ms.get(self.oldest).copied().flatten();
        oldest.is_some_and(|at_ms| now_ms.saturating_sub(at_ms) <= FLOOD_MS)
    }

    /// Rejected frames since boot.
    pub const fn dropped(&self) -> DroppedFrames {
        self.dropped
    }

    /// Gives out a challenge, or opens a session to who answers it.
    fn open(
        &mut self,
        now_ms: u64,
        source: u8,
        service: Service,
        random: impl FnOnce() -> Option<u64>,
    ) -> SessionEvent {
        let request = Message::Service(service);
        if self.is_owned(now_ms) {
            return reply(&request, status::ARMED);
        }
        if service.op == op::ARM && !self.may_arm {
            return reply(&request, status::FAULTY);
        }
        if self.challenge.as_ref().is_some_and(|challenge| !challenge.is_valid(now_ms)) {
            self.challenge = None;
        }
        let Some(authentication) = self.take_authentication(source) else {
            // One that nobody has answered stays: requests of others must not invalidate it.
            let known = self.challenge.as_ref().map(|challenge| challenge.number);
            let Some(number) = known.or_else(|| Some(random()? & CHALLENGE_MASK)) else {
                return reply(&request, status::FAULTY);
            };
            let challenge = self.challenge.get_or_insert(Challenge {
                number,
                mac: None,
                at_ms: now_ms,
                op: service.op,
            });
            (challenge.at_ms, challenge.op) = (now_ms, service.op);
            let reply = ServiceReply {
                op: service.op,
                status: status::CHALLENGE,
                extra: (number >> u32::BITS) as u16,
                detail: number as u32,
            };
            return SessionEvent::Reply(Message::ServiceReply(reply));
        };
        let Some((mac, counter)) = self.answered(now_ms, &request, &authentication) else {
            self.reject_unauthenticated(now_ms);
            return reply(&request, status::REFUSED);
        };
        let is_armed = service.op == op::ARM;
        self.challenge = None;
        self.is_abandoned &= !is_armed;
        self.open =
            Some(OpenSession { mac, counter, active_ms: now_ms, is_armed, commanded_ms: None });
        reply(&request, status::DONE)
    }

    /// Codes and counter of the session that an answer to the challenge opens, if it is right.
    fn answered(
        &mut self,
        now_ms: u64,
        request: &Message,
        authentication: &Authentication,
    ) -> Option<(SessionMac, u64)> {
        if !self.may_check(now_ms) {
            return None;
        }
        let (key, node) = (self.key, self.node);
        let challenge = self.challenge.as_mut()?;
        let mac =
            challenge.mac.get_or_insert_with(|| SessionMac::new(&key, node, challenge.number));
        let counter = counter_of(mac, node, 0, request, authentication)?;
        Some((mac.clone(), counter))
    }

    /// Whether another code may be checked now.
    fn may_check(&mut self, now_ms: u64) -> bool {
        let (count, begun_ms) = &mut self.checked;
        if now_ms.saturating_sub(*begun_ms) >= CODE_WINDOW_MS {
            (*count, *begun_ms) = (0, now_ms);
        }
        *count = count.saturating_add(1);
        *count <= MAX_CODES
    }

    /// Whether nobody else may open a session.
    fn is_owned(&self, now_ms: u64) -> bool {
        self.open.as_ref().is_some_and(|open| {
            let is_active = now_ms.saturating_sub(open.active_ms) <= TAKEOVER_MS;
            is_active || (open.is_armed && self.is_moving)
        })
    }

    /// Uses up the authentication of a line, and checks the request by it.
    fn is_of_owner(&mut self, now_ms: u64, source: u8, message: &Message) -> bool {
        let authentication = self.take_authentication(source);
        if authentication.is_none() || self.open.is_none() || !self.may_check(now_ms) {
            return false;
        }
        let (Some(open), Some(authentication)) = (&mut self.open, authentication) else {
            return false;
        };
        let counter = counter_of(&open.mac, self.node, open.counter, message, &authentication);
        if let Some(counter) = counter {
            (open.counter, open.active_ms) = (counter, now_ms);
        }
        counter.is_some()
    }

    fn take_authentication(&mut self, source: u8) -> Option<Authentication> {
        self.authentications.get_mut(usize::from(source))?.take()
    }

    /// A request of the owner.
    fn accept(&mut self, now_ms: u64, message: Message) -> SessionEvent {
        match (message, &mut self.open) {
            (Message::Command(command), Some(open)) if open.is_armed => {
                open.commanded_ms = Some(now_ms);
                SessionEvent::Command(command)
            }
            (Message::Command(_), _) => reply(&message, status::UNAUTHENTICATED),
            (Message::Service(Service { op: op::END, .. }), _) => {
                self.close();
                reply(&message, status::DONE)
            }
            (Message::Service(Service { op: op::RENEW, .. }), _) => reply(&message, status::DONE),
            _ => SessionEvent::Other(message),
        }
    }

    fn reject_malformed(&mut self, now_ms: u64) -> SessionEvent {
        self.dropped.malformed = self.dropped.malformed.saturating_add(1);
        self.record_rejection(now_ms);
        SessionEvent::Ignored
    }

    fn reject_unauthenticated(&mut self, now_ms: u64) {
        self.dropped.unauthenticated = self.dropped.unauthenticated.saturating_add(1);
        self.record_rejection(now_ms);
    }

    fn record_rejection(&mut self, now_ms: u64) {
        if let Some(oldest) = self.rejected_ms.get_mut(self.oldest) {
            *oldest = Some(now_ms);
        }
        self.oldest = (self.oldest + 1) % FLOOD;
    }
}

impl Challenge {
    fn is_valid(&self, now_ms: u64) -> bool {
        now_ms.saturating_sub(self.at_ms) <= CHALLENGE_TIMEOUT_MS
    }
}

impl Authentication {
    /// An authentication with this code.
    pub fn new(counter: u64, tag: Tag) -> Self {
        let [t0, t1, t2, t3, tag_high] = tag;
        let counter = (counter & COUNTER_MASK) as u32;
        Self { counter, tag_low: u32::from_le_bytes([t0, t1, t2, t3]), tag_high }
    }

    /// Its code.
    pub fn tag(&self) -> Tag {
        let [t0, t1, t2, t3] = self.tag_low.to_le_bytes();
        [t0, t1, t2, t3, self.tag_high]
    }
}

/// The freshness counter of a message, if its code is valid.
fn counter_of(
    mac: &SessionMac,
    node: u16,
    last: u64,
    message: &Message,
    authentication: &Authentication,
) -> Option<u64> {
    let counter = next_counter(last, authentication.counter);
    let id = frame_id(node, message.number());
    mac.is_valid(counter, id, message.to_bytes(), authentication.tag()).then_some(counter)
}

/// Whether a frame stops this node. With any content: a malformed stop is still a stop.
pub fn is_stop(node: u16, id: u16) -> bool {
    let number = (id & 0x1F) as u8;
    id == ESTOP_ALL_ID || (id >> 5 == node && const { EStop::LAYOUT.numbers() }.contains(&number))
}

/// The reply to a service request.
pub const fn service_reply(service: Service, status: u8, detail: u32) -> ServiceReply {
    ServiceReply { op: service.op, status, extra: 0, detail }
}

/// The reply to a request that the gripper does not carry out. Others have none: a flood of forged commands must not become
/// a flood of replies.
pub fn refusal(request: &Message, status: u8) -> Option<Message> {
    match request {
        Message::Service(service) => {
            Some(Message::ServiceReply(service_reply(*service, status, 0)))
        }
        Message::ParamRequest(request) => Some(Message::ParamReply(ParamReply {
            op: request.op,
            id: request.id,
            status: match status {
                status::UNAUTHENTICATED => parameters::status::UNAUTHENTICATED,
                _ => parameters::status::ARMED,
            },
            value: 0,
        })),
        Message::CalibrationChunk(_) => {
            let service = Service { op: op::UPLOAD, argument: 0 };
            Some(Message::ServiceReply(service_reply(service, status, 0)))
        }
        _ => None,
    }
}

fn reply(request: &Message, status: u8) -> SessionEvent {
    refusal(request, status).map_or(SessionEvent::Ignored, SessionEvent::Reply)
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::protocol::host_session::HostSession;
    use crate::protocol::{CAN, DEFAULT_NODE};

    const KEY: Key = Key(*b"a key of 16 byte");
    const COMMAND: Message =
        Message::Command(Command { mode: 2, position: 400, speed: 0, force: 0, flags: 0 });

    /// Random number before the first challenge; more bits than a challenge has.
    const RANDOM: u64 = 0xFEDC_BA98_7654_3210;

    /// A gripper and a host that know the same key, and what the gripper answered.
    struct Pair {
        gripper: Session,
        host: HostSession,
        random: u64,
    }

    impl Pair {
        fn new() -> Self {
            let gripper = Session::new(DEFAULT_NODE, KEY, 100);
            Self { gripper, host: HostSession::new(DEFAULT_NODE, KEY), random: RANDOM }
        }

        /// With an open session.
        fn opened(op: u8, at_ms: u64) -> Self {
            let mut pair = Self::new();
            pair.open(at_ms, op);
            assert!(pair.host.is_open());
            pair
        }

        fn open(&mut self, at_ms: u64, op: u8) {
            let mut messages: VecDeque<Message> = self.host.open(op).into_iter().collect();
            while let Some(message) = messages.pop_front() {
                if let SessionEvent::Reply(Message::ServiceReply(reply)) = self.send(at_ms, message)
                {
                    messages.extend(self.host.receive(&reply));
                }
            }
        }

        fn send(&mut self, at_ms: u64, message: Message) -> SessionEvent {
            self.random += 1;
            let random = self.random;
            let id = frame_id(DEFAULT_NODE, message.number());
            self.gripper.receive(at_ms, CAN, (id, &message.to_bytes()), || Some(random))
        }

        /// Requests a challenge; returns the answer to it.
        fn answer(&mut self, at_ms: u64) -> [Message; 2] {
            let SessionEvent::Reply(Message::ServiceReply(reply)) =
                self.send(at_ms, service(op::ARM))
            else {
                panic!("no reply");
            };
            let answer = self.host.receive(&reply);
            [answer[0], answer[1]]
        }

        fn send_both(
            &mut self,
            at_ms: u64,
            [authentication, message]: [Message; 2],
        ) -> SessionEvent {
            assert_eq!(self.send(at_ms, authentication), SessionEvent::Ignored);
            self.send(at_ms, message)
        }

        fn send_sealed(&mut self, at_ms: u64, message: Message) -> SessionEvent {
            let sealed = self.host.seal(message).unwrap();
            self.send_both(at_ms, sealed)
        }
    }

    fn service(op: u8) -> Message {
        Message::Service(Service { op, argument: 0 })
    }

    fn status_of(event: SessionEvent) -> Option<u8> {
        match event {
            SessionEvent::Reply(Message::ServiceReply(reply)) => Some(reply.status),
            _ => None,
        }
    }

    #[test]
    fn commands_are_accepted_from_the_armed_owner_only() {
        let mut pair = Pair::new();
        assert_eq!(pair.send(0, COMMAND), SessionEvent::Ignored);
        pair.open(0, op::ARM);
        assert!(matches!(pair.send_sealed(1, COMMAND), SessionEvent::Command(_)));
        assert_eq!(pair.send(2, COMMAND), SessionEvent::Ignored);
        assert_eq!(pair.gripper.dropped().unauthenticated, 2);
        let mut pair = Pair::opened(op::OPEN, 0);
        assert_eq!(pair.send_sealed(1, COMMAND), SessionEvent::Ignored);
    }

    /// No request of the table that needs an owner is accepted without one: in particular none that moves the motor.
    #[test]
    fn each_request_needs_the_authority_of_its_rule() {
        let requests = (0..=255).map(service).chain([COMMAND]).chain((0..=0xFF).map(|id| {
            let request = parameters::op::WRITE;
            Message::ParamRequest(crate::protocol::messages::ParamRequest {
                op: request,
                id,
                status: 0,
                value: 1,
            })
        }));
        for request in requests {
            let rule = RequestKind::of(&request).map(|kind| kind.rule().authority);
            let is_free = matches!(Pair::new().send(0, request), SessionEvent::Other(_));
            assert_eq!(is_free, rule == Some(Authority::Anyone), "{request:?}");
            let mut other = Pair::opened(op::OPEN, 0);
            let mut host = HostSession::new(DEFAULT_NODE, Key([1; 16]));
            // The same challenge, but another key.
            let (extra, detail) = ((RANDOM >> 32) as u16, RANDOM as u32 + 1);
            host.receive(&ServiceReply { op: op::OPEN, status: 1, extra, detail });
            host.receive(&ServiceReply { op: op::OPEN, status: 0, extra: 0, detail: 0 });
            let [authentication, request] = host.seal(request).unwrap();
            other.send(1, authentication);
            let is_accepted = matches!(other.send(1, request), SessionEvent::Other(_));
            assert_eq!(is_accepted, rule == Some(Authority::Anyone), "{request:?}");
        }
    }

    #[test]
    fn challenge_has_48_random_bits() {
        let mut pair = Pair::new();
        let SessionEvent::Reply(Message::ServiceReply(reply)) = pair.send(0, service(op::ARM))
        else {
            panic!("no reply");
        };
        assert_eq!((reply.status, reply.extra, reply.detail), (1, 0xBA98, 0x7654_3211));
    }

    #[test]
    fn another_key_or_time_out_is_in_effect_at_once() {
        let mut pair = Pair::opened(op::ARM, 0);
        assert!(pair.gripper.mac().is_some());
        pair.send_sealed(1, COMMAND);
        assert!(pair.gripper.is_alive(101) && !pair.gripper.is_alive(102));
        pair.gripper.set_timeout_ms(300);
        assert!(pair.gripper.is_alive(301) && !pair.gripper.is_alive(302));
        pair.gripper.set_key(Key([9; 16]));
        assert_eq!(pair.gripper.key(), Key([9; 16]));
        assert!(!pair.gripper.is_armed() && pair.gripper.mac().is_none());
        assert_eq!(pair.send_sealed(2, COMMAND), SessionEvent::Ignored);
        pair.open(3, op::ARM);
        assert!(!pair.gripper.is_armed());
    }

    #[test]
    fn dropped_frames_are_counted_by_their_reason() {
        let mut pair = Pair::new();
        let frames: [(u8, &[u8]); 6] = [
            (0x1F, &[0; 8]),
            (3, &[0; 7]),
            (3, &[0xFF; 8]),
            (1, &[0; 8]),
            (3, &[0; 8]),
            (3, &[0; 8]),
        ];
        for (number, bytes) in frames {
            pair.gripper.receive(0, CAN, (frame_id(DEFAULT_NODE, number), bytes), || Some(0));
        }
        let dropped = pair.gripper.dropped();
        assert_eq!(dropped, DroppedFrames { unknown: 1, malformed: 3, unauthenticated: 2 });
        assert_eq!(dropped.all(), 6);
    }

    #[test]
    fn challenge_expires_and_is_answered_once() {
        let mut pair = Pair::new();
        let answer = pair.answer(0);
        assert_eq!(status_of(pair.send_both(501, answer)), Some(status::REFUSED));
        // A request of somebody else does not replace a challenge that is not answered.
        pair.send(502, service(op::ARM));
        pair.send(900, service(op::ARM));
        let answer = pair.answer(1300);
        assert_eq!(status_of(pair.send_both(1800, answer)), Some(status::DONE));
        pair.gripper.close();
        assert_eq!(status_of(pair.send_both(1801, answer)), Some(status::REFUSED));
    }

    #[test]
    fn nothing_is_accepted_twice() {
        let mut pair = Pair::opened(op::ARM, 0);
        let sealed = pair.host.seal(COMMAND).unwrap();
        pair.send_both(1, sealed);
        assert!(pair.gripper.is_alive(1));
        for at_ms in 2..100 {
            assert_eq!(pair.send_both(at_ms, sealed), SessionEvent::Ignored);
        }
        // In a later session with the same key.
        pair.gripper.close();
        pair.open(200, op::ARM);
        assert_eq!(pair.send_both(201, sealed), SessionEvent::Ignored);
        assert!(matches!(pair.send_sealed(202, COMMAND), SessionEvent::Command(_)));
    }

    #[test]
    fn lost_messages_do_not_end_the_session() {
        let mut pair = Pair::opened(op::ARM, 0);
        for (at_ms, lost) in [(10, 0), (20, 1), (30, 100), (40, 70_000)] {
            for _ in 0..lost {
                pair.host.seal(COMMAND);
            }
            let event = pair.send_sealed(at_ms, COMMAND);
            assert!(matches!(event, SessionEvent::Command(_)), "{lost}");
        }
        // Only the code arrives; the next message is another one.
        let [authentication, _] = pair.host.seal(COMMAND).unwrap();
        pair.send(50, authentication);
        assert!(matches!(pair.send_sealed(60, COMMAND), SessionEvent::Command(_)));
    }

    #[test]
    fn requests_without_a_code_use_up_none_of_the_checks() {
        let mut pair = Pair::opened(op::ARM, 0);
        for _ in 0..100 {
            pair.send(20, COMMAND);
        }
        assert!(matches!(pair.send_sealed(20, COMMAND), SessionEvent::Command(_)));
    }

    #[test]
    fn refused_requests_are_answered_with_their_kind() {
        let parameter = |status| ParamReply { op: parameters::op::WRITE, id: 2, status, value: 0 };
        let request = Message::ParamRequest(crate::protocol::messages::ParamRequest {
            op: parameters::op::WRITE,
            id: 2,
            ..Default::default()
        });
        for (given, expected) in [
            (status::UNAUTHENTICATED, parameters::status::UNAUTHENTICATED),
            (status::ARMED, parameters::status::ARMED),
        ] {
            let reply = refusal(&request, given);
            assert_eq!(reply, Some(Message::ParamReply(parameter(expected))));
        }
        let upload = ServiceReply { op: op::UPLOAD, status: status::ARMED, extra: 0, detail: 0 };
        let chunk =
            Message::CalibrationChunk(crate::protocol::messages::CalibrationChunk::default());
        assert_eq!(refusal(&chunk, status::ARMED), Some(Message::ServiceReply(upload)));
        let save = ServiceReply { op: op::SAVE, status: status::GRIPPING, extra: 0, detail: 0 };
        assert_eq!(
            refusal(&service(op::SAVE), status::GRIPPING),
            Some(Message::ServiceReply(save))
        );
        assert_eq!(refusal(&COMMAND, status::ARMED), None);
    }

    #[test]
    fn at_most_four_codes_are_checked_in_ten_milliseconds() {
        let mut pair = Pair::opened(op::ARM, 0);
        let mut forged = pair.host.seal(COMMAND).unwrap();
        let Message::Authentication(code) = &mut forged[0] else { unreachable!() };
        code.tag_high ^= 1;
        for _ in 0..4 {
            pair.send_both(20, forged);
        }
        assert_eq!(pair.send_sealed(29, COMMAND), SessionEvent::Ignored);
        assert!(matches!(pair.send_sealed(30, COMMAND), SessionEvent::Command(_)));
    }

    #[test]
    fn message_with_a_bit_error_is_rejected() {
        for bit in 0..128 {
            let mut pair = Pair::opened(op::ARM, 0);
            let sealed = pair.host.seal(COMMAND).unwrap();
            let mut bytes = sealed.map(|message| message.to_bytes());
            bytes[bit / 64][bit % 64 / 8] ^= 1 << (bit % 8);
            let mut last = SessionEvent::Ignored;
            for (message, bytes) in sealed.iter().zip(bytes) {
                let id = frame_id(DEFAULT_NODE, message.number());
                last = pair.gripper.receive(1, CAN, (id, &bytes), || Some(0));
            }
            assert_eq!(last, SessionEvent::Ignored, "bit {bit}");
        }
    }

    #[test]
    fn code_of_one_line_does_not_authenticate_a_message_of_another() {
        let mut pair = Pair::opened(op::ARM, 0);
        let [authentication, message] = pair.host.seal(COMMAND).unwrap();
        pair.send(1, authentication);
        let id = frame_id(DEFAULT_NODE, message.number());
        let event = pair.gripper.receive(1, SERIAL, (id, &message.to_bytes()), || Some(0));
        assert_eq!(event, SessionEvent::Ignored);
        assert!(matches!(pair.send(1, message), SessionEvent::Command(_)));
    }

    #[test]
    fn no_challenge_without_a_random_number() {
        let mut pair = Pair::new();
        let request = service(op::ARM);
        let frame = (frame_id(DEFAULT_NODE, request.number()), &request.to_bytes()[..]);
        let reply = pair.gripper.receive(0, CAN, frame, || None);
        assert_eq!(status_of(reply), Some(status::FAULTY));
        pair.open(1, op::ARM);
        assert!(pair.host.is_open());
    }

    #[test]
    fn session_is_taken_over_only_after_silence_and_rest() {
        let mut pair = Pair::opened(op::ARM, 0);
        pair.send_sealed(10, COMMAND);
        let request = |pair: &mut Pair, at_ms| status_of(pair.send(at_ms, service(op::ARM)));
        assert_eq!(request(&mut pair, 11), Some(status::ARMED));
        assert!(pair.gripper.is_alive(11));
        assert_eq!(request(&mut pair, 10 + TAKEOVER_MS), Some(status::ARMED));
        pair.gripper.set_is_moving(true);
        assert_eq!(request(&mut pair, 11 + TAKEOVER_MS), Some(status::ARMED));
        pair.gripper.set_is_moving(false);
        assert_eq!(request(&mut pair, 11 + TAKEOVER_MS), Some(status::CHALLENGE));
        // It proves nothing yet: the owner can still come back.
        assert!(matches!(pair.send_sealed(12 + TAKEOVER_MS, COMMAND), SessionEvent::Command(_)));
    }

    #[test]
    fn session_ends_by_its_owner_or_by_silence() {
        let mut pair = Pair::opened(op::ARM, 0);
        assert_eq!(status_of(pair.send(1, service(op::END))), Some(status::UNAUTHENTICATED));
        assert!(pair.gripper.is_armed());
        assert_eq!(status_of(pair.send_sealed(2, service(op::END))), Some(status::DONE));
        assert!(!pair.gripper.is_armed() && !pair.gripper.is_silent(3));
        pair.open(10, op::ARM);
        pair.send_sealed(20, COMMAND);
        pair.gripper.expire(20 + EXPIRY_MS);
        assert!(pair.gripper.is_armed() && pair.gripper.is_silent(20 + EXPIRY_MS));
        pair.gripper.expire(21 + EXPIRY_MS);
        // The host stays lost until another one arms.
        assert!(!pair.gripper.is_armed() && pair.gripper.is_silent(21 + EXPIRY_MS));
        pair.open(30 + EXPIRY_MS, op::ARM);
        assert!(!pair.gripper.is_silent(31 + EXPIRY_MS));
    }

    #[test]
    fn session_is_renewed_by_its_owner_only() {
        let mut pair = Pair::opened(op::OPEN, 0);
        assert_eq!(
            status_of(pair.send(EXPIRY_MS - 1, service(op::RENEW))),
            Some(status::UNAUTHENTICATED)
        );
        assert_eq!(status_of(pair.send_sealed(EXPIRY_MS, service(op::RENEW))), Some(status::DONE));
        pair.gripper.expire(2 * EXPIRY_MS);
        assert!(pair.gripper.mac().is_some());
        pair.gripper.expire(2 * EXPIRY_MS + 1);
        assert!(pair.gripper.mac().is_none());
    }

    #[test]
    fn fault_ends_an_armed_session_and_allows_services() {
        let mut pair = Pair::opened(op::ARM, 0);
        pair.gripper.set_may_arm(false);
        assert!(!pair.gripper.is_armed());
        assert_eq!(status_of(pair.send(1, service(op::ARM))), Some(status::FAULTY));
        pair.open(2, op::OPEN);
        pair.gripper.set_may_arm(false);
        let event = pair.send_sealed(3, service(op::CLEAR_FAULTS));
        assert!(matches!(event, SessionEvent::Other(Message::Service(_))));
    }

    #[test]
    fn key_is_written_on_the_serial_line_only() {
        let mut pair = Pair::new();
        let message = service(op::WRITE_KEY);
        let id = frame_id(DEFAULT_NODE, message.number());
        let frame = (id, &message.to_bytes()[..]);
        let on_serial = |pair: &mut Pair| pair.gripper.receive(0, SERIAL, frame, || Some(0));
        assert_eq!(status_of(on_serial(&mut pair)), Some(status::NOT_PRESENT));
        pair.gripper.set_is_present(true);
        assert_eq!(on_serial(&mut pair), SessionEvent::Other(message));
        assert_eq!(status_of(pair.send(0, message)), Some(status::NOT_PRESENT));
    }

    #[test]
    fn stop_with_any_content_is_accepted_for_own_node_only() {
        let mut session = Session::new(DEFAULT_NODE, KEY, 100);
        let stop = frame_id(DEFAULT_NODE, EStop::LAYOUT.number);
        for content in [&[][..], &[0; 8], &[0xFF; 8], &[1, 2, 3], &[0; 64]] {
            let mut event = |id| session.receive(0, CAN, (id, content), || Some(0));
            assert_eq!(event(ESTOP_ALL_ID), SessionEvent::Stop);
            assert_eq!(event(stop), SessionEvent::Stop);
            assert_eq!(event(frame_id(3, EStop::LAYOUT.number)), SessionEvent::Ignored);
        }
        assert_eq!(session.dropped(), DroppedFrames::default());
    }

    #[test]
    fn sixteen_rejections_within_a_second_are_a_flood() {
        let mut pair = Pair::new();
        for i in 0..15 {
            pair.send(60 * i, COMMAND);
            assert!(!pair.gripper.is_flooded(60 * i));
        }
        pair.send(900, COMMAND);
        assert!(pair.gripper.is_flooded(1000) && !pair.gripper.is_flooded(1001));
    }

    #[test]
    fn message_of_own_node_is_counted_as_malformed() {
        let mut session = Session::new(DEFAULT_NODE, KEY, 100);
        let heartbeat = frame_id(DEFAULT_NODE, 1);
        assert_eq!(
            session.receive(0, CAN, (heartbeat, &[0; 8]), || Some(0)),
            SessionEvent::Ignored
        );
        assert_eq!(session.dropped().malformed, 1);
        let unknown = frame_id(DEFAULT_NODE, 0x1F);
        assert_eq!(session.receive(0, CAN, (unknown, &[0; 8]), || Some(0)), SessionEvent::Ignored);
        assert_eq!(session.dropped().unknown, 1);
    }

    proptest! {
        /// At any time, also beyond 2^32 milliseconds, which is after 49.7 days.
        #[test]
        fn limits_of_time_do_not_depend_on_the_time(
            begin in prop_oneof![0_u64..1 << 44, (1_u64 << 32) - 20_000..(1 << 32) + 20_000],
            after in 0_u64..20_000,
        ) {
            let mut pair = Pair::opened(op::ARM, begin);
            pair.send_sealed(begin, COMMAND);
            let now = begin + after;
            prop_assert_eq!(pair.gripper.is_alive(now), after <= 100);
            prop_assert_eq!(pair.gripper.is_silent(now), after > 100);
            pair.gripper.expire(now);
            prop_assert_eq!(pair.gripper.is_armed(), after <= EXPIRY_MS);
            let takes_over = status_of(pair.send(now, service(op::ARM))) == Some(status::CHALLENGE);
            prop_assert_eq!(takes_over, after > TAKEOVER_MS);
            let mut later = Pair::new();
            later.send(begin, service(op::ARM));
            prop_assert_eq!(later.gripper.is_arming(now), after <= CHALLENGE_TIMEOUT_MS);
        }

        /// Whoever does not know the key, but every code of an earlier session, gets nothing accepted.
        #[test]
        fn recorded_and_mixed_messages_are_rejected(
            picks in prop::collection::vec((0_usize..40, 0_usize..40, 0_u32..3), 1..60),
        ) {
            let mut pair = Pair::opened(op::ARM, 0);
            let mut recorded = Vec::new();
            for i in 0..40 {
                let command = Command { mode: i % 3, position: u16::from(i), ..Command::default() };
                let sealed = pair.host.seal(Message::Command(command)).unwrap();
                recorded.push(sealed);
                pair.send_both(1, sealed);
            }
            for (code, message, shift) in picks {
                let Message::Authentication(code) = recorded[code][0] else { unreachable!() };
                let counter = (code.counter + shift) & 0xFF_FFFF;
                pair.send(2, Message::Authentication(Authentication { counter, ..code }));
                prop_assert_eq!(pair.send(2, recorded[message][1]), SessionEvent::Ignored);
            }
        }
    }
}
