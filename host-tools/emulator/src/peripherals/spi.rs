//! SPI as the controller of one device, RM0440 section 39: frames of 8 or 16 bits, FIFOs of 32 bits, DMA requests.

use std::collections::VecDeque;

use stm32_metapac::spi::regs::{Cr1, Cr2};

use crate::devices::SpiDevice;
use crate::peripherals::Context;
use crate::registers::registers;
use crate::time::Time;
use crate::violations::Kind;

registers! { "SPI1":
    CR1 = 0x00, CR2 = 0x04, SR = 0x08, DR16 = 0x0C, CRCPR = 0x10, RXCRCR = 0x14, TXCRCR = 0x18, I2SCFGR = 0x1C, I2SPR = 0x20,
}
/// Offset of the data register.
pub(crate) const DATA: u32 = DR16;

const RESET_CR2: u32 = 0x0700;
/// CR1: bidirectional, CRC, 8 bits of CRC, receive only, least significant bit first.
const UNMODELLED_CR1: u32 = 0xEC80;
/// CR2: all but the DMA requests, the select output, the data size and the reception threshold.
const UNMODELLED_CR2: u32 = 0x60F8;
/// Bytes that each FIFO holds.
const FIFO_BYTES: usize = 4;

/// The peripheral.
#[derive(Clone)]
pub struct Spi {
    /// Modes, 2 CPOL + CPHA, that the device understands.
    modes: &'static [u32],
    cr1: u32,
    cr2: u32,
    received: VecDeque<u16>,
    waiting: VecDeque<u16>,
    sending: Option<u16>,
    due: Time,
    frame_time: Time,
    is_overrun: bool,
    /// Frames that have ended.
    pub frames: u64,
    /// Frames that the select line has cut off.
    pub cut: u64,
}

impl Spi {
    pub(crate) fn new(modes: &'static [u32]) -> Self {
        Self {
            modes,
            cr1: 0,
            cr2: RESET_CR2,
            received: VecDeque::new(),
            waiting: VecDeque::new(),
            sending: None,
            due: Time::NEVER,
            frame_time: Time::ZERO,
            is_overrun: false,
            frames: 0,
            cut: 0,
        }
    }

    /// All registers take their reset values.
    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.modes);
    }

    pub(crate) fn next_event(&self) -> Time {
        self.due
    }

    /// The end of a frame.
    pub(crate) fn advance(&mut self, now: Time, device: &mut dyn SpiDevice) {
        if self.due > now {
            return;
        }
        self.due = Time::NEVER;
        if let Some(frame) = self.sending.take() {
            let answer = device.transfer(now, frame);
            self.frames += 1;
            if self.received.len() < self.capacity() {
                self.received.push_back(answer & self.mask());
            } else {
                self.is_overrun = true;
            }
        }
        self.start_frame(now);
    }

    /// The device's select line rises.
    pub(crate) fn deselect(&mut self) {
        self.cut += u64::from(self.sending.is_some());
    }

    /// Request lines of DMA: receive, transmit.
    pub(crate) fn dma_requests(&self) -> [bool; 2] {
        let cr2 = Cr2(self.cr2);
        [cr2.rxdmaen() && !self.received.is_empty(), cr2.txdmaen() && self.has_room()]
    }

    fn frame_bytes(&self) -> usize {
        if Cr2(self.cr2).ds().to_bits() > 7 { 2 } else { 1 }
    }

    fn mask(&self) -> u16 {
        if self.frame_bytes() == 2 { u16::MAX } else { 0xFF }
    }

    fn capacity(&self) -> usize {
        FIFO_BYTES / self.frame_bytes()
    }

    /// TXE: the FIFO is at most half full.
    fn has_room(&self) -> bool {
        2 * self.waiting.len() <= self.capacity()
    }

    fn start_frame(&mut self, now: Time) {
        if Cr1(self.cr1).spe() && self.sending.is_none() {
            self.sending = self.waiting.pop_front();
            if self.sending.is_some() {
                self.due = now + self.frame_time;
            }
        }
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CR1 => self.cr1,
            CR2 => self.cr2,
            SR => {
                let [full, room, overrun, busy] = [
                    !self.received.is_empty(),
                    self.has_room(),
                    self.is_overrun,
                    self.sending.is_some() || !self.waiting.is_empty(),
                ]
                .map(u32::from);
                // Levels of the FIFOs: empty, a quarter, half, full.
                let level = |frames: usize| match frames * self.frame_bytes() {
                    0 => 0,
                    1 => 1,
                    2 | 3 => 2,
                    _ => 3,
                };
                let levels = level(self.received.len()) << 9 | level(self.waiting.len()) << 11;
                full | room << 1 | overrun << 6 | busy << 7 | levels
            }
            DR16 => {
                // Reading the data and then the status clears an overrun; nothing here depends on the order.
                self.is_overrun = false;
                self.received.pop_front().unwrap_or(0).into()
            }
            CRCPR => 7,
            RXCRCR | TXCRCR | I2SCFGR => 0,
            I2SPR => 2,
            _ => context.unmodelled(offset),
        }
    }

    /// `bytes`: width of the access. `has_pins`: clock and both data lines are connected to pins. `is_selected`: the
    /// device's select line is low. `clock_cycles`: duration of cycles of the peripheral's clock.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        bytes: u32,
        [has_pins, is_selected]: [bool; 2],
        clock_cycles: impl Fn(u64) -> Time,
        context: &mut Context,
    ) {
        match offset {
            CR1 => {
                self.cr1 = value;
                if value & UNMODELLED_CR1 != 0 {
                    context.unmodelled_setting(offset, "CRC, one data line, LSB first");
                }
                self.start_frame(context.now);
            }
            CR2 => {
                if value & UNMODELLED_CR2 != 0 || !matches!(Cr2(value).ds().to_bits(), 7 | 15) {
                    context.unmodelled_setting(offset, "interrupts, other frames");
                }
                self.cr2 = value;
            }
            DR16 => {
                let problem = if Cr1(self.cr1).mstr().to_bits() != 1
                    || bytes as usize != self.frame_bytes()
                {
                    Some((Kind::Misconfigured, "not a frame of a controller"))
                } else if self.waiting.len() >= self.capacity() {
                    Some((Kind::Overrun, "a frame while the FIFO is full"))
                } else {
                    None
                };
                if let Some((kind, text)) = problem {
                    context.report(kind, offset, text);
                    return;
                }
                for (kind, text, is_wrong) in [
                    (
                        Kind::Misconfigured,
                        "clock polarity or phase is not the device's",
                        !self.modes.contains(&(self.cr1 & 3)),
                    ),
                    (Kind::PinNotConnected, "clock or data is not at its pin", !has_pins),
                    (Kind::Misconfigured, "a frame without the select line", !is_selected),
                ] {
                    if is_wrong {
                        context.report(kind, offset, text);
                    }
                }
                let divisor = 2_u64 << Cr1(self.cr1).br().to_bits();
                self.frame_time = clock_cycles(8 * self.frame_bytes() as u64 * divisor);
                self.waiting.push_back(value as u16 & self.mask());
                self.start_frame(context.now);
            }
            CRCPR | I2SCFGR | I2SPR if value & !7 != 0 => {
                context.unmodelled_setting(offset, "CRC or I2S")
            }
            SR | CRCPR | RXCRCR | TXCRCR | I2SCFGR | I2SPR => {}
            _ => context.unmodelled_write(offset),
        }
    }
}
