//! Sessions of hosts: arming by challenge and response, authentication of commands.
//!
//! A host that requests arming receives a nonce as a challenge, and returns it within [`CHALLENGE_TIMEOUT_MS`]. From then on
//! every command carries a checksum that includes the nonce, and a counter. Commands of an earlier session and repeated
//! commands are rejected. This protects against accidents, not against an attacker with access to the bus: a random frame
//! with the right identifier is accepted with probability 2^-19.

use crate::checksum::CRC16;
use crate::protocol::layout::{Direction, FrameError};
use crate::protocol::messages::{Command, EStop, Message, Service, ServiceReply};
use crate::protocol::{ESTOP_ALL_ID, frame_id};

/// Validity of a challenge.
pub const CHALLENGE_TIMEOUT_MS: u32 = 500;
/// Commands that may be lost between two accepted ones.
const MAX_LOST: u8 = 1;
/// Rejected frames within `FLOOD_MS` that are a fault of a sender.
const FLOOD: usize = 16;
/// Time window of [`FLOOD`].
const FLOOD_MS: u32 = 1000;

/// Constant in every service request, "MG", against stray frames.
pub const SERVICE_MAGIC: u16 = 0x474D;
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
    /// Arm, in two steps.
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
    /// Verify and activate the uploaded calibration; it runs after a reboot.
    pub const FINISH_UPLOAD: u8 = 10;
    /// Read the description of the running calibration, four bytes at a time: argument 0 asks for its length in bits 0 to 15
    /// and its origin in bits 16 to 23 (0: linked, 1 and 2: the slot in flash, plus one), n for the bytes from 4 (n - 1).
    pub const DESCRIPTION: u8 = 11;
    /// End the session that has this nonce.
    pub const END: u8 = 12;
}

/// Status of a service reply.
pub mod status {
    /// Done.
    pub const DONE: u8 = 0;
    /// The reply carries the nonce to return.
    pub const CHALLENGE: u8 = 1;
    /// Wrong or expired nonce.
    pub const REFUSED: u8 = 2;
    /// Arming is prevented by a fault.
    pub const FAULTY: u8 = 3;
    /// Not allowed while armed, or while a tare or a calibration is in progress.
    pub const ARMED: u8 = 4;
    /// Failed; the detail has the reason.
    pub const FAILED: u8 = 5;
    /// Unknown operation.
    pub const UNKNOWN: u8 = 6;
    /// Not allowed while an object is, or may be, gripped.
    pub const GRIPPING: u8 = 7;
}

/// Rejected frames since boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DroppedFrames {
    /// Unknown message number.
    pub unknown: u32,
    /// Invalid content or checksum.
    pub malformed: u32,
    /// Counter not continued.
    pub replayed: u32,
    /// Command before arming, or expired nonce.
    pub late: u32,
}

impl DroppedFrames {
    /// Their sum.
    pub const fn all(self) -> u32 {
        self.unknown
            .saturating_add(self.malformed)
            .saturating_add(self.replayed)
            .saturating_add(self.late)
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
    Reply {
        /// The reply.
        reply: ServiceReply,
        /// Whether a session has just been opened.
        armed: bool,
    },
    /// An accepted command.
    Command(Command),
    /// Another valid message of a host.
    Other(Message),
}

/// State of the session.
#[derive(Clone, Copy, Debug)]
pub struct Session {
    node: u16,
    timeout_ms: u32,
    may_arm: bool,
    challenge: Option<Challenge>,
    open: Option<OpenSession>,
    dropped: DroppedFrames,
    /// Ring of the times of the latest rejected frames.
    rejected_ms: [Option<u32>; FLOOD],
    /// Index of the oldest of them.
    oldest: usize,
}

#[derive(Clone, Copy, Debug)]
struct Challenge {
    nonce: u16,
    at_ms: u32,
}

#[derive(Clone, Copy, Debug)]
struct OpenSession {
    nonce: u16,
    /// Counter and time of the last accepted command.
    last: Option<(u8, u32)>,
}

impl Session {
    /// No session. A host counts as silent after `timeout_ms` without a command.
    pub const fn new(node: u16, timeout_ms: u32) -> Self {
        Self {
            node,
            timeout_ms,
            may_arm: true,
            challenge: None,
            open: None,
            dropped: DroppedFrames { unknown: 0, malformed: 0, replayed: 0, late: 0 },
            rejected_ms: [None; FLOOD],
            oldest: 0,
        }
    }

    /// Processes a frame. `random` must be fresh at every call; it becomes the nonce of a challenge.
    pub fn receive(&mut self, now_ms: u32, id: u16, bytes: &[u8], random: u16) -> SessionEvent {
        if is_stop(self.node, id) {
            return SessionEvent::Stop;
        }
        if id >> 5 != self.node {
            return SessionEvent::Ignored;
        }
        let number = (id & 0x1F) as u8;
        let message = match Message::from_frame(number, bytes) {
            Ok(message) => message,
            Err(FrameError::Unknown) => {
                self.dropped.unknown = self.dropped.unknown.saturating_add(1);
                return SessionEvent::Ignored;
            }
            Err(FrameError::Length | FrameError::Reserved) => return self.reject_malformed(now_ms),
        };
        match message {
            Message::Command(command) => self.command(now_ms, command),
            Message::Service(service) if service.magic != SERVICE_MAGIC => {
                self.reject_malformed(now_ms)
            }
            Message::Service(service) if service.op == op::ARM && !self.may_arm => {
                self.close();
                let reply = service_reply(service, status::FAULTY, 0);
                SessionEvent::Reply { reply, armed: false }
            }
            Message::Service(service) if service.op == op::ARM => self.arm(now_ms, service, random),
            Message::Service(service) if service.op == op::END => self.end(now_ms, service),
            other if other.direction() == Direction::In => SessionEvent::Other(other),
            // A message that only this node sends.
            _ => self.reject_malformed(now_ms),
        }
    }

    /// Allows or forbids arming; forbidding closes the session.
    pub fn set_may_arm(&mut self, may_arm: bool) {
        self.may_arm = may_arm;
        if !may_arm {
            self.close();
        }
    }

    /// Sets the time without a command after which a host counts as silent.
    pub fn set_timeout_ms(&mut self, timeout_ms: u32) {
        self.timeout_ms = timeout_ms;
    }

    /// Closes the session; only arming opens another.
    pub fn close(&mut self) {
        self.open = None;
        self.challenge = None;
    }

    /// Whether a host has armed.
    pub const fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Whether a challenge is pending and not expired.
    pub fn is_challenge_pending(&self, now_ms: u32) -> bool {
        self.challenge
            .is_some_and(|challenge| now_ms.wrapping_sub(challenge.at_ms) <= CHALLENGE_TIMEOUT_MS)
    }

    /// Whether the last command arrived in time.
    pub fn is_alive(&self, now_ms: u32) -> bool {
        let last = self.open.and_then(|open| open.last);
        last.is_some_and(|(_, at_ms)| now_ms.wrapping_sub(at_ms) <= self.timeout_ms)
    }

    /// Whether commands have stopped arriving.
    pub fn is_silent(&self, now_ms: u32) -> bool {
        let commanded = self.open.is_some_and(|open| open.last.is_some());
        commanded && !self.is_alive(now_ms)
    }

    /// Whether `FLOOD` frames were rejected within `FLOOD_MS`.
    pub fn is_flooded(&self, now_ms: u32) -> bool {
        let oldest = self.rejected_ms.get(self.oldest).copied().flatten();
        oldest.is_some_and(|at_ms| now_ms.wrapping_sub(at_ms) <= FLOOD_MS)
    }

    /// Rejected frames since boot.
    pub const fn dropped(&self) -> DroppedFrames {
        self.dropped
    }

    fn arm(&mut self, now_ms: u32, service: Service, random: u16) -> SessionEvent {
        let reply = |status, nonce| ServiceReply { nonce, ..service_reply(service, status, 0) };
        if service.nonce == 0 {
            // Zero requests a nonce, so it cannot be one.
            let nonce = random.max(1);
            // It proves nothing, so that it must not end the session of a host that is alive.
            if !self.is_alive(now_ms) {
                self.open = None;
            }
            self.challenge = Some(Challenge { nonce, at_ms: now_ms });
            return SessionEvent::Reply { reply: reply(status::CHALLENGE, nonce), armed: false };
        }
        let challenge = self.challenge.take();
        let in_time = |challenge: &Challenge| {
            challenge.nonce == service.nonce
                && now_ms.wrapping_sub(challenge.at_ms) <= CHALLENGE_TIMEOUT_MS
        };
        let Some(challenge) = challenge.filter(in_time) else {
            self.dropped.late = self.dropped.late.saturating_add(1);
            self.record_rejection(now_ms);
            return SessionEvent::Reply { reply: reply(status::REFUSED, 0), armed: false };
        };
        self.open = Some(OpenSession { nonce: challenge.nonce, last: None });
        SessionEvent::Reply { reply: reply(status::DONE, challenge.nonce), armed: true }
    }

    fn end(&mut self, now_ms: u32, service: Service) -> SessionEvent {
        let is_own = self.open.is_some_and(|open| open.nonce == service.nonce);
        let status = if is_own {
            self.close();
            status::DONE
        } else {
            self.dropped.late = self.dropped.late.saturating_add(1);
            self.record_rejection(now_ms);
            status::REFUSED
        };
        SessionEvent::Reply { reply: service_reply(service, status, 0), armed: false }
    }

    fn command(&mut self, now_ms: u32, command: Command) -> SessionEvent {
        let id = frame_id(self.node, const { Command::LAYOUT.number });
        let Some(open) = &mut self.open else {
            self.dropped.late = self.dropped.late.saturating_add(1);
            self.record_rejection(now_ms);
            return SessionEvent::Ignored;
        };
        if authenticate(open.nonce, id, command) != command {
            return self.reject_malformed(now_ms);
        }
        let is_next = |(last, _): (u8, u32)| {
            let step = command.counter.wrapping_sub(last) & 0xF;
            (1..=1 + MAX_LOST).contains(&step)
        };
        if !open.last.is_none_or(is_next) {
            self.dropped.replayed = self.dropped.replayed.saturating_add(1);
            self.record_rejection(now_ms);
            return SessionEvent::Ignored;
        }
        open.last = Some((command.counter, now_ms));
        SessionEvent::Command(command)
    }

    fn reject_malformed(&mut self, now_ms: u32) -> SessionEvent {
        self.dropped.malformed = self.dropped.malformed.saturating_add(1);
        self.record_rejection(now_ms);
        SessionEvent::Ignored
    }

    fn record_rejection(&mut self, now_ms: u32) {
        if let Some(oldest) = self.rejected_ms.get_mut(self.oldest) {
            *oldest = Some(now_ms);
        }
        self.oldest = (self.oldest + 1) % FLOOD;
    }
}

/// Whether a frame stops this node. With any content: a malformed stop is still a stop.
pub fn is_stop(node: u16, id: u16) -> bool {
    let number = (id & 0x1F) as u8;
    id == ESTOP_ALL_ID || (id >> 5 == node && const { EStop::LAYOUT.numbers() }.contains(&number))
}

/// The reply to a service request.
pub fn service_reply(service: Service, status: u8, detail: u32) -> ServiceReply {
    ServiceReply { op: service.op, status, nonce: 0, detail }
}

/// The command with its checksum over nonce, identifier, and the bytes before the checksum.
pub fn authenticate(nonce: u16, id: u16, command: Command) -> Command {
    let bytes = Command { crc: 0, ..command }.to_bytes();
    let [before @ .., _, _] = bytes;
    let mut digest = CRC16.digest();
    digest.update(&nonce.to_le_bytes());
    digest.update(&id.to_le_bytes());
    digest.update(&before);
    Command { crc: digest.finalize(), ..command }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::DEFAULT_NODE;

    const COMMAND: u16 = frame_id(DEFAULT_NODE, Command::LAYOUT.number);
    const SERVICE: u16 = frame_id(DEFAULT_NODE, Service::LAYOUT.number);
    const NONCE: u16 = 0xBEEF;

    fn service(op: u8, nonce: u16) -> [u8; 8] {
        let service = Service { op, magic: SERVICE_MAGIC, nonce, argument: 0 };
        service.to_bytes()
    }

    fn command(nonce: u16, counter: u8) -> Command {
        let command = Command { mode: 2, counter, position: 400, ..Command::default() };
        authenticate(nonce, COMMAND, command)
    }

    fn armed(at_ms: u32) -> Session {
        let mut session = Session::new(DEFAULT_NODE, 100);
        session.receive(at_ms, SERVICE, &service(op::ARM, 0), NONCE);
        session.receive(at_ms, SERVICE, &service(op::ARM, NONCE), 0);
        assert!(session.is_open());
        session
    }

    fn accepts(session: &mut Session, now_ms: u32, command: Command) -> bool {
        session.receive(now_ms, COMMAND, &command.to_bytes(), 0) == SessionEvent::Command(command)
    }

    #[test]
    fn command_before_arming_is_rejected() {
        let mut session = Session::new(DEFAULT_NODE, 100);
        assert!(!accepts(&mut session, 0, command(0, 1)));
        assert_eq!(session.dropped().late, 1);
    }

    #[test]
    fn challenge_expires_and_is_valid_once() {
        let mut session = Session::new(DEFAULT_NODE, 100);
        let request = service(op::ARM, 0);
        let response = service(op::ARM, NONCE);
        session.receive(0, SERVICE, &request, NONCE);
        session.receive(501, SERVICE, &response, 0);
        assert!(!session.is_open());
        // The challenge is consumed by the first response.
        session.receive(502, SERVICE, &response, 0);
        assert!(!session.is_open());
        session.receive(600, SERVICE, &request, NONCE);
        let SessionEvent::Reply { reply, armed } = session.receive(1100, SERVICE, &response, 0)
        else {
            panic!("no reply");
        };
        assert!(armed && reply.status == status::DONE && session.is_open());
        assert_eq!(session.dropped().late, 2);
    }

    #[test]
    fn only_the_nonce_ends_the_session_of_a_live_host() {
        let mut session = armed(0);
        assert!(accepts(&mut session, 10, command(NONCE, 1)));
        session.receive(20, SERVICE, &service(op::ARM, 0), 0x1234);
        session.receive(20, SERVICE, &service(op::END, 0), 0);
        session.receive(20, SERVICE, &service(op::END, 0x1234), 0);
        assert!(session.is_open());
        assert!(accepts(&mut session, 30, command(NONCE, 2)));
        session.receive(40, SERVICE, &service(op::END, NONCE), 0);
        assert!(!session.is_open());
        // A silent host is replaced, also by one that only asks.
        let mut session = armed(0);
        assert!(accepts(&mut session, 10, command(NONCE, 1)));
        session.receive(111, SERVICE, &service(op::ARM, 0), 0x1234);
        assert!(!session.is_open());
    }

    #[test]
    fn command_of_earlier_session_is_rejected() {
        let mut session = armed(0);
        let recorded = command(NONCE, 1);
        assert!(accepts(&mut session, 1, recorded));
        session.close();
        session.receive(10, SERVICE, &service(op::ARM, 0), 0x1234);
        session.receive(11, SERVICE, &service(op::ARM, 0x1234), 0);
        assert!(session.is_open());
        assert!(!accepts(&mut session, 12, recorded));
        assert_eq!(session.dropped().malformed, 1);
    }

    #[test]
    fn counter_must_advance_by_one_or_two() {
        let mut session = armed(0);
        for (counter, is_accepted) in
            [(15, true), (15, false), (0, true), (2, true), (5, false), (1, false), (3, true)]
        {
            assert_eq!(accepts(&mut session, 1, command(NONCE, counter)), is_accepted, "{counter}");
        }
        assert_eq!(session.dropped().replayed, 3);
    }

    #[test]
    fn command_with_bit_error_is_rejected() {
        let valid = command(NONCE, 1).to_bytes();
        for bit in 0..64 {
            let mut session = armed(0);
            let mut corrupt = valid;
            corrupt[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(
                session.receive(1, COMMAND, &corrupt, 0),
                SessionEvent::Ignored,
                "bit {bit}"
            );
            assert_eq!(session.dropped().malformed, 1);
        }
    }

    #[test]
    fn host_is_silent_after_timeout_across_clock_overflow() {
        let begin = u32::MAX - 20;
        let mut session = armed(begin);
        assert!(!session.is_alive(begin));
        assert!(accepts(&mut session, begin, command(NONCE, 1)));
        assert!(session.is_alive(begin.wrapping_add(100)));
        assert!(!session.is_alive(begin.wrapping_add(101)));
    }

    #[test]
    fn stop_with_any_content_is_accepted_for_own_node_only() {
        let mut session = Session::new(DEFAULT_NODE, 100);
        let stop = frame_id(DEFAULT_NODE, EStop::LAYOUT.number);
        for content in [&[][..], &[0; 8], &[0xFF; 8], &[1, 2, 3], &[0; 64]] {
            assert_eq!(session.receive(0, ESTOP_ALL_ID, content, 0), SessionEvent::Stop);
            assert_eq!(session.receive(0, stop, content, 0), SessionEvent::Stop);
            let other = frame_id(3, EStop::LAYOUT.number);
            assert_eq!(session.receive(0, other, content, 0), SessionEvent::Ignored);
        }
        assert_eq!(session.dropped(), DroppedFrames::default());
    }

    #[test]
    fn sixteen_rejections_within_a_second_are_a_flood() {
        let mut session = armed(0);
        for i in 0..15 {
            session.receive(60 * i, COMMAND, &[0; 8], 0);
            assert!(!session.is_flooded(60 * i));
        }
        session.receive(900, COMMAND, &[0; 8], 0);
        assert!(session.is_flooded(1000) && !session.is_flooded(1001));
    }

    #[test]
    fn message_of_own_node_is_counted_as_malformed() {
        let mut session = Session::new(DEFAULT_NODE, 100);
        let heartbeat = frame_id(DEFAULT_NODE, 1);
        assert_eq!(session.receive(0, heartbeat, &[0; 8], 0), SessionEvent::Ignored);
        assert_eq!(session.dropped().malformed, 1);
        assert_eq!(
            session.receive(0, frame_id(DEFAULT_NODE, 0x1F), &[0; 8], 0),
            SessionEvent::Ignored
        );
        assert_eq!(session.dropped().unknown, 1);
    }
}
