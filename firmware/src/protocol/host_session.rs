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
    /// Operation that opened the session, once the gripper has confirmed it.
    opened_by: Option<u8>,
}

impl HostSession {
    /// Session with the gripper of this node; not open.
    pub const fn new(node: u16, key: Key) -> Self {
        Self { node, key, mac: None, counter: 0, opened_by: None }
    }

    /// Request for a session, [`op::ARM`] or [`op::OPEN`]; before it the end of the present one, if any.
    pub fn open(&mut self, op: u8) -> Vec<Message, 3> {
        let mut messages = self.end();
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
        match reply.status {
            status::CHALLENGE => {
                let challenge = u64::from(reply.extra) << u32::BITS | u64::from(reply.detail);
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
        self.counter = self.counter.saturating_add(1);
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
