//! DMA controllers and their request multiplexer, RM0440 sections 12 and 13. Transfers themselves are made by
//! [`crate::soc`], which sees memories and peripherals.

use stm32_metapac::bdma::regs::Cr;

use crate::peripherals::Context;
use crate::registers::{interrupt, registers};

registers! { "DMA1": ISR = 0x00, IFCR = 0x04, CH0_CR = 0x08, CH0_NDTR = 0x0C, CH0_PAR = 0x10, CH0_MAR = 0x14, CH7_MAR = 0xA0 }

/// Channels of both controllers.
pub const CHANNELS: usize = 16;
const OF_ONE: usize = 8;
/// Bytes from one channel's registers to the next.
const STRIDE: u32 = 20;

/// DMAMUX: an event at each request (13.6.1).
const EVENT_GENERATION: u32 = 1 << 9;
/// Flags of a channel in ISR and IFCR.
const TRANSFER_COMPLETE: u32 = 2;
const HALF_TRANSFER: u32 = 4;
const TRANSFER_ERROR: u32 = 8;

/// A channel's registers.
#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    cr: u32,
    /// As the program wrote it: what a circular transfer begins anew with.
    length: u32,
    left: u32,
    /// Transfers since the channel was switched on or began anew.
    done: u32,
    peripheral: u32,
    memory: u32,
    /// Register of its multiplexer.
    mux: u32,
}

impl Channel {
    /// The request line that it serves.
    const fn request(&self) -> u8 {
        self.mux as u8 & 0x7F
    }
}

/// One transfer of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Transfer {
    pub(crate) channel: usize,
    pub(crate) peripheral: u32,
    pub(crate) memory: u32,
    /// Bytes on either side.
    pub(crate) peripheral_width: u32,
    pub(crate) memory_width: u32,
    pub(crate) to_peripheral: bool,
}

/// The peripherals.
#[derive(Clone, Default)]
pub struct Dma {
    channels: [Channel; CHANNELS],
    flags: [u32; 2],
    /// Channels that are on and have something left, one bit each.
    active: u16,
    interrupts: [usize; CHANNELS],
}

impl Dma {
    pub(crate) fn new() -> Self {
        let names =
            |place: usize| format!("DMA{}_CHANNEL{}", place / OF_ONE + 1, place % OF_ONE + 1);
        Self {
            interrupts: std::array::from_fn(|place| interrupt(&names(place))),
            ..Self::default()
        }
    }

    /// One of the controllers takes its reset values.
    pub(crate) fn reset(&mut self, controller: usize) {
        for place in controller * OF_ONE..(controller + 1) * OF_ONE {
            self.channels[place] = Channel { mux: self.channels[place].mux, ..Channel::default() };
            self.active &= !(1 << place);
        }
        self.flags[controller] = 0;
    }

    /// Request lines that active channels wait for, with the channel.
    pub(crate) fn waiting(&self) -> impl Iterator<Item = (usize, u8)> {
        let (active, channels) = (self.active, &self.channels);
        (0..CHANNELS)
            .filter(move |place| active >> place & 1 != 0)
            .map(|place| (place, channels[place].request()))
    }

    /// Whether no channel is active.
    pub(crate) fn is_idle(&self) -> bool {
        self.active == 0
    }

    /// The next transfer of an active channel; it is then counted as made.
    pub(crate) fn next_transfer(&mut self, place: usize) -> Transfer {
        let channel = &mut self.channels[place];
        let cr = Cr(channel.cr);
        let done = channel.done;
        let [peripheral_width, memory_width] =
            [cr.psize(), cr.msize()].map(|size| 1 << size.to_bits().min(2));
        let transfer = Transfer {
            channel: place,
            peripheral: channel.peripheral + if cr.pinc() { done * peripheral_width } else { 0 },
            memory: channel.memory + if cr.minc() { done * memory_width } else { 0 },
            peripheral_width,
            memory_width,
            to_peripheral: cr.dir().to_bits() == 1,
        };
        channel.left -= 1;
        channel.done += 1;
        let mut flags = 0;
        if channel.left == channel.length / 2 {
            flags |= HALF_TRANSFER;
        }
        if channel.left == 0 {
            flags |= TRANSFER_COMPLETE;
            if cr.circ() {
                (channel.left, channel.done) = (channel.length, 0)
            } else {
                self.active &= !(1 << place)
            }
        }
        self.raise(place, flags);
        transfer
    }

    /// The channel's address was refused: it stops.
    pub(crate) fn fail(&mut self, place: usize) {
        self.channels[place].cr &= !1;
        self.active &= !(1 << place);
        self.raise(place, TRANSFER_ERROR);
    }

    fn raise(&mut self, place: usize, flags: u32) {
        if flags != 0 {
            // With every flag the global one.
            self.flags[place / OF_ONE] |= (flags | 1) << (4 * (place % OF_ONE));
        }
    }

    /// Levels of the interrupts: number and level of each channel's.
    pub(crate) fn interrupts(&self) -> impl Iterator<Item = (usize, bool)> {
        self.channels.iter().enumerate().map(|(place, channel)| {
            let flags = self.flags[place / OF_ONE] >> (4 * (place % OF_ONE));
            (self.interrupts[place], flags & channel.cr & 0xE != 0)
        })
    }

    pub(crate) fn read(&mut self, controller: usize, offset: u32, context: &mut Context) -> u32 {
        match offset {
            ISR => self.flags[controller],
            IFCR => 0,
            CH0_CR..=CH7_MAR => {
                let channel =
                    &self.channels[controller * OF_ONE + ((offset - CH0_CR) / STRIDE) as usize];
                match (offset - CH0_CR) % STRIDE + CH0_CR {
                    CH0_CR => channel.cr,
                    CH0_NDTR => channel.left,
                    CH0_PAR => channel.peripheral,
                    CH0_MAR => channel.memory,
                    _ => context.unmodelled(offset),
                }
            }
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(
        &mut self,
        controller: usize,
        offset: u32,
        value: u32,
        context: &mut Context,
    ) {
        match offset {
            IFCR => {
                // Clearing the global flag clears all of a channel.
                let all = (0..OF_ONE)
                    .filter(|place| value >> (4 * place) & 1 != 0)
                    .fold(0, |all, place| all | 0xF << (4 * place));
                self.flags[controller] &= !(value | all);
                // What is cleared singly takes the global flag with it once none is left.
                for place in 0..OF_ONE {
                    if self.flags[controller] >> (4 * place) & 0xE == 0 {
                        self.flags[controller] &= !(1 << (4 * place));
                    }
                }
            }
            CH0_CR..=CH7_MAR => self.write_channel(controller, offset, value, context),
            ISR => {}
            _ => context.unmodelled_write(offset),
        }
    }

    fn write_channel(&mut self, controller: usize, offset: u32, value: u32, context: &mut Context) {
        let place = controller * OF_ONE + ((offset - CH0_CR) / STRIDE) as usize;
        let channel = &mut self.channels[place];
        let is_on = channel.cr & 1 != 0;
        match (offset - CH0_CR) % STRIDE + CH0_CR {
            CH0_CR => {
                if Cr(value).mem2mem() {
                    context.unmodelled_setting(offset, "memory to memory");
                }
                if value & 1 != 0 && !is_on {
                    channel.done = 0;
                }
                channel.cr = value & 0x7FFF;
                let is_active = value & 1 != 0 && channel.left > 0;
                self.active = self.active & !(1 << place) | u16::from(is_active) << place;
            }
            _ if is_on => context.write_protected(offset, "a channel's registers while it is on"),
            CH0_NDTR => (channel.length, channel.left) = (value & 0xFFFF, value & 0xFFFF),
            CH0_PAR => channel.peripheral = value,
            CH0_MAR => channel.memory = value,
            _ => context.unmodelled_write(offset),
        }
    }

    pub(crate) fn read_mux(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            0x00..=0x3C => self.channels[offset as usize / 4].mux,
            0x80 => 0,
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write_mux(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            0x00..=0x3C => {
                // Events at each request go nowhere without a channel that waits for them.
                if value & !(0x7F | EVENT_GENERATION) != 0 {
                    context.unmodelled_setting(offset, "synchronisation of requests");
                }
                self.channels[offset as usize / 4].mux = value;
            }
            0x84 => {}
            _ => context.unmodelled_write(offset),
        }
    }
}
