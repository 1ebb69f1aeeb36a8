//! Reset and clock control, RM0440 section 7: oscillators with their start-up times, the clock tree, gates, resets, and
//! the cause of the last one.

use std::fmt;

use stm32_metapac::rcc::regs::{Bdcr, Ccipr, Cfgr, Cr, Crrcr, Csr, Pllcfgr};

use crate::peripherals::{Context, Words, bit};
use crate::registers::{RccBit, registers};
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "RCC":
    CR = 0x00, ICSCR = 0x04, CFGR = 0x08, PLLCFGR = 0x0C, CIER = 0x18, CIFR = 0x1C, CICR = 0x20,
    AHB1RSTR = 0x28, APB2RSTR = 0x40, AHB1ENR = 0x48, APB1ENR1 = 0x58, APB2ENR = 0x60, AHB1SMENR = 0x68,
    APB2SMENR = 0x80, CCIPR = 0x88, BDCR = 0x90, CSR = 0x94, CRRCR = 0x98, CCIPR2 = 0x9C,
}

const WORDS: usize = 40;
/// Internal oscillators.
const HSI: Frequency = Frequency(16_000_000);
const HSI48: Frequency = Frequency(48_000_000);
/// Start-up times, typical (datasheet DS12288 tables 42 to 47): crystal 2 ms, HSI 0.8 us, HSI48 2.5 us, LSI 80 us;
/// the PLL locks in 15 us.
const HSE_START: Time = Time::from_ms(2);
const HSI_START: Time = Time::from_ns(800);
const HSI48_START: Time = Time::from_ns(2500);
const LSI_START: Time = Time::from_us(80);
const PLL_LOCK: Time = Time::from_us(15);

/// Above this the core's clock rises in two steps, with at least this time at half of it by the AHB prescaler (RM0440 6.1.5; ST's
/// HAL_RCC_ClockConfig does the same).
const HALF_SPEED: Frequency = Frequency(80_000_000);
const TRANSITION: Time = Time::from_us(1);

/// Frequencies of the clocks that peripherals run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// Core, AHB, DMA, flash.
    pub core: Frequency,
    /// System clock, before the AHB prescaler.
    pub system: Frequency,
    /// APB1 and its timers.
    pub apb1: Frequency,
    /// Timers on APB1.
    pub apb1_timers: Frequency,
    /// APB2.
    pub apb2: Frequency,
    /// Timers on APB2.
    pub apb2_timers: Frequency,
    /// Kernel clocks of I2C1 to I2C3.
    pub i2c: [Frequency; 3],
    /// Kernel clock of USART2.
    pub usart2: Frequency,
    /// Kernel clock of the CAN controllers.
    pub fdcan: Frequency,
    /// Kernel clock of ADC1 and ADC2, before their own prescaler.
    pub adc12: Frequency,
    /// Of ADC3 to ADC5.
    pub adc345: Frequency,
    /// Clock of the random number generator.
    pub rng: Frequency,
    /// Clock of the independent watchdog.
    pub lsi: Frequency,
}

/// What ended the last run, as flags of CSR (7.4.28).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// The supply came.
    PowerOn,
    /// The independent watchdog.
    Watchdog,
    /// SYSRESETREQ.
    Software,
    /// The reset pin.
    Pin,
}

impl fmt::Display for ResetCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PowerOn => "power-on",
            Self::Watchdog => "watchdog",
            Self::Software => "software",
            Self::Pin => "reset pin",
        })
    }
}

impl ResetCause {
    /// Every reset also pulls the reset pin low.
    fn flags(self) -> Csr {
        let mut flags = Csr(0);
        flags.set_pinrstf(true);
        match self {
            Self::PowerOn => flags.set_borrstf(true),
            Self::Watchdog => flags.set_iwdgrstf(true),
            Self::Software => flags.set_sftrstf(true),
            Self::Pin => {}
        }
        flags
    }
}

/// The peripheral.
#[derive(Clone)]
pub struct Rcc {
    words: Words<WORDS>,
    /// When each oscillator is ready: HSI, HSE, PLL, HSI48, LSI.
    ready: [Time; 5],
    /// The crystal, if the board has one and it oscillates.
    crystal: Frequency,
    /// The low-speed oscillator of this chip: 32 kHz, 29.5 to 34 over temperature and supply.
    lsi: Frequency,
    clocks: Clocks,
    /// When the core's clock changed last.
    changed: Time,
    css_failed: bool,
}

const OSCILLATORS: [(u32, u32); 5] = [(CR, 8), (CR, 16), (CR, 24), (CRRCR, 0), (CSR, 0)];

impl Rcc {
    pub(crate) fn new(crystal: Frequency, lsi: Frequency) -> Self {
        let mut rcc = Self {
            words: Words::default(),
            ready: [Time::NEVER; 5],
            crystal,
            lsi,
            clocks: Clocks {
                core: HSI,
                system: HSI,
                apb1: HSI,
                apb1_timers: HSI,
                apb2: HSI,
                apb2_timers: HSI,
                i2c: [HSI; 3],
                usart2: HSI,
                fdcan: Frequency(0),
                adc12: Frequency(0),
                adc345: Frequency(0),
                rng: Frequency(0),
                lsi,
            },
            changed: Time::ZERO,
            css_failed: false,
        };
        rcc.reset(Time::ZERO, ResetCause::PowerOn);
        rcc
    }

    /// Reset values of 7.4. The flags of causes add up until software clears them.
    pub(crate) fn reset(&mut self, now: Time, cause: ResetCause) {
        let before = match cause {
            ResetCause::PowerOn => 0,
            _ => self.words[CSR] & 0xFE00_0000,
        };
        self.words = Words::new(&[
            (CR, 0x0000_0500),
            (ICSCR, 0x4000_0000),
            (CFGR, 0x0000_0005),
            (PLLCFGR, 0x0000_1000),
            (AHB1ENR, 0x0000_0100),
            (APB1ENR1, 0x0000_0400),
            (CSR, before | cause.flags().0),
        ]);
        self.ready = [Time::NEVER; 5];
        self.ready[0] = now;
        self.css_failed = false;
        self.derive();
    }

    /// Frequencies now.
    pub(crate) fn clocks(&self) -> &Clocks {
        &self.clocks
    }

    /// Whether a gate or a reset is set.
    pub(crate) fn is_set(&self, place: RccBit) -> bool {
        bit(self.words[place.offset], place.bit)
    }

    /// The watchdog switches its oscillator on (42.3.2).
    pub(crate) fn start_lsi(&mut self, now: Time) {
        let mut csr = Csr(self.words[CSR]);
        csr.set_lsion(true);
        self.words[CSR] = csr.0;
        self.ready[4] = self.ready[4].min(now + LSI_START);
    }

    /// The crystal oscillates again where it is switched on.
    pub(crate) fn restore_crystal(&mut self, crystal: Frequency) {
        self.crystal = crystal;
        self.derive();
    }

    /// The crystal stops. With the clock security system on, the core goes on with HSI and the non-maskable interrupt
    /// is raised (7.2.9), once in this model; without it, a core that runs on it stops: true for the former.
    pub(crate) fn fail_crystal(&mut self) -> bool {
        self.crystal = Frequency(0);
        let mut control = Cr(self.words[CR]);
        let is_detected = control.csson() && control.hseon();
        if is_detected {
            control.set_hseon(false);
            control.set_hserdy(false);
            if Pllcfgr(self.words[PLLCFGR]).pllsrc().to_bits() == 3 {
                control.set_pllon(false);
                control.set_pllrdy(false);
            }
            self.words[CR] = control.0;
            let mut configuration = Cfgr(self.words[CFGR]);
            configuration.0 = configuration.0 & !0xF | 0b0101;
            self.words[CFGR] = configuration.0;
            self.css_failed = true;
        }
        self.derive();
        is_detected
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        self.settle(context.now);
        match offset {
            CIFR => u32::from(self.css_failed) << 8,
            CR..=CICR | AHB1RSTR..=CCIPR2 if offset as usize / 4 < WORDS => self.words[offset],
            _ => context.unmodelled(offset),
        }
    }

    /// Sets the ready flags of oscillators whose start-up time is over.
    fn settle(&mut self, now: Time) {
        for ((offset, place), ready) in OSCILLATORS.into_iter().zip(self.ready) {
            let flag = if offset == CR { place + 1 + u32::from(place == 8) } else { place + 1 };
            let is_on = bit(self.words[offset], place) && ready <= now;
            let is_on = is_on && (place != 16 || self.crystal.0 > 0);
            let word = &mut self.words[offset];
            *word = *word & !(1 << flag) | u32::from(is_on) << flag;
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        let now = context.now;
        self.settle(now);
        let old = if offset as usize / 4 < WORDS { self.words[offset] } else { 0 };
        match offset {
            CR => {
                // Ready flags are read only; the clock security system cannot be switched off by software.
                const READY: u32 = 1 << 10 | 1 << 17 | 1 << 25;
                self.words[CR] = value & !READY | old & (READY | 1 << 19);
            }
            CFGR => self.switch(value, context),
            PLLCFGR => {
                if bit(self.words[CR], 24) {
                    context.write_protected(offset, "the PLL is configured while it runs");
                } else {
                    self.words[PLLCFGR] = value;
                }
            }
            CICR => self.css_failed &= !bit(value, 8),
            CSR => {
                let keeps = if bit(value, 23) { 0 } else { old & 0xFE00_0000 };
                self.words[CSR] = value & 1 | old & 2 | keeps;
            }
            CRRCR => self.words[CRRCR] = value & 1 | old & 2,
            BDCR => {
                if Bdcr(value).lseon() {
                    context.unmodelled_setting(offset, "the low-speed crystal");
                }
                self.words[BDCR] = value;
            }
            CIFR => {}
            ICSCR
            | CIER
            | AHB1RSTR..=APB2RSTR
            | AHB1ENR..=APB2ENR
            | AHB1SMENR..=APB2SMENR
            | CCIPR
            | CCIPR2 => {
                self.words[offset] = value;
            }
            _ => context.unmodelled_write(offset),
        }
        for ((place, ready), start) in OSCILLATORS.into_iter().zip(&mut self.ready).zip([
            HSI_START,
            HSE_START,
            PLL_LOCK,
            HSI48_START,
            LSI_START,
        ]) {
            if place.0 == offset {
                let is_on = bit(self.words[offset], place.1);
                let was_on = bit(old, place.1);
                *ready = match (was_on, is_on) {
                    (false, true) => now + start,
                    (_, false) => Time::NEVER,
                    (true, true) => *ready,
                };
            }
        }
        self.settle(now);
        self.derive();
    }

    /// The system clock follows its selection once the source is ready; 7.2.7.
    fn switch(&mut self, value: u32, context: &mut Context) {
        let mut wanted = Cfgr(value);
        let control = Cr(self.words[CR]);
        let is_ready = match wanted.sw().to_bits() {
            1 => control.hsirdy(),
            2 => control.hserdy(),
            3 => control.pllrdy() && Pllcfgr(self.words[PLLCFGR]).pllren(),
            _ => false,
        };
        if !is_ready {
            context.misconfigured(CFGR, "a clock is selected that is not ready");
            return;
        }
        wanted.set_sws(wanted.sw());
        let before = self.clocks.core;
        self.words[CFGR] = wanted.0;
        self.derive();
        let after = self.clocks.core;
        if after == before {
            return;
        }
        let lasted = context.now.since(self.changed);
        self.changed = context.now;
        if after > HALF_SPEED
            && after > before
            && (2 * u64::from(before.0) < after.0.into() || lasted < TRANSITION)
        {
            context.report(
                Kind::ClockLimit,
                CFGR,
                "the core's clock rises above 80 MHz without 1 us at half of it",
            );
        }
    }

    fn pll(&self) -> Frequency {
        let configuration = Pllcfgr(self.words[PLLCFGR]);
        let source = match configuration.pllsrc().to_bits() {
            2 => HSI,
            3 => self.crystal,
            _ => Frequency(0),
        };
        let factor = u64::from(configuration.plln().to_bits());
        let divisor = u64::from(configuration.pllm().to_bits()) + 1;
        Frequency((u64::from(source.0) * factor / divisor) as u32)
    }

    fn derive(&mut self) {
        let (configuration, pll) = (Cfgr(self.words[CFGR]), Pllcfgr(self.words[PLLCFGR]));
        let vco = self.pll();
        let half_steps = |bits: u8| 2 * (u32::from(bits) + 1);
        let system = match configuration.sws().to_bits() {
            1 => HSI,
            2 => self.crystal,
            3 => vco.divided_by(half_steps(pll.pllr().to_bits())),
            _ => Frequency(0),
        };
        let pll_q = if pll.pllqen() {
            vco.divided_by(half_steps(pll.pllq().to_bits()))
        } else {
            Frequency(0)
        };
        let ahb = match configuration.hpre().to_bits() {
            bits @ 8..=11 => 2 << (bits - 8),
            // There is no division by 32.
            bits @ 12..=15 => 64 << (bits - 12),
            _ => 1,
        };
        let core = system.divided_by(ahb);
        let apb = |bits: u8| if bits & 4 != 0 { 2 << (bits & 3) } else { 1 };
        let (divisor1, divisor2) =
            (apb(configuration.ppre1().to_bits()), apb(configuration.ppre2().to_bits()));
        let (apb1, apb2) = (core.divided_by(divisor1), core.divided_by(divisor2));
        let timers = |bus: Frequency, divisor: u32| {
            if divisor == 1 { bus } else { Frequency(2 * bus.0) }
        };
        let select = Ccipr(self.words[CCIPR]);
        let of_bus = |selection: u8| match selection {
            0 => apb1,
            1 => system,
            2 => HSI,
            _ => Frequency(0),
        };
        let of_converters = |selection: u8| match selection {
            2 => system,
            1 if pll.pllpen() => {
                let bits = u32::from(pll.pllp().to_bits());
                let divisor = if bits == 0 { 7 } else { bits.max(2) };
                vco.divided_by(divisor)
            }
            _ => Frequency(0),
        };
        let hsi48 = Crrcr(self.words[CRRCR]).hsi48on();
        self.clocks = Clocks {
            core,
            system,
            apb1,
            apb1_timers: timers(apb1, divisor1),
            apb2,
            apb2_timers: timers(apb2, divisor2),
            i2c: [select.i2c1sel(), select.i2c2sel(), select.i2c3sel()]
                .map(|selection| of_bus(selection.to_bits())),
            usart2: of_bus(select.usart2sel().to_bits()),
            fdcan: match select.fdcansel().to_bits() {
                0 => self.crystal,
                1 => pll_q,
                2 => apb1,
                _ => Frequency(0),
            },
            adc12: of_converters(select.adc12sel().to_bits()),
            adc345: of_converters(select.adc345sel().to_bits()),
            rng: match select.clk48sel().to_bits() {
                0 if hsi48 => HSI48,
                2 => pll_q,
                _ => Frequency(0),
            },
            lsi: self.lsi,
        };
    }

    /// Bits of a reset register that a write has just set.
    pub(crate) fn is_reset_register(offset: u32) -> bool {
        (AHB1RSTR..=APB2RSTR).contains(&offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::violations::Violations;

    fn with(rcc: &mut Rcc, now: Time, offset: u32, value: u32) -> Violations {
        let mut violations = Violations::default();
        let clocks = *rcc.clocks();
        let mut context =
            Context { now, clocks: &clocks, violations: &mut violations, base: 0x4002_1000 };
        rcc.write(offset, value, &mut context);
        violations
    }

    #[test]
    fn crystal_of_24_mhz_gives_160_and_80_mhz_after_the_pll_locks() {
        let mut rcc = Rcc::new(Frequency(24_000_000), Frequency(32_000));
        assert_eq!(rcc.clocks().core, Frequency(16_000_000));
        with(&mut rcc, Time::ZERO, CR, 0x0001_0500);
        // Source crystal, / 6, * 80, Q / 4, R / 2.
        with(&mut rcc, Time::ZERO, PLLCFGR, 3 | 5 << 4 | 80 << 8 | 1 << 20 | 1 << 21 | 1 << 24);
        with(&mut rcc, Time::from_ms(2), CR, 0x0101_0500);
        let early = with(&mut rcc, Time::from_ms(2), CFGR, 3);
        assert!(early.iter().any(|violation| violation.kind == Kind::Misconfigured));
        // HPRE 8: halved, for 1 us.
        assert!(with(&mut rcc, Time::from_us(2015), CFGR, 3 | 8 << 4).iter().next().is_none());
        assert_eq!(rcc.clocks().core, Frequency(80_000_000));
        let jump = with(&mut rcc.clone(), Time::from_ns(2_015_900), CFGR, 3);
        assert!(jump.iter().any(|violation| violation.kind == Kind::ClockLimit));
        assert!(with(&mut rcc, Time::from_us(2016), CFGR, 3).iter().next().is_none());
        assert_eq!(rcc.clocks().core, Frequency(160_000_000));
        // FDCANSEL 1: PLL Q.
        with(&mut rcc, Time::from_us(2015), CCIPR, 1 << 24);
        assert_eq!(rcc.clocks().fdcan, Frequency(80_000_000));
        // APB1 / 4 doubles its timers' clock.
        with(&mut rcc, Time::from_us(2015), CFGR, 3 | 8 << 4 | 5 << 8);
        assert_eq!(rcc.clocks().apb1, Frequency(20_000_000));
        assert_eq!(rcc.clocks().apb1_timers, Frequency(40_000_000));
    }

    #[test]
    fn lost_crystal_needs_the_clock_security_system() {
        let mut rcc = Rcc::new(Frequency(24_000_000), Frequency(32_000));
        with(&mut rcc, Time::ZERO, CR, 0x0001_0500);
        with(&mut rcc, Time::from_ms(2), CFGR, 2);
        assert!(!rcc.fail_crystal());
        assert_eq!(rcc.clocks().core, Frequency(0));
        let mut rcc = Rcc::new(Frequency(24_000_000), Frequency(32_000));
        with(&mut rcc, Time::ZERO, CR, 0x0009_0500);
        with(&mut rcc, Time::from_ms(2), CFGR, 2);
        assert!(rcc.fail_crystal());
        assert_eq!(rcc.clocks().core, Frequency(16_000_000));
        assert!(rcc.css_failed);
        with(&mut rcc, Time::from_ms(2), CICR, 1 << 8);
        assert!(!rcc.css_failed);
    }
}
