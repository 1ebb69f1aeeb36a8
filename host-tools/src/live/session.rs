//! A host's session with a gripper: arming with a nonce, and commands that carry a counter and an authentication tag. It
//! makes and takes messages; how they travel is another's.

use firmware::session::{MAGIC, op, sealed, status};
use firmware::wire::identifier;
use firmware::wire::messages::{Command, Message, Service, ServiceReply};

/// The session.
pub struct HostSession {
    node: u16,
    nonce: Option<u16>,
    counter: u8,
    /// A nonce that comes is not confirmed.
    is_ending: bool,
}

impl HostSession {
    /// With the gripper of this node; not armed.
    pub const fn new(node: u16) -> Self {
        Self {
            node,
            nonce: None,
            counter: 0,
            is_ending: false,
        }
    }

    /// The request to arm; an earlier session ends.
    pub fn arm(&mut self) -> Message {
        (self.nonce, self.is_ending) = (None, false);
        service(op::ARM, 0)
    }

    /// The request that ends the session, so that the gripper waits for no further command: one for a nonce, which is not
    /// confirmed.
    pub fn end(&mut self) -> Message {
        (self.nonce, self.is_ending) = (None, true);
        service(op::ARM, 0)
    }

    /// Evaluates a reply of the gripper; the message that answers it, where the protocol asks for one.
    pub fn receive(&mut self, reply: &ServiceReply) -> Option<Message> {
        match (reply.op, reply.status) {
            (op::ARM, status::SAY_BACK) if !self.is_ending => Some(Message::Service(Service {
                op: op::ARM,
                magic: MAGIC,
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

    /// Whether the gripper has confirmed the session.
    pub const fn is_armed(&self) -> bool {
        self.nonce.is_some()
    }

    /// A command with the next counter and its tag; none before the gripper has confirmed the session.
    pub fn seal(&mut self, command: Command) -> Option<Message> {
        let nonce = self.nonce?;
        self.counter = (self.counter + 1) & 0xF;
        let command = Command {
            counter: self.counter,
            ..command
        };
        let id = identifier(self.node, Command::LAYOUT.number);
        Some(Message::Command(sealed(nonce, id, command)))
    }
}

/// The request for a service.
pub fn service(op: u8, argument: u32) -> Message {
    Message::Service(Service {
        op,
        magic: MAGIC,
        nonce: 0,
        argument,
    })
}

#[cfg(test)]
mod tests {
    use firmware::session::{Heard, Session};
    use firmware::wire::DEFAULT_NODE;

    use super::*;

    #[test]
    fn commands_count_after_arming_and_not_before() {
        let mut host = HostSession::new(DEFAULT_NODE);
        assert_eq!(host.seal(Command::default()), None);
        let id = |message: &Message| identifier(DEFAULT_NODE, message.number());
        let mut firmware = Session::new(DEFAULT_NODE, 100);
        let mut message = Some(host.arm());
        while let Some(sent) = message.take() {
            if let Heard::Reply { reply, .. } = firmware.hear(0, id(&sent), &sent.to_bytes(), 77) {
                message = host.receive(&reply);
            }
        }
        assert!(host.is_armed());
        for _ in 0..20 {
            let command = host.seal(Command::default()).unwrap();
            let heard = firmware.hear(0, id(&command), &command.to_bytes(), 77);
            assert!(matches!(heard, Heard::Command(_)), "{heard:?}");
        }
        let request = host.end();
        let Heard::Reply { reply, .. } = firmware.hear(0, id(&request), &request.to_bytes(), 78)
        else {
            panic!("no reply");
        };
        assert_eq!(host.receive(&reply), None);
        assert!(!firmware.is_open() && !host.is_armed());
    }
}
