//! SPI1 as the controller of a device with frames of 16 bits, RM0440 section 39.

use stm32_metapac::spi::regs::{Cr1, Cr2};

use crate::devices::SpiDevice;
use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::Time;
use crate::violations::Kind;

registers! { "SPI1":
    CR1 = 0x00, CR2 = 0x04, SR = 0x08, DR16 = 0x0C, CRCPR = 0x10, RXCRCR = 0x14, TXCRCR = 0x18, I2SCFGR = 0x1C, I2SPR = 0x20,
}

/// Clock idle low, data change on the rising edge and are taken on the falling one: CPOL 0, CPHA 1.
const MODE_1: u32 = 1;
/// CR2.DS of 16 bits.
const BITS_16: u8 = 0xF;
const RESET_CR2: u32 = 0x0700;

/// The peripheral.
pub struct Spi {
    cr1: u32,
    cr2: u32,
    received: Option<u16>,
    sending: Option<u16>,
    due: Time,
    is_overrun: bool,
    /// Frames that have ended.
    pub frames: u64,
    /// Frames that the select line has cut off.
    pub cut: u64,
}

impl Spi {
    pub(crate) fn new() -> Self {
        Self {
            cr1: 0,
            cr2: RESET_CR2,
            received: None,
            sending: None,
            due: Time::NEVER,
            is_overrun: false,
            frames: 0,
            cut: 0,
        }
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
            match self.received {
                None => self.received = Some(answer),
                Some(_) => self.is_overrun = true,
            }
        }
    }

    /// The device's select line rises.
    pub(crate) fn deselect(&mut self) {
        self.cut += u64::from(self.sending.is_some());
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CR1 => self.cr1,
            CR2 => self.cr2,
            SR => {
                let [full, overrun, busy] =
                    [self.received.is_some(), self.is_overrun, self.sending.is_some()]
                        .map(u32::from);
                full | 2 | overrun << 6 | busy << 7
            }
            DR16 => {
                // Reading the data and then the status clears an overrun; nothing here depends on the order.
                self.is_overrun = false;
                self.received.take().unwrap_or(0).into()
            }
            CRCPR => 7,
            RXCRCR | TXCRCR | I2SCFGR => 0,
            I2SPR => 2,
            _ => context.unmodelled(offset),
        }
    }

    /// `bytes`: width of the access. `has_pins`: clock and both data lines are connected to pins. `is_selected`: the
    /// device's select line is low.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        bytes: u32,
        [has_pins, is_selected]: [bool; 2],
        context: &mut Context,
    ) {
        match offset {
            CR1 => self.cr1 = value,
            CR2 => {
                if value & 0x0FB != 0 {
                    context.report(
                        Kind::UnmodelledSetting,
                        offset,
                        "DMA requests, interrupts, other frames",
                    );
                }
                self.cr2 = value;
            }
            DR16 => {
                let (cr1, cr2) = (Cr1(self.cr1), Cr2(self.cr2));
                let is_ready = cr1.spe() && cr1.mstr().to_bits() == 1;
                if !is_ready
                    || bytes != 2
                    || cr2.ds().to_bits() != BITS_16
                    || self.cr1 & 0xEE80 != 0 && bit(self.cr1, 15)
                {
                    context.report(
                        Kind::Misconfigured,
                        offset,
                        "not a frame of 16 bits of a controller that is on",
                    );
                    return;
                }
                if self.cr1 & 3 != MODE_1 {
                    context.report(
                        Kind::Misconfigured,
                        offset,
                        "the device takes data on the falling edge, clock idle low",
                    );
                }
                if !has_pins {
                    context.report(
                        Kind::PinNotConnected,
                        offset,
                        "clock or data is not at its pin",
                    );
                }
                if self.sending.is_some() {
                    context.report(
                        Kind::Overrun,
                        offset,
                        "a frame while the last one is under way",
                    );
                    return;
                }
                if !is_selected {
                    context.report(Kind::Misconfigured, offset, "a frame without the select line");
                }
                self.sending = Some(value as u16);
                let divisor = 2_u64 << cr1.br().to_bits();
                self.due = context.now + context.clocks.apb2.cycles(16 * divisor);
            }
            CRCPR | I2SCFGR | I2SPR if value & !7 != 0 => {
                context.report(Kind::UnmodelledSetting, offset, "CRC or I2S");
            }
            SR | CRCPR | RXCRCR | TXCRCR | I2SCFGR | I2SPR => {}
            _ => {
                context.unmodelled(offset);
            }
        }
    }
}
