//! Synchronisation of virtual time with the wall clock.

use std::thread;
use std::time::{Duration, Instant};

use emulator::Time;

/// Larger lag is not recovered: running a burst at full speed would distort real-time behaviour.
const LATE: Duration = Duration::from_millis(200);

/// Pacing state.
pub struct Pace {
    /// Virtual seconds per second; `None` for maximum speed.
    speed: Option<f64>,
    started: Instant,
    /// Both clocks at the reference time.
    from: (Duration, Time),
    /// Total lag of virtual time.
    behind: Duration,
}

impl Pace {
    /// Reference at virtual time zero.
    pub fn new(speed: Option<f64>) -> Self {
        Self {
            speed,
            started: Instant::now(),
            from: (Duration::ZERO, Time::ZERO),
            behind: Duration::ZERO,
        }
    }

    /// Sleeps until the wall clock reaches this virtual time.
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

    /// Seconds of wall-clock time.
    pub fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// True if virtual time kept up with the requested speed.
    pub fn keeps_up(&self) -> bool {
        self.behind.is_zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_time_waits_and_lost_time_is_not_recovered() {
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
    fn maximum_speed_does_not_wait() {
        let mut pace = Pace::new(None);
        let before = Instant::now();
        pace.wait(Time::from_ms(100_000));
        assert!(before.elapsed() < Duration::from_secs(10) && pace.keeps_up());
    }
}
