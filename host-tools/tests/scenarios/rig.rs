//! Runs a scenario on a board, in virtual time or emulated, and records what it reports.

use std::collections::VecDeque;

use embedded_can::Frame;
use firmware::parameters::op as parameter_op;
use firmware::parameters::schema::counter;
use firmware::protocol::authentication::Key;
use firmware::protocol::can::CanFrame;
use firmware::protocol::host_session::HostSession;
use firmware::protocol::messages::{Command, FaultEvent, Message, ParamRequest};
use firmware::protocol::serial::{MAX_PACKET_BYTES, Packet, PacketDecoder, Tick, encode};
use firmware::protocol::session::op;
use firmware::protocol::{DEFAULT_NODE, frame_id};
use firmware::system::faults::Event;
use firmware::tasks::FIRST_TICK_US;
use sim::board::{Connections, SimulatedBoard, VirtualTimeBoard};
use sim::closed_loop::emulated_board::EmulatedBoard;

use super::file::{Act, Scenario, Step};

/// From the first sensor transfer to the first tick, less the address bits.
const FIRST_TICK_AFTER_US: u64 = FIRST_TICK_US - 15;

/// Execution of the board's program.
#[allow(clippy::large_enum_variant, dead_code)] // Each test uses one variant.
pub enum Layer {
    /// Tasks in virtual time.
    Loops(Box<VirtualTimeBoard>),
    /// The image in an emulated chip.
    Image(Box<EmulatedBoard>),
}

impl Layer {
    fn board(&mut self) -> &mut dyn SimulatedBoard {
        match self {
            Self::Loops(board) => &mut **board,
            Self::Image(board) => &mut **board,
        }
    }

    fn connections(&self) -> &Connections {
        match self {
            Self::Loops(board) => board.connections(),
            Self::Image(board) => board.connections(),
        }
    }

    /// Runs to the first sensor transfer; returns the time of the first tick.
    fn begin(&mut self) -> u64 {
        let Self::Image(board) = self else {
            return FIRST_TICK_US;
        };
        for step in 1..1000 {
            let time_us = 20 * step;
            board.run_until(time_us).unwrap();
            if board.connections.buses[0].borrow().transfers > 0 {
                return time_us + FIRST_TICK_AFTER_US;
            }
        }
        panic!("the image addresses no sensor within 20 ms");
    }

    /// Leaves a byte in the controller of a sensor bus.
    fn leave_byte(&mut self, bus: usize) {
        const BYTE: u8 = 0x5A;
        match self {
            Self::Loops(board) => board.residues[bus].set(Some(BYTE)),
            Self::Image(board) => assert!(board.chip.soc.leave_received_byte(bus, BYTE)),
        }
    }
}

/// Board, host and observations.
pub struct ScenarioRig {
    layer: Layer,
    /// Time of the first tick.
    origin_us: u64,
    /// The same by the board's clock, from its first tick report.
    board_origin_us: Option<u32>,
    host: Host,
    receiver: PacketDecoder,
    counts: [Option<u32>; 2],
    observed: Observed,
}

/// Reports of the board; times in milliseconds from the first tick.
#[derive(Default)]
pub struct Observed {
    pub faults: Vec<(f64, FaultEvent)>,
    pub ticks: Vec<Tick>,
    /// Time of the first tick by the board's clock.
    pub origin_us: u32,
    pub missed: u32,
    pub dropped: u32,
    pub bus_clearings: usize,
}

/// Host on the CAN bus.
struct Host {
    session: HostSession,
    commands_per_s: u32,
    flood_per_s: u32,
    garbage_per_s: u32,
    /// Number of processed frames of the board.
    looked: usize,
    /// Last command with its authentication, for repetition.
    last: Option<[CanFrame; 2]>,
    noise: u32,
}

impl ScenarioRig {
    pub fn new(mut layer: Layer) -> Self {
        let origin_us = layer.begin();
        Self {
            layer,
            origin_us,
            board_origin_us: None,
            host: Host::new(),
            receiver: PacketDecoder::default(),
            counts: [None; 2],
            observed: Observed::default(),
        }
    }

    /// Runs a scenario to its end.
    pub fn play(mut self, scenario: &Scenario) -> (Observed, Layer) {
        let mut steps: VecDeque<Step> = scenario.step.clone().into();
        steps.make_contiguous().sort_by(|a, b| a.at_ms.total_cmp(&b.at_ms));
        for ms in 0..(1000.0 * scenario.seconds) as u64 {
            while let Some(step) = steps.pop_front_if(|step| step.at_ms < (ms + 1) as f64) {
                self.run_to(step.at_ms);
                self.act(step.act);
            }
            self.run_to((ms + 1) as f64);
            self.host.each_ms(ms, self.layer.connections());
            self.look();
        }
        self.host = Host::new();
        self.count(1000.0 * scenario.seconds);
        (self.observed, self.layer)
    }

    fn run_to(&mut self, ms: f64) {
        let time_us = self.origin_us + (1000.0 * ms) as u64;
        self.layer.board().run_until(time_us).unwrap();
    }

    /// Reads the counters over the serial line, which is independent of CAN faults.
    fn count(&mut self, end_ms: f64) {
        const COUNTERS: [u16; 2] = [counter::TICKS_MISSED, counter::FRAMES_REFUSED];
        for attempt in 0..20 {
            for (id, count) in COUNTERS.into_iter().zip(self.counts) {
                let request = ParamRequest { op: parameter_op::READ, id, status: 0, value: 0 };
                let message = Message::ParamRequest(request);
                let packet = Packet::Message { copy: 0, message };
                if count.is_none() {
                    let mut line = self.layer.connections().line.borrow_mut();
                    // A zero terminates preceding garbage.
                    line.put(0);
                    let mut buffer = [0; MAX_PACKET_BYTES];
                    encode(&packet, &mut buffer).unwrap().iter().for_each(|byte| line.put(*byte));
                }
            }
            self.run_to(end_ms + f64::from(attempt + 1) * 5.0);
            self.look();
            if let [Some(missed), Some(dropped)] = self.counts {
                (self.observed.missed, self.observed.dropped) = (missed, dropped);
                return;
            }
        }
        panic!("the board does not answer on its serial line");
    }

    /// Collects the reports since the last call.
    fn look(&mut self) {
        let bytes = std::mem::take(&mut self.layer.connections().line.borrow_mut().sent);
        for packet in bytes.iter().filter_map(|byte| self.receiver.push(*byte)) {
            match packet {
                Packet::Tick(tick) => {
                    let origin = self.board_origin_us.get_or_insert(tick.time_us);
                    self.observed.origin_us = *origin;
                    self.observed.ticks.push(tick);
                }
                Packet::Message { message: Message::ParamReply(reply), .. } => match reply.id {
                    counter::TICKS_MISSED => self.counts[0] = Some(reply.value),
                    counter::FRAMES_REFUSED => self.counts[1] = Some(reply.value),
                    _ => {}
                },
                Packet::Message { .. } => {}
            }
        }
        // Only bus probes precede the first tick.
        let Some(origin_us) = self.board_origin_us else {
            return;
        };
        for (time_us, event) in self.layer.board().take_events() {
            let ms = time_us as f64 / 1000.0;
            match event {
                Event::Fault(fault) => {
                    self.observed.faults.push((ms - f64::from(origin_us) / 1000.0, fault))
                }
                Event::BusCleared { .. } => self.observed.bus_clearings += 1,
                Event::BusScanned { .. } | Event::InertialSensor { .. } => {}
            }
        }
    }

    fn act(&mut self, act: Act) {
        let connections = self.layer.connections().clone();
        let bus = |number: usize| connections.buses[number].borrow_mut();
        let can = || connections.can.borrow_mut();
        match act {
            Act::Unplug { sensor } => {
                connections.change_sensor(sensor, |sensor| sensor.unplugged = true)
            }
            Act::Plug { sensor } => {
                connections.change_sensor(sensor, |sensor| sensor.unplugged = false)
            }
            Act::Refuse { sensor, transfers } => {
                connections.change_sensor(sensor, |sensor| sensor.refuses = transfers);
            }
            Act::Freeze { sensor } => {
                connections.change_sensor(sensor, |sensor| sensor.frozen = true)
            }
            Act::Thaw { sensor } => {
                connections.change_sensor(sensor, |sensor| sensor.frozen = false)
            }
            Act::Gain { sensor, factor } => {
                connections.change_sensor(sensor, |sensor| sensor.gain = factor)
            }
            Act::Stretch { sensor, us } => connections.change_sensor(sensor, |sensor| {
                sensor.stretches = Some(emulator::Time::from_us(us));
            }),
            Act::Slip { sensor, clocks } => {
                connections.change_sensor(sensor, |sensor| sensor.slips = Some(clocks));
            }
            Act::Short { bus: n } => bus(n).data_low_clocks = u32::MAX,
            Act::Open { bus: n } => bus(n).data_low_clocks = 0,
            Act::Residue { bus } => self.layer.leave_byte(bus),
            Act::DisturbCan => can().disturbed = true,
            Act::CalmCan => can().disturbed = false,
            Act::LeaveAlone => can().no_acknowledge = true,
            Act::Join => can().no_acknowledge = false,
            Act::Flood { frames_per_s } => self.host.flood_per_s = frames_per_s,
            Act::Garbage { bytes_per_s } => self.host.garbage_per_s = bytes_per_s,
            Act::Arm => self.host.arm(&connections),
            Act::Command { per_s } => self.host.commands_per_s = per_s,
            Act::Spoil { frames } => self.host.repeat(frames, true, &connections),
            Act::Repeat { frames } => self.host.repeat(frames, false, &connections),
        }
    }
}

impl Host {
    fn new() -> Self {
        Self {
            session: HostSession::new(DEFAULT_NODE, Key::NONE),
            commands_per_s: 0,
            flood_per_s: 0,
            garbage_per_s: 0,
            looked: 0,
            last: None,
            noise: 0,
        }
    }

    fn arm(&mut self, board: &Connections) {
        for message in self.session.open(op::ARM) {
            send(message, board);
        }
    }

    /// Advances the host by a millisecond.
    fn each_ms(&mut self, ms: u64, board: &Connections) {
        self.listen(board);
        let due = |per_s: u32| per_s > 0 && (ms * u64::from(per_s)) % 1000 < u64::from(per_s);
        if due(self.commands_per_s)
            && self.session.is_armed()
            && let Some(sealed) = self.session.seal(Message::Command(Command::default()))
        {
            self.last = Some(sealed.map(|message| send(message, board)));
        }
        board.can.borrow_mut().flood(self.flood_per_s / 1000);
        let mut line = board.line.borrow_mut();
        for _ in 0..self.garbage_per_s / 1000 {
            self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            line.put((self.noise >> 24) as u8);
        }
    }

    /// Answers the board's challenge.
    fn listen(&mut self, board: &Connections) {
        let frames: Vec<CanFrame> = {
            let can = board.can.borrow();
            let new = can.board_frames.iter().skip(self.looked);
            new.map(|(_, frame)| *frame).collect()
        };
        self.looked += frames.len();
        for frame in frames {
            let number = (frame.identifier() & 0x1F) as u8;
            if let Ok(Message::ServiceReply(reply)) = Message::from_frame(number, frame.data()) {
                for response in self.session.receive(&reply) {
                    send(response, board);
                }
            }
        }
    }

    /// Repeats the last command, with a flipped bit if `is_corrupt`.
    fn repeat(&self, frames: u32, is_corrupt: bool, board: &Connections) {
        let [authentication, command] = self.last.expect("no command yet");
        for i in 0..frames {
            let mut bytes: [u8; 8] = command.data().try_into().unwrap();
            // Bits that every command has.
            bytes[1 + (i % 4) as usize] ^= if is_corrupt { 0x10 } else { 0 };
            let mut can = board.can.borrow_mut();
            can.put(authentication);
            can.put(CanFrame::from_bytes(command.identifier(), bytes));
        }
    }
}

fn send(message: Message, board: &Connections) -> CanFrame {
    let id = frame_id(DEFAULT_NODE, message.number());
    let frame = CanFrame::from_bytes(id, message.to_bytes());
    board.can.borrow_mut().put(frame);
    frame
}
