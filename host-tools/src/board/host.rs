//! A host on a simulated CAN bus: it arms with the nonce, repeats its command, and hears what the board tells.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_can::Frame;
use firmware::wire::can::CanFrame;
use firmware::wire::messages::{
    Command, EStop, FaultEvent, Foot, Force, GripStatus, Heartbeat, Message, ParamReply,
    ParamRequest, ServiceReply,
};
use firmware::wire::{DEFAULT_NODE, identifier};

use super::can::CanBus;
use crate::live::session::{HostSession, service};

/// Milliseconds from one command to the next.
const EVERY_MS: u32 = Command::LAYOUT.period_ms as u32;

/// What the board told, the last of each kind, with the time in microseconds at which its frame had passed.
#[derive(Clone, Debug, Default)]
pub struct Told {
    /// It lives.
    pub heartbeat: Option<(u64, Heartbeat)>,
    /// The grip.
    pub status: Option<(u64, GripStatus)>,
    /// The foot.
    pub foot: Option<(u64, Foot)>,
    /// The forces at each sensor.
    pub forces: [Option<(u64, Force)>; 4],
    /// Every fault that came or went.
    pub faults: Vec<(u64, FaultEvent)>,
    /// Every answer to a service, refused commands among them.
    pub replies: Vec<(u64, ServiceReply)>,
    /// Longest tick of sensing and estimating, in microseconds.
    pub worst_tick_us: u16,
    /// Every answer to [`Host::ask_parameter`].
    pub parameters: Vec<(u64, ParamReply)>,
}

/// The host.
pub struct Host {
    bus: Rc<RefCell<CanBus>>,
    session: HostSession,
    command: Option<Command>,
    waits_ms: u32,
    /// It says nothing more.
    pub is_silent: bool,
    /// What it has heard.
    pub told: Told,
}

impl Host {
    /// It has said nothing yet.
    pub fn new(bus: Rc<RefCell<CanBus>>) -> Self {
        Self {
            bus,
            session: HostSession::new(DEFAULT_NODE),
            command: None,
            waits_ms: 0,
            is_silent: false,
            told: Told::default(),
        }
    }

    /// Asks for a nonce, and says it back once it comes.
    pub fn arm(&mut self) {
        let request = self.session.arm();
        self.put(request);
    }

    /// Asks for a service.
    pub fn service(&mut self, op: u8, argument: u32) {
        self.put(service(op, argument));
    }

    /// Reads or writes a parameter.
    pub fn ask_parameter(&mut self, request: ParamRequest) {
        self.put(Message::ParamRequest(request));
    }

    /// Commands from now on, again and again, at once for the first time.
    pub fn order(&mut self, command: Command) {
        self.command = Some(command);
        self.waits_ms = 0;
    }

    /// Says stop.
    pub fn stop(&mut self) {
        self.put(Message::EStop(EStop::default()));
    }

    /// A millisecond: hears what has passed, then speaks.
    pub fn tick(&mut self) {
        self.hear();
        let Some(command) = self.command.filter(|_| self.session.is_armed()) else {
            return;
        };
        if self.waits_ms > 0 {
            self.waits_ms -= 1;
            return;
        }
        self.waits_ms = EVERY_MS - 1;
        if let Some(message) = self.session.seal(command) {
            self.put(message);
        }
    }

    fn hear(&mut self) {
        let heard = std::mem::take(&mut self.bus.borrow_mut().heard);
        for (time_us, frame) in heard {
            let number = (frame.identifier() & 0x1F) as u8;
            let Ok(message) = Message::from_frame(number, frame.data()) else {
                continue;
            };
            match message {
                Message::Heartbeat(beat) => self.told.heartbeat = Some((time_us, beat)),
                Message::GripStatus(status) => self.told.status = Some((time_us, status)),
                Message::Foot(foot) => self.told.foot = Some((time_us, foot)),
                Message::Force(force) => {
                    let sensor = usize::from(number - Force::LAYOUT.number);
                    self.told.forces[sensor] = Some((time_us, force));
                }
                Message::FaultEvent(event) => self.told.faults.push((time_us, event)),
                Message::Timing(timing) => {
                    self.told.worst_tick_us = self.told.worst_tick_us.max(timing.worst_loop);
                }
                Message::ParamReply(reply) => self.told.parameters.push((time_us, reply)),
                Message::ServiceReply(reply) => self.answer(time_us, reply),
                _ => {}
            }
        }
    }

    fn answer(&mut self, time_us: u64, reply: ServiceReply) {
        if let Some(message) = self.session.receive(&reply) {
            self.put(message);
        }
        self.told.replies.push((time_us, reply));
    }

    /// Whether it has a session, as far as it knows.
    pub fn is_armed(&self) -> bool {
        self.session.is_armed()
    }

    fn put(&self, message: Message) {
        if !self.is_silent {
            let id = identifier(DEFAULT_NODE, message.number());
            self.bus
                .borrow_mut()
                .put(CanFrame::of(id, message.to_bytes()));
        }
    }
}
