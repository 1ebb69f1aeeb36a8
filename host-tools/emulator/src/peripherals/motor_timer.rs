//! The advanced timer of the motor, TIM1, RM0440 section 28: centre-aligned pulses of three complementary channels with
//! preload, the fourth channel as a trigger, and the break that switches the outputs off without the program.

use stm32_metapac::timer::regs::{Af1Adv, BdtrAdv};

use crate::peripherals::syscfg::BreakSource;
use crate::peripherals::{Context, Words, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "TIM1":
    CR1 = 0x00, CR2 = 0x04, SMCR = 0x08, DIER = 0x0C, SR = 0x10, EGR = 0x14, CCMR_OUTPUT0 = 0x18, CCMR_OUTPUT1 = 0x1C,
    CCER = 0x20, CNT = 0x24, PSC = 0x28, ARR = 0x2C, RCR = 0x30, CCR0 = 0x34, CCR3 = 0x40, BDTR = 0x44, DTR2 = 0x54,
    AF1 = 0x60, AF2 = 0x64,
}

const WORDS: usize = 26;
/// Bits of SR: update, break, break 2, system break.
const UPDATE: u32 = 1;
const BREAK: u32 = 1 << 7;
const BREAK_2: u32 = 1 << 8;
const SYSTEM_BREAK: u32 = 1 << 13;
/// All channels and complementary channels on (CCER).
const ALL_OUTPUTS: u32 = 0x555;
/// Bits of BDTR that LOCK level 1 protects (28.6.20): dead time, both breaks' enable, polarity, filter and direction,
/// automatic output enable; of CR2 the outputs' idle levels.
const LOCKED: u32 = 0x33FF_70FF;
const LOCKED_IDLE_LEVELS: u32 = 0x0000_7F00;
/// BDTR.MOE.
const MAIN_OUTPUT: u32 = 1 << 15;
/// LOCK itself is written once.
const LOCK: u32 = 0x300;

/// What happens within a period, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moment {
    /// The fourth channel's reference rises: the converter's trigger.
    Trigger,
    /// The counter's top.
    Top,
    /// The counter's bottom: new duties are taken over.
    Bottom,
}

/// The peripheral.
#[derive(Clone)]
pub struct MotorTimer {
    words: Words<WORDS>,
    /// Values in use; new ones wait for an update.
    compares: [u32; 4],
    reload: u32,
    repetitions: u32,
    clock: Frequency,
    /// The bottom at which the period began.
    since: Time,
    next: Option<(Time, Moment)>,
    is_locked: bool,
    /// Levels at the break inputs; an input whose pin is not connected is low.
    break_inputs: [bool; 2],
    /// Level of the supply's detector, where it is connected to the break.
    is_supply_low: bool,
    /// A debugger has halted the core, and DBG_TIM1_STOP is set: no counting, outputs as without MOE (28.3.32).
    is_stopped: bool,
    /// When the outputs were switched on (true) or off.
    pub switched: Vec<(Time, bool)>,
}

impl MotorTimer {
    pub(crate) fn new() -> Self {
        Self {
            words: Words::new(&[(ARR, 0xFFFF), (AF1, 1), (AF2, 1)]),
            compares: [0; 4],
            reload: 0xFFFF,
            repetitions: 0,
            clock: Frequency(0),
            since: Time::ZERO,
            next: None,
            is_locked: false,
            break_inputs: [false; 2],
            is_supply_low: false,
            is_stopped: false,
            switched: Vec::new(),
        }
    }

    /// Registers take their reset values; what was switched stays known.
    pub(crate) fn reset(&mut self, now: Time) {
        let was_on = self.is_driving();
        let switched = std::mem::take(&mut self.switched);
        *self = Self { break_inputs: self.break_inputs, switched, ..Self::new() };
        if was_on {
            self.switched.push((now, false));
        }
    }

    fn bdtr(&self) -> BdtrAdv {
        BdtrAdv(self.words[BDTR])
    }

    fn half(&self) -> Time {
        self.clock.cycles(u64::from(self.reload))
    }

    /// Whether the half bridges are driven: main output, channels and counter are on.
    pub fn is_driving(&self) -> bool {
        let is_on = self.bdtr().moe() && !self.is_stopped;
        is_on && self.words[CCER] & ALL_OUTPUTS == ALL_OUTPUTS && bit(self.words[CR1], 0)
    }

    /// Shares of the period in which the high sides are on; none where the outputs are off.
    pub fn duties(&self) -> Option<[f64; 3]> {
        let [u, v, w, _] = self.compares;
        let top = f64::from(self.reload.max(1));
        self.is_driving().then(|| [u, v, w].map(|compare| (f64::from(compare) / top).min(1.0)))
    }

    /// Length of a half period.
    pub(crate) fn half_period(&self) -> Time {
        self.half()
    }

    pub(crate) fn next_event(&self) -> Time {
        self.next.map_or(Time::NEVER, |(time, _)| time)
    }

    /// Another clock from now on. The counter keeps its value, but counts from 0 after the clock had stopped.
    pub(crate) fn set_clock(&mut self, clock: Frequency, now: Time) {
        if clock == self.clock {
            return;
        }
        let counts = self.counts(now);
        self.clock = clock;
        if let Some((_, moment)) = self.next {
            let cycles = match moment {
                Moment::Trigger => self.compares[3],
                Moment::Top => self.reload,
                Moment::Bottom => 2 * self.reload,
            };
            self.since = now - clock.cycles(counts);
            self.next = Some((self.since + clock.cycles(u64::from(cycles)), moment));
        }
    }

    /// What happens now; the next one is then due.
    pub(crate) fn advance(&mut self, now: Time) -> Option<Moment> {
        let (time, moment) = self.next.filter(|(time, _)| *time <= now)?;
        match moment {
            Moment::Trigger => {}
            Moment::Top => self.end(),
            Moment::Bottom => {
                self.since = time;
                self.end();
            }
        }
        self.schedule(Some(moment));
        Some(moment)
    }

    /// What comes after `last` in the period that began at `since`.
    fn schedule(&mut self, last: Option<Moment>) {
        if !bit(self.words[CR1], 0) {
            self.next = None;
            return;
        }
        let rise = self.compares[3];
        let has_trigger = rise > 0 && rise < self.reload;
        let (cycles, moment) = match last {
            None | Some(Moment::Bottom) if has_trigger => (rise, Moment::Trigger),
            None | Some(Moment::Bottom | Moment::Trigger) => (self.reload, Moment::Top),
            Some(Moment::Top) => (2 * self.reload, Moment::Bottom),
        };
        self.next = Some((self.since + self.clock.cycles(u64::from(cycles)), moment));
    }

    /// An end of the counter: after as many as RCR says, an update (28.3.3).
    fn end(&mut self) {
        match self.repetitions {
            0 => self.update(),
            _ => self.repetitions -= 1,
        }
    }

    fn update(&mut self) {
        self.reload = self.words[ARR];
        self.repetitions = self.words[RCR];
        self.compares = [0, 1, 2, 3].map(|channel| self.words[CCR0 + 4 * channel]);
        self.words[SR] |= UPDATE;
    }

    /// Whether the rise of the fourth channel's reference is the trigger TRGO2: PWM mode 2 and MMS2.
    pub(crate) fn triggers_converter(&self) -> bool {
        let mode = self.words[CCMR_OUTPUT1] >> 12 & 7 | self.words[CCMR_OUTPUT1] >> 21 & 8;
        mode == 7 && self.words[CR2] >> 20 & 0xF == 7 && !self.is_stopped
    }

    /// Whether TRGO follows the update event: MMS.
    pub(crate) fn triggers_on_update(&self) -> bool {
        self.words[CR2] >> 4 & 7 == 2 && !self.is_stopped
    }

    /// From when to when in this period each low side is on; none where the outputs are off.
    pub(crate) fn low_side_windows(&self) -> Option<[[Time; 2]; 3]> {
        let dead = u64::from(self.bdtr().dtg());
        let at = |counts: u64| self.since + self.clock.cycles(counts);
        let window = |compare: u32| match u64::from(compare) {
            0 => [Time::ZERO, Time::NEVER],
            compare => [at(compare + dead), at(2 * u64::from(self.reload) - compare)],
        };
        let [u, v, w, _] = self.compares;
        self.is_driving().then(|| [u, v, w].map(window))
    }

    /// A debugger stops or continues the counter. Its events continue, as the time of what it drives does.
    pub(crate) fn set_stopped(&mut self, is_stopped: bool, now: Time) {
        let was_on = self.is_driving();
        self.is_stopped = is_stopped;
        if self.is_driving() != was_on {
            self.switched.push((now, !was_on));
        }
    }

    /// The level at a break input changes.
    pub(crate) fn set_break_input(&mut self, input: usize, level: bool, now: Time) {
        self.break_inputs[input] = level;
        self.check_breaks(now);
    }

    /// An internal source of the break; the clock security system always is one. BKE enables all of them (28.6.20).
    pub(crate) fn system_break(&mut self, _: Option<BreakSource>, now: Time) {
        if self.bdtr().bke(0) {
            self.words[SR] |= SYSTEM_BREAK;
            self.switch_off(now);
        }
    }

    /// The supply's detector, connected to the break: as long as it is active the outputs cannot be switched on.
    pub(crate) fn set_supply_break(&mut self, is_low: bool, now: Time) {
        self.is_supply_low = is_low;
        self.check_breaks(now);
    }

    fn switch_off(&mut self, now: Time) {
        let was_on = self.is_driving();
        let mut bdtr = self.bdtr();
        bdtr.set_moe(false);
        self.words[BDTR] = bdtr.0;
        if was_on {
            self.switched.push((now, false));
        }
    }

    /// Whether a break input is active: enabled, connected to its pin, at its active level.
    fn is_broken(&self) -> [bool; 2] {
        let bdtr = self.bdtr();
        [0, 1].map(|input| {
            let af = Af1Adv(self.words[if input == 0 { AF1 } else { AF2 }]);
            let active_high = bdtr.bkp(input).to_bits() == 1;
            // Polarity of the pin's own path, BKINP.
            let level = self.break_inputs[input] != bit(af.0, 9);
            bdtr.bke(input) && af.bkine() && level == active_high
        })
    }

    /// Flags of the breaks that are active.
    fn active_breaks(&self) -> u32 {
        let [first, second] = self.is_broken();
        let system = self.is_supply_low && self.bdtr().bke(0);
        u32::from(first) * BREAK + u32::from(second) * BREAK_2 + u32::from(system) * SYSTEM_BREAK
    }

    fn check_breaks(&mut self, now: Time) {
        let broken = self.is_broken();
        self.words[SR] |= self.active_breaks();
        if broken.contains(&true) && self.bdtr().moe() {
            self.switch_off(now);
        }
        if self.is_supply_low {
            self.system_break(Some(BreakSource::Supply), now);
        }
    }

    /// Levels of the interrupts: break, update.
    pub(crate) fn interrupts(&self) -> [bool; 2] {
        let active = self.words[SR] & self.words[DIER];
        let breaks = active & BREAK != 0
            || self.words[SR] & (BREAK_2 | SYSTEM_BREAK) != 0 && bit(self.words[DIER], 7);
        [breaks, active & UPDATE != 0]
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CNT => self.count(context.now),
            EGR => 0,
            CR1..=CCR3 | BDTR | DTR2 | AF1 | AF2 => self.words[offset],
            _ => context.unmodelled(offset),
        }
    }

    /// Cycles of the clock since the counter was last at 0.
    fn counts(&self, now: Time) -> u64 {
        now.since(self.since).ps() / self.clock.period().ps()
    }

    fn count(&self, now: Time) -> u32 {
        if !bit(self.words[CR1], 0) || self.clock.0 == 0 {
            return 0;
        }
        let ticks = self.counts(now) as u32 % (2 * self.reload).max(1);
        ticks.min(2 * self.reload - ticks)
    }

    /// `has_pins`: the six outputs are connected to the timer.
    pub(crate) fn write(&mut self, offset: u32, value: u32, has_pins: bool, context: &mut Context) {
        let was_on = self.is_driving();
        match offset {
            CR1 => {
                if value & 1 != 0 && value & 0x60 != 0x20 {
                    context
                        .unmodelled_setting(offset, "pulses that are not centre-aligned, mode 1");
                }
                let starts = bit(value, 0) && !bit(self.words[CR1], 0);
                self.words[CR1] = value;
                if starts {
                    self.clock = context.clocks.apb2_timers;
                    self.since = context.now;
                }
                if starts || !bit(value, 0) {
                    self.schedule(None);
                }
            }
            EGR => {
                if bit(value, 0) {
                    self.update();
                }
                if value & (BREAK | BREAK_2) != 0 {
                    self.words[SR] |= value & (BREAK | BREAK_2);
                    self.switch_off(context.now);
                }
            }
            // A flag of a break that is active stays (28.6.6).
            SR => self.words[SR] &= value | self.active_breaks(),
            BDTR => self.write_bdtr(value, context),
            CCR0..=CCR3 => self.words[offset] = value & 0xFFFF,
            ARR | RCR => self.words[offset] = value & 0xFFFF,
            PSC | SMCR | DTR2 if value != 0 => context
                .unmodelled_setting(offset, "a prescaler, a slave mode, asymmetric dead times"),
            PSC | SMCR | DTR2 => {}
            CR2 if self.is_locked && (self.words[CR2] ^ value) & LOCKED_IDLE_LEVELS != 0 => {
                context.write_protected(offset, "bits that LOCK protects")
            }
            CR2 | DIER | CCMR_OUTPUT0 | CCMR_OUTPUT1 | CCER | AF1 | AF2 => {
                self.words[offset] = value
            }
            _ => context.unmodelled_write(offset),
        }
        self.check_breaks(context.now);
        let is_on = self.is_driving();
        if is_on && !was_on {
            self.check_bridge(has_pins, context);
        }
        if is_on != was_on {
            self.switched.push((context.now, is_on));
        }
    }

    fn write_bdtr(&mut self, value: u32, context: &mut Context) {
        let old = self.words[BDTR];
        let keeps = if self.is_locked { LOCKED | LOCK } else { 0 };
        if (old ^ value) & keeps != 0 {
            context.write_protected(BDTR, "bits that LOCK protects");
        }
        self.words[BDTR] = value & !keeps | old & keeps;
        // "This flag must be reset to re-start PWM operation" (28.6.6, SBIF).
        if self.words[SR] & SYSTEM_BREAK != 0 && old & MAIN_OUTPUT == 0 {
            self.words[BDTR] &= !MAIN_OUTPUT;
        }
        if self.bdtr().aoe() {
            context.unmodelled_setting(BDTR, "outputs that come back by themselves");
        }
        self.is_locked |= value & LOCK != 0;
    }

    fn check_bridge(&self, has_pins: bool, context: &mut Context) {
        if !has_pins {
            context.report(
                Kind::PinNotConnected,
                BDTR,
                "the main output is on and a pin of it is not the timer's",
            );
        }
        if self.bdtr().dtg() == 0 {
            context.report(Kind::UnsafeBridge, BDTR, "no dead time between high and low side");
        }
        // Every output active high, and each pair complementary.
        if self.words[CCER] & 0xAAA != 0 {
            context.report(Kind::UnsafeBridge, CCER, "an output is inverted");
        }
    }
}
