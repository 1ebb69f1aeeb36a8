//! A serial port, RM0440 section 37: frames of eight bits, with and without FIFO, requests for DMA in both directions.

use std::collections::VecDeque;

use stm32_metapac::usart::regs::{Cr1, Isr};

use crate::devices::SerialLine;
use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "USART2":
    CR1 = 0x00, CR2 = 0x04, CR3 = 0x08, BRR = 0x0C, GTPR = 0x10, RTOR = 0x14, RQR = 0x18, ISR = 0x1C, ICR = 0x20,
    RDR = 0x24, TDR = 0x28, PRESC = 0x2C,
}

/// Bits of a frame: start, eight, stop.
const FRAME_BITS: u64 = 10;
/// Depth of both FIFOs.
const DEPTH: usize = 8;
/// Enables in CR1 and flags in ISR of IDLE, RXNE, TC, TXE are the same bits.
const SAME: u32 = 0xF0;
const CLEARABLE: u32 = 0x0012_3B5F;
/// The other end samples right up to this difference of the rates, in percent.
const TOLERANCE: u64 = 3;

/// The peripheral.
#[derive(Clone)]
pub struct Usart {
    cr1: u32,
    cr2: u32,
    cr3: u32,
    brr: u32,
    isr: Isr,
    /// What the program has not read.
    received: VecDeque<u8>,
    /// What waits behind the frame under way.
    waiting: VecDeque<u8>,
    sending: Option<u8>,
    receiving: Option<u8>,
    sent_at: Time,
    received_at: Time,
    /// A frame has ended since the line was last idle.
    was_busy: bool,
    clock: Frequency,
}

impl Usart {
    pub(crate) fn new() -> Self {
        Self {
            cr1: 0,
            cr2: 0,
            cr3: 0,
            brr: 0,
            isr: Isr(0xC0),
            received: VecDeque::new(),
            waiting: VecDeque::new(),
            sending: None,
            receiving: None,
            sent_at: Time::NEVER,
            received_at: Time::NEVER,
            was_busy: false,
            clock: Frequency(0),
        }
    }

    pub(crate) fn set_clock(&mut self, clock: Frequency) {
        self.clock = clock;
    }

    fn cr1(&self) -> Cr1 {
        Cr1(self.cr1)
    }

    /// Bits per second by BRR; 37.5.7.
    fn baud_rate(&self) -> u64 {
        let divisor = match self.cr1().over8().to_bits() {
            0 => u64::from(self.brr),
            _ => u64::from(self.brr & 0xFFF0 | (self.brr & 7) << 1) / 2,
        };
        u64::from(self.clock.0) / divisor.max(1)
    }

    fn frame(&self) -> Time {
        Frequency(self.baud_rate() as u32).cycles(FRAME_BITS)
    }

    /// Bytes that wait in either direction at the most.
    fn depth(&self) -> usize {
        if self.cr1().fifoen() { DEPTH } else { 1 }
    }

    fn receives(&self) -> bool {
        self.cr1().ue() && self.cr1().re()
    }

    /// What happens next: the end of a frame either way, or the beginning of one from the other end.
    pub(crate) fn next_event(&self, line: &dyn SerialLine) -> Time {
        let begins =
            if self.receives() && self.receiving.is_none() && self.received_at == Time::NEVER {
                line.next_byte()
            } else {
                Time::NEVER
            };
        self.sent_at.min(self.received_at).min(begins)
    }

    pub(crate) fn advance(&mut self, line: &mut dyn SerialLine, context: &mut Context) {
        let now = context.now;
        if self.sent_at <= now {
            self.sent_at = Time::NEVER;
            if let Some(byte) = self.sending.take() {
                line.receive(now, byte);
            }
            self.isr.set_tc(self.waiting.is_empty());
            self.send(now);
        }
        if self.received_at <= now {
            self.received_at = Time::NEVER;
            match self.receiving.take() {
                Some(byte) => self.deliver(byte),
                // A whole frame has passed without a start.
                None if std::mem::take(&mut self.was_busy) => self.isr.set_idle(true),
                None => {}
            }
        }
        if self.receives() && self.received_at == Time::NEVER {
            self.receiving = line.transmit(now);
            if self.receiving.is_some() {
                self.check_rate(line, context);
            }
            if self.receiving.is_some() || self.was_busy {
                self.received_at = now + self.frame();
            }
        }
    }

    fn check_rate(&self, line: &dyn SerialLine, context: &mut Context) {
        let (own, other) = (self.baud_rate(), u64::from(line.baud_rate()));
        if own.abs_diff(other) * 100 > TOLERANCE * other {
            context.misconfigured(BRR, "another baud rate than the other end's");
        }
    }

    fn deliver(&mut self, byte: u8) {
        self.was_busy = true;
        if self.received.len() >= self.depth() {
            self.isr.set_ore(true);
            return;
        }
        self.received.push_back(byte);
        self.isr.set_rxne(true);
    }

    /// Moves what waits into the shift register.
    fn send(&mut self, now: Time) {
        if self.sending.is_none()
            && let Some(byte) = self.waiting.pop_front()
        {
            self.sending = Some(byte);
            self.sent_at = now + self.frame();
            self.isr.set_txe(true);
            self.isr.set_tc(false);
        }
    }

    /// Level of the interrupt.
    pub(crate) fn interrupt(&self) -> bool {
        let errors = self.isr.pe() || self.isr.fe() || self.isr.ne() || self.isr.ore();
        self.cr1 & self.isr.0 & SAME != 0
            || bit(self.cr3, 0) && errors
            || bit(self.cr1, 5) && self.isr.ore()
    }

    /// Levels of the DMA requests: receive, transmit.
    pub(crate) fn dma_requests(&self) -> [bool; 2] {
        let transmits = self.cr1().ue() && self.cr1().te();
        [bit(self.cr3, 6) && self.isr.rxne(), bit(self.cr3, 7) && self.isr.txe() && transmits]
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CR1 => self.cr1,
            CR2 => self.cr2,
            CR3 => self.cr3,
            BRR => self.brr,
            ISR => self.isr.0,
            RDR => {
                let byte = self.received.pop_front().unwrap_or(0);
                self.isr.set_rxne(!self.received.is_empty());
                byte.into()
            }
            GTPR | RTOR | RQR | ICR | TDR | PRESC => 0,
            _ => context.unmodelled(offset),
        }
    }

    /// `has_pins`: both lines are connected to pins.
    pub(crate) fn write(&mut self, offset: u32, value: u32, has_pins: bool, context: &mut Context) {
        match offset {
            CR1 => {
                let starts = bit(value, 0) && !self.cr1().ue();
                self.cr1 = value;
                let cr1 = self.cr1();
                if value & 0xD000_1400 != 0 {
                    context.unmodelled_setting(
                        offset,
                        "FIFO interrupts, parity, or other than eight bits",
                    );
                }
                if starts && self.brr < 16 {
                    context.misconfigured(offset, "switched on without a baud rate");
                }
                if starts && !has_pins {
                    context.report(Kind::PinNotConnected, offset, "a line is not at its pin");
                }
                self.isr.set_teack(cr1.ue() && cr1.te());
                self.isr.set_reack(cr1.ue() && cr1.re());
            }
            CR2 => {
                if value != 0 {
                    context.unmodelled_setting(
                        offset,
                        "other stop bits, LIN, a synchronous clock, swapped pins",
                    );
                }
                self.cr2 = value;
            }
            CR3 => {
                if value & !0x00C9 != 0 {
                    context.unmodelled_setting(
                        offset,
                        "hardware flow control, smart card, FIFO thresholds",
                    );
                }
                self.cr3 = value;
            }
            BRR if self.cr1().ue() => {
                context.write_protected(offset, "the baud rate while the port is on")
            }
            BRR => self.brr = value & 0xFFFF,
            RQR if bit(value, 3) => {
                self.received.clear();
                self.isr.set_rxne(false);
            }
            ICR => self.isr.0 &= !(value & CLEARABLE),
            TDR => {
                if !self.isr.txe() {
                    context.report(
                        Kind::Overrun,
                        offset,
                        "a byte is written before there is room for it",
                    );
                    return;
                }
                self.waiting.push_back(value as u8);
                self.isr.set_txe(self.waiting.len() < self.depth());
                self.isr.set_tc(false);
                self.send(context.now);
            }
            GTPR | RTOR | PRESC if value != 0 => {
                context.unmodelled_setting(offset, "a guard time, a time-out, a prescaler")
            }
            RQR | ISR | RDR | GTPR | RTOR | PRESC => {}
            _ => context.unmodelled_write(offset),
        }
    }
}
