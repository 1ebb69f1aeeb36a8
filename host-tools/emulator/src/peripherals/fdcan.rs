//! A CAN controller, RM0440 section 44: message RAM, acceptance filters, three transmit buffers, error counters,
//! bus-off. Classic frames only.

use stm32_metapac::can::regs::{Cccr, Nbtp, Rxgfc};

use crate::devices::{CanBus, CanEvent, CanFrame, Transmission};
use crate::peripherals::{Context, Words, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "FDCAN1":
    CREL = 0x00, ENDN = 0x04, DBTP = 0x0C, TEST = 0x10, RWD = 0x14, CCCR = 0x18, NBTP = 0x1C, TSCC = 0x20, TSCV = 0x24,
    TOCC = 0x28, TOCV = 0x2C, ECR = 0x40, PSR = 0x44, TDCR = 0x48, IR = 0x50, IE = 0x54, ILS = 0x58, ILE = 0x5C,
    RXGFC = 0x80, XIDAM = 0x84, HPMS = 0x88, RXFS0 = 0x90, RXFA0 = 0x94, RXFS1 = 0x98, RXFA1 = 0x9C, TXBC = 0xC0,
    TXFQS = 0xC4, TXBRP = 0xC8, TXBAR = 0xCC, TXBCR = 0xD0, TXBTO = 0xD4, TXBCF = 0xD8, TXBTIE = 0xDC, TXBCIE = 0xE0,
    TXEFS = 0xE4, TXEFA = 0xE8, CKDIV = 0x100,
}

/// Message RAM of one controller in words (44.3.3), and where its parts begin.
pub(crate) const RAM_WORDS: usize = 0x350 / 4;
const STANDARD_FILTERS: usize = 0;
const EXTENDED_FILTERS: usize = 0x70 / 4;
const RECEIVE: [usize; 2] = [0xB0 / 4, 0x188 / 4];
const TRANSMIT: usize = 0x278 / 4;
const ELEMENT: usize = 18;
/// Elements of a receive FIFO, and transmit buffers.
const DEPTH: usize = 3;
/// Extended identifier and remote frame in the first word of an element.
const XTD: u32 = 1 << 30;
const RTR: u32 = 1 << 29;

/// Flags of IR: a new message in FIFO 0, one lost there; those of FIFO 1 are three bits up. Transmission complete,
/// cancellation finished, error passive, warning, bus-off.
const NEW_MESSAGE: u32 = 1;
const FULL: u32 = 1 << 1;
const LOST: u32 = 1 << 2;
const TRANSMITTED: u32 = 1 << 7;
const CANCELLED: u32 = 1 << 8;
const ERROR_PASSIVE: u32 = 1 << 17;
const WARNING: u32 = 1 << 18;
const BUS_OFF: u32 = 1 << 19;
/// Groups of interrupts that ILS routes to line 1 (44.4.20): bits of IR of each.
const GROUPS: [u32; 7] = [0x7, 0x38, 0x1C0, 0x1E00, 0xE000, 0x3_0000, 0xFC_0000];

/// Thresholds of the error counters (ISO 11898-1, 12.1.4), and what an error adds to the transmitter's.
const WARNING_AT: u32 = 96;
const PASSIVE_AT: u32 = 128;
const OFF_AT: u32 = 256;
const ERROR: u32 = 8;
/// A controller joins the bus again after 128 times eleven recessive bits.
const RECOVERY_BITS: u64 = 128 * 11;

/// A receive FIFO's indices.
#[derive(Clone, Copy, Debug, Default)]
struct Fifo {
    fill: usize,
    get: usize,
    put: usize,
    has_lost: bool,
}

/// The peripheral.
#[derive(Clone)]
pub struct Fdcan {
    cccr: Cccr,
    nbtp: u32,
    rxgfc: u32,
    plain: Words<{ 0x104 / 4 }>,
    ram: Vec<u32>,
    fifos: [Fifo; 2],
    /// Buffers that wait to be sent, in the order of their requests.
    pending: Vec<usize>,
    /// The buffer whose frame the bus was offered last.
    offered: Option<usize>,
    cancels: u32,
    /// Last error: 0 none, 3 acknowledgement, 5 bit 0; 7 since it was read.
    last_error: u32,
    errors: u32,
    is_off: bool,
    recovers: Time,
    clock: Frequency,
    /// Frames for which a FIFO had no place.
    pub lost: u64,
    /// Frames of other nodes that no filter let in.
    pub refused: u64,
}

impl Fdcan {
    pub(crate) fn new() -> Self {
        let mut cccr = Cccr(0);
        cccr.set_init(true);
        Self {
            cccr,
            nbtp: 0x0600_0A03,
            rxgfc: 0,
            plain: Words::new(&[
                (CREL, 0x3214_1218),
                (ENDN, 0x8765_4321),
                (DBTP, 0xA33),
                (TOCC, 0xFFFF_0000),
                (TOCV, 0xFFFF),
                (XIDAM, 0x1FFF_FFFF),
            ]),
            ram: vec![0; RAM_WORDS],
            fifos: [Fifo::default(); 2],
            pending: Vec::new(),
            offered: None,
            cancels: 0,
            last_error: 7,
            errors: 0,
            is_off: false,
            recovers: Time::NEVER,
            clock: Frequency(0),
            lost: 0,
            refused: 0,
        }
    }

    /// Registers take their reset values; message RAM keeps its contents (44.3.3), counts go on.
    pub(crate) fn reset(&mut self) {
        let ram = std::mem::take(&mut self.ram);
        *self =
            Self { ram, clock: self.clock, lost: self.lost, refused: self.refused, ..Self::new() };
    }

    pub(crate) fn set_clock(&mut self, clock: Frequency) {
        self.clock = clock;
    }

    /// Whether the controller takes part in the bus.
    fn is_on(&self) -> bool {
        !self.cccr.init() && !self.is_off && self.recovers == Time::NEVER
    }

    /// Whether it has left the bus after too many errors.
    pub fn is_off(&self) -> bool {
        self.is_off
    }

    /// Length of a bit by NBTP.
    pub(crate) fn bit_time(&self) -> Time {
        let timing = Nbtp(self.nbtp);
        let quanta = u64::from(timing.ntseg1()) + u64::from(timing.ntseg2()) + 3;
        self.clock.cycles(quanta * (u64::from(timing.nbrp()) + 1))
    }

    pub(crate) fn next_event(&self, bus: &dyn CanBus) -> Time {
        self.recovers.min(bus.next_event())
    }

    pub(crate) fn advance(&mut self, bus: &mut dyn CanBus, context: &mut Context) {
        let now = context.now;
        if self.recovers <= now {
            self.recovers = Time::NEVER;
            (self.errors, self.is_off) = (0, false);
            self.raise(BUS_OFF);
        }
        while let Some(event) = bus.take_event(now) {
            match event {
                CanEvent::Sent(frame, outcome) => self.sent(&frame, outcome),
                CanEvent::Received(frame) => self.receive(&frame, context),
            }
        }
        self.offer(bus, now);
    }

    /// Gives the bus the frame that would go next.
    pub(crate) fn offer(&mut self, bus: &mut dyn CanBus, now: Time) {
        let is_queue = bit(self.plain[TXBC], 24);
        let next = if is_queue {
            self.pending.iter().copied().min_by_key(|buffer| self.frame(*buffer).priority())
        } else {
            self.pending.first().copied()
        };
        self.offered = next.filter(|_| self.is_on());
        bus.offer(now, self.offered.map(|buffer| self.frame(buffer)));
    }

    fn frame(&self, buffer: usize) -> CanFrame {
        let at = TRANSMIT + ELEMENT * buffer;
        let is_extended = self.ram[at] & XTD != 0;
        let id = if is_extended { self.ram[at] & 0x1FFF_FFFF } else { self.ram[at] >> 18 & 0x7FF };
        let length = (self.ram[at + 1] >> 16 & 0xF).min(8) as u8;
        let mut data = [0; 8];
        for (place, byte) in data.iter_mut().enumerate().take(length.into()) {
            *byte = (self.ram[at + 2 + place / 4] >> (8 * (place % 4))) as u8;
        }
        CanFrame { id, is_extended, is_remote: self.ram[at] & RTR != 0, length, data }
    }

    /// A frame of this controller has ended on the bus.
    fn sent(&mut self, frame: &CanFrame, outcome: Transmission) {
        let Some(buffer) =
            self.pending.iter().copied().find(|buffer| self.frame(*buffer) == *frame)
        else {
            return;
        };
        let (was_warned, was_passive) = (self.errors >= WARNING_AT, self.errors >= PASSIVE_AT);
        match outcome {
            Transmission::Acknowledged => {
                self.end(buffer, TXBTO);
                self.errors = self.errors.saturating_sub(1);
                self.last_error = 0;
                if bit(self.plain[TXBTIE], buffer as u32) {
                    self.raise(TRANSMITTED);
                }
            }
            Transmission::NotAcknowledged => {
                // Passive, a transmitter alone on the bus counts no further.
                self.errors += if was_passive { 0 } else { ERROR };
                self.last_error = 3;
            }
            Transmission::BitError => {
                self.errors += ERROR;
                self.last_error = 5;
            }
        }
        if outcome != Transmission::Acknowledged
            && (self.cccr.dar() || bit(self.cancels, buffer as u32))
        {
            self.end(buffer, TXBCF);
        }
        if was_warned != (self.errors >= WARNING_AT) {
            self.raise(WARNING);
        }
        if was_passive != (self.errors >= PASSIVE_AT) {
            self.raise(ERROR_PASSIVE);
        }
        if self.errors >= OFF_AT {
            self.leave();
        }
    }

    /// A buffer is free again; a cancellation that came too late is finished as well.
    fn end(&mut self, buffer: usize, flag: u32) {
        self.pending.retain(|pending| *pending != buffer);
        self.plain[flag] |= 1 << buffer;
        if bit(self.cancels, buffer as u32) {
            self.cancels &= !(1 << buffer);
            self.plain[TXBCF] |= 1 << buffer;
            if bit(self.plain[TXBCIE], buffer as u32) {
                self.raise(CANCELLED);
            }
        }
    }

    /// Off the bus, until the program clears INIT and the recovery has passed (44.3.2).
    fn leave(&mut self) {
        (self.is_off, self.errors) = (true, OFF_AT - 1);
        self.cccr.set_init(true);
        self.raise(BUS_OFF);
    }

    fn raise(&mut self, flags: u32) {
        self.plain[IR] |= flags;
    }

    /// The FIFO that a filter sends a frame to; 44.3.3 and 44.4.30.
    fn filter(&self, frame: &CanFrame, context: &mut Context) -> Option<usize> {
        let global = Rxgfc(self.rxgfc);
        if frame.is_remote && bit(global.0, u32::from(!frame.is_extended)) {
            return None;
        }
        let matched = if frame.is_extended {
            (0..usize::from(global.lse()))
                .map(|place| &self.ram[EXTENDED_FILTERS + 2 * place..][..2])
                .find_map(|filter| {
                    let (first, second) = (filter[0] & 0x1FFF_FFFF, filter[1] & 0x1FFF_FFFF);
                    let matches = match filter[1] >> 30 {
                        0 | 3 => (first..=second).contains(&frame.id),
                        1 => frame.id == first || frame.id == second,
                        _ => frame.id & second == first & second,
                    };
                    let action = filter[0] >> 29;
                    (matches && action != 0).then_some(action)
                })
        } else {
            (0..usize::from(global.lss())).map(|place| self.ram[STANDARD_FILTERS + place]).find_map(
                |filter| {
                    let (first, second) = (filter >> 16 & 0x7FF, filter & 0x7FF);
                    let matches = match filter >> 30 {
                        0 => (first..=second).contains(&frame.id),
                        1 => frame.id == first || frame.id == second,
                        2 => frame.id & second == first & second,
                        _ => false,
                    };
                    let action = filter >> 27 & 7;
                    (matches && action != 0).then_some(action)
                },
            )
        };
        match matched {
            Some(1) => Some(0),
            Some(2) => Some(1),
            Some(3) => None,
            Some(_) => {
                context.unmodelled_setting(RXGFC, "a filter that sets a priority");
                None
            }
            None => {
                let rest = if frame.is_extended {
                    global.anfe().to_bits()
                } else {
                    global.anfs().to_bits()
                };
                [0, 1].into_iter().find(|fifo| *fifo == usize::from(rest))
            }
        }
    }

    fn receive(&mut self, frame: &CanFrame, context: &mut Context) {
        if !self.is_on() {
            return;
        }
        let Some(fifo) = self.filter(frame, context) else {
            self.refused += 1;
            return;
        };
        let shift = 3 * fifo as u32;
        if self.fifos[fifo].fill >= DEPTH {
            self.lost += 1;
            self.fifos[fifo].has_lost = true;
            self.raise(LOST << shift);
            return;
        }
        let at = RECEIVE[fifo] + ELEMENT * self.fifos[fifo].put;
        let id = if frame.is_extended { frame.id | XTD } else { frame.id << 18 };
        self.ram[at] = id | if frame.is_remote { RTR } else { 0 };
        self.ram[at + 1] = u32::from(frame.length) << 16 | self.timestamp(context.now);
        for (place, word) in frame.data.chunks(4).enumerate() {
            self.ram[at + 2 + place] =
                word.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
        }
        let state = &mut self.fifos[fifo];
        state.put = (state.put + 1) % DEPTH;
        state.fill += 1;
        let is_full = state.fill == DEPTH;
        self.raise((NEW_MESSAGE | if is_full { FULL } else { 0 }) << shift);
    }

    fn timestamp(&self, now: Time) -> u32 {
        (now.ps() / self.bit_time().ps().max(1)) as u32 & 0xFFFF
    }

    /// Levels of the two interrupt lines.
    pub(crate) fn interrupts(&self) -> [bool; 2] {
        let active = self.plain[IR] & self.plain[IE];
        let (routes, lines) = (self.plain[ILS], self.plain[ILE]);
        let of_line = |line: u32| {
            let groups = GROUPS.iter().enumerate().filter(|(group, _)| routes >> group & 1 == line);
            let bits = groups.fold(0, |all, (_, bits)| all | bits);
            bit(lines, line) && active & bits != 0
        };
        [of_line(0), of_line(1)]
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CCCR => self.cccr.0,
            NBTP => self.nbtp,
            RXGFC => self.rxgfc,
            TSCV => self.timestamp(context.now),
            ECR => self.errors.min(255),
            PSR => {
                let state = u32::from(self.errors >= PASSIVE_AT) << 5
                    | u32::from(self.errors >= WARNING_AT) << 6
                    | u32::from(self.is_off) << 7;
                // Activity: idle. The last error reads 7 until there is another.
                0x708 | state | std::mem::replace(&mut self.last_error, 7)
            }
            RXFS0 | RXFS1 => {
                let fifo = &self.fifos[usize::from(offset == RXFS1)];
                let is_full = fifo.fill == DEPTH;
                fifo.fill as u32
                    | (fifo.get as u32) << 8
                    | (fifo.put as u32) << 16
                    | u32::from(is_full) << 24
                    | u32::from(fifo.has_lost) << 25
            }
            TXFQS => {
                let free = (0..DEPTH).find(|buffer| !self.pending.contains(buffer));
                let put = free.unwrap_or(0) as u32;
                (DEPTH - self.pending.len()) as u32 | put << 16 | u32::from(free.is_none()) << 21
            }
            TXBRP => self.pending.iter().fold(0, |all, buffer| all | 1 << buffer),
            TXBAR | TXBCR | RXFA0 | RXFA1 => 0,
            CREL | ENDN | DBTP | TEST | RWD | TSCC | TOCC | TOCV | TDCR | IR | IE | ILS | ILE
            | XIDAM | HPMS | TXBC | TXBTO | TXBCF | TXBTIE | TXBCIE | TXEFS | TXEFA | CKDIV => {
                self.plain[offset]
            }
            _ => context.unmodelled(offset),
        }
    }

    /// `has_pins`: connected to a transceiver. `is_sending`: the bus carries the frame that it was offered last.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        [has_pins, is_sending]: [bool; 2],
        context: &mut Context,
    ) {
        let is_open = self.cccr.init() && self.cccr.cce();
        match offset {
            CCCR => self.write_cccr(value, has_pins, context),
            NBTP | RXGFC | DBTP | TXBC | XIDAM | TDCR | TSCC | CKDIV if !is_open => {
                context.write_protected(offset, "the configuration while the controller is on")
            }
            NBTP => self.nbtp = value,
            RXGFC => self.rxgfc = value,
            IR => self.plain[IR] &= !value,
            TXBAR => {
                for buffer in (0..DEPTH).filter(|buffer| bit(value, *buffer as u32)) {
                    if self.pending.contains(&buffer) {
                        context.report(Kind::Overrun, offset, "a buffer whose frame has not gone");
                    } else {
                        self.check_element(buffer, context);
                        self.pending.push(buffer);
                    }
                    self.plain[TXBTO] &= !(1 << buffer);
                    self.plain[TXBCF] &= !(1 << buffer);
                }
            }
            TXBCR => {
                for buffer in (0..DEPTH).filter(|buffer| bit(value, *buffer as u32)) {
                    // What the bus carries already ends first.
                    if is_sending && self.offered == Some(buffer) && self.is_on() {
                        self.cancels |= 1 << buffer
                    } else {
                        self.cancels |= 1 << buffer;
                        self.end(buffer, TXBCF);
                    }
                }
            }
            RXFA0 | RXFA1 => {
                let fifo = &mut self.fifos[usize::from(offset == RXFA1)];
                // What is acknowledged frees itself and all before it.
                let freed = ((value & 7) as usize + DEPTH - fifo.get) % DEPTH + 1;
                if freed <= fifo.fill {
                    fifo.fill -= freed;
                    fifo.get = (fifo.get + freed) % DEPTH;
                    fifo.has_lost = false;
                }
            }
            TEST if value & 0x10 != 0 => context.unmodelled_setting(offset, "loop back"),
            IE | ILS | ILE | DBTP | TXBC | XIDAM | TDCR | TSCC | CKDIV | TXBTIE | TXBCIE | TOCC
            | TEST | RWD => {
                self.plain[offset] = value;
            }
            PSR | ECR | TSCV | TOCV | TXEFA => {}
            _ => context.unmodelled_write(offset),
        }
    }

    fn check_element(&self, buffer: usize, context: &mut Context) {
        if self.ram[TRANSMIT + ELEMENT * buffer + 1] & 0x0030_0000 != 0 {
            context.unmodelled_setting(TXBAR, "an FD frame or a switch of the bit rate");
        }
    }

    fn write_cccr(&mut self, value: u32, has_pins: bool, context: &mut Context) {
        let was_init = self.cccr.init();
        let mut next = Cccr(value);
        // Configuration change needs INIT; leaving INIT ends it.
        if !next.init() || !was_init {
            next.set_cce(false);
        }
        next.set_csa(next.csr());
        if next.fdoe() || next.mon() || next.asm() || next.test() {
            context.unmodelled_setting(CCCR, "FD frames, or a test, monitoring or restricted mode");
        }
        self.cccr = next;
        if next.cce() && !was_init {
            context.write_protected(CCCR, "CCE without INIT");
        }
        if was_init && !next.init() {
            if !has_pins {
                context.report(Kind::PinNotConnected, CCCR, "a line is not at its pin");
            }
            if self.is_off {
                self.recovers = context.now + Time::from_ps(self.bit_time().ps() * RECOVERY_BITS);
            }
        }
    }

    /// Message RAM by bytes from its beginning.
    pub(crate) fn read_ram(&self, offset: u32) -> Option<u32> {
        self.ram.get(offset as usize / 4).copied()
    }

    /// A word of message RAM; it takes whole words only (44.3.3).
    pub(crate) fn write_ram(&mut self, offset: u32, value: u32, bytes: u32, context: &mut Context) {
        if bytes != 4 {
            context.misconfigured(offset, "message RAM takes whole words only");
        }
        match self.ram.get_mut(offset as usize / 4) {
            Some(word) => *word = value,
            None => context.unmodelled_write(offset),
        }
    }

    /// Bits of a different length than the other nodes' end in errors; checked as the controller joins the bus.
    pub(crate) fn check_timing(&self, bus: &dyn CanBus, context: &mut Context) {
        let (own, other) = (self.bit_time().ps(), bus.bit_time().ps());
        if self.is_on() && own.abs_diff(other) * 200 > other {
            context.misconfigured(NBTP, "another bit rate than the bus's");
        }
    }
}
