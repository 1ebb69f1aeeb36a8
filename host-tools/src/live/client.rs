//! A host that commands a gripper over its line or bus: arming, one command repeated in time, and what it reports.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use firmware::session::{op, status};
use firmware::wire::messages::{Command, EStop, Message, ServiceReply};
use firmware::wire::serial::Packet;

use super::answers::Refusal;
use super::session::{HostSession, service};
use super::source::Source;
use super::state::State;

/// Time between two commands: the gripper stops where none comes for 100 ms.
const PERIOD: Duration = Duration::from_millis(20);

/// The host.
pub struct Client {
    source: Box<dyn Source>,
    session: HostSession,
    begun: Instant,
    command: Option<Command>,
    sent: Option<Instant>,
    /// What is known of the gripper.
    pub state: State,
    /// Status of the last reply to a request to arm that did not arm.
    pub not_armed: Option<u8>,
    /// The last command that was refused, since [`Self::command`].
    pub refused: Option<Refusal>,
}

impl Client {
    /// A host of the gripper of this node; says nothing yet.
    pub fn new(source: Box<dyn Source>, node: u16) -> Self {
        Self {
            source,
            session: HostSession::new(node),
            begun: Instant::now(),
            command: None,
            sent: None,
            state: State::default(),
            not_armed: None,
            refused: None,
        }
    }

    /// Name of line or bus.
    pub fn name(&self) -> String {
        self.source.name()
    }

    /// Seconds since it began.
    pub fn elapsed_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    /// Requests a session.
    ///
    /// # Errors
    /// The line or bus is gone.
    pub fn arm(&mut self) -> Result<()> {
        self.not_armed = None;
        let request = self.session.arm();
        self.source.say(request)
    }

    /// Ends the session.
    ///
    /// # Errors
    /// The line or bus is gone.
    pub fn end_session(&mut self) -> Result<()> {
        self.command = None;
        let request = self.session.end();
        self.source.say(request)
    }

    /// Whether the gripper has confirmed the session.
    pub const fn is_armed(&self) -> bool {
        self.session.is_armed()
    }

    /// Requests a service.
    ///
    /// # Errors
    /// The line or bus is gone.
    pub fn request(&mut self, op: u8) -> Result<()> {
        self.source.say(service(op, 0))
    }

    /// Repeats this command from now on.
    pub const fn command(&mut self, command: Command) {
        self.command = Some(command);
        (self.sent, self.refused) = (None, None);
    }

    /// Stops the gripper at once and repeats no command any more.
    ///
    /// # Errors
    /// The line or bus is gone.
    pub fn stop(&mut self) -> Result<()> {
        self.command = None;
        self.source.say(Message::EStop(EStop::default()))
    }

    /// Receives what has come and sends what is due; waits a moment at the most.
    ///
    /// # Errors
    /// The line or bus is gone.
    pub fn poll(&mut self) -> Result<()> {
        let mut packets = Vec::new();
        let goes_on = self.source.hear(&mut packets)?;
        let now_s = self.elapsed_s();
        self.state.lost.broken = self.source.broken();
        for packet in &packets {
            self.state.take(now_s, packet);
            if let Packet::Message {
                message: Message::ServiceReply(reply),
                ..
            } = packet
            {
                self.reply(reply)?;
            }
        }
        if !goes_on {
            bail!(
                "{}: the gripper's end of the connection was closed",
                self.name()
            );
        }
        self.send_due()
    }

    fn reply(&mut self, reply: &ServiceReply) -> Result<()> {
        match (reply.op, reply.status) {
            (op::ARM, status::SAY_BACK | status::DONE) => {}
            (op::ARM, status) => self.not_armed = Some(status),
            (op::COMMAND, status::REFUSED) => {
                let refusal = Refusal::of(reply.detail);
                // A reply to the command before it comes late.
                if self
                    .command
                    .is_some_and(|command| command.mode == refusal.mode)
                {
                    self.refused = Some(refusal);
                }
            }
            _ => {}
        }
        match self.session.receive(reply) {
            Some(answer) => self.source.say(answer),
            None => Ok(()),
        }
    }

    fn send_due(&mut self) -> Result<()> {
        let is_due = self.sent.is_none_or(|sent| sent.elapsed() >= PERIOD);
        let Some(command) = self.command.filter(|_| is_due) else {
            return Ok(());
        };
        if let Some(message) = self.session.seal(command) {
            self.source.say(message)?;
            self.sent = Some(Instant::now());
        }
        Ok(())
    }
}
