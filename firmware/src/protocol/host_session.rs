//! Host side of a session with a gripper: arming with a nonce, commands with a counter and an authentication tag. Without
//! input or output: used on a real connection and by the simulated host.

use crate::protocol::frame_id;
use crate::protocol::messages::{Command, Message, Service, ServiceReply};
use crate::protocol::session::{SERVICE_MAGIC, authenticate, op, status};

/// Protocol state of a session; creates and evaluates messages without input or output.
pub struct HostSession {
    node: u16,
    nonce: Option<u16>,
    counter: u8,
}

impl HostSession {
    /// Session with the gripper of this node; not armed.
    pub const fn new(node: u16) -> Self {
        Self { node, nonce: None, counter: 0 }
    }

    /// Request to arm.
    pub fn arm(&mut self) -> Message {
        self.nonce = None;
        service(op::ARM, 0)
    }

    /// Request that ends the session, so that the gripper expects no further command.
    pub fn end(&mut self) -> Message {
        let nonce = self.nonce.take().unwrap_or_default();
        Message::Service(Service { op: op::END, magic: SERVICE_MAGIC, nonce, argument: 0 })
    }

    /// Evaluates a reply of the gripper; returns the response that the protocol requires.
    pub fn receive(&mut self, reply: &ServiceReply) -> Option<Message> {
        match (reply.op, reply.status) {
            (op::ARM, status::CHALLENGE) => Some(Message::Service(Service {
                op: op::ARM,
                magic: SERVICE_MAGIC,
                nonce: reply.nonce,
                argument: 0,
            })),
            (op::ARM, status::DONE) => {
                self.nonce = Some(reply.nonce);
                None
            }
            _ => None,
        }
    }

    /// True once the gripper has confirmed the session.
    pub const fn is_armed(&self) -> bool {
        self.nonce.is_some()
    }

    /// A command with the next counter and its tag; `None` before the session is confirmed.
    pub fn seal(&mut self, command: Command) -> Option<Message> {
        let nonce = self.nonce?;
        self.counter = (self.counter + 1) & 0xF;
        let command = Command { counter: self.counter, ..command };
        let id = frame_id(self.node, Command::LAYOUT.number);
        Some(Message::Command(authenticate(nonce, id, command)))
    }
}

/// Request for a service.
pub fn service(op: u8, argument: u32) -> Message {
    Message::Service(Service { op, magic: SERVICE_MAGIC, nonce: 0, argument })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::DEFAULT_NODE;
    use crate::protocol::session::{Session, SessionEvent};

    #[test]
    fn commands_count_only_after_arming() {
        let mut host = HostSession::new(DEFAULT_NODE);
        assert_eq!(host.seal(Command::default()), None);
        let id = |message: &Message| frame_id(DEFAULT_NODE, message.number());
        let mut firmware = Session::new(DEFAULT_NODE, 100);
        let mut message = Some(host.arm());
        while let Some(sent) = message.take() {
            if let SessionEvent::Reply { reply, .. } =
                firmware.receive(0, id(&sent), &sent.to_bytes(), 77)
            {
                message = host.receive(&reply);
            }
        }
        assert!(host.is_armed());
        for _ in 0..20 {
            let command = host.seal(Command::default()).unwrap();
            let outcome = firmware.receive(0, id(&command), &command.to_bytes(), 77);
            assert!(matches!(outcome, SessionEvent::Command(_)), "{outcome:?}");
        }
        let request = host.end();
        let SessionEvent::Reply { reply, .. } =
            firmware.receive(0, id(&request), &request.to_bytes(), 78)
        else {
            panic!("no reply");
        };
        assert_eq!(host.receive(&reply), None);
        assert!(!firmware.is_open() && !host.is_armed());
    }
}
