//! The board's clock of 32 bits, over its turns of 71.6 minutes.

/// A packet may be late by this; a step of the clock that is longer than the time that has passed is none.
const SLACK_S: f64 = 2.0;

/// The clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoardClock {
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    told: u32,
    time_us: u64,
    at_s: f64,
}

impl BoardClock {
    /// Microseconds since the board's start, or since it was first heard; `at_s` is when `told` was heard,
    /// in seconds. `None` where the clock does not go on: the board has started anew.
    pub fn take(&mut self, told: u32, at_s: f64) -> Option<u64> {
        let time_us = match self.last {
            None => u64::from(told),
            Some(last) => {
                let step_us = told.wrapping_sub(last.told);
                let passed_s = at_s - last.at_s + SLACK_S;
                if step_us == 0 || f64::from(step_us) > 1e6 * passed_s {
                    self.last = None;
                    return None;
                }
                last.time_us + u64::from(step_us)
            }
        };
        self.last = Some(Last {
            told,
            time_us,
            at_s,
        });
        Some(time_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_on_over_its_turn() {
        let mut clock = BoardClock::default();
        assert_eq!(clock.take(u32::MAX - 499, 0.0), Some(0xFFFF_FE0C));
        assert_eq!(clock.take(500, 0.001), Some(0xFFFF_FE0C + 1000));
    }

    #[test]
    fn a_clock_that_repeats_itself_or_goes_back_is_a_board_that_started_anew() {
        for again in [5_000_000, 4_999_000, 2_000] {
            let mut clock = BoardClock::default();
            clock.take(5_000_000, 10.0);
            assert_eq!(clock.take(again, 11.0), None);
            assert_eq!(
                clock.take(again + 1000, 11.0),
                Some(u64::from(again) + 1000)
            );
        }
        // Beyond half a turn the step back looks like one forward that is longer than what has passed.
        let mut clock = BoardClock::default();
        clock.take(3_000_000_000, 10.0);
        assert_eq!(clock.take(2_000, 12.0), None);
    }

    #[test]
    fn an_interruption_as_long_as_the_time_that_passed_is_a_gap() {
        let mut clock = BoardClock::default();
        clock.take(1_000_000, 0.0);
        assert_eq!(clock.take(61_000_000, 60.0), Some(61_000_000));
    }
}
