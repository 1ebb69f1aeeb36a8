//! A general-purpose timer of 32 bits that counts up, RM0440 section 29: TIM5, the time base of the firmware.

use crate::peripherals::{Context, Words, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};

registers! { "TIM5":
    CR1 = 0x00, CR2 = 0x04, SMCR = 0x08, DIER = 0x0C, SR = 0x10, EGR = 0x14, CCMR_OUTPUT0 = 0x18, CCMR_OUTPUT1 = 0x1C,
    CCER = 0x20, CNT = 0x24, PSC = 0x28, ARR = 0x2C, CCR0 = 0x34, CCR3 = 0x40,
}

const WORDS: usize = 17;
/// Flags of SR and enables of DIER that are modelled: update and the four compares.
const FLAGS: u32 = 0x1F;

/// The peripheral.
#[derive(Clone)]
pub struct Timer {
    words: Words<WORDS>,
    /// Prescaler in use; a new one is taken over with the next update.
    prescaler: u32,
    /// The counter was `from` at `since`.
    since: Time,
    from: u64,
    /// Counts up to which flags are set, on the scale of `from`; grows beyond the period.
    seen: u64,
    clock: Frequency,
}

impl Timer {
    pub(crate) fn new() -> Self {
        let words = Words::new(&[(ARR, u32::MAX)]);
        Self { words, prescaler: 0, since: Time::ZERO, from: 0, seen: 0, clock: Frequency(0) }
    }

    fn is_running(&self) -> bool {
        bit(self.words[CR1], 0) && self.clock.0 > 0
    }

    fn tick(&self) -> Time {
        self.clock.cycles(u64::from(self.prescaler) + 1)
    }

    pub(crate) fn period(&self) -> u64 {
        u64::from(self.words[ARR]) + 1
    }

    /// Counts since the timer was set last, not reduced to the period.
    fn count(&self, now: Time) -> u64 {
        if self.is_running() {
            self.from + now.since(self.since).ps() / self.tick().ps()
        } else {
            self.from
        }
    }

    /// The counter, without the effects that a read by the program has.
    pub(crate) fn counter(&self, now: Time) -> u32 {
        (self.count(now) % self.period()) as u32
    }

    /// Sets the flags of what has happened by now.
    fn catch_up(&mut self, now: Time) {
        let count = self.count(now);
        if count <= self.seen {
            return;
        }
        let (period, seen) = (self.period(), self.seen);
        let mut flags = u32::from(count / period > seen / period);
        for channel in 0..4 {
            let compare = u64::from(self.words[CCR0 + 4 * channel]);
            // Times that the counter has been at the compare value by a count.
            let passes = |count: u64| {
                if count >= compare { (count - compare) / period + 1 } else { 0 }
            };
            if compare < period && passes(count) > passes(seen) {
                flags |= 2 << channel;
            }
        }
        self.words[SR] |= flags;
        self.seen = count;
    }

    /// Takes the counter's value as the new beginning, keeping the phase of the prescaler.
    fn rebase(&mut self, now: Time) {
        let count = self.count(now);
        self.since = if self.is_running() {
            self.since + Time::from_ps((count - self.from) * self.tick().ps())
        } else {
            now
        };
        let whole = count / self.period() * self.period();
        self.from = count - whole;
        self.seen = self.seen.max(count) - whole;
    }

    /// When an enabled flag is set next.
    pub(crate) fn next_event(&self) -> Time {
        let enabled = self.words[DIER] & FLAGS;
        if !self.is_running() || enabled == 0 {
            return Time::NEVER;
        }
        let period = self.period();
        let after = |place: u64| {
            if self.seen < place {
                place
            } else {
                place + ((self.seen - place) / period + 1) * period
            }
        };
        let update = bit(enabled, 0).then(|| (self.seen / period + 1) * period);
        let compares = (0..4)
            .filter(|channel| bit(enabled, channel + 1))
            .map(|channel| u64::from(self.words[CCR0 + 4 * channel]));
        let compares = compares.filter(|compare| *compare < period).map(after);
        let next = update.into_iter().chain(compares).min();
        next.map_or(Time::NEVER, |count| {
            self.since + Time::from_ps((count - self.from).saturating_mul(self.tick().ps()))
        })
    }

    pub(crate) fn advance(&mut self, now: Time) {
        self.catch_up(now);
    }

    /// Level of its interrupt.
    pub(crate) fn interrupt(&self) -> bool {
        self.words[SR] & self.words[DIER] & FLAGS != 0
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        self.catch_up(context.now);
        match offset {
            CNT => self.counter(context.now),
            EGR => 0,
            CR1..=ARR | CCR0..=CCR3 => self.words[offset],
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        let now = context.now;
        if self.clock != context.clocks.apb1_timers {
            self.rebase(now);
            self.clock = context.clocks.apb1_timers;
        }
        self.catch_up(now);
        self.rebase(now);
        match offset {
            SR => self.words[SR] &= value,
            CNT => (self.from, self.seen, self.since) = (u64::from(value), u64::from(value), now),
            EGR => {
                if bit(value, 0) {
                    self.prescaler = self.words[PSC];
                    (self.from, self.seen, self.since) = (0, 0, now);
                    // CR1.URS: only an overflow sets the flag then.
                    self.words[SR] |= u32::from(!bit(self.words[CR1], 2));
                }
                self.words[SR] |= value & 0x1E;
            }
            CR1 => {
                if value & 0x7A != 0 {
                    context.unmodelled_setting(offset, "counting down, up and down, or once");
                }
                self.words[CR1] = value;
            }
            DIER => {
                if value & !FLAGS != 0 {
                    context.unmodelled_setting(offset, "a trigger's or a DMA request's enable");
                }
                self.words[DIER] = value;
            }
            CR2 | SMCR | CCMR_OUTPUT0 | CCMR_OUTPUT1 | CCER => {
                if value != 0 {
                    context.unmodelled_setting(offset, "a channel's pin, a trigger");
                }
                self.words[offset] = value;
            }
            PSC | ARR | CCR0..=CCR3 => self.words[offset] = value,
            _ => context.unmodelled_write(offset),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::peripherals::clocks::{Clocks, Rcc};
    use crate::violations::Violations;

    struct Bench {
        timer: Timer,
        clocks: Clocks,
        violations: Violations,
    }

    impl Bench {
        fn new() -> Self {
            let clocks = *Rcc::new(Frequency(24_000_000), Frequency(32_000)).clocks();
            Self { timer: Timer::new(), clocks, violations: Violations::default() }
        }

        fn write(&mut self, us: u64, offset: u32, value: u32) {
            let (now, base) = (Time::from_us(us), 0);
            let mut context =
                Context { now, clocks: &self.clocks, violations: &mut self.violations, base };
            self.timer.write(offset, value, &mut context);
        }

        fn read(&mut self, us: u64, offset: u32) -> u32 {
            let (now, base) = (Time::from_us(us), 0);
            let mut context =
                Context { now, clocks: &self.clocks, violations: &mut self.violations, base };
            self.timer.read(offset, &mut context)
        }
    }

    #[test]
    fn a_compare_raises_the_interrupt_once_a_period_at_its_count() {
        let mut bench = Bench::new();
        // 16 MHz / 16: counts of a microsecond; a period of 1000; compare 2 at 300.
        for (offset, value) in
            [(PSC, 15), (ARR, 999), (EGR, 1), (SR, 0), (CCR0 + 4, 300), (DIER, 4), (CR1, 1)]
        {
            bench.write(10, offset, value);
        }
        assert_eq!(bench.timer.next_event(), Time::from_us(310));
        bench.timer.advance(Time::from_us(309));
        assert!(!bench.timer.interrupt());
        bench.timer.advance(Time::from_us(310));
        assert!(bench.timer.interrupt());
        assert_eq!(bench.read(400, CNT), 390);
        bench.write(400, SR, !4);
        assert!(!bench.timer.interrupt());
        assert_eq!(bench.timer.next_event(), Time::from_us(1310));
        // A compare value that the counter has passed waits for the next period.
        bench.write(2100, CCR0 + 4, 50);
        bench.write(2100, SR, 0);
        assert_eq!(bench.timer.next_event(), Time::from_us(3060));
        assert_eq!(bench.read(3009, CNT), 999);
        assert_eq!(bench.read(3010, CNT), 0);
    }

    #[test]
    fn an_overflow_sets_the_update_flag() {
        let mut bench = Bench::new();
        for (offset, value) in [(PSC, 15), (ARR, 0xFFFF), (EGR, 1), (SR, 0), (DIER, 1), (CR1, 1)] {
            bench.write(0, offset, value);
        }
        assert_eq!(bench.timer.next_event(), Time::from_us(65_536));
        assert_eq!(bench.read(65_535, SR), 0b11110 & bench.read(65_535, SR));
        assert_eq!(bench.read(65_536, SR) & 1, 1);
    }
}
