//! Time of the tasks: the timer of the board, or the virtual time of a simulation.

use embassy_futures::select::{Either, select};

/// A clock with asynchronous waiting.
pub trait Clock {
    /// Microseconds since boot.
    fn now_us(&self) -> u64;

    /// Waits until [`Clock::now_us`] is at least `time_us`.
    fn until(&self, time_us: u64) -> impl Future<Output = ()>;
}

impl<C: Clock> Clock for &C {
    fn now_us(&self) -> u64 {
        C::now_us(self)
    }

    fn until(&self, time_us: u64) -> impl Future<Output = ()> {
        C::until(self, time_us)
    }
}

/// Waits for `length_us`.
pub async fn delay_us<C: Clock>(clock: &C, length_us: u64) {
    clock.until(clock.now_us().saturating_add(length_us)).await;
}

/// Output of a future, or `None` if it takes longer than `length_us`; then it is cancelled.
pub async fn with_timeout_us<C: Clock, F: Future>(
    clock: &C,
    length_us: u64,
    future: F,
) -> Option<F::Output> {
    match select(future, delay_us(clock, length_us)).await {
        Either::First(output) => Some(output),
        Either::Second(()) => None,
    }
}
