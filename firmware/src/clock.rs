//! Time as the loops see it: the board's timer, or a simulation's virtual time.

use embassy_futures::select::{Either, select};

/// A clock that can be waited for.
pub trait Clock {
    /// Microseconds since boot.
    fn now_us(&self) -> u64;

    /// Waits until [`Clock::now_us`] is at least this; ends at once where it is already.
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

/// Waits for so many microseconds.
pub async fn pause<C: Clock>(clock: &C, length_us: u64) {
    clock.until(clock.now_us().saturating_add(length_us)).await;
}

/// What a future gives within so many microseconds; `None` where it takes longer, and is given up.
pub async fn within<C: Clock, F: Future>(
    clock: &C,
    length_us: u64,
    future: F,
) -> Option<F::Output> {
    match select(future, pause(clock, length_us)).await {
        Either::First(output) => Some(output),
        Either::Second(()) => None,
    }
}
