//! Who may move the gripper: arming, and which commands count.
//!
//! A host asks to arm and gets a number, the nonce; it says the number back within
//! [`ECHO_MS`], and from then on seals every command with it. A command counts where its checksum is
//! right and its counter goes on: what was recorded in an earlier session, or is sent twice, moves
//! nothing. This is against accidents, not against an attacker with access to the bus: a random frame
//! with the right identifier passes once in 2^19.

use crate::wire::layout::{Direction, Malformed};
use crate::wire::messages::{Command, EStop, Message, Service, ServiceReply};
use crate::wire::serial::CHECKSUM;
use crate::wire::{STOP_ALL, identifier};

/// A nonce is forgotten after this time.
pub const ECHO_MS: u32 = 500;
/// Commands that may be lost between two that count.
const LOST: u8 = 1;
/// So many dropped frames within [`FLOOD_MS`] are a broken or a strange sender.
const FLOOD: usize = 16;
/// See [`FLOOD`].
const FLOOD_MS: u32 = 1000;

/// In every service, so that a stray frame starts none: "MG".
pub const MAGIC: u16 = 0x474D;

/// Services that a host may ask for.
pub mod op {
    /// Clears latched faults whose cause is gone.
    pub const CLEAR_FAULTS: u8 = 1;
    /// Takes the present forces as zero.
    pub const TARE: u8 = 2;
    /// Writes parameters to flash.
    pub const SAVE: u8 = 3;
    /// Restarts.
    pub const REBOOT: u8 = 4;
    /// Arms, in two steps.
    pub const ARM: u8 = 5;
    /// Asks for the version.
    pub const VERSION: u8 = 6;
    /// No service: the answer to a command that is not done carries it ([`crate::grip::reason::Refused`]).
    pub const COMMAND: u8 = 7;
    /// Measures of itself, while nobody is armed; the argument says what
    /// ([`crate::motor::calibration::Measure`]). What it finds counts at once, and is kept by [`SAVE`].
    pub const MEASURE: u8 = 8;
}

/// Answers to a service.
pub mod status {
    /// Done.
    pub const DONE: u8 = 0;
    /// Say this nonce back.
    pub const SAY_BACK: u8 = 1;
    /// The nonce is wrong, or too late.
    pub const REFUSED: u8 = 2;
    /// Nobody may arm: a fault forbids it.
    pub const FAULTY: u8 = 3;
    /// Not while somebody is armed.
    pub const ARMED: u8 = 4;
    /// It was tried and did not succeed; see the detail.
    pub const FAILED: u8 = 5;
    /// No such service.
    pub const UNKNOWN: u8 = 6;
}

/// Frames that moved nothing, since boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Of a number that nobody knows.
    pub unknown: u32,
    /// Not what their number promises, or with a wrong checksum.
    pub malformed: u32,
    /// With a counter that does not go on.
    pub replayed: u32,
    /// Before arming, or a nonce that came too late.
    pub late: u32,
}

impl Dropped {
    /// All of them.
    pub const fn all(self) -> u32 {
        self.unknown
            .saturating_add(self.malformed)
            .saturating_add(self.replayed)
            .saturating_add(self.late)
    }
}

/// What a frame was good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing: it is not for this node, or it was dropped and counted.
    Nothing,
    /// Stop at once.
    Stop,
    /// Answer with this; `armed` where a session has just begun.
    Reply {
        /// The answer.
        reply: ServiceReply,
        /// Whether commands count from here on.
        armed: bool,
    },
    /// Do this.
    Command(Command),
    /// Another message of a host, sound but not of the session's concern.
    Other(Message),
}

/// A conversation with a host.
#[derive(Clone, Copy, Debug)]
pub struct Session {
    node: u16,
    silent_ms: u32,
    may_arm: bool,
    offer: Option<Offer>,
    open: Option<Open>,
    dropped: Dropped,
    /// When the latest frames were dropped, in a ring; `None` before there were so many.
    latest: [Option<u32>; FLOOD],
    /// Where the oldest of them stands.
    oldest: usize,
}

#[derive(Clone, Copy, Debug)]
struct Offer {
    nonce: u16,
    at_ms: u32,
}

#[derive(Clone, Copy, Debug)]
struct Open {
    nonce: u16,
    /// Counter and time of the command that counted last.
    last: Option<(u8, u32)>,
}

impl Session {
    /// Nobody has armed; a host is silent after so many milliseconds without a command.
    pub const fn new(node: u16, silent_ms: u32) -> Self {
        Self {
            node,
            silent_ms,
            may_arm: true,
            offer: None,
            open: None,
            dropped: Dropped {
                unknown: 0,
                malformed: 0,
                replayed: 0,
                late: 0,
            },
            latest: [None; FLOOD],
            oldest: 0,
        }
    }

    /// Takes a frame. `random` is fresh with every call: a nonce is made of it.
    pub fn hear(&mut self, now_ms: u32, id: u16, bytes: &[u8], random: u16) -> Heard {
        if id == STOP_ALL {
            return Heard::Stop;
        }
        if id >> 5 != self.node {
            return Heard::Nothing;
        }
        let number = (id & 0x1F) as u8;
        if const { EStop::LAYOUT.numbers() }.contains(&number) {
            // Whatever it carries: a stop that is written badly is meant all the same.
            return Heard::Stop;
        }
        let message = match Message::from_frame(number, bytes) {
            Ok(message) => message,
            Err(Malformed::Unknown) => {
                self.dropped.unknown = self.dropped.unknown.saturating_add(1);
                return Heard::Nothing;
            }
            Err(Malformed::Length | Malformed::Reserved) => return self.malformed(now_ms),
        };
        match message {
            Message::Command(command) => self.command(now_ms, command),
            Message::Service(service) if service.magic != MAGIC => self.malformed(now_ms),
            Message::Service(service) if service.op == op::ARM && !self.may_arm => {
                self.close();
                let reply = answer(service, status::FAULTY, 0);
                Heard::Reply {
                    reply,
                    armed: false,
                }
            }
            Message::Service(service) if service.op == op::ARM => self.arm(now_ms, service, random),
            other if other.direction() == Direction::In => Heard::Other(other),
            // Somebody speaks in this node's name.
            _ => self.malformed(now_ms),
        }
    }

    /// Says whether somebody may arm; where not, the session ends.
    pub fn allow(&mut self, may_arm: bool) {
        self.may_arm = may_arm;
        if !may_arm {
            self.close();
        }
    }

    /// Another time after which a host counts as silent.
    pub fn set_silent_ms(&mut self, silent_ms: u32) {
        self.silent_ms = silent_ms;
    }

    /// Ends the session: a fault, a reset, or a host that asked for it. Only arming begins another.
    pub fn close(&mut self) {
        self.open = None;
        self.offer = None;
    }

    /// Whether somebody has armed.
    pub const fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Whether a nonce is offered and may still be said back.
    pub fn is_offered(&self, now_ms: u32) -> bool {
        self.offer
            .is_some_and(|offer| now_ms.wrapping_sub(offer.at_ms) <= ECHO_MS)
    }

    /// Whether commands arrive in time.
    pub fn is_alive(&self, now_ms: u32) -> bool {
        let last = self.open.and_then(|open| open.last);
        last.is_some_and(|(_, at_ms)| now_ms.wrapping_sub(at_ms) <= self.silent_ms)
    }

    /// Whether a host that has commanded does so no more.
    pub fn is_silent(&self, now_ms: u32) -> bool {
        let commanded = self.open.is_some_and(|open| open.last.is_some());
        commanded && !self.is_alive(now_ms)
    }

    /// Whether so many frames were dropped lately that the sender is broken or strange.
    pub fn is_flooded(&self, now_ms: u32) -> bool {
        let oldest = self.latest.get(self.oldest).copied().flatten();
        oldest.is_some_and(|at_ms| now_ms.wrapping_sub(at_ms) <= FLOOD_MS)
    }

    /// What was dropped since boot.
    pub const fn dropped(&self) -> Dropped {
        self.dropped
    }

    fn arm(&mut self, now_ms: u32, service: Service, random: u16) -> Heard {
        let reply = |status, nonce| ServiceReply {
            nonce,
            ..answer(service, status, 0)
        };
        if service.nonce == 0 {
            // Zero asks for a nonce, so it is none.
            let nonce = random.max(1);
            self.open = None;
            self.offer = Some(Offer {
                nonce,
                at_ms: now_ms,
            });
            return Heard::Reply {
                reply: reply(status::SAY_BACK, nonce),
                armed: false,
            };
        }
        let offer = self.offer.take();
        let in_time = |offer: &Offer| {
            offer.nonce == service.nonce && now_ms.wrapping_sub(offer.at_ms) <= ECHO_MS
        };
        let Some(offer) = offer.filter(in_time) else {
            self.dropped.late = self.dropped.late.saturating_add(1);
            self.note(now_ms);
            return Heard::Reply {
                reply: reply(status::REFUSED, 0),
                armed: false,
            };
        };
        self.open = Some(Open {
            nonce: offer.nonce,
            last: None,
        });
        Heard::Reply {
            reply: reply(status::DONE, offer.nonce),
            armed: true,
        }
    }

    fn command(&mut self, now_ms: u32, command: Command) -> Heard {
        let id = identifier(self.node, const { Command::LAYOUT.number });
        let Some(open) = &mut self.open else {
            self.dropped.late = self.dropped.late.saturating_add(1);
            self.note(now_ms);
            return Heard::Nothing;
        };
        if sealed(open.nonce, id, command) != command {
            return self.malformed(now_ms);
        }
        let goes_on = |(last, _): (u8, u32)| {
            let step = command.counter.wrapping_sub(last) & 0xF;
            (1..=1 + LOST).contains(&step)
        };
        if !open.last.is_none_or(goes_on) {
            self.dropped.replayed = self.dropped.replayed.saturating_add(1);
            self.note(now_ms);
            return Heard::Nothing;
        }
        open.last = Some((command.counter, now_ms));
        Heard::Command(command)
    }

    fn malformed(&mut self, now_ms: u32) -> Heard {
        self.dropped.malformed = self.dropped.malformed.saturating_add(1);
        self.note(now_ms);
        Heard::Nothing
    }

    /// Remembers when a frame was dropped.
    fn note(&mut self, now_ms: u32) {
        if let Some(oldest) = self.latest.get_mut(self.oldest) {
            *oldest = Some(now_ms);
        }
        self.oldest = (self.oldest + 1) % FLOOD;
    }
}

/// The answer to a service.
pub fn answer(service: Service, status: u8, detail: u32) -> ServiceReply {
    ServiceReply {
        op: service.op,
        status,
        nonce: 0,
        detail,
    }
}

/// The command with the checksum that this session asks for: over the nonce, the identifier, and the
/// bytes before the checksum.
pub fn sealed(nonce: u16, id: u16, command: Command) -> Command {
    let bytes = Command { crc: 0, ..command }.to_bytes();
    let [before @ .., _, _] = bytes;
    let mut digest = CHECKSUM.digest();
    digest.update(&nonce.to_le_bytes());
    digest.update(&id.to_le_bytes());
    digest.update(&before);
    Command {
        crc: digest.finalize(),
        ..command
    }
}

#[cfg(test)]
mod tests;
