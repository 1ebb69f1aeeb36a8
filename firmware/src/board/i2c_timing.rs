//! Timing register of the I2C peripheral of the STM32 from its clock, by the bus specification (UM10204, revision 7) and
//! the equations of RM0440 (40.4.9, 40.4.10).

/// Speed mode of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum I2cMode {
    /// 400 kHz.
    Fast,
    /// 1 MHz; requires 20 mA drivers.
    FastPlus,
}

/// Limits of a mode in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct I2cLimits {
    /// Shortest period of the clock.
    pub period: u32,
    /// Shortest low time of the clock.
    pub low: u32,
    /// Shortest high time of the clock.
    pub high: u32,
    /// Shortest setup time of data before the clock rises.
    pub setup: u32,
    /// Longest time from the falling clock to valid data.
    pub valid: u32,
    /// Longest rise time.
    pub rise: u32,
}

/// Edge times of the bus of a board in nanoseconds, given by pull-ups, drivers and lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EdgeTimes {
    /// From 30 to 70 % of the supply.
    pub rise: u32,
    /// From 70 to 30 %.
    pub fall: u32,
}

impl I2cMode {
    /// Limits by the specification.
    pub const fn limits(self) -> I2cLimits {
        match self {
            Self::Fast => {
                I2cLimits { period: 2500, low: 1300, high: 600, setup: 100, valid: 900, rise: 300 }
            }
            Self::FastPlus => {
                I2cLimits { period: 1000, low: 500, high: 260, setup: 50, valid: 450, rise: 120 }
            }
        }
    }
}

/// Shortest and longest delay of the analogue filter in nanoseconds.
pub const FILTER: (u32, u32) = (50, 260);

/// Fields of the register in counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct I2cTiming {
    /// Clock divider minus one.
    pub prescaler: u8,
    /// Data setup time minus one.
    pub setup: u8,
    /// Data hold time.
    pub hold: u8,
    /// High time minus one.
    pub high: u8,
    /// Low time minus one.
    pub low: u8,
}

impl I2cTiming {
    /// Value of the register.
    pub const fn word(self) -> u32 {
        ((self.prescaler as u32) << 28)
            | ((self.setup as u32) << 20)
            | ((self.hold as u32) << 16)
            | ((self.high as u32) << 8)
            | self.low as u32
    }
}

/// The fastest timing within the specification at a peripheral clock of `kernel_hz`, with the smallest prescaler. `None` if
/// that clock or the edges do not allow any.
pub const fn i2c_timing(kernel_hz: u32, mode: I2cMode, edges: EdgeTimes) -> Option<I2cTiming> {
    let limits = mode.limits();
    // Four peripheral clocks must fit into the low phase, less the longest delay of the filter: in Fast-mode Plus that needs
    // 17 MHz (RM0440 41.4.2; ES0430 2.15.1: else data may be sampled wrongly).
    let in_time = 4_000_000_000 <= (limits.low - FILTER.1) as u64 * kernel_hz as u64;
    if edges.rise > limits.rise || !in_time {
        return None;
    }
    let mut prescaler = 0;
    while prescaler < 16 {
        if let Some(timing) = with_prescaler(kernel_hz, prescaler, &limits, edges) {
            return Some(timing);
        }
        prescaler += 1;
    }
    None
}

const fn with_prescaler(
    kernel_hz: u32,
    prescaler: u8,
    limits: &I2cLimits,
    edges: EdgeTimes,
) -> Option<I2cTiming> {
    let divided = prescaler as u64 + 1;
    let setup = steps_up(edges.rise + limits.setup, kernel_hz, divided);
    // Each phase is longer than its register value by the edge, the filter delay and two clocks of synchronisation. The
    // shortest of these count: no edge time.
    let synced = FILTER.0 as u64 + 2 * 1_000_000_000 / kernel_hz as u64;
    let low = steps_up(limits.low, kernel_hz, divided);
    let high = steps_up(limits.high, kernel_hz, divided);
    let spare = (limits.period as u64).saturating_sub(2 * synced) as u32;
    let all = steps_up(spare, kernel_hz, divided);
    // The remaining time goes to the low phase, which slow edges shorten.
    let low = if all > low + high { all - high } else { low };
    // Data must not change before the end of the falling edge.
    let clocks = 3 * 1_000_000_000 / kernel_hz as u64;
    let hold_ns = (edges.fall as u64).saturating_sub(FILTER.0 as u64 + clocks) as u32;
    let hold = steps_up(hold_ns, kernel_hz, divided);
    let longest = (limits.valid as u64)
        .saturating_sub(edges.rise as u64 + FILTER.1 as u64 + 4 * 1_000_000_000 / kernel_hz as u64);
    let hold_fits = hold * divided * 1_000_000_000 <= longest * kernel_hz as u64 || hold == 0;
    if setup > 16 || low > 256 || high > 256 || hold > 15 || !hold_fits || setup == 0 {
        return None;
    }
    Some(I2cTiming {
        prescaler,
        setup: (setup - 1) as u8,
        hold: hold as u8,
        high: (high - 1) as u8,
        low: (low - 1) as u8,
    })
}

/// Steps of the divided clock that last at least `ns` nanoseconds.
const fn steps_up(ns: u32, kernel_hz: u32, divided: u64) -> u64 {
    (ns as u64 * kernel_hz as u64).div_ceil(1_000_000_000 * divided)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nanoseconds of `steps` of the divided clock.
    fn ns(steps: u32, timing: I2cTiming, kernel_hz: u32) -> f64 {
        f64::from(steps) * f64::from(timing.prescaler + 1) * 1e9 / f64::from(kernel_hz)
    }

    fn check(word: I2cTiming, kernel_hz: u32, mode: I2cMode, edges: EdgeTimes) {
        let limits = mode.limits();
        let low = ns(u32::from(word.low) + 1, word, kernel_hz);
        let high = ns(u32::from(word.high) + 1, word, kernel_hz);
        let setup = ns(u32::from(word.setup) + 1, word, kernel_hz);
        let hold = ns(u32::from(word.hold), word, kernel_hz);
        let clock = 1e9 / f64::from(kernel_hz);
        let (rise, fall) = (f64::from(edges.rise), f64::from(edges.fall));
        let (fastest, slowest) = (f64::from(FILTER.0), f64::from(FILTER.1));
        let here = std::format!("{word:?} at {kernel_hz} Hz, {mode:?}, {edges:?}");
        assert!(low >= f64::from(limits.low), "low {low} ns: {here}");
        assert!(high >= f64::from(limits.high), "high {high} ns: {here}");
        assert!(setup >= rise + f64::from(limits.setup), "setup {setup} ns: {here}");
        assert!(hold >= fall - fastest - 3.0 * clock - 1.0, "hold {hold} ns: {here}");
        let valid = hold + rise + slowest + 4.0 * clock;
        assert!(hold == 0.0 || valid <= f64::from(limits.valid) + 1.0, "valid {valid} ns: {here}");
        let period = low + high + 2.0 * (fastest + 2.0 * clock);
        assert!(period >= f64::from(limits.period) - 1.0, "too fast, {period} ns: {here}");
    }

    const fn edges(rise: u32, fall: u32) -> EdgeTimes {
        EdgeTimes { rise, fall }
    }

    const EDGES: [EdgeTimes; 4] = [edges(20, 5), edges(60, 10), edges(100, 60), edges(120, 120)];

    #[test]
    fn timings_meet_specification_for_all_clocks_and_edges() {
        for (mode, edges) in
            [I2cMode::Fast, I2cMode::FastPlus].into_iter().flat_map(|m| EDGES.map(|e| (m, e)))
        {
            let mut found = 0;
            for mhz in 4..=170 {
                let kernel_hz = mhz * 1_000_000;
                if let Some(timing) = i2c_timing(kernel_hz, mode, edges) {
                    check(timing, kernel_hz, mode, edges);
                    found += 1;
                }
            }
            // The slowest edges leave no time for data in fast mode plus.
            let possible = mode == I2cMode::Fast || edges.fall < 120;
            assert!(!possible || found >= 130, "{mode:?}, {edges:?}: only {found} clocks");
        }
    }

    #[test]
    fn bus_period_is_within_3_percent_of_limit() {
        for (kernel_hz, mode) in [
            (160_000_000, I2cMode::FastPlus),
            (160_000_000, I2cMode::Fast),
            (16_000_000, I2cMode::Fast),
        ] {
            let timing = i2c_timing(kernel_hz, mode, EDGES[1]).unwrap();
            let steps = u32::from(timing.low) + u32::from(timing.high) + 2;
            let synced = f64::from(FILTER.0) + 2e9 / f64::from(kernel_hz);
            let period = ns(steps, timing, kernel_hz) + 2.0 * synced;
            let limit = 1.03 * f64::from(mode.limits().period);
            assert!(period <= limit, "{period} ns at {kernel_hz} Hz");
        }
    }

    #[test]
    fn word_places_the_fields() {
        let timing = I2cTiming { prescaler: 1, setup: 2, hold: 3, high: 0x45, low: 0x67 };
        assert_eq!(timing.word(), 0x1023_4567);
    }

    #[test]
    fn no_timing_for_slow_clock_or_slow_edges() {
        assert_eq!(i2c_timing(0, I2cMode::Fast, EDGES[0]), None);
        assert_eq!(i2c_timing(16_000_000, I2cMode::FastPlus, EDGES[0]), None);
        assert!(i2c_timing(17_000_000, I2cMode::FastPlus, EDGES[0]).is_some());
        let slow = EdgeTimes { rise: 121, fall: 10 };
        assert_eq!(i2c_timing(160_000_000, I2cMode::FastPlus, slow), None);
    }
}
