//! Sessions of this machine with a gripper: a client that repeats a command, a connection whose requests are authenticated,
//! refusals as text.

use crate::control::CLOSED_MM;
use crate::format::state_name;
use crate::source::{ConnectionLost, SILENCE, Source, receive_messages};
use crate::state::GripperState;
use anyhow::{Result, bail};
use firmware::config::limits::GripLimits;
use firmware::grip::commands::{RefusalReason, mode};
use firmware::protocol::PROTOCOL_VERSION;
use firmware::protocol::authentication::{DataMac, Key};
use firmware::protocol::host_session::{HostSession, needs_owner, service};
use firmware::protocol::messages::{Command, EStop, Message, ServiceReply};
use firmware::protocol::serial::Packet;
use firmware::protocol::session::{TAKEOVER_MS, op, status};
use std::time::{Duration, Instant};

/// Period of commands: the gripper stops after 100 ms without one.
const PERIOD: Duration = Duration::from_millis(20);

/// Time between two requests for a session, and until no further one is made: another host may have left one open.
const REQUEST: Duration = Duration::from_millis(250);
const REQUESTS: Duration = Duration::from_millis(TAKEOVER_MS + 2000);

/// Silence after which an owner renews its session: before another host can take it over.
const RENEWAL: Duration = Duration::from_millis(TAKEOVER_MS / 2);

/// Five heartbeats in seconds; for an emulated gripper at half of its speed, more than two.
const CERTAIN_S: f64 = 0.5;

/// What a host needs for a session with a gripper.
#[derive(Clone, Copy, Debug)]
pub struct Credentials {
    /// Node number of the gripper.
    pub node: u16,
    /// Key that host and gripper share; [`Key::NONE`] for an unprotected gripper.
    pub key: Key,
}

impl Credentials {
    /// Of an unprotected gripper with the default node number.
    pub const UNPROTECTED: Self = Self { node: firmware::protocol::DEFAULT_NODE, key: Key::NONE };
}

/// A connection in a session without motion: requests that need a code get one, and the session is renewed while it is read.
pub struct SessionSource<'s> {
    source: &'s mut dyn Source,
    session: HostSession,
    /// Time of the latest request with a code.
    sealed: Duration,
}

impl SessionSource<'_> {
    /// Code of data in this session.
    pub fn digest(&self) -> Option<DataMac> {
        self.session.mac().map(|mac| mac.digest())
    }

    fn open(&mut self) -> Result<()> {
        open(self.source, &mut self.session, op::OPEN, REQUESTS)?;
        self.sealed = self.source.now();
        Ok(())
    }
}

/// Requests a session until the gripper confirms it, for at most `limit`.
///
/// # Errors
/// The gripper refuses the session or does not reply ([`ConnectionLost`]), or the connection is lost.
pub(crate) fn open(
    source: &mut dyn Source,
    session: &mut HostSession,
    op: u8,
    limit: Duration,
) -> Result<()> {
    let begun = source.now();
    let mut refused = None;
    while source.now() < begun + limit {
        for message in session.open(op) {
            source.send(message)?;
        }
        let asked = source.now();
        while source.now() < asked + REQUEST {
            for message in receive_messages(source)? {
                let Message::ServiceReply(reply) = message else { continue };
                if reply.op == op {
                    refused = Some(reply.status);
                }
                for answer in session.receive(&reply) {
                    source.send(answer)?;
                }
            }
            if session.is_armed() || op == op::OPEN && session.is_open() {
                return Ok(());
            }
        }
    }
    let name = source.name();
    match refused {
        Some(status) => bail!("{name}: the gripper opens no session: {}", session_refusal(status)),
        None => Err(ConnectionLost::unreachable(&name).into()),
    }
}

impl Source for SessionSource<'_> {
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        if self.source.now() > self.sealed + RENEWAL {
            self.send(service(op::RENEW, 0))?;
        }
        self.source.receive(packets)
    }

    fn send(&mut self, message: Message) -> Result<()> {
        match self.session.seal(message).filter(|_| needs_owner(&message)) {
            Some(sealed) => {
                self.sealed = self.source.now();
                sealed.into_iter().try_for_each(|message| self.source.send(message))
            }
            None => self.source.send(message),
        }
    }

    fn broken(&self) -> u32 {
        self.source.broken()
    }

    fn name(&self) -> String {
        self.source.name()
    }

    fn now(&self) -> Duration {
        self.source.now()
    }

    fn pause(&mut self, time: Duration) -> Result<()> {
        self.source.pause(time)
    }
}

/// Opens a session without motion, does some work in it, and ends it.
///
/// # Errors
/// The connection is lost, the gripper opens no session, or the error of the work.
pub fn with_session<T>(
    source: &mut dyn Source,
    Credentials { node, key }: Credentials,
    work: impl FnOnce(&mut SessionSource<'_>) -> Result<T>,
) -> Result<T> {
    let mut session =
        SessionSource { source, session: HostSession::new(node, key), sealed: Duration::ZERO };
    session.open()?;
    let result = work(&mut session);
    let ended =
        session.session.end().into_iter().try_for_each(|message| session.source.send(message));
    result.and_then(|value| ended.map(|()| value))
}

/// Host that controls a gripper.
pub struct Client {
    source: Box<dyn Source + Send>,
    session: HostSession,
    begun: Instant,
    command: Option<Command>,
    sent: Option<Instant>,
    /// Service that the gripper has not answered.
    requested: Option<u8>,
    /// Latest state of the gripper.
    pub state: GripperState,
    /// Status of the last refused session.
    pub not_armed: Option<u8>,
    /// Last refused command since [`Self::command`].
    pub refused: Option<Refusal>,
    /// Heartbeats since [`Self::command`].
    pub beats: u32,
    /// State code that all heartbeats have had since this time.
    said: Option<(u8, f64)>,
}

impl Client {
    /// Host of a gripper; sends nothing yet.
    pub fn new(source: Box<dyn Source + Send>, Credentials { node, key }: Credentials) -> Self {
        Self {
            source,
            session: HostSession::new(node, key),
            begun: Instant::now(),
            command: None,
            sent: None,
            requested: None,
            state: GripperState::default(),
            not_armed: None,
            refused: None,
            beats: 0,
            said: None,
        }
    }

    /// Name of the line or bus.
    pub fn name(&self) -> String {
        self.source.name()
    }

    /// Seconds since the start.
    pub fn elapsed_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    /// Whether all heartbeats have had the present state for so long that the gripper's own would have contradicted a stranger's.
    pub fn is_certain(&self) -> bool {
        self.said.is_some_and(|(_, since_s)| self.elapsed_s() >= since_s + CERTAIN_S)
    }

    /// Requests a session with motion.
    ///
    /// # Errors
    /// The connection is lost.
    pub fn arm(&mut self) -> Result<()> {
        self.not_armed = None;
        let request = self.session.open(op::ARM);
        self.send_all(request)
    }

    /// Ends the session.
    ///
    /// # Errors
    /// The connection is lost.
    pub fn end_session(&mut self) -> Result<()> {
        self.command = None;
        let request = self.session.end();
        self.send_all(request)
    }

    /// True once the gripper has confirmed the session.
    pub fn is_armed(&self) -> bool {
        self.session.is_armed()
    }

    /// Requests a service, in a session of its own if none is open.
    ///
    /// # Errors
    /// The connection is lost.
    pub fn request(&mut self, op: u8) -> Result<()> {
        self.requested = Some(op);
        if self.session.is_open() {
            return self.send_requested();
        }
        let request = self.session.open(op::OPEN);
        self.send_all(request)
    }

    /// Whether the gripper has answered the last request.
    pub const fn is_answered(&self) -> bool {
        self.requested.is_none()
    }

    fn send_requested(&mut self) -> Result<()> {
        let sealed = self.requested.and_then(|op| self.session.seal(service(op, 0)));
        self.send_all(sealed.into_iter().flatten())
    }

    fn send_all(&mut self, messages: impl IntoIterator<Item = Message>) -> Result<()> {
        messages.into_iter().try_for_each(|message| self.source.send(message))
    }

    /// Command to repeat from now on.
    pub const fn command(&mut self, command: Command) {
        self.command = Some(command);
        (self.sent, self.refused, self.beats) = (None, None, 0);
    }

    /// Stops the gripper and ends the repetition.
    ///
    /// # Errors
    /// The connection is lost.
    pub fn stop(&mut self) -> Result<()> {
        self.command = None;
        self.source.send(Message::EStop(EStop::default()))
    }

    /// Receives pending messages and sends due commands; waits briefly.
    ///
    /// # Errors
    /// The connection is lost.
    pub fn poll(&mut self) -> Result<()> {
        let mut packets = Vec::new();
        let goes_on = self.source.receive(&mut packets)?;
        let now_s = self.elapsed_s();
        self.state.lost.broken = self.source.broken();
        for packet in &packets {
            self.state.update(now_s, packet);
            match packet {
                Packet::Message { message: Message::ServiceReply(reply), .. } => {
                    self.reply(reply)?
                }
                Packet::Message { message: Message::Heartbeat(beat), .. }
                    if beat.protocol_major == PROTOCOL_VERSION.0 =>
                {
                    self.beats = self.beats.saturating_add(1);
                    if self.said.is_none_or(|(state, _)| state != beat.state) {
                        self.said = Some((beat.state, now_s));
                    }
                }
                _ => {}
            }
        }
        let silent_s = self.state.received_s.map(|received_s| now_s - received_s);
        if !goes_on || silent_s.is_some_and(|silent_s| silent_s > SILENCE.as_secs_f64()) {
            return Err(ConnectionLost::silent(&self.name()).into());
        }
        self.send_due()
    }

    fn reply(&mut self, reply: &ServiceReply) -> Result<()> {
        let was_open = self.session.is_open();
        let answer = self.session.receive(reply);
        match (reply.op, reply.status) {
            (op::ARM | op::OPEN, status::CHALLENGE | status::DONE) => {}
            // Refused because of another's code.
            (op::ARM | op::OPEN, _) if !answer.is_empty() => {}
            (op::ARM | op::OPEN, status) => self.not_armed = Some(status),
            (op::COMMAND, status::REFUSED) => {
                let refusal = Refusal::of(reply.detail);
                // A late reply to the previous command.
                if self.command.is_some_and(|command| command.mode == refusal.mode) {
                    self.refused = Some(refusal);
                }
            }
            _ => {}
        }
        if self.requested == Some(reply.op) {
            self.requested = None;
        }
        self.send_all(answer)?;
        if self.session.is_open() && !was_open { self.send_requested() } else { Ok(()) }
    }

    fn send_due(&mut self) -> Result<()> {
        let is_due = self.sent.is_none_or(|sent| sent.elapsed() >= PERIOD);
        let Some(command) = self.command.filter(|_| is_due) else {
            return Ok(());
        };
        if self.session.is_armed()
            && let Some(sealed) = self.session.seal(Message::Command(command))
        {
            self.send_all(sealed)?;
            self.sent = Some(Instant::now());
        }
        Ok(())
    }
}

/// Refused command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Mode of the command.
    pub mode: u8,
    state: u8,
    reason: u8,
}

impl Refusal {
    /// From the detail of the reply ([`firmware::grip::commands::CommandRefusal::reply`]).
    pub const fn of(detail: u32) -> Self {
        let [reason, state, mode, _] = detail.to_le_bytes();
        Self { mode, state, reason }
    }

    /// Whether the drive is not enabled.
    pub const fn is_not_enabled(&self) -> bool {
        self.reason == RefusalReason::NotEnabled as u8
    }

    /// Whether the reason is a fault.
    pub const fn is_of_fault(&self) -> bool {
        self.reason == RefusalReason::FaultActive as u8
            || self.reason == RefusalReason::FaultLatched as u8
    }

    /// Whether a repetition may be accepted: the current offsets are being measured, the session begins, or the fingers still
    /// move towards the end of an earlier command.
    pub fn is_transient(&self) -> bool {
        let begins = [mode::ENABLE, mode::RELEASE].contains(&self.mode) && self.is_not_enabled();
        let ends = self.mode == mode::DISABLE && self.reason != RefusalReason::Stopped as u8;
        begins || ends || self.reason == RefusalReason::MotorNotReady as u8
    }

    /// Reason, state and remedy as text.
    pub fn words(&self) -> String {
        let reason = REASONS.into_iter().find(|reason| *reason as u8 == self.reason);
        let reason = match reason {
            Some(RefusalReason::NotParked) => {
                format!("{}: {}", advice(RefusalReason::NotParked), foot_openings())
            }
            Some(reason) => advice(reason).to_owned(),
            None => format!("reason {}, unknown to this tool", self.reason),
        };
        format!("refused in state {}: {reason}", state_name(self.state))
    }
}

/// Openings at which ground contact may begin, and how to reach them.
pub fn foot_openings() -> String {
    let GripLimits { flat_contact_mm, line_contact_mm: [line_mm, tolerance_mm], .. } =
        GripLimits::GRIPPER;
    format!(
        "flat needs at most {flat_contact_mm} mm (first --position {CLOSED_MM}), --contact line {line_mm} ± {tolerance_mm} mm \
         (first --position {line_mm})"
    )
}

const REASONS: [RefusalReason; 15] = [
    RefusalReason::UnknownMode,
    RefusalReason::NotEnabled,
    RefusalReason::FaultActive,
    RefusalReason::FaultLatched,
    RefusalReason::MotorNotReady,
    RefusalReason::NotHomed,
    RefusalReason::Busy,
    RefusalReason::Gripping,
    RefusalReason::FootMode,
    RefusalReason::NotApplicable,
    RefusalReason::OutOfRange,
    RefusalReason::Blind,
    RefusalReason::Loaded,
    RefusalReason::NotParked,
    RefusalReason::Stopped,
];

const fn advice(reason: RefusalReason) -> &'static str {
    match reason {
        RefusalReason::UnknownMode => {
            "the firmware does not support this command: it is older than this tool"
        }
        RefusalReason::NotEnabled => "the drive is not enabled",
        RefusalReason::FaultActive => "a fault is active: remove its cause",
        RefusalReason::FaultLatched => {
            "a fault is latched: clear it with --clear-faults once its cause is gone"
        }
        RefusalReason::MotorNotReady => {
            "the motor is not ready: its offsets are being measured, or it has tripped"
        }
        RefusalReason::NotHomed => "the opening is not referenced: home first, with --home",
        RefusalReason::Busy => "the fingers are moving",
        RefusalReason::Gripping => "an object is gripped: release it first",
        RefusalReason::FootMode => "ground-contact mode is active: leave it first",
        RefusalReason::NotApplicable => "not applicable in this state",
        RefusalReason::OutOfRange => "a number is out of range",
        RefusalReason::Blind => {
            "no finger reports a valid force: check the sensors with `cargo magpie monitor`"
        }
        RefusalReason::Loaded => "the fingers are loaded: remove the load",
        RefusalReason::NotParked => "the opening is not that of the ground contact",
        RefusalReason::Stopped => {
            "a stop is latched: make sure that the gripper may move again, then use --clear-faults"
        }
    }
}

/// Checks the version of the protocol: messages of another major version would be misinterpreted.
///
/// # Errors
/// The gripper has another major protocol version.
pub fn check_protocol(state: &GripperState) -> Result<()> {
    if state.other_protocol.is_of_gripper {
        bail!(
            "the gripper uses protocol version {}, this tool {}: use the tool version of its firmware",
            state.other_protocol.major,
            PROTOCOL_VERSION.0
        );
    }
    Ok(())
}

/// Reason of a refused session.
pub const fn session_refusal(code: u8) -> &'static str {
    match code {
        status::CHALLENGE => {
            "it does not confirm the answer to its challenge: is the connection slow?"
        }
        status::REFUSED => {
            "it has another key than this host: give its key with --key FILE, or none if it is unprotected"
        }
        status::FAULTY => {
            "a fault prevents it: check with `cargo magpie monitor`, remove its cause, and use --clear-faults"
        }
        status::ARMED => "another host owns its session: end that program first",
        status::UNKNOWN => "its firmware is older than this tool",
        _ => "the firmware gives no reason known to this tool",
    }
}

#[cfg(test)]
mod tests {
    use firmware::grip::commands::CommandRefusal;
    use firmware::grip::states::{PowerState, TaskState, state_code};
    use firmware::protocol::session::{EXPIRY_MS, Session, SessionEvent};
    use firmware::protocol::{SERIAL, frame_id};

    use super::*;

    /// The session of a gripper at the end of a line, in virtual time.
    struct Gripper {
        session: Session,
        now_ms: u64,
        replies: Vec<Packet>,
    }

    impl Source for Gripper {
        fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
            self.now_ms += 20;
            self.session.expire(self.now_ms);
            packets.append(&mut self.replies);
            Ok(true)
        }

        fn send(&mut self, message: Message) -> Result<()> {
            let id = frame_id(Credentials::UNPROTECTED.node, message.number());
            let frame = (id, &message.to_bytes()[..]);
            let event = self.session.receive(self.now_ms, SERIAL, frame, || Some(7));
            if let SessionEvent::Reply(message) = event {
                self.replies.push(Packet::Message { copy: 0, message });
            }
            Ok(())
        }

        fn broken(&self) -> u32 {
            0
        }

        fn name(&self) -> String {
            "gripper".to_owned()
        }

        fn now(&self) -> Duration {
            Duration::from_millis(self.now_ms)
        }
    }

    #[test]
    fn long_work_keeps_the_session() {
        let Credentials { node, key } = Credentials::UNPROTECTED;
        let session = Session::new(node, key, 100);
        let mut gripper = Gripper { session, now_ms: 5, replies: Vec::new() };
        let code = with_session(&mut gripper, Credentials::UNPROTECTED, |source| {
            while source.now() < Duration::from_millis(3 * EXPIRY_MS) {
                source.receive(&mut Vec::new())?;
            }
            Ok(source.digest().map(DataMac::finish))
        });
        assert!(code.unwrap().is_some());
        assert_eq!(gripper.session.dropped().all(), 0);
    }

    #[test]
    fn refusal_names_reason_and_state() {
        for reason in REASONS {
            let refused = CommandRefusal {
                mode: 4,
                reason,
                state: state_code(PowerState::Enabled, TaskState::Unhomed),
            };
            let refusal = Refusal::of(refused.reply().detail);
            assert_eq!(refusal.mode, 4);
            let words = format!("refused in state unhomed: {}", advice(reason));
            assert!(refusal.words().starts_with(&words), "{}", refusal.words());
        }
    }
}
