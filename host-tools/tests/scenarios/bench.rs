//! A board on which a scenario happens: what is done to it, and what it tells.

use std::collections::VecDeque;

use embedded_can::Frame;
use firmware::events::Event;
use firmware::loops::FIRST_TICK_US;
use firmware::session::{MAGIC, op, sealed, status};
use firmware::wire::can::CanFrame;
use firmware::wire::messages::{Command, FaultEvent, Message, Service};
use firmware::wire::serial::{Packet, Receiver, Tick};
use firmware::wire::{DEFAULT_NODE, identifier};
use host_tools::board::Board;

use super::file::{Act, Scenario, Step};

const COMMAND: u16 = identifier(DEFAULT_NODE, Command::LAYOUT.number);
const SERVICE: u16 = identifier(DEFAULT_NODE, Service::LAYOUT.number);
/// A frame of a flood: the shortest there is, for this node, and no message.
const FLOOD: u16 = identifier(DEFAULT_NODE, 0x1F);
/// Frames of a flood that wait at most.
const QUEUE: usize = 50;

/// The board, the host beside it, and what was seen.
pub struct Bench {
    pub board: Board,
    host: Host,
    receiver: Receiver,
    pub seen: Seen,
}

/// What the board told; times in milliseconds from the first tick.
#[derive(Default)]
pub struct Seen {
    pub faults: Vec<(f64, FaultEvent)>,
    pub ticks: Vec<Tick>,
    pub missed: u32,
    pub dropped: u32,
    pub bus_clearings: usize,
}

/// Somebody at the other end.
#[derive(Default)]
struct Host {
    nonce: Option<u16>,
    echoed: bool,
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
    pub fn new(board: Board) -> Self {
        Self {
            board,
            host: Host::default(),
            receiver: Receiver::default(),
            seen: Seen::default(),
        }
    }

    /// Plays a scenario to its end.
    pub fn play(mut self, scenario: &Scenario) -> Seen {
        let mut steps: VecDeque<Step> = scenario.step.clone().into();
        let mut steps_sorted = steps.make_contiguous().to_vec();
        steps_sorted.sort_by(|a, b| a.at_ms.total_cmp(&b.at_ms));
        steps = steps_sorted.into();
        for ms in 0..(1000.0 * scenario.seconds) as u64 {
            while let Some(step) = steps.pop_front_if(|step| step.at_ms < (ms + 1) as f64) {
                self.run_to(step.at_ms);
                self.act(step.act);
            }
            self.run_to((ms + 1) as f64);
            self.host.each_ms(ms, &self.board);
            self.look();
        }
        let counts = &self.board.exchange.counts;
        let load =
            |count: &std::sync::atomic::AtomicU32| count.load(std::sync::atomic::Ordering::Relaxed);
        self.seen.missed = load(&counts.ticks_missed);
        self.seen.dropped = load(&counts.dropped);
        self.seen
    }

    fn run_to(&mut self, ms: f64) {
        self.board.run_until(FIRST_TICK_US + (1000.0 * ms) as u64);
    }

    /// Takes up what the board told since the last look.
    fn look(&mut self) {
        for (time_us, event) in self.board.events.borrow_mut().drain(..) {
            let ms = (time_us as f64 - FIRST_TICK_US as f64) / 1000.0;
            match event {
                Event::Fault(fault) => self.seen.faults.push((ms, fault)),
                Event::Cleared { .. } => self.seen.bus_clearings += 1,
                Event::Found { .. } => {}
            }
        }
        let bytes = std::mem::take(&mut self.board.line.borrow_mut().sent);
        let packets = bytes.iter().filter_map(|byte| self.receiver.take(*byte));
        self.seen
            .ticks
            .extend(packets.filter_map(|packet| match packet {
                Packet::Tick(tick) => Some(tick),
                Packet::Message { .. } => None,
            }));
    }

    fn act(&mut self, act: Act) {
        let sensor = |number: usize, change: &dyn Fn(&mut host_tools::board::i2c::Sensor)| {
            for bus in &self.board.buses {
                let sensors = &mut bus.borrow_mut().sensors;
                sensors
                    .iter_mut()
                    .filter(|sensor| sensor.number == number)
                    .for_each(change);
            }
        };
        let bus = |number: usize| self.board.buses[number].borrow_mut();
        let can = || self.board.can.borrow_mut();
        match act {
            Act::Unplug { sensor: n } => sensor(n, &|sensor| sensor.unplugged = true),
            Act::Plug { sensor: n } => sensor(n, &|sensor| sensor.unplugged = false),
            Act::Refuse {
                sensor: n,
                transfers,
            } => sensor(n, &|sensor| sensor.refuses = transfers),
            Act::Freeze { sensor: n } => sensor(n, &|sensor| sensor.frozen = true),
            Act::Thaw { sensor: n } => sensor(n, &|sensor| sensor.frozen = false),
            Act::Gain { sensor: n, factor } => sensor(n, &|sensor| sensor.gain = factor),
            Act::Slip { sensor: n, clocks } => sensor(n, &|sensor| sensor.slips = Some(clocks)),
            Act::Short { bus: n } => bus(n).held = u32::MAX,
            Act::Open { bus: n } => bus(n).held = 0,
            Act::DisturbCan => can().disturbed = true,
            Act::CalmCan => can().disturbed = false,
            Act::LeaveAlone => can().alone = true,
            Act::Join => can().alone = false,
            Act::Flood { frames_per_s } => self.host.flood_per_s = frames_per_s,
            Act::Garbage { bytes_per_s } => self.host.garbage_per_s = bytes_per_s,
            Act::Arm => self.host.ask(&self.board),
            Act::Command { per_s } => self.host.commands_per_s = per_s,
            Act::Spoil { frames } => self.host.spoil(frames, &self.board),
            Act::Repeat { frames } => self.host.repeat(frames, &self.board),
        }
    }
}

impl Host {
    fn ask(&mut self, board: &Board) {
        self.nonce = None;
        self.echoed = false;
        self.service(0, board);
    }

    fn service(&self, nonce: u16, board: &Board) {
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
    fn each_ms(&mut self, ms: u64, board: &Board) {
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
    fn listen(&mut self, board: &Board) {
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
    fn spoil(&mut self, frames: u32, board: &Board) {
        for i in 0..frames {
            let command = sealed(self.nonce.unwrap_or(0), COMMAND, Command::default());
            let mut bytes = command.to_bytes();
            bytes[(i % 6) as usize] ^= 0x10;
            board.can.borrow_mut().put(CanFrame::of(COMMAND, bytes));
        }
    }

    /// The last command once more.
    fn repeat(&mut self, frames: u32, board: &Board) {
        for _ in 0..frames {
            board
                .can
                .borrow_mut()
                .put(self.last.expect("no command yet"));
        }
    }
}
