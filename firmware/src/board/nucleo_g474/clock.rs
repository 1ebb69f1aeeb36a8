//! Clock of the tasks.

use embassy_time::{Instant, Timer};

use crate::clock::Clock;

/// Time of the timer that `embassy-time` uses.
#[derive(Clone, Copy, Debug)]
pub struct BoardClock;

impl Clock for BoardClock {
    fn now_us(&self) -> u64 {
        Instant::now().as_micros()
    }

    async fn until(&self, time_us: u64) {
        Timer::at(Instant::from_micros(time_us)).await;
    }
}
