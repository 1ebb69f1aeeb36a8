//! A host on the CAN bus: opens sessions, repeats its command, records the board's messages.

use crate::board::can::CanBus;
use embedded_can::Frame;
use firmware::parameters;
use firmware::protocol::authentication::Key;
use firmware::protocol::can::CanFrame;
use firmware::protocol::host_session::{HostSession, needs_owner, service};
use firmware::protocol::messages::{
    Command, EStop, FaultEvent, Foot, Force, GripStatus, Heartbeat, Message, ParamReply,
    ParamRequest, Power, ServiceReply,
};
use firmware::protocol::session::{op, status};
use firmware::protocol::{DEFAULT_NODE, frame_id};
use std::cell::RefCell;
use std::rc::Rc;

/// Period of the command in milliseconds.
const EVERY_MS: u32 = Command::LAYOUT.period_ms as u32;

/// Milliseconds until a session is requested again.
const OPEN_MS: u32 = 50;

/// Messages of the board, the last of each kind, with the end time of the frame in microseconds.
#[derive(Clone, Debug, Default)]
pub struct ReceivedMessages {
    /// Heartbeat.
    pub heartbeat: Option<(u64, Heartbeat)>,
    /// Grip status.
    pub status: Option<(u64, GripStatus)>,
    /// Latest supply and temperatures.
    pub power: Option<(u64, Power)>,
    /// Foot status.
    pub foot: Option<(u64, Foot)>,
    /// Forces of each sensor.
    pub forces: [Option<(u64, Force)>; 4],
    /// All fault events.
    pub faults: Vec<(u64, FaultEvent)>,
    /// All service replies, refused commands included.
    pub replies: Vec<(u64, ServiceReply)>,
    /// Longest tick of sensing and estimation, in microseconds.
    pub worst_tick_us: u16,
    /// All replies to [`CanHost::request_parameter`].
    pub parameters: Vec<(u64, ParamReply)>,
}

/// Simulated host.
pub struct CanHost {
    bus: Rc<RefCell<CanBus>>,
    session: HostSession,
    command: Option<Command>,
    wait_ms: u32,
    /// Requests for which a session is being opened, and milliseconds since it was requested.
    waiting: Vec<Message>,
    opening_ms: u32,
    /// Requests in a session without a reply, to be repeated if the session has ended meanwhile.
    unanswered: Vec<Message>,
    /// Stops all transmissions.
    pub is_silent: bool,
    /// Received messages.
    pub received: ReceivedMessages,
}

impl CanHost {
    /// Connects a host to a bus.
    pub fn new(bus: Rc<RefCell<CanBus>>) -> Self {
        Self {
            bus,
            session: HostSession::new(DEFAULT_NODE, Key::NONE),
            command: None,
            wait_ms: 0,
            waiting: Vec::new(),
            opening_ms: 0,
            unanswered: Vec::new(),
            is_silent: false,
            received: ReceivedMessages::default(),
        }
    }

    /// A copy in its present state, on another bus.
    pub fn copy(&self, bus: Rc<RefCell<CanBus>>) -> Self {
        Self {
            bus,
            session: self.session.clone(),
            command: self.command,
            wait_ms: self.wait_ms,
            waiting: self.waiting.clone(),
            opening_ms: self.opening_ms,
            unanswered: self.unanswered.clone(),
            is_silent: self.is_silent,
            received: self.received.clone(),
        }
    }

    /// Opens a session with motion, as soon as the challenge arrives.
    pub fn arm(&mut self) {
        self.waiting.clear();
        for request in self.session.open(op::ARM) {
            self.send(request);
        }
    }

    /// Requests a service.
    pub fn service(&mut self, op: u8, argument: u32) {
        self.request(service(op, argument));
    }

    /// Reads or writes a parameter.
    pub fn request_parameter(&mut self, request: ParamRequest) {
        self.request(Message::ParamRequest(request));
    }

    /// Sends a request; if it needs a session, in the open one, or in one that it opens.
    fn request(&mut self, request: Message) {
        if !needs_owner(&request) {
            return self.send(request);
        }
        let is_opening = !self.waiting.is_empty();
        self.waiting.push(request);
        if self.session.is_open() {
            self.send_waiting();
        } else if !is_opening {
            self.open();
        }
    }

    fn open(&mut self) {
        self.opening_ms = 0;
        for request in self.session.open(op::OPEN) {
            self.send(request);
        }
    }

    /// Takes the request that a reply answers. If the gripper did not accept its session, the request is repeated in a new one
    /// and true is returned.
    fn take_answered(&mut self, is_refused: bool, answers: impl Fn(&Message) -> bool) -> bool {
        let Some(place) = self.unanswered.iter().position(answers) else {
            return false;
        };
        let request = self.unanswered.remove(place);
        if is_refused {
            self.session.forget();
            self.request(request);
        }
        is_refused
    }

    fn send_waiting(&mut self) {
        for request in std::mem::take(&mut self.waiting) {
            self.unanswered.push(request);
            self.send_sealed(request);
        }
    }

    fn send_sealed(&mut self, message: Message) {
        for message in self.session.seal(message).into_iter().flatten() {
            self.send(message);
        }
    }

    /// Sets the command to repeat, sent immediately.
    pub fn order(&mut self, command: Command) {
        self.command = Some(command);
        self.wait_ms = 0;
    }

    /// Sends an emergency stop.
    pub fn stop(&mut self) {
        self.send(Message::EStop(EStop::default()));
    }

    /// Advances by a millisecond: receives, then sends.
    pub fn tick(&mut self) {
        self.receive();
        self.opening_ms += 1;
        if !self.waiting.is_empty() && self.opening_ms > OPEN_MS {
            self.open();
        }
        let Some(command) = self.command.filter(|_| self.session.is_armed()) else {
            return;
        };
        if self.wait_ms > 0 {
            self.wait_ms -= 1;
            return;
        }
        self.wait_ms = EVERY_MS - 1;
        self.send_sealed(Message::Command(command));
    }

    fn receive(&mut self) {
        let frames = std::mem::take(&mut self.bus.borrow_mut().board_frames);
        for (time_us, frame) in frames {
            let number = (frame.identifier() & 0x1F) as u8;
            let Ok(message) = Message::from_frame(number, frame.data()) else {
                continue;
            };
            match message {
                Message::Heartbeat(beat) => self.received.heartbeat = Some((time_us, beat)),
                Message::GripStatus(status) => self.received.status = Some((time_us, status)),
                Message::Foot(foot) => self.received.foot = Some((time_us, foot)),
                Message::Power(power) => self.received.power = Some((time_us, power)),
                Message::Force(force) => {
                    let sensor = usize::from(number - Force::LAYOUT.number);
                    self.received.forces[sensor] = Some((time_us, force));
                }
                Message::FaultEvent(event) => self.received.faults.push((time_us, event)),
                Message::Timing(timing) => {
                    self.received.worst_tick_us =
                        self.received.worst_tick_us.max(timing.worst_loop);
                }
                Message::ParamReply(reply)
                    if self.take_answered(
                        reply.status == parameters::status::UNAUTHENTICATED,
                        |request| matches!(request, Message::ParamRequest(request) if request.id == reply.id),
                    ) => {}
                Message::ParamReply(reply) => self.received.parameters.push((time_us, reply)),
                Message::ServiceReply(reply) => self.handle_reply(time_us, reply),
                _ => {}
            }
        }
    }

    fn handle_reply(&mut self, time_us: u64, reply: ServiceReply) {
        for message in self.session.receive(&reply) {
            self.send(message);
        }
        if self.session.is_open() {
            self.send_waiting();
        }
        let opens =
            reply.op == op::OPEN && matches!(reply.status, status::CHALLENGE | status::DONE);
        let is_refused = reply.status == status::UNAUTHENTICATED;
        let answers = |request: &Message| matches!(request, Message::Service(request) if request.op == reply.op);
        if opens || self.take_answered(is_refused, answers) {
            return;
        }
        self.received.replies.push((time_us, reply));
    }

    /// Whether the board has confirmed the session.
    pub fn is_armed(&self) -> bool {
        self.session.is_armed()
    }

    /// Sends a message, unless it is silent.
    pub fn send(&self, message: Message) {
        if !self.is_silent {
            let id = frame_id(DEFAULT_NODE, message.number());
            self.bus.borrow_mut().put(CanFrame::from_bytes(id, message.to_bytes()));
        }
    }
}
