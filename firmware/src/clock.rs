//! Time of the tasks: the timer of the board, or the virtual time of a simulation.

use embassy_futures::select::{Either, select};
use embedded_hal_async::delay::DelayNs;

/// A clock with asynchronous waiting.
pub trait Clock {
    /// Microseconds since boot.
    fn now_us(&self) -> u64;

    /// Waits until [`Clock::now_us`] is at least `time_us`. The future may be polled again after its end.
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

/// A value with the time of its measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timed<T> {
    /// In microseconds since boot.
    pub time_us: u64,
    /// The value.
    pub value: T,
}

impl<T: Copy> Timed<T> {
    /// Age at `time_us` in microseconds, negative if measured after it, and the value; `None` if older than `max_us`.
    pub fn fresh(&self, time_us: u64, max_us: i64) -> Option<(i64, T)> {
        let age_us = (time_us as i64).saturating_sub(self.time_us as i64);
        (age_us <= max_us).then_some((age_us, self.value))
    }
}

/// Waits on a clock, for drivers.
#[derive(Clone, Copy, Debug)]
pub struct ClockDelay<'c, C>(pub &'c C);

impl<C: Clock> DelayNs for ClockDelay<'_, C> {
    async fn delay_ns(&mut self, ns: u32) {
        delay_us(self.0, u64::from(ns.div_ceil(1000))).await;
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
