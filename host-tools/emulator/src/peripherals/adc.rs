//! Converters, RM0440 section 21: injected conversions of four inputs on a trigger of the motor's timer, regular conversions
//! of one input by software.

use stm32_metapac::adc::regs::{Cr, Jsqr};

use crate::devices::Drivetrain;
use crate::peripherals::{Context, Words, bit};
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
/// JEXTEN of a rising edge.
const RISING: u8 = 1;
/// The first conversion later than this after the last one, or after the calibration, may be wrong (ES0430, "Wrong ADC
/// conversion results when delay between calibration and first conversion or between two consecutive conversions is too
/// long"); by so many counts here.
const LONG_PAUSE: Time = Time::from_ms(1);
const PAUSE_ERROR: u16 = 100;
/// What a conversion of another converter adds to a sample that is converted meanwhile, in counts (ES0430, "ADC results
/// disturbed by conversions of another ADC instance").
const DISTURBANCE: u16 = 12;
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

/// Triggers of injected conversions, by JEXTSEL (RM0440 tables 164 and 166).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trigger {
    /// TIM1_TRGO.
    Tim1Trgo = 0,
    /// TIM1_TRGO2.
    Tim1Trgo2 = 8,
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
    words: Words<WORDS>,
    common: u32,
    /// Stable since it was switched on. The flag says so once; software clears it.
    is_ready: bool,
    work: Option<(Time, Work)>,
    inputs: Inputs,
    sampled: [u16; 4],
    /// End of the last conversion or calibration.
    converted: Time,
    /// The conversion under way is the first one after a long pause.
    is_late: bool,
    /// Another converter converts at the same time.
    is_disturbed: bool,
    /// Triggers that came while the last sequence was under way.
    pub missed: u64,
    /// Sequences whose results nobody had read when the next ended.
    pub overwritten: u64,
}

impl Adc {
    pub(crate) fn new(inputs: Inputs) -> Self {
        Self {
            words: Words::new(&[(CR, 0x2000_0000), (CFGR, 0x8000_0000)]),
            common: 0,
            is_ready: false,
            work: None,
            inputs,
            sampled: [0; 4],
            converted: Time::ZERO,
            is_late: false,
            is_disturbed: false,
            missed: 0,
            overwritten: 0,
        }
    }

    pub(crate) fn reset(&mut self) {
        let inputs = self.inputs.clone();
        *self = Self { missed: self.missed, overwritten: self.overwritten, ..Self::new(inputs) };
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
        SAMPLING[(self.words[register] >> (3 * (channel % 10)) & 7) as usize] + CONVERSION
    }

    /// So many half cycles of the converter's clock (21.4.3, ADC_CCR).
    fn half_cycles(&self, count: u64, context: &Context) -> Time {
        const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
        let (clock, divisor) = match self.common >> 16 & 3 {
            0 => (self.clock(context), PRESCALERS[(self.common as usize >> 18 & 15).min(11)]),
            mode => (context.clocks.core, 1 << (mode - 1)),
        };
        match clock.cycles(count * divisor) {
            Time::NEVER => Time::NEVER,
            time => Time::from_ps(time.ps() / 2),
        }
    }

    /// Whether it converts.
    pub(crate) fn is_converting(&self) -> bool {
        matches!(self.work, Some((_, Work::Sample(_) | Work::Convert | Work::Regular(_))))
    }

    /// A conversion begins.
    fn begin(&mut self, ends: Time, work: Work, now: Time) {
        self.is_late = now.since(self.converted) > LONG_PAUSE;
        self.work = Some((ends, work));
    }

    /// Another converter converts.
    pub(crate) fn disturb(&mut self) {
        self.is_disturbed = self.is_converting();
    }

    /// What a conversion gives for an input with these counts.
    fn with_errors(&self, counts: u16, is_first: bool) -> u32 {
        let late = if self.is_late && is_first { PAUSE_ERROR } else { 0 };
        let disturbed = if self.is_disturbed { DISTURBANCE } else { 0 };
        (counts + late + disturbed).min(4095).into()
    }

    /// Injected channels in the order of their conversions, with their beginning and the end of sampling after the trigger.
    pub(crate) fn sampling_times(&self, context: &Context) -> Vec<(u32, Time, Time)> {
        let mut before = 0;
        let times = self.injected().into_iter().map(|channel| {
            let (from, time) = (before, self.conversion(channel));
            before += time;
            let sampled = from + time - CONVERSION;
            (channel, self.half_cycles(from, context), self.half_cycles(sampled, context))
        });
        times.collect()
    }

    /// Injected channels in the order of their conversions.
    fn injected(&self) -> Vec<u32> {
        let ranks = 0..=u32::from(Jsqr(self.words[JSQR]).jl());
        ranks.map(|rank| self.words[JSQR] >> (9 + 6 * rank) & 0x1F).collect()
    }

    /// Number of the phase that a channel measures, U to W.
    pub(crate) fn phase(&self, channel: u32) -> Option<usize> {
        let Inputs::Motor([phases @ .., _]) = self.inputs else { return None };
        phases.iter().position(|phase| *phase == channel)
    }

    /// A trigger of the timer; true where a sequence begins.
    pub(crate) fn trigger(&mut self, trigger: Trigger, context: &mut Context) -> bool {
        let jsqr = Jsqr(self.words[JSQR]);
        let cr = Cr(self.words[CR]);
        if !cr.aden()
            || !cr.jadstart()
            || jsqr.jexten().to_bits() != RISING
            || jsqr.jextsel() != trigger as u8
        {
            return false;
        }
        if matches!(self.work, Some((_, Work::Sample(_) | Work::Convert))) {
            self.missed += 1;
            return false;
        }
        let channels = self.injected().into_iter();
        let times: Vec<u64> = channels.map(|channel| self.conversion(channel)).collect();
        let first = times.first().map_or(0, |time| time - CONVERSION);
        let sampled = context.now + self.half_cycles(first, context);
        let ends = context.now + self.half_cycles(times.iter().sum(), context);
        self.begin(sampled, Work::Sample(ends), context.now);
        true
    }

    pub(crate) fn next_event(&self) -> Time {
        self.work.map_or(Time::NEVER, |(time, _)| time)
    }

    pub(crate) fn advance(&mut self, now: Time, drivetrain: &mut dyn Drivetrain) {
        let Some((_, work)) = self.work.take_if(|(time, _)| *time <= now) else {
            return;
        };
        match work {
            Work::Calibrate => {
                self.words[CR] &= !CALIBRATE;
                self.converted = now;
            }
            Work::Stabilise => {
                self.is_ready = true;
                self.words[ISR] |= READY;
            }
            Work::Sample(ends) => {
                if matches!(self.inputs, Inputs::Motor(_)) {
                    self.sampled = drivetrain.sample();
                } else {
                    self.sampled[..3].copy_from_slice(&drivetrain.temperatures());
                }
                self.work = Some((ends, Work::Convert));
            }
            Work::Convert => {
                for (rank, channel) in (0..).zip(self.injected()) {
                    let input = self.input(channel);
                    let counts = input.map_or(0, |input| self.sampled[input]);
                    self.words[JDR0 + 4 * rank] = self.with_errors(counts, rank == 0);
                }
                self.overwritten += u64::from(self.words[ISR] & SEQUENCE != 0);
                self.words[ISR] |= END | SEQUENCE;
                self.end(now);
            }
            Work::Regular(channel) => {
                let counts = drivetrain.temperatures();
                let counts = self.input(channel).map_or(0, |input| counts[input]);
                self.words[DR] = self.with_errors(counts, true);
                self.words[ISR] |= REGULAR_END;
                self.words[CR] &= !(1 << 2);
                self.end(now);
            }
        }
    }

    fn end(&mut self, now: Time) {
        (self.converted, self.is_disturbed) = (now, false);
    }

    /// Number of what a channel is connected to.
    fn input(&self, channel: u32) -> Option<usize> {
        match &self.inputs {
            Inputs::Motor(channels) => channels.iter().position(|known| *known == channel),
            Inputs::Temperatures(channels) => {
                channels.iter().find(|(known, _)| *known == channel).map(|(_, input)| *input)
            }
        }
    }

    /// Level of the interrupt.
    pub(crate) fn interrupt(&self) -> bool {
        self.words[ISR] & self.words[IER] & ENABLED_INTERRUPTS != 0
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            DR => {
                self.words[ISR] &= !(1 << 2);
                self.words[DR]
            }
            JDR0..=JDR3 => {
                self.words[ISR] &= !END;
                self.words[offset]
            }
            COMMON_CCR => self.common,
            COMMON_CSR => self.words[ISR] & 0x7FF,
            ISR..=SMPR2 | SQR1..=SQR4 | JSQR | OFR0..=OFR3 | DIFSEL | CALFACT | GCOMP => {
                self.words[offset]
            }
            _ => context.unmodelled(offset),
        }
    }

    /// `has_pins`: the inputs at pins are analog.
    pub(crate) fn write(&mut self, offset: u32, value: u32, has_pins: bool, context: &mut Context) {
        let cr = Cr(self.words[CR]);
        let is_started = cr.adstart() || cr.jadstart();
        match offset {
            ISR => self.words[ISR] &= !value,
            CR => self.write_cr(value, has_pins, context),
            COMMON_CCR if cr.aden() && (value ^ self.common) & CLOCK_AND_MODE != 0 => {
                context.write_protected(offset, "the converters' clock while one is on")
            }
            COMMON_CCR => self.common = value,
            CFGR | CFGR2 | SMPR | SMPR2 | DIFSEL if is_started => {
                context.write_protected(offset, "the configuration while it converts")
            }
            CFGR => {
                if value & 0x01E0_2003 != 0 {
                    context.unmodelled_setting(
                        offset,
                        "DMA, continuous conversions, a queue, a watchdog",
                    );
                }
                self.words[CFGR] = value;
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
                self.words[offset] = value;
            }
            _ => context.unmodelled_write(offset),
        }
    }

    fn write_cr(&mut self, value: u32, has_pins: bool, context: &mut Context) {
        let old = self.words[CR];
        let is_on = bit(old, 0);
        let now = context.now;
        if value & CALIBRATE != 0 {
            if is_on || old & REGULATOR == 0 {
                context.misconfigured(
                    CR,
                    "a calibration of a converter that is on, or without its regulator",
                )
            } else {
                self.words[CR] = value;
                self.work =
                    Some((now + self.half_cycles(2 * CALIBRATION, context), Work::Calibrate));
            }
            return;
        }
        if old & CALIBRATE != 0 {
            context.write_protected(CR, "a command while it calibrates");
            return;
        }
        // Enable, disable, start and stop are set by software and cleared by hardware.
        let mut next = value & 0x7000_0000 | old & 0xF;
        if bit(value, 0) && !is_on {
            if value & REGULATOR == 0 {
                context.misconfigured(CR, "switched on without its regulator");
            }
            next |= 1;
            self.work = Some((now + STABILISATION, Work::Stabilise));
        }
        if bit(value, 1) {
            next &= !0xF;
            self.work = None;
            self.is_ready = false;
            self.words[ISR] &= !READY;
        }
        for (start, stop) in [(2, 4), (3, 5)] {
            if bit(value, start) {
                if !is_on || !self.is_ready {
                    context.misconfigured(CR, "conversions of a converter that is not ready");
                }
                next |= 1 << start;
            }
            if bit(value, stop) {
                next &= !(1 << start);
            }
        }
        if bit(value, 2) {
            let sequence = self.words[SQR1];
            let channel = sequence >> 6 & 0x1F;
            let is_known = matches!(&self.inputs, Inputs::Temperatures(inputs)
                if inputs.iter().any(|(known, _)| *known == channel));
            if sequence & 0xF != 0 || !is_known {
                context.unmodelled_setting(CR, "regular conversions of these inputs");
            }
            let ends = now + self.half_cycles(self.conversion(channel), context);
            self.begin(ends, Work::Regular(channel), now);
        }
        if value & 0b1100 != 0 && !has_pins {
            context.report(Kind::PinNotConnected, CR, "an input of the converter is not analog");
        }
        self.words[CR] = next;
    }
}
