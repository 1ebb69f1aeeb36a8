//! The image in the emulated chip with a simulated gripper; its serial line and CAN bus are ports of this
//! machine that other programs use like a board.
//!
//! - here: the board, step by step.
//! - [`calibration`]: calibration of a gripper with hidden effects: recordings, model, tables, errors of the board.
//! - [`deadlines`]: latency of each tick's packet.
//! - [`line`](mod@line): the serial line as a transport in the board's time.
//! - [`pace`]: synchronisation of virtual time with the wall clock.

pub mod calibration;
pub mod deadlines;
pub mod line;
pub mod pace;

use std::path::Path;

use anyhow::Result;
use embedded_can::Frame;
use emulator::{LogLine, ResetRecord, Time};
use firmware::grip::states::{TASK_CODE, TaskState};
use firmware::protocol::DEFAULT_NODE;
use firmware::protocol::can::CanFrame;
use firmware::protocol::messages::{FaultEvent, Message};
use firmware::protocol::serial::{BAUD_RATE, Packet, PacketDecoder};

use crate::pty::Pty;
use crate::socket_can::Bridge;
use crate::socketcand::server::Server;
use crate::source::packet;
use deadlines::{Clocks, Deadlines, FrameDelays};
use sim::board::SimulatedBoard;
use sim::board::can::CanBus;
use sim::closed_loop::coupling::SharedGripper;
use sim::closed_loop::emulated_board::EmulatedBoard;
use sim::drivetrain::mechanics::Object;

/// Interval of exchanges with the ports: short against the command period and the firmware's timeouts.
pub const STEP: Time = Time::from_ms(1);
/// Frames of other nodes that wait for the bus, at least as many as it carries in a step: further ones wait at their senders.
const WAITING: usize = 32;
/// The same of an interface of this machine, whose senders do not wait; further ones are lost.
const BRIDGED: usize = 512;
/// Bytes that the serial line carries in a step: further ones wait at their sender.
const STEP_BYTES: usize = BAUD_RATE as usize / 10_000;
/// Clearance in mm when an object is placed between the fingers.
const CLEARANCE_M: f64 = 0.5e-3;

/// Connection of the CAN bus.
pub enum CanPort {
    /// TCP server.
    Server(Server),
    /// Interface of this machine.
    Interface(Bridge),
}

impl CanPort {
    /// Hands on what was on the bus, and puts frames of other nodes on it as far as it has room; returns the number of those that
    /// had none.
    fn exchange(&mut self, sent: &[(u64, CanFrame)], bus: &mut CanBus) -> Result<u64> {
        match self {
            Self::Server(server) => {
                let others = bus.other_frames.get_or_insert_default();
                server.exchange(sent, &std::mem::take(others));
                while bus.waiting() < WAITING
                    && let Some(frame) = server.next_frame()
                {
                    bus.put(frame);
                }
                Ok(0)
            }
            Self::Interface(bridge) => {
                let mut dropped = 0;
                for frame in bridge.exchange(sent.iter().map(|(_, frame)| *frame))? {
                    if bus.waiting() < BRIDGED { bus.put(frame) } else { dropped += 1 }
                }
                Ok(dropped)
            }
        }
    }

    fn take_notices(&mut self) -> Vec<String> {
        match self {
            Self::Server(server) => server.take_notices(),
            Self::Interface(_) => Vec::new(),
        }
    }
}

/// Event to display.
pub enum Notice {
    /// Line of the image's log.
    Log(LogLine),
    /// Reset of the chip.
    Reset(ResetRecord),
    /// Fault event of the image.
    Fault(FaultEvent),
    /// Event of a port or of the simulation.
    Port(String),
}

/// Emulated board with its ports.
pub struct Emulation {
    pub board: EmulatedBoard,
    /// Latency of the ticks.
    pub deadlines: Deadlines,
    /// Latency of the frames with forces.
    pub force_frames: FrameDelays,
    /// Longest time from the beginning of a tick to its estimate in microseconds, as the firmware reports it.
    pub worst_tick_us: u16,
    /// Frames from the ports dropped because the queue was full.
    pub dropped_frames: u64,
    /// Fault events with their time in microseconds.
    pub faults: Vec<(u64, FaultEvent)>,
    /// Time at which the object is taken away for good.
    pub remove_object_at: Option<Time>,
    gripper: SharedGripper,
    /// Object placed after homing, since homing measures the stroke.
    object: Option<Object>,
    is_placed: bool,
    pty: Pty,
    can: CanPort,
    receiver: PacketDecoder,
    resets: usize,
    end: Time,
}

impl Emulation {
    /// Board at power-on.
    pub fn new(
        board: EmulatedBoard,
        gripper: SharedGripper,
        object: Option<Object>,
        pty: Pty,
        can: CanPort,
    ) -> Self {
        Self {
            board,
            deadlines: Deadlines::default(),
            force_frames: FrameDelays::default(),
            worst_tick_us: 0,
            dropped_frames: 0,
            faults: Vec::new(),
            remove_object_at: None,
            gripper,
            object,
            is_placed: false,
            pty,
            can,
            receiver: PacketDecoder::default(),
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

    /// True after the end of the replayed recording.
    pub fn is_over(&self) -> bool {
        self.board.connections.now.borrow().ended()
    }

    /// Frames dropped by the interface.
    pub fn unsent_frames(&self) -> u64 {
        match &self.can {
            CanPort::Server(_) => 0,
            CanPort::Interface(bridge) => bridge.dropped(),
        }
    }

    /// Runs one step and exchanges bytes and frames with the ports.
    ///
    /// # Errors
    /// The emulation cannot continue, or a port failed.
    pub fn step(&mut self) -> Result<Vec<Notice>> {
        self.end += STEP;
        let halted = self.board.run_until(self.end.us());
        let mut notices: Vec<_> = self.resets().collect();
        notices.extend(self.remove_object());
        notices.extend(self.board.chip.take_log().into_iter().map(Notice::Log));
        self.exchange_bytes()?;
        self.exchange_frames(&mut notices)?;
        halted?;
        Ok(notices)
    }

    fn resets(&mut self) -> impl Iterator<Item = Notice> + use<> {
        let resets = self.board.chip.resets.get(self.resets..).unwrap_or_default().to_vec();
        self.resets += resets.len();
        if !resets.is_empty() {
            self.deadlines.restart();
            self.force_frames.restart();
        }
        resets.into_iter().map(Notice::Reset)
    }

    fn exchange_bytes(&mut self) -> Result<()> {
        let clocks =
            Clocks { now: self.board.chip.now(), firmware_us: self.board.chip.soc.time_base() };
        let sent = self.board.take_sent();
        for (ended, packet) in sent.packets(&mut self.receiver) {
            if let Packet::Tick(tick) = packet {
                self.deadlines.push(tick.time_us, ended, clocks);
                self.force_frames.push_tick(clocks.time(tick.time_us));
            }
        }
        self.pty.send_latest(&sent.bytes)?;
        let mut line = self.board.connections.line.borrow_mut();
        let mut bytes = [0; STEP_BYTES];
        let room = STEP_BYTES.saturating_sub(line.waiting());
        let count = self.pty.take(&mut bytes[..room])?;
        bytes.iter().take(count).for_each(|byte| line.put(*byte));
        Ok(())
    }

    fn exchange_frames(&mut self, notices: &mut Vec<Notice>) -> Result<()> {
        let sent = std::mem::take(&mut self.board.connections.can.borrow_mut().board_frames);
        for (time_us, frame) in &sent {
            let message = packet(DEFAULT_NODE, frame.identifier(), frame.data());
            match message {
                Some(Packet::Message { message: Message::Heartbeat(beat), .. }) => {
                    notices.extend(self.place(beat.state));
                }
                Some(Packet::Message { message: Message::Timing(timing), .. }) => {
                    self.worst_tick_us = self.worst_tick_us.max(timing.worst_loop);
                }
                Some(Packet::Message { copy, message: Message::Force(_) }) => {
                    self.force_frames.push_frame(copy, Time::from_us(*time_us));
                }
                Some(Packet::Message { message: Message::FaultEvent(event), .. }) => {
                    self.faults.push((*time_us, event));
                    notices.push(Notice::Fault(event));
                }
                _ => {}
            }
        }
        let mut bus = self.board.connections.can.borrow_mut();
        self.dropped_frames += self.can.exchange(&sent, &mut bus)?;
        notices.extend(self.can.take_notices().into_iter().map(Notice::Port));
        Ok(())
    }

    /// Takes the object away at its time.
    fn remove_object(&mut self) -> Option<Notice> {
        self.remove_object_at.take_if(|at| *at <= self.end)?;
        let object = self.object.take()?;
        self.gripper.borrow_mut().rig.plant.set_object(None);
        Some(removal(&object))
    }

    /// Places the object between the fingers of a homed gripper and removes it before homing.
    fn place(&mut self, state: u8) -> Option<Notice> {
        let object = self.object.as_ref()?;
        let task = state.checked_sub(TASK_CODE)?;
        let is_homed = task != TaskState::Unhomed as u8 && task != TaskState::Homing as u8;
        let plant = &mut self.gripper.borrow_mut().rig.plant;
        if is_homed == self.is_placed {
            return None;
        }
        if is_homed && plant.opening_m() < object.width_m + CLEARANCE_M {
            return None;
        }
        plant.set_object(is_homed.then_some(object));
        self.is_placed = is_homed;
        let width_mm = 1e3 * object.width_m;
        Some(if is_homed {
            Notice::Port(format!("an object of {width_mm} mm is between the fingers"))
        } else {
            removal(object)
        })
    }
}

fn removal(object: &Object) -> Notice {
    Notice::Port(format!("the object of {} mm is taken away", 1e3 * object.width_m))
}
