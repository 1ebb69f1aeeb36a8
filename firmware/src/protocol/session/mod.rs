//! Sessions of hosts: opening by challenge and response, one owner, authentication of requests.
//!
//! A host requests a session without a code, and receives a challenge. It repeats the request with the code that only a
//! holder of the key can compute ([`crate::protocol::authentication`]), and owns the session from then on. There are sessions with motion
//! ([`op::ARM`]) and without ([`op::OPEN`], for services and parameters). A request that needs a code is preceded by an
//! [`Authentication`] on the same line. What needs one is in [`crate::protocol::rules`].
//!
//! Frames without a valid code are counted and end nothing. Codes are checked at a limited rate on each line. Those of the owner
//! are recognised before that by their counters, which others cannot predict ([`SessionMac::following`]), and are checked however
//! many forged ones come in between.
//!
//! A session ends by [`op::END`], after [`EXPIRY_MS`] without a valid request, and, if it is armed, when a fault forbids it. Another host
//! can open one once the owner was silent for [`TAKEOVER_MS`] and nothing moves.

mod codes;
#[cfg(test)]
mod tests;

use crate::parameters;
use crate::protocol::authentication::{CHALLENGE_MASK, COUNTER_MASK, Key, SessionMac, Tag};
use crate::protocol::layout::{Direction, FrameError};
use crate::protocol::messages::{
    Authentication, Command, EStop, Message, ParamReply, Service, ServiceReply,
};
use crate::protocol::rules::{Authority, RequestKind};
use crate::protocol::{ESTOP_ALL_ID, SERIAL, SOURCES};
pub use codes::DueCounters;
use codes::{CodeCheck, LineCodes, SessionCodes};

/// Validity of a challenge after it was drawn, however often it is requested.
pub const CHALLENGE_TIMEOUT_MS: u64 = 2000;
/// Silence of the owner after which another host can open a session.
pub const TAKEOVER_MS: u64 = 1000;
/// Silence of the owner that ends the session.
pub const EXPIRY_MS: u64 = 10_000;
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
    /// Wrong code for the challenge, or no challenge was requested in time. The reply carries the present challenge: the code
    /// may have been another's.
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
    lines: [LineCodes; SOURCES],
    dropped: DroppedFrames,
    /// Ring of the times of the latest rejected frames.
    rejected_ms: [Option<u64>; FLOOD],
    /// Index of the oldest of them.
    oldest: usize,
}

#[derive(Clone, Debug)]
struct Challenge {
    number: u64,
    codes: SessionCodes,
    /// When it was drawn.
    drawn_ms: u64,
    /// Operation of its last request.
    op: u8,
}

#[derive(Clone, Debug)]
struct OpenSession {
    codes: SessionCodes,
    /// Time of the last valid request.
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
            lines: [LineCodes::NEW; SOURCES],
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
            self.receive_code(now_ms, source, authentication);
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
        self.open.as_ref().map(|open| open.codes.mac())
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

    /// Counters that the next authentications of owners have, as transmitted: of the session, and of an answer to the
    /// challenge. Their frames must not be lost among others.
    pub fn due_counters(&self) -> DueCounters {
        let DueCounters([mut open, mut challenge]) = DueCounters::NONE;
        if let Some(session) = &self.open {
            open = session.codes.due();
        }
        if let Some(offered) = &self.challenge {
            challenge = offered.codes.due();
        }
        DueCounters([open, challenge])
    }

    fn expire_challenge(&mut self, now_ms: u64) {
        if self.challenge.as_ref().is_some_and(|challenge| !challenge.is_valid(now_ms)) {
            self.challenge = None;
        }
    }

    /// Keeps an authentication for the next request of its line.
    fn receive_code(&mut self, now_ms: u64, source: u8, authentication: Authentication) {
        self.expire_challenge(now_ms);
        let open = self.open.as_mut().map(|open| &mut open.codes);
        let challenge = self.challenge.as_mut().map(|challenge| &mut challenge.codes);
        let mut codes = open.into_iter().chain(challenge);
        if !codes.any(|codes| codes.expect(source, &authentication))
            && let Some(line) = self.lines.get_mut(usize::from(source))
        {
            line.latest = Some(authentication);
        }
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
        self.expire_challenge(now_ms);
        let (key, node) = (self.key, self.node);
        let challenge = match &mut self.challenge {
            Some(challenge) => challenge,
            // One that nobody has answered stays: requests of others must not invalidate it.
            None => {
                let Some(number) = random().map(|number| number & CHALLENGE_MASK) else {
                    return reply(&request, status::FAULTY);
                };
                let codes = SessionCodes::new(SessionMac::new(&key, node, number));
                self.challenge.insert(Challenge { number, codes, drawn_ms: now_ms, op: service.op })
            }
        };
        let Some(line) = self.lines.get_mut(usize::from(source)) else {
            return SessionEvent::Ignored;
        };
        let check = challenge.codes.check(now_ms, (source, line), node, &request);
        if check != CodeCheck::Valid {
            // Also after a wrong code: it may be another's, before the first request of this host.
            let (extra, detail) = ((challenge.number >> u32::BITS) as u16, challenge.number as u32);
            let mut status = status::CHALLENGE;
            if check == CodeCheck::Invalid {
                status = status::REFUSED;
                self.reject_unauthenticated(now_ms);
            } else {
                challenge.op = service.op;
            }
            let reply = ServiceReply { op: service.op, status, extra, detail };
            return SessionEvent::Reply(Message::ServiceReply(reply));
        }
        let is_armed = service.op == op::ARM;
        self.is_abandoned &= !is_armed;
        self.open = self.challenge.take().map(|Challenge { codes, .. }| OpenSession {
            codes,
            active_ms: now_ms,
            is_armed,
            commanded_ms: None,
        });
        reply(&request, status::DONE)
    }

    /// Whether nobody else may open a session.
    fn is_owned(&self, now_ms: u64) -> bool {
        self.open.as_ref().is_some_and(|open| {
            let is_active = now_ms.saturating_sub(open.active_ms) <= TAKEOVER_MS;
            is_active || (open.is_armed && self.is_moving)
        })
    }

    /// Checks a request by the authentication before it.
    fn is_of_owner(&mut self, now_ms: u64, source: u8, message: &Message) -> bool {
        let Some(line) = self.lines.get_mut(usize::from(source)) else {
            return false;
        };
        let Some(open) = &mut self.open else {
            line.latest = None;
            return false;
        };
        let check = open.codes.check(now_ms, (source, line), self.node, message);
        let is_valid = check == CodeCheck::Valid;
        if is_valid {
            open.active_ms = now_ms;
        }
        is_valid
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
        now_ms.saturating_sub(self.drawn_ms) <= CHALLENGE_TIMEOUT_MS
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
