//! The image in the emulated chip, around it a simulated gripper, and its serial line and CAN bus as ports of this
//! machine, through which other programs talk to it as to a board.
//!
//! - here: the board, step by step.
//! - [`deadlines`]: when each tick's packet had passed.
//! - [`pace`]: virtual time against the clock.

pub mod deadlines;
pub mod pace;

use std::path::Path;

use anyhow::Result;
use embedded_can::Frame;
use firmware::grip::states::{TASK_CODE, Task};
use firmware::wire::DEFAULT_NODE;
use firmware::wire::can::CanFrame;
use firmware::wire::messages::{FaultEvent, Message};
use firmware::wire::serial::{Packet, Receiver};
use sim_board::{LogLine, ResetRecord, Time};

use super::pty::Pty;
use super::socket_can::Bridge;
use super::socketcand::server::Server;
use super::source::packet;
use crate::board::SimulatedBoard;
use crate::board::emulated::EmulatedBoard;
use crate::drive::world::Shared;
use crate::plant::object::Object;
use deadlines::{Clocks, Deadlines};

/// Between two exchanges with the ports: short against the period of commands and the firmware's timeouts.
pub const STEP: Time = Time::from_ms(1);
/// Frames of other nodes that wait for the bus; a real bus has no room for more either.
const WAITING: usize = 512;
/// An object is put between the fingers where they are open so much wider.
const CLEARANCE_M: f64 = 0.5e-3;

/// Where the CAN bus goes.
pub enum CanPort {
    /// To clients over TCP.
    Server(Server),
    /// To an interface of this machine.
    Interface(Bridge),
}

impl CanPort {
    fn exchange(&mut self, sent: &[(u64, CanFrame)]) -> Result<Vec<CanFrame>> {
        match self {
            Self::Server(server) => Ok(server.exchange(sent)),
            Self::Interface(bridge) => bridge.exchange(sent.iter().map(|(_, frame)| *frame)),
        }
    }

    fn take_notices(&mut self) -> Vec<String> {
        match self {
            Self::Server(server) => server.take_notices(),
            Self::Interface(_) => Vec::new(),
        }
    }
}

/// What people may want to read as it happens.
pub enum Notice {
    /// A line of the image's log.
    Log(LogLine),
    /// The chip was reset.
    Reset(ResetRecord),
    /// The image reports a fault, or that one is gone.
    Fault(FaultEvent),
    /// Something about ports or surroundings.
    Port(String),
}

/// The board with its ports.
pub struct Emulation {
    /// The board.
    pub board: EmulatedBoard,
    /// When each tick's packet had passed.
    pub deadlines: Deadlines,
    /// Frames from the ports for which the bus had no room.
    pub dropped_frames: u64,
    /// Faults as the image reported them, with the time in microseconds.
    pub faults: Vec<(u64, FaultEvent)>,
    gripper: Shared,
    /// Put between the fingers once the gripper is homed, for homing measures its own stroke.
    object: Option<Object>,
    is_placed: bool,
    pty: Pty,
    can: CanPort,
    receiver: Receiver,
    resets: usize,
    end: Time,
}

impl Emulation {
    /// A board that has just been switched on.
    pub fn new(
        board: EmulatedBoard,
        gripper: Shared,
        object: Option<Object>,
        pty: Pty,
        can: CanPort,
    ) -> Self {
        Self {
            board,
            deadlines: Deadlines::default(),
            dropped_frames: 0,
            faults: Vec::new(),
            gripper,
            object,
            is_placed: false,
            pty,
            can,
            receiver: Receiver::default(),
            resets: 0,
            end: Time::ZERO,
        }
    }

    /// Path of the serial line.
    pub fn serial(&self) -> &Path {
        &self.pty.path
    }

    /// Virtual time since power-on.
    pub fn now(&self) -> Time {
        self.board.chip.now()
    }

    /// Whether the recording that the sensors measure has ended.
    pub fn is_over(&self) -> bool {
        self.board.connections.now.borrow().ended()
    }

    /// Frames that the interface had no room for.
    pub fn unsent_frames(&self) -> u64 {
        match &self.can {
            CanPort::Server(_) => 0,
            CanPort::Interface(bridge) => bridge.dropped(),
        }
    }

    /// Runs one step and exchanges what passed on line and bus.
    ///
    /// # Errors
    /// The chip cannot go on, or a port is gone.
    pub fn step(&mut self) -> Result<Vec<Notice>> {
        self.end += STEP;
        let halted = self.board.run_until(self.end.us());
        let mut notices: Vec<_> = self.resets().collect();
        notices.extend(self.board.chip.take_log().into_iter().map(Notice::Log));
        self.exchange_bytes()?;
        self.exchange_frames(&mut notices)?;
        halted?;
        Ok(notices)
    }

    fn resets(&mut self) -> impl Iterator<Item = Notice> + use<> {
        let resets = self
            .board
            .chip
            .resets
            .get(self.resets..)
            .unwrap_or_default()
            .to_vec();
        self.resets += resets.len();
        if !resets.is_empty() {
            self.deadlines.restart();
        }
        resets.into_iter().map(Notice::Reset)
    }

    fn exchange_bytes(&mut self) -> Result<()> {
        let clocks = Clocks {
            now: self.board.chip.now(),
            firmware_us: self.board.chip.soc.time_base(),
        };
        let sent = self.board.take_sent();
        for (ended, packet) in sent.packets(&mut self.receiver) {
            if let Packet::Tick(tick) = packet {
                self.deadlines.push(tick.time_us, ended, clocks);
            }
        }
        self.pty.send_latest(&sent.bytes)?;
        let mut bytes = [0; 256];
        let count = self.pty.take(&mut bytes)?;
        let mut line = self.board.connections.line.borrow_mut();
        bytes.iter().take(count).for_each(|byte| line.put(*byte));
        Ok(())
    }

    fn exchange_frames(&mut self, notices: &mut Vec<Notice>) -> Result<()> {
        let sent = std::mem::take(&mut self.board.connections.can.borrow_mut().heard);
        for (time_us, frame) in &sent {
            let message = packet(DEFAULT_NODE, frame.identifier(), frame.data());
            match message {
                Some(Packet::Message {
                    message: Message::Heartbeat(beat),
                    ..
                }) => {
                    notices.extend(self.place(beat.state));
                }
                Some(Packet::Message {
                    message: Message::FaultEvent(event),
                    ..
                }) => {
                    self.faults.push((*time_us, event));
                    notices.push(Notice::Fault(event));
                }
                _ => {}
            }
        }
        let received = self.can.exchange(&sent)?;
        notices.extend(self.can.take_notices().into_iter().map(Notice::Port));
        let mut bus = self.board.connections.can.borrow_mut();
        for frame in received {
            match bus.waiting() < WAITING {
                true => bus.put(frame),
                false => self.dropped_frames += 1,
            }
        }
        Ok(())
    }

    /// Puts the object between the fingers of a homed gripper, and takes it away before the next homing.
    fn place(&mut self, state: u8) -> Option<Notice> {
        let object = self.object.as_ref()?;
        let task = state.checked_sub(TASK_CODE)?;
        let is_homed = task != Task::Unhomed as u8 && task != Task::Homing as u8;
        let plant = &mut self.gripper.borrow_mut().rig.plant;
        if is_homed == self.is_placed {
            return None;
        }
        if is_homed && plant.opening_m() < object.width_m + CLEARANCE_M {
            return None;
        }
        plant.hold(is_homed.then_some(object));
        self.is_placed = is_homed;
        let width_mm = 1e3 * object.width_m;
        Some(Notice::Port(match is_homed {
            true => format!("an object of {width_mm} mm is between the fingers"),
            false => format!("the object of {width_mm} mm is taken away"),
        }))
    }
}
