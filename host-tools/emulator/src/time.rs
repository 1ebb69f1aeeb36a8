//! Time of the emulation: picoseconds since power-on, so that a cycle of every clock of the chip is a whole number
//! of units to within one part in 10^4 (160 MHz: 6250 ps, 16 MHz: 62,500 ps).

use std::ops::{Add, AddAssign, Sub};

/// A point in time, or a duration, in picoseconds. Wraps after 213 days.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(u64);

impl Time {
    /// Power-on.
    pub const ZERO: Self = Self(0);
    /// Later than everything that is scheduled.
    pub const NEVER: Self = Self(u64::MAX);

    /// So many picoseconds.
    pub const fn from_ps(ps: u64) -> Self {
        Self(ps)
    }

    /// So many nanoseconds.
    pub const fn from_ns(ns: u64) -> Self {
        Self(ns * 1000)
    }

    /// So many microseconds.
    pub const fn from_us(us: u64) -> Self {
        Self(us * 1_000_000)
    }

    /// So many milliseconds.
    pub const fn from_ms(ms: u64) -> Self {
        Self::from_us(ms * 1000)
    }

    /// Picoseconds.
    pub const fn ps(self) -> u64 {
        self.0
    }

    /// Whole nanoseconds.
    pub const fn ns(self) -> u64 {
        self.0 / 1000
    }

    /// Whole microseconds.
    pub const fn us(self) -> u64 {
        self.0 / 1_000_000
    }

    /// Milliseconds, for reports.
    pub fn as_ms(self) -> f64 {
        self.0 as f64 / 1e9
    }

    /// Seconds, for reports.
    pub fn as_s(self) -> f64 {
        self.0 as f64 / 1e12
    }

    /// The time from another point to this one; zero where that is later.
    pub const fn since(self, earlier: Self) -> Self {
        Self(self.0.saturating_sub(earlier.0))
    }
}

impl Add for Time {
    type Output = Self;

    /// [`Time::NEVER`] stays what it is.
    fn add(self, duration: Self) -> Self {
        Self(self.0.saturating_add(duration.0))
    }
}

impl AddAssign for Time {
    fn add_assign(&mut self, duration: Self) {
        *self = *self + duration;
    }
}

impl Sub for Time {
    type Output = Self;

    fn sub(self, earlier: Self) -> Self {
        self.since(earlier)
    }
}

/// A frequency in hertz; zero where a clock is off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Frequency(pub u32);

impl Frequency {
    /// One cycle, rounded to a picosecond; [`Time::NEVER`] of a clock that is off.
    pub const fn period(self) -> Time {
        match self.0 {
            0 => Time::NEVER,
            hz => Time((1_000_000_000_000 + hz as u64 / 2) / hz as u64),
        }
    }

    /// So many cycles; [`Time::NEVER`] of a clock that is off. Rounds once, not in each cycle.
    pub const fn cycles(self, count: u64) -> Time {
        match self.0 {
            0 => Time::NEVER,
            hz => {
                let ps = count as u128 * 1_000_000_000_000 / hz as u128;
                Time(if ps > u64::MAX as u128 { u64::MAX } else { ps as u64 })
            }
        }
    }

    /// Divided by a prescaler.
    pub const fn divided_by(self, divisor: u32) -> Self {
        Self(self.0 / divisor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_of_each_clock_in_picoseconds() {
        assert_eq!(Frequency(160_000_000).period(), Time::from_ps(6250));
        assert_eq!(Frequency(16_000_000).period(), Time::from_ps(62_500));
        assert_eq!(Frequency(24_000_000).period(), Time::from_ps(41_667));
        assert_eq!(Frequency(24_000_000).cycles(24), Time::from_us(1));
        assert_eq!(Frequency(32_000).cycles(640), Time::from_ms(20));
        assert_eq!(Frequency(0).period(), Time::NEVER);
        assert_eq!(Frequency(0).cycles(3), Time::NEVER);
    }

    #[test]
    fn never_plus_a_duration_is_never() {
        assert_eq!(Time::NEVER + Time::from_us(1), Time::NEVER);
        assert_eq!(Time::ZERO - Time::from_us(1), Time::ZERO);
    }
}
