//! Timing of an I2C bus: the register of the peripheral from its clock, by the bus specification
//! (UM10204, revision 7) and the equations of RM0440 (40.4.9, 40.4.10).

/// How fast a bus is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// 400 kHz.
    Fast,
    /// 1 MHz; needs the drivers of 20 mA.
    FastPlus,
}

/// Times of a mode in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Shortest period of the clock.
    pub period: u32,
    /// The clock stays low at least so long.
    pub low: u32,
    /// And high at least so long.
    pub high: u32,
    /// Data stand still so long before the clock rises.
    pub setup: u32,
    /// Data are valid at the latest so long after the clock fell.
    pub valid: u32,
    /// Longest rise.
    pub rise: u32,
}

/// Edges of a board's bus in nanoseconds: pull-ups, drivers and lines make them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edges {
    /// From 30 to 70 % of the supply.
    pub rise: u32,
    /// From 70 to 30 %.
    pub fall: u32,
}

impl Mode {
    /// What the specification asks for.
    pub const fn limits(self) -> Limits {
        match self {
            Self::Fast => Limits {
                period: 2500,
                low: 1300,
                high: 600,
                setup: 100,
                valid: 900,
                rise: 300,
            },
            Self::FastPlus => Limits {
                period: 1000,
                low: 500,
                high: 260,
                setup: 50,
                valid: 450,
                rise: 120,
            },
        }
    }
}

/// Shortest and longest delay of the analogue filter in nanoseconds.
pub const FILTER: (u32, u32) = (50, 260);

/// Fields of the register, as counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Clock divider less one.
    pub prescaler: u8,
    /// Setup of data less one.
    pub setup: u8,
    /// Hold of data.
    pub hold: u8,
    /// High time less one.
    pub high: u8,
    /// Low time less one.
    pub low: u8,
}

impl Timing {
    /// The register's word.
    pub const fn word(self) -> u32 {
        ((self.prescaler as u32) << 28)
            | ((self.setup as u32) << 20)
            | ((self.hold as u32) << 16)
            | ((self.high as u32) << 8)
            | self.low as u32
    }
}

/// The fastest timing within the specification at a peripheral clock of `kernel_hz`, with the finest steps;
/// `None` where that clock is too slow or too fast for any, or the edges leave no time.
pub const fn timing(kernel_hz: u32, mode: Mode, edges: Edges) -> Option<Timing> {
    let limits = mode.limits();
    // The peripheral sees each phase only where four of its clocks fit the low one beside the filter.
    let in_time = 4_000_000_000 <= (limits.low - FILTER.0) as u64 * kernel_hz as u64;
    if edges.rise > limits.rise || !in_time {
        return None;
    }
    let mut prescaler = 0;
    while prescaler < 16 {
        if let Some(timing) = with(kernel_hz, prescaler, &limits, edges) {
            return Some(timing);
        }
        prescaler += 1;
    }
    None
}

const fn with(kernel_hz: u32, prescaler: u8, limits: &Limits, edges: Edges) -> Option<Timing> {
    let divided = prescaler as u64 + 1;
    let setup = up(edges.rise + limits.setup, kernel_hz, divided);
    // Beside what the register asks for, each phase lasts until the bus has followed and the filter and two
    // clocks of synchronisation have passed. The shortest of these count: edges without slope.
    let synced = FILTER.0 as u64 + 2 * 1_000_000_000 / kernel_hz as u64;
    let low = up(limits.low, kernel_hz, divided);
    let high = up(limits.high, kernel_hz, divided);
    let spare = (limits.period as u64).saturating_sub(2 * synced) as u32;
    let all = up(spare, kernel_hz, divided);
    // What the period leaves beside the shortest phases goes to the low one, which the slow edges eat.
    let low = if all > low + high { all - high } else { low };
    // Data must not change before the clock has surely fallen.
    let clocks = 3 * 1_000_000_000 / kernel_hz as u64;
    let hold_ns = (edges.fall as u64).saturating_sub(FILTER.0 as u64 + clocks) as u32;
    let hold = up(hold_ns, kernel_hz, divided);
    let longest = (limits.valid as u64)
        .saturating_sub(edges.rise as u64 + FILTER.1 as u64 + 4 * 1_000_000_000 / kernel_hz as u64);
    let hold_fits = hold * divided * 1_000_000_000 <= longest * kernel_hz as u64 || hold == 0;
    if setup > 16 || low > 256 || high > 256 || hold > 15 || !hold_fits || setup == 0 {
        return None;
    }
    Some(Timing {
        prescaler,
        setup: (setup - 1) as u8,
        hold: hold as u8,
        high: (high - 1) as u8,
        low: (low - 1) as u8,
    })
}

/// Steps of the divided clock that last at least `ns` nanoseconds.
const fn up(ns: u32, kernel_hz: u32, divided: u64) -> u64 {
    (ns as u64 * kernel_hz as u64).div_ceil(1_000_000_000 * divided)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nanoseconds of `steps` of the divided clock.
    fn ns(steps: u32, timing: Timing, kernel_hz: u32) -> f64 {
        f64::from(steps) * f64::from(timing.prescaler + 1) * 1e9 / f64::from(kernel_hz)
    }

    fn check(word: Timing, kernel_hz: u32, mode: Mode, edges: Edges) {
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
        assert!(
            setup >= rise + f64::from(limits.setup),
            "setup {setup} ns: {here}"
        );
        assert!(
            hold >= fall - fastest - 3.0 * clock - 1.0,
            "hold {hold} ns: {here}"
        );
        let valid = hold + rise + slowest + 4.0 * clock;
        assert!(
            hold == 0.0 || valid <= f64::from(limits.valid) + 1.0,
            "valid {valid} ns: {here}"
        );
        let period = low + high + 2.0 * (fastest + 2.0 * clock);
        assert!(
            period >= f64::from(limits.period) - 1.0,
            "too fast, {period} ns: {here}"
        );
    }

    const fn edges(rise: u32, fall: u32) -> Edges {
        Edges { rise, fall }
    }

    const EDGES: [Edges; 4] = [edges(20, 5), edges(60, 10), edges(100, 60), edges(120, 120)];

    #[test]
    fn every_timing_keeps_to_the_specification_over_all_clocks_and_edges() {
        for (mode, edges) in [Mode::Fast, Mode::FastPlus]
            .into_iter()
            .flat_map(|m| EDGES.map(|e| (m, e)))
        {
            let mut found = 0;
            for mhz in 4..=170 {
                let kernel_hz = mhz * 1_000_000;
                if let Some(timing) = timing(kernel_hz, mode, edges) {
                    check(timing, kernel_hz, mode, edges);
                    found += 1;
                }
            }
            // The slowest edges of all leave no time for data in the fast mode plus.
            let possible = mode == Mode::Fast || edges.fall < 120;
            assert!(
                !possible || found >= 130,
                "{mode:?}, {edges:?}: only {found} clocks"
            );
        }
    }

    #[test]
    fn the_bus_is_hardly_slower_than_its_mode_allows() {
        for (kernel_hz, mode) in [
            (160_000_000, Mode::FastPlus),
            (160_000_000, Mode::Fast),
            (16_000_000, Mode::Fast),
        ] {
            let timing = timing(kernel_hz, mode, EDGES[1]).unwrap();
            let steps = u32::from(timing.low) + u32::from(timing.high) + 2;
            let synced = f64::from(FILTER.0) + 2e9 / f64::from(kernel_hz);
            let period = ns(steps, timing, kernel_hz) + 2.0 * synced;
            let limit = 1.03 * f64::from(mode.limits().period);
            assert!(period <= limit, "{period} ns at {kernel_hz} Hz");
        }
    }

    #[test]
    fn the_word_has_its_fields_in_place() {
        let timing = Timing {
            prescaler: 1,
            setup: 2,
            hold: 3,
            high: 0x45,
            low: 0x67,
        };
        assert_eq!(timing.word(), 0x1023_4567);
    }

    #[test]
    fn where_clock_or_edges_leave_no_time_there_is_no_timing() {
        assert_eq!(timing(0, Mode::Fast, EDGES[0]), None);
        assert_eq!(timing(1_000_000, Mode::FastPlus, EDGES[0]), None);
        let slow = Edges {
            rise: 121,
            fall: 10,
        };
        assert_eq!(timing(160_000_000, Mode::FastPlus, slow), None);
    }
}
