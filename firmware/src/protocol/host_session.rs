//! Host side of a session with a gripper: challenge and response, codes and freshness counters of requests. Without input or
//! output: used on a real connection and by the simulated host.

use heapless::Vec;

use crate::protocol::authentication::{Key, SessionMac};
use crate::protocol::frame_id;
use crate::protocol::messages::{Authentication, Message, Service, ServiceReply};
use crate::protocol::rules::{Authority, RequestKind};
use crate::protocol::session::{op, status};

/// Protocol state of a session; creates and evaluates messages without input or output.
#[derive(Clone, Debug)]
pub struct HostSession {
    node: u16,
    key: Key,
    mac: Option<SessionMac>,
    counter: u64,
    /// Challenge that was answered since the last request for a session.
    answered: Option<u64>,
    /// Operation that opened the session, once the gripper has confirmed it.
    opened_by: Option<u8>,
}

impl HostSession {
    /// Session with the gripper of this node; not open.
    pub const fn new(node: u16, key: Key) -> Self {
        Self { node, key, mac: None, counter: 0, answered: None, opened_by: None }
    }

    /// Request for a session, [`op::ARM`] or [`op::OPEN`]; before it the end of the present one, if any.
    pub fn open(&mut self, op: u8) -> Vec<Message, 3> {
        let mut messages = self.end();
        self.answered = None;
        // It has room.
        let _ = messages.push(service(op, 0));
        messages
    }

    /// Request that ends the session, so that the gripper expects no further command.
    pub fn end(&mut self) -> Vec<Message, 3> {
        let sealed = self.seal(service(op::END, 0)).filter(|_| self.is_open());
        self.forget();
        sealed.iter().flatten().copied().collect()
    }

    /// The gripper has ended the session.
    pub fn forget(&mut self) {
        (self.mac, self.opened_by) = (None, None);
    }

    /// Evaluates a reply of the gripper; returns the response that the protocol requires.
    pub fn receive(&mut self, reply: &ServiceReply) -> Vec<Message, 2> {
        if !matches!(reply.op, op::ARM | op::OPEN) {
            return Vec::new();
        }
        let challenge = u64::from(reply.extra) << u32::BITS | u64::from(reply.detail);
        // The refusal of this host's answer, or of another's code before its request.
        let is_refused = reply.status == status::REFUSED;
        if is_refused && (challenge == 0 || self.answered == Some(challenge)) {
            return Vec::new();
        }
        match reply.status {
            // Nobody asked for a challenge in an open session: its codes stay.
            status::CHALLENGE | status::REFUSED if self.is_open() => Vec::new(),
            status::CHALLENGE | status::REFUSED => {
                self.answered = Some(challenge);
                self.mac = Some(SessionMac::new(&self.key, self.node, challenge));
                (self.counter, self.opened_by) = (0, None);
                self.seal(service(reply.op, 0)).iter().flatten().copied().collect()
            }
            status::DONE => {
                self.opened_by = self.mac.is_some().then_some(reply.op);
                Vec::new()
            }
            _ => Vec::new(),
        }
    }

    /// True once the gripper has confirmed the session.
    pub const fn is_open(&self) -> bool {
        self.opened_by.is_some()
    }

    /// True once the gripper has confirmed a session with motion.
    pub fn is_armed(&self) -> bool {
        self.opened_by == Some(op::ARM)
    }

    /// Codes of the session.
    pub const fn mac(&self) -> Option<&SessionMac> {
        self.mac.as_ref()
    }

    /// A message with its authentication, to be sent in this order; `None` before a challenge.
    pub fn seal(&mut self, message: Message) -> Option<[Message; 2]> {
        let mac = self.mac.as_ref()?;
        self.counter = mac.following(self.counter);
        let id = frame_id(self.node, message.number());
        let tag = mac.tag(self.counter, id, message.to_bytes());
        let authentication = Authentication::new(self.counter, tag);
        Some([Message::Authentication(authentication), message])
    }
}

/// Whether a message needs the authority of a session's owner.
pub fn needs_owner(message: &Message) -> bool {
    let authority = RequestKind::of(message).map(|kind| kind.rule().authority);
    matches!(authority, Some(Authority::Owner | Authority::OwnerOrPresence))
}

/// Request for a service.
pub const fn service(op: u8, argument: u32) -> Message {
    Message::Service(Service { op, argument })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::DEFAULT_NODE;
    use crate::protocol::authentication::CHALLENGE_MASK;
    use crate::protocol::messages::{Command, EStop, HostAttitude, ParamRequest};

    const KEY: Key = Key(*b"key of the tests");

    fn reply(op: u8, status: u8, challenge: u64) -> ServiceReply {
        ServiceReply { op, status, extra: (challenge >> 32) as u16, detail: challenge as u32 }
    }

    #[test]
    fn session_is_open_from_the_confirmation_until_its_end() {
        for (operation, is_armed) in [(op::ARM, true), (op::OPEN, false)] {
            let mut host = HostSession::new(DEFAULT_NODE, KEY);
            let command = Message::Command(Command::default());
            // Before a challenge there is no code, and nothing to end.
            assert!(host.seal(command).is_none() && host.mac().is_none());
            assert_eq!(host.open(operation)[..], [service(operation, 0)]);
            host.receive(&reply(operation, status::DONE, 0));
            assert!(!host.is_open());
            // Replies to other requests are none to this one.
            assert!(host.receive(&reply(op::SAVE, status::CHALLENGE, 1)).is_empty());
            let challenge = 0x1234_5678_9ABC & CHALLENGE_MASK;
            let answer = host.receive(&reply(operation, status::CHALLENGE, challenge));
            let mac = SessionMac::new(&KEY, DEFAULT_NODE, challenge);
            let sealed = |number, message: Message| {
                let counter = (0..number).fold(0, |counter, _| mac.following(counter));
                let id = frame_id(DEFAULT_NODE, message.number());
                let tag = mac.tag(counter, id, message.to_bytes());
                [Message::Authentication(Authentication::new(counter, tag)), message]
            };
            assert_eq!(answer[..], sealed(1, service(operation, 0)));
            assert!(!host.is_open() && !host.is_armed());
            host.receive(&reply(operation, status::DONE, 0));
            assert!(host.is_open());
            assert_eq!(host.is_armed(), is_armed);
            assert!(host.mac().is_some());
            assert_eq!(host.seal(command), Some(sealed(2, command)));
            assert_eq!(host.end()[..], sealed(3, service(op::END, 0)));
            assert!(!host.is_open() && host.seal(command).is_none());
            assert!(host.end().is_empty());
        }
    }

    /// Replies of the gripper have no code: anybody can send one.
    #[test]
    fn a_challenge_in_an_open_session_changes_nothing() {
        for status in [status::CHALLENGE, status::REFUSED] {
            let mut host = HostSession::new(DEFAULT_NODE, KEY);
            host.open(op::ARM);
            host.receive(&reply(op::ARM, status::CHALLENGE, 5));
            host.receive(&reply(op::ARM, status::DONE, 0));
            let mut undisturbed = host.clone();
            assert!(host.receive(&reply(op::ARM, status, 6)).is_empty());
            let command = Message::Command(Command::default());
            assert_eq!(host.seal(command), undisturbed.seal(command));
        }
    }

    #[test]
    fn forgotten_session_needs_a_new_challenge() {
        let mut host = HostSession::new(DEFAULT_NODE, KEY);
        host.receive(&reply(op::OPEN, status::CHALLENGE, 5));
        host.receive(&reply(op::OPEN, status::DONE, 0));
        host.forget();
        assert!(!host.is_open() && host.mac().is_none());
    }

    #[test]
    fn requests_of_an_owner_need_its_code() {
        let write = ParamRequest { op: 1, id: 2, ..ParamRequest::default() };
        for (message, needs) in [
            (Message::EStop(EStop::default()), false),
            (Message::HostAttitude(HostAttitude::default()), false),
            (service(op::VERSION, 0), false),
            (service(op::ARM, 0), false),
            (service(op::TARE, 0), true),
            (service(op::WRITE_KEY, 0), true),
            (Message::Command(Command::default()), true),
            (Message::ParamRequest(write), true),
        ] {
            assert_eq!(needs_owner(&message), needs, "{message:?}");
        }
    }
}
