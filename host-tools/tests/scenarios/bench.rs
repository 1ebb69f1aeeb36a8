//! A board on which a scenario happens, whichever way its program runs: what is done to it, and what it reports.

use std::collections::VecDeque;

use embedded_can::Frame;
use firmware::events::Event;
use firmware::loops::FIRST_TICK_US;
use firmware::parameters::op as parameter_op;
use firmware::parameters::table::counter;
use firmware::session::{MAGIC, op, sealed, status};
use firmware::wire::can::CanFrame;
use firmware::wire::messages::{Command, FaultEvent, Message, ParamRequest, Service};
use firmware::wire::serial::{LONGEST, Packet, Receiver, Tick, encode};
use firmware::wire::{DEFAULT_NODE, identifier};
use host_tools::board::emulated::EmulatedBoard;
use host_tools::board::{Board, Connections, SimulatedBoard};

use super::file::{Act, Scenario, Step};

const COMMAND: u16 = identifier(DEFAULT_NODE, Command::LAYOUT.number);
const SERVICE: u16 = identifier(DEFAULT_NODE, Service::LAYOUT.number);
/// A frame of a flood: the shortest there is, for this node, and no message.
const FLOOD: u16 = identifier(DEFAULT_NODE, 0x1F);
/// Frames of a flood that wait at most.
const QUEUE: usize = 50;
/// From the first transfer on a sensor bus to the first tick, less the address that had passed by then.
const FIRST_TICK_AFTER_US: u64 = FIRST_TICK_US - 15;

/// How the board's program runs.
#[allow(clippy::large_enum_variant, dead_code)] // One of a test; each test has one of them.
pub enum Layer {
    /// The firmware's loops in virtual time.
    Loops(Box<Board>),
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

    /// Runs to where the sensors are first addressed; when the first tick begins then.
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

/// The board, the host next to it, and what was seen.
pub struct Bench {
    layer: Layer,
    /// When the first tick begins.
    origin_us: u64,
    /// The same by the board's clock, from the first tick that it reports.
    board_origin_us: Option<u32>,
    host: Host,
    receiver: Receiver,
    counts: [Option<u32>; 2],
    seen: Seen,
}

/// What the board reported; times in milliseconds from the first tick.
#[derive(Default)]
pub struct Seen {
    pub faults: Vec<(f64, FaultEvent)>,
    pub ticks: Vec<Tick>,
    /// Time of the first tick by the board's clock.
    pub origin_us: u32,
    pub missed: u32,
    pub dropped: u32,
    pub bus_clearings: usize,
}

/// The host.
#[derive(Default)]
struct Host {
    nonce: Option<u16>,
    commands_per_s: u32,
    counter: u8,
    flood_per_s: u32,
    garbage_per_s: u32,
    /// Frames of the board that were looked at.
    looked: usize,
    /// The last command, for one who repeats it.
    last: Option<CanFrame>,
    noise: u32,
}

impl Bench {
    pub fn new(mut layer: Layer) -> Self {
        let origin_us = layer.begin();
        Self {
            layer,
            origin_us,
            board_origin_us: None,
            host: Host::default(),
            receiver: Receiver::default(),
            counts: [None; 2],
            seen: Seen::default(),
        }
    }

    /// Plays a scenario to its end.
    pub fn play(mut self, scenario: &Scenario) -> (Seen, Layer) {
        let mut steps: VecDeque<Step> = scenario.step.clone().into();
        steps
            .make_contiguous()
            .sort_by(|a, b| a.at_ms.total_cmp(&b.at_ms));
        for ms in 0..(1000.0 * scenario.seconds) as u64 {
            while let Some(step) = steps.pop_front_if(|step| step.at_ms < (ms + 1) as f64) {
                self.run_to(step.at_ms);
                self.act(step.act);
            }
            self.run_to((ms + 1) as f64);
            self.host.each_ms(ms, self.layer.connections());
            self.look();
        }
        self.host = Host::default();
        self.count(1000.0 * scenario.seconds);
        (self.seen, self.layer)
    }

    fn run_to(&mut self, ms: f64) {
        let time_us = self.origin_us + (1000.0 * ms) as u64;
        self.layer.board().run_until(time_us).unwrap();
    }

    /// Asks for the counters over the serial line, which what goes wrong on the CAN bus does not touch.
    fn count(&mut self, end_ms: f64) {
        const COUNTERS: [u16; 2] = [counter::TICKS_MISSED, counter::FRAMES_REFUSED];
        for attempt in 0..20 {
            for (id, count) in COUNTERS.into_iter().zip(self.counts) {
                let request = ParamRequest {
                    op: parameter_op::READ,
                    id,
                    status: 0,
                    value: 0,
                };
                let message = Message::ParamRequest(request);
                let packet = Packet::Message { copy: 0, message };
                if count.is_none() {
                    let mut line = self.layer.connections().line.borrow_mut();
                    // What was garbage before it ends with a zero.
                    line.put(0);
                    let mut buffer = [0; LONGEST];
                    encode(&packet, &mut buffer)
                        .unwrap()
                        .iter()
                        .for_each(|byte| line.put(*byte));
                }
            }
            self.run_to(end_ms + f64::from(attempt + 1) * 5.0);
            self.look();
            if let [Some(missed), Some(dropped)] = self.counts {
                (self.seen.missed, self.seen.dropped) = (missed, dropped);
                return;
            }
        }
        panic!("the board does not answer on its serial line");
    }

    /// Takes up what the board reported since the last look.
    fn look(&mut self) {
        let bytes = std::mem::take(&mut self.layer.connections().line.borrow_mut().sent);
        for packet in bytes.iter().filter_map(|byte| self.receiver.take(*byte)) {
            match packet {
                Packet::Tick(tick) => {
                    let origin = self.board_origin_us.get_or_insert(tick.time_us);
                    self.seen.origin_us = *origin;
                    self.seen.ticks.push(tick);
                }
                Packet::Message {
                    message: Message::ParamReply(reply),
                    ..
                } => match reply.id {
                    counter::TICKS_MISSED => self.counts[0] = Some(reply.value),
                    counter::FRAMES_REFUSED => self.counts[1] = Some(reply.value),
                    _ => {}
                },
                Packet::Message { .. } => {}
            }
        }
        // Before the first tick only buses are probed.
        let Some(origin_us) = self.board_origin_us else {
            return;
        };
        for (time_us, event) in self.layer.board().take_events() {
            let ms = time_us as f64 / 1000.0;
            match event {
                Event::Fault(fault) => self
                    .seen
                    .faults
                    .push((ms - f64::from(origin_us) / 1000.0, fault)),
                Event::Cleared { .. } => self.seen.bus_clearings += 1,
                Event::Found { .. } => {}
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
                sensor.stretches = Some(sim_board::Time::from_us(us));
            }),
            Act::Slip { sensor, clocks } => {
                connections.change_sensor(sensor, |sensor| sensor.slips = Some(clocks));
            }
            Act::Short { bus: n } => bus(n).held = u32::MAX,
            Act::Open { bus: n } => bus(n).held = 0,
            Act::Residue { bus } => self.layer.leave_byte(bus),
            Act::DisturbCan => can().disturbed = true,
            Act::CalmCan => can().disturbed = false,
            Act::LeaveAlone => can().alone = true,
            Act::Join => can().alone = false,
            Act::Flood { frames_per_s } => self.host.flood_per_s = frames_per_s,
            Act::Garbage { bytes_per_s } => self.host.garbage_per_s = bytes_per_s,
            Act::Arm => self.host.ask(&connections),
            Act::Command { per_s } => self.host.commands_per_s = per_s,
            Act::Spoil { frames } => self.host.spoil(frames, &connections),
            Act::Repeat { frames } => self.host.repeat(frames, &connections),
        }
    }
}

impl Host {
    fn ask(&mut self, board: &Connections) {
        self.nonce = None;
        self.service(0, board);
    }

    fn service(&self, nonce: u16, board: &Connections) {
        let service = Service {
            op: op::ARM,
            magic: MAGIC,
            nonce,
            argument: 0,
        };
        board
            .can
            .borrow_mut()
            .put(CanFrame::of(SERVICE, service.to_bytes()));
    }

    /// What the host does in a millisecond.
    fn each_ms(&mut self, ms: u64, board: &Connections) {
        self.listen(board);
        let due = |per_s: u32| per_s > 0 && (ms * u64::from(per_s)) % 1000 < u64::from(per_s);
        if let Some(nonce) = self.nonce
            && due(self.commands_per_s)
        {
            self.counter = (self.counter + 1) & 0xF;
            let command = Command {
                counter: self.counter,
                ..Command::default()
            };
            let frame = CanFrame::of(COMMAND, sealed(nonce, COMMAND, command).to_bytes());
            self.last = Some(frame);
            board.can.borrow_mut().put(frame);
        }
        let mut can = board.can.borrow_mut();
        let id = embedded_can::StandardId::new(FLOOD).unwrap();
        for _ in 0..self.flood_per_s / 1000 {
            if can.waiting() < QUEUE {
                can.put(CanFrame::new(id, &[]).unwrap());
            }
        }
        let mut line = board.line.borrow_mut();
        for _ in 0..self.garbage_per_s / 1000 {
            self.noise = self
                .noise
                .wrapping_mul(1_664_525)
                .wrapping_add(1_013_904_223);
            line.put((self.noise >> 24) as u8);
        }
    }

    /// Answers the board's nonce.
    fn listen(&mut self, board: &Connections) {
        let mut found = None;
        {
            let can = board.can.borrow();
            for (_, frame) in can.heard.iter().skip(self.looked) {
                let number = (frame.identifier() & 0x1F) as u8;
                if let Ok(Message::ServiceReply(reply)) = Message::from_frame(number, frame.data())
                    && reply.status == status::SAY_BACK
                {
                    found = Some(reply.nonce);
                }
            }
            self.looked = can.heard.len();
        }
        if let Some(nonce) = found {
            self.service(nonce, board);
            self.nonce = Some(nonce);
        }
    }

    /// Commands with a bit that flipped.
    fn spoil(&mut self, frames: u32, board: &Connections) {
        for i in 0..frames {
            let command = sealed(self.nonce.unwrap_or(0), COMMAND, Command::default());
            let mut bytes = command.to_bytes();
            bytes[(i % 6) as usize] ^= 0x10;
            board.can.borrow_mut().put(CanFrame::of(COMMAND, bytes));
        }
    }

    /// The last command once more.
    fn repeat(&mut self, frames: u32, board: &Connections) {
        for _ in 0..frames {
            let last = self.last.expect("no command yet");
            board.can.borrow_mut().put(last);
        }
    }
}
