//! Virtual time against the clock of this machine.

use std::thread;
use std::time::{Duration, Instant};

use sim_board::Time;

/// Virtual time that is later than this is not caught up with: a burst at full speed would be no time to rely on.
const LATE: Duration = Duration::from_millis(200);

/// The pace.
pub struct Pace {
    /// Virtual seconds in a second; none: as fast as this machine computes.
    speed: Option<f64>,
    started: Instant,
    /// Both clocks at the moment from which the pace counts.
    from: (Duration, Time),
    /// By how much virtual time fell behind in total.
    behind: Duration,
}

impl Pace {
    /// Starts with virtual time at zero.
    pub fn new(speed: Option<f64>) -> Self {
        Self {
            speed,
            started: Instant::now(),
            from: (Duration::ZERO, Time::ZERO),
            behind: Duration::ZERO,
        }
    }

    /// Waits until it is this late.
    pub fn wait(&mut self, now: Time) {
        let Some(speed) = self.speed else { return };
        let (from, from_virtual) = self.from;
        let due = from + Duration::from_secs_f64((now - from_virtual).as_s() / speed);
        let elapsed = self.started.elapsed();
        match elapsed.checked_sub(due) {
            None => thread::sleep(due - elapsed),
            Some(late) if late > LATE => {
                self.behind += late;
                self.from = (elapsed, now);
            }
            Some(_) => {}
        }
    }

    /// Seconds of this machine's clock.
    pub fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Whether virtual time kept to the pace.
    pub fn keeps_up(&self) -> bool {
        self.behind.is_zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_time_waits_for_the_clock_and_no_lost_time_is_caught_up() {
        let mut pace = Pace::new(Some(2.0));
        pace.wait(Time::from_ms(60));
        let elapsed = pace.started.elapsed();
        assert!(elapsed >= Duration::from_millis(30), "{elapsed:?}");
        assert!(pace.keeps_up());
        thread::sleep(LATE + Duration::from_millis(60));
        pace.wait(Time::from_ms(61));
        assert!(!pace.keeps_up());
        let before = Instant::now();
        pace.wait(Time::from_ms(81));
        assert!(before.elapsed() >= Duration::from_millis(9));
    }

    #[test]
    fn without_a_pace_nothing_waits() {
        let mut pace = Pace::new(None);
        let before = Instant::now();
        pace.wait(Time::from_ms(100_000));
        assert!(before.elapsed() < Duration::from_secs(10) && pace.keeps_up());
    }
}
