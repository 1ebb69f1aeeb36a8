//! Clock of the tasks.

use core::future::poll_fn;
use core::pin::pin;
use core::task::Poll;

use embassy_time::{Instant, Timer};

use crate::clock::Clock;

/// Time of the timer that `embassy-time` uses.
#[derive(Clone, Copy, Debug)]
pub struct BoardClock;

impl Clock for BoardClock {
    fn now_us(&self) -> u64 {
        Instant::now().as_micros()
    }

    /// Unlike [`Timer`], does not search all tasks for the next alarm each time the waiting task is polled: the queue ignores a
    /// later time than the one that the task waits for.
    fn until(&self, time_us: u64) -> impl Future<Output = ()> {
        let mut alarm_us = time_us;
        poll_fn(move |context| {
            if self.now_us() >= time_us {
                return Poll::Ready(());
            }
            let _ = pin!(Timer::at(Instant::from_micros(alarm_us))).poll(context);
            alarm_us = time_us.saturating_add(1);
            Poll::Pending
        })
    }
}
