//! Converters, RM0440 section 21: injected conversions of four inputs on a trigger of the motor's timer, regular conversions
//! of one input by software.

use stm32_metapac::adc::regs::{Cr, Jsqr};

use crate::devices::Drivetrain;
use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "ADC1":
    ISR = 0x00, IER = 0x04, CR = 0x08, CFGR = 0x0C, CFGR2 = 0x10, SMPR = 0x14, SMPR2 = 0x18, SQR1 = 0x30, SQR4 = 0x3C,
    DR = 0x40, JSQR = 0x4C, OFR0 = 0x60, OFR3 = 0x6C, JDR0 = 0x80, JDR3 = 0x8C, DIFSEL = 0xB0, CALFACT = 0xB4, GCOMP = 0xC0,
}
/// Registers common to ADC1 and ADC2, or to ADC3 to ADC5, follow theirs.
pub(crate) const COMMON_CSR: u32 = 0x300;
pub(crate) const COMMON_CCR: u32 = 0x308;

/// CCR: what may change only while all converters are off: dual mode, delay, DMA, clock.
const CLOCK_AND_MODE: u32 = 0x003F_EF1F;

const WORDS: usize = 0x100 / 4;
/// Times in half cycles of the converter: sampling by SMPR, and a conversion of 12 bits.
const SAMPLING: [u64; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
const CONVERSION: u64 = 25;
/// A calibration takes 116 cycles (21.4.8); the converter is ready 1 us after it is enabled, at the most.
const CALIBRATION: u64 = 116;
const STABILISATION: Time = Time::from_us(1);
/// JEXTSEL of TIM1_TRGO2, and JEXTEN of a rising edge.
const TIM1_TRGO2: u8 = 8;
const RISING: u8 = 1;
/// Flags: ready, end of a regular conversion and of their sequence, of an injected conversion and of their sequence.
const READY: u32 = 1;
const REGULAR_END: u32 = 1 << 2 | 1 << 3;
const END: u32 = 1 << 5;
const SEQUENCE: u32 = 1 << 6;
const ENABLED_INTERRUPTS: u32 = 0x7FF;
/// CR bits that software sets and hardware clears: the calibration and the four commands.
const REGULATOR: u32 = 1 << 28;
const CALIBRATE: u32 = 1 << 31;

/// What the converter does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    Calibrate,
    Stabilise,
    /// The inputs are sampled; conversions take until then.
    Sample(Time),
    Convert,
    /// A regular conversion of this channel.
    Regular(u32),
}

/// What the inputs of a converter are connected to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Inputs {
    /// Channels of phases U, V, W and of the bus voltage, injected.
    Motor([u32; 4]),
    /// Channels that are converted singly, with the number of each in [`Drivetrain::temperatures`].
    Temperatures(Vec<(u32, usize)>),
}

/// The peripheral.
#[derive(Clone)]
pub struct Adc {
    words: [u32; WORDS],
    common: u32,
    /// Stable since it was switched on. The flag says so once; software clears it.
    is_ready: bool,
    work: Option<(Time, Work)>,
    inputs: Inputs,
    sampled: [u16; 4],
    /// Triggers that came while the last sequence was under way.
    pub missed: u64,
    /// Sequences whose results nobody had read when the next ended.
    pub overwritten: u64,
}

impl Adc {
    pub(crate) fn new(inputs: Inputs) -> Self {
        let mut words = [0; WORDS];
        words[CR as usize / 4] = 0x2000_0000;
        words[CFGR as usize / 4] = 0x8000_0000;
        Self {
            words,
            common: 0,
            is_ready: false,
            work: None,
            inputs,
            sampled: [0; 4],
            missed: 0,
            overwritten: 0,
        }
    }

    pub(crate) fn reset(&mut self) {
        let inputs = self.inputs.clone();
        *self = Self { missed: self.missed, overwritten: self.overwritten, ..Self::new(inputs) };
    }

    fn word(&self, offset: u32) -> u32 {
        self.words[offset as usize / 4]
    }

    fn word_mut(&mut self, offset: u32) -> &mut u32 {
        &mut self.words[offset as usize / 4]
    }

    fn clock(&self, context: &Context) -> Frequency {
        match self.inputs {
            Inputs::Motor(_) => context.clocks.adc12,
            Inputs::Temperatures(_) => context.clocks.adc345,
        }
    }

    /// Half cycles from the beginning of a channel's conversion to its end.
    fn conversion(&self, channel: u32) -> u64 {
        let register = if channel < 10 { SMPR } else { SMPR2 };
        SAMPLING[(self.word(register) >> (3 * (channel % 10)) & 7) as usize] + CONVERSION
    }

    /// So many half cycles of the converter's clock (21.4.3, ADC_CCR).
    fn half_cycles(&self, count: u64, context: &Context) -> Time {
        const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
        let (clock, divisor) = match self.common >> 16 & 3 {
            0 => (self.clock(context), PRESCALERS[(self.common as usize >> 18 & 15).min(11)]),
            mode => (context.clocks.core, 1 << (mode - 1)),
        };
        clock.cycles(count * divisor).ps().checked_div(2).map_or(Time::NEVER, Time::from_ps)
    }

    /// The timer's trigger.
    pub(crate) fn trigger(&mut self, context: &mut Context) {
        let jsqr = Jsqr(self.word(JSQR));
        let cr = Cr(self.word(CR));
        if !cr.aden()
            || !cr.jadstart()
            || jsqr.jexten().to_bits() != RISING
            || jsqr.jextsel() != TIM1_TRGO2
        {
            return;
        }
        if matches!(self.work, Some((_, Work::Sample(_) | Work::Convert))) {
            self.missed += 1;
            return;
        }
        let channels =
            (0..=u32::from(jsqr.jl())).map(|rank| self.word(JSQR) >> (9 + 6 * rank) & 0x1F);
        let times: Vec<u64> = channels.map(|channel| self.conversion(channel)).collect();
        let first = times.first().map_or(0, |time| time - CONVERSION);
        let sampled = context.now + self.half_cycles(first, context);
        let ends = context.now + self.half_cycles(times.iter().sum(), context);
        self.work = Some((sampled, Work::Sample(ends)));
    }

    pub(crate) fn next_event(&self) -> Time {
        self.work.map_or(Time::NEVER, |(time, _)| time)
    }

    pub(crate) fn advance(&mut self, now: Time, drivetrain: &mut dyn Drivetrain) {
        let Some((_, work)) = self.work.take_if(|(time, _)| *time <= now) else {
            return;
        };
        match work {
            Work::Calibrate => *self.word_mut(CR) &= !CALIBRATE,
            Work::Stabilise => {
                self.is_ready = true;
                *self.word_mut(ISR) |= READY;
            }
            Work::Sample(ends) => {
                self.sampled = drivetrain.sample();
                self.work = Some((ends, Work::Convert));
            }
            Work::Convert => {
                let jsqr = self.word(JSQR);
                for rank in 0..4 {
                    let channel = jsqr >> (9 + 6 * rank) & 0x1F;
                    let Inputs::Motor(inputs) = &self.inputs else { continue };
                    let input = inputs.iter().position(|input| *input == channel);
                    *self.word_mut(JDR0 + 4 * rank) =
                        input.map_or(0, |input| self.sampled[input]).into();
                }
                self.overwritten += u64::from(self.word(ISR) & SEQUENCE != 0);
                *self.word_mut(ISR) |= END | SEQUENCE;
            }
            Work::Regular(channel) => {
                let Inputs::Temperatures(inputs) = &self.inputs else { return };
                let input = inputs.iter().find(|(known, _)| *known == channel);
                let counts = drivetrain.temperatures();
                *self.word_mut(DR) = input.map_or(0, |(_, input)| counts[*input]).into();
                *self.word_mut(ISR) |= REGULAR_END;
                *self.word_mut(CR) &= !(1 << 2);
            }
        }
    }

    /// Level of the interrupt.
    pub(crate) fn interrupt(&self) -> bool {
        self.word(ISR) & self.word(IER) & ENABLED_INTERRUPTS != 0
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            DR => {
                *self.word_mut(ISR) &= !(1 << 2);
                self.word(DR)
            }
            JDR0..=JDR3 => {
                *self.word_mut(ISR) &= !END;
                self.word(offset)
            }
            COMMON_CCR => self.common,
            COMMON_CSR => self.word(ISR) & 0x7FF,
            ISR..=SMPR2 | SQR1..=SQR4 | JSQR | OFR0..=OFR3 | DIFSEL | CALFACT | GCOMP => {
                self.word(offset)
            }
            _ => context.unmodelled(offset),
        }
    }

    /// `has_pins`: the inputs at pins are analog.
    pub(crate) fn write(&mut self, offset: u32, value: u32, has_pins: bool, context: &mut Context) {
        let cr = Cr(self.word(CR));
        let is_started = cr.adstart() || cr.jadstart();
        match offset {
            ISR => *self.word_mut(ISR) &= !value,
            CR => self.write_cr(value, has_pins, context),
            COMMON_CCR if cr.aden() && (value ^ self.common) & CLOCK_AND_MODE != 0 => context
                .report(Kind::WriteProtected, offset, "the converters' clock while one is on"),
            COMMON_CCR => self.common = value,
            CFGR | CFGR2 | SMPR | SMPR2 | DIFSEL if is_started => {
                context.report(Kind::WriteProtected, offset, "the configuration while it converts");
            }
            CFGR => {
                if value & 0x01E0_2003 != 0 {
                    context.report(
                        Kind::UnmodelledSetting,
                        offset,
                        "DMA, continuous conversions, a queue, a watchdog",
                    );
                }
                *self.word_mut(CFGR) = value;
            }
            IER
            | CFGR2
            | SMPR
            | SMPR2
            | SQR1..=SQR4
            | JSQR
            | OFR0..=OFR3
            | DIFSEL
            | CALFACT
            | GCOMP => {
                *self.word_mut(offset) = value;
            }
            _ => {
                context.unmodelled(offset);
            }
        }
    }

    fn write_cr(&mut self, value: u32, has_pins: bool, context: &mut Context) {
        let old = self.word(CR);
        let is_on = bit(old, 0);
        let now = context.now;
        if value & CALIBRATE != 0 {
            if is_on || old & REGULATOR == 0 {
                context.report(
                    Kind::Misconfigured,
                    CR,
                    "a calibration of a converter that is on, or without its regulator",
                )
            } else {
                *self.word_mut(CR) = value;
                self.work =
                    Some((now + self.half_cycles(2 * CALIBRATION, context), Work::Calibrate));
            }
            return;
        }
        if old & CALIBRATE != 0 {
            context.report(Kind::WriteProtected, CR, "a command while it calibrates");
            return;
        }
        // Enable, disable, start and stop are set by software and cleared by hardware.
        let mut next = value & 0x7000_0000 | old & 0xF;
        if bit(value, 0) && !is_on {
            if value & REGULATOR == 0 {
                context.report(Kind::Misconfigured, CR, "switched on without its regulator");
            }
            next |= 1;
            self.work = Some((now + STABILISATION, Work::Stabilise));
        }
        if bit(value, 1) {
            next &= !0xF;
            self.work = None;
            self.is_ready = false;
            *self.word_mut(ISR) &= !READY;
        }
        for (start, stop) in [(2, 4), (3, 5)] {
            if bit(value, start) {
                if !is_on || !self.is_ready {
                    context.report(
                        Kind::Misconfigured,
                        CR,
                        "conversions of a converter that is not ready",
                    );
                }
                next |= 1 << start;
            }
            if bit(value, stop) {
                next &= !(1 << start);
            }
        }
        if bit(value, 2) {
            let sequence = self.word(SQR1);
            let channel = sequence >> 6 & 0x1F;
            let is_known = matches!(&self.inputs, Inputs::Temperatures(inputs)
                if inputs.iter().any(|(known, _)| *known == channel));
            if sequence & 0xF != 0 || !is_known {
                context.report(Kind::UnmodelledSetting, CR, "regular conversions of these inputs");
            }
            let ends = now + self.half_cycles(self.conversion(channel), context);
            self.work = Some((ends, Work::Regular(channel)));
        }
        if value & 0b1100 != 0 && !has_pins {
            context.report(Kind::PinNotConnected, CR, "an input of the converter is not analog");
        }
        *self.word_mut(CR) = next;
    }
}
