//! A host on a simulated CAN bus: it arms with the nonce, repeats its command, and hears what the board tells.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_can::Frame;
use firmware::session::{MAGIC, op, sealed, status};
use firmware::wire::can::CanFrame;
use firmware::wire::messages::{
    Command, EStop, FaultEvent, Foot, Force, GripStatus, Heartbeat, Message, ParamReply,
    ParamRequest, Service, ServiceReply,
};
use firmware::wire::{DEFAULT_NODE, identifier};

use super::can::CanBus;

const COMMAND: u16 = identifier(DEFAULT_NODE, Command::LAYOUT.number);
const SERVICE: u16 = identifier(DEFAULT_NODE, Service::LAYOUT.number);
const PARAMETER: u16 = identifier(DEFAULT_NODE, ParamRequest::LAYOUT.number);
const STOP: u16 = identifier(DEFAULT_NODE, EStop::LAYOUT.number);
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
    /// Every answer to [`Host::ask_parameter`].
    pub parameters: Vec<(u64, ParamReply)>,
}

/// The host.
pub struct Host {
    bus: Rc<RefCell<CanBus>>,
    nonce: Option<u16>,
    counter: u8,
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
            nonce: None,
            counter: 0,
            command: None,
            waits_ms: 0,
            is_silent: false,
            told: Told::default(),
        }
    }

    /// Asks for a nonce, and says it back once it comes.
    pub fn arm(&mut self) {
        self.nonce = None;
        self.service(op::ARM, 0);
    }

    /// Asks for a service.
    pub fn service(&mut self, op: u8, argument: u32) {
        self.ask(Service {
            op,
            magic: MAGIC,
            nonce: 0,
            argument,
        });
    }

    /// Reads or writes a parameter.
    pub fn ask_parameter(&mut self, request: ParamRequest) {
        self.put(CanFrame::of(PARAMETER, request.to_bytes()));
    }

    /// Commands from now on, again and again, at once for the first time.
    pub fn order(&mut self, command: Command) {
        self.command = Some(command);
        self.waits_ms = 0;
    }

    /// Says stop.
    pub fn stop(&mut self) {
        self.put(CanFrame::of(STOP, EStop::default().to_bytes()));
    }

    /// A millisecond: hears what has passed, then speaks.
    pub fn tick(&mut self) {
        self.hear();
        let Some((nonce, command)) = self.nonce.zip(self.command) else {
            return;
        };
        if self.waits_ms > 0 {
            self.waits_ms -= 1;
            return;
        }
        self.waits_ms = EVERY_MS - 1;
        self.counter = (self.counter + 1) & 0xF;
        let command = Command {
            counter: self.counter,
            ..command
        };
        self.put(CanFrame::of(
            COMMAND,
            sealed(nonce, COMMAND, command).to_bytes(),
        ));
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
                Message::ParamReply(reply) => self.told.parameters.push((time_us, reply)),
                Message::ServiceReply(reply) => self.answer(time_us, reply),
                _ => {}
            }
        }
    }

    fn answer(&mut self, time_us: u64, reply: ServiceReply) {
        if reply.op == op::ARM && reply.status == status::SAY_BACK {
            self.ask(Service {
                op: op::ARM,
                magic: MAGIC,
                nonce: reply.nonce,
                argument: 0,
            });
        }
        if reply.op == op::ARM && reply.status == status::DONE {
            self.nonce = Some(reply.nonce);
        }
        self.told.replies.push((time_us, reply));
    }

    /// Whether it has a session, as far as it knows.
    pub fn is_armed(&self) -> bool {
        self.nonce.is_some()
    }

    fn ask(&self, service: Service) {
        self.put(CanFrame::of(SERVICE, service.to_bytes()));
    }

    fn put(&self, frame: CanFrame) {
        if !self.is_silent {
            self.bus.borrow_mut().put(frame);
        }
    }
}
