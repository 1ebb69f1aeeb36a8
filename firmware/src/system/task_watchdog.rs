//! Supervision of the tasks: the watchdog is fed only while every task makes progress.
//!
//! Each task checks in once per iteration ([`TaskProgress::check_in`]). [`TaskWatchdog::check`] runs every
//! [`FEED_PERIOD_MS`]. When a task has not checked in within its time-out, or never, feeding stops for good, and the
//! watchdog resets the chip after [`WATCHDOG_TIMEOUT_MS`]. From the last iteration to the reset it takes at most the sum of
//! the three times.
//!
//! The independent watchdog has its own oscillator of 32 kHz with a tolerance of some 10 %, and cannot be stopped. It covers
//! tasks that hang; the motor outputs have faster protections.

use core::sync::atomic::{AtomicU32, Ordering};

/// Feeding period.
pub const FEED_PERIOD_MS: u32 = 5;
/// Watchdog timeout.
pub const WATCHDOG_TIMEOUT_MS: u32 = 20;
// Tolerates a few late feeds and a fast oscillator.
const _: () = assert!(WATCHDOG_TIMEOUT_MS >= 3 * FEED_PERIOD_MS);

/// A supervised task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskId {
    /// [`crate::tasks::sense`], 1 kHz.
    Sense,
    /// [`crate::tasks::estimate`], 1 kHz.
    Estimate,
    /// [`crate::tasks::GripLoop`], 1 kHz.
    Grip,
    /// [`crate::tasks::transmit`]; at least 10 Hz by the heartbeat.
    Transmit,
    /// [`crate::tasks::host_service`]; also checks in without messages.
    HostService,
}

/// Count of the tasks.
pub const TASKS: usize = 5;

impl TaskId {
    /// All tasks.
    pub const ALL: [Self; TASKS] =
        [Self::Sense, Self::Estimate, Self::Grip, Self::Transmit, Self::HostService];

    /// Longest time between two check-ins. Assumed: ten ticks at 1 kHz, three heartbeats.
    pub const fn timeout_ms(self) -> u32 {
        match self {
            Self::Sense | Self::Estimate | Self::Grip => 10,
            Self::Transmit | Self::HostService => 300,
        }
    }
}

/// Check-in counters of the tasks.
#[derive(Debug, Default)]
pub struct TaskProgress {
    check_ins: [AtomicU32; TASKS],
}

impl TaskProgress {
    /// No check-ins yet.
    pub const fn new() -> Self {
        Self { check_ins: [const { AtomicU32::new(0) }; TASKS] }
    }

    /// Called by the task once per iteration, and from nowhere else: a check-in by a timer would hide a hang.
    pub fn check_in(&self, which: TaskId) {
        if let Some(check_ins) = self.check_ins.get(which as usize) {
            check_ins.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn check_ins(&self) -> [u32; TASKS] {
        self.check_ins.each_ref().map(|check_ins| check_ins.load(Ordering::Relaxed))
    }
}

/// Decides whether the watchdog may be fed.
#[derive(Clone, Copy, Debug)]
pub struct TaskWatchdog {
    /// Last value of each counter, and the time of its last change.
    last: [(u32, u32); TASKS],
    hung: Option<TaskId>,
}

impl TaskWatchdog {
    /// From now on each task must check in within its time-out.
    pub const fn new(now_ms: u32) -> Self {
        Self { last: [(0, now_ms); TASKS], hung: None }
    }

    /// Checks all tasks. Must be called every [`FEED_PERIOD_MS`].
    ///
    /// # Errors
    /// The first task that hangs; from then on always.
    pub fn check(&mut self, now_ms: u32, progress: &TaskProgress) -> Result<(), TaskId> {
        let check_ins = progress.check_ins();
        for ((which, last), check_ins) in TaskId::ALL.into_iter().zip(&mut self.last).zip(check_ins)
        {
            let (before, at_ms) = *last;
            if check_ins != before {
                *last = (check_ins, now_ms);
            } else if now_ms.wrapping_sub(at_ms) > which.timeout_ms() {
                self.hung.get_or_insert(which);
            }
        }
        self.hung.map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Check-in period of each task.
    const PERIOD_MS: [u32; TASKS] = [1, 1, 1, 100, 100];

    /// Runs the tasks, `which` only for the first `until_ms`. Returns the task that hangs, and the time of the last feed.
    fn run(start_ms: u32, which: TaskId, until_ms: u32) -> (Option<TaskId>, u32) {
        let progress = TaskProgress::new();
        let mut watchdog = TaskWatchdog::new(start_ms);
        let mut fed_ms = 0;
        for ms in 0..10_000 {
            for (each, period_ms) in TaskId::ALL.into_iter().zip(PERIOD_MS) {
                if ms % period_ms == 0 && (each != which || ms < until_ms) {
                    progress.check_in(each);
                }
            }
            if ms % FEED_PERIOD_MS == 0 {
                match watchdog.check(start_ms.wrapping_add(ms), &progress) {
                    Ok(()) => fed_ms = ms,
                    Err(hangs) => return (Some(hangs), fed_ms),
                }
            }
        }
        (None, fed_ms)
    }

    #[test]
    fn watchdog_is_fed_while_all_tasks_check_in() {
        for start_ms in [0, u32::MAX - 50] {
            assert_eq!(run(start_ms, TaskId::Sense, u32::MAX), (None, 9_995));
        }
    }

    #[test]
    fn hung_task_stops_feeding_within_its_timeout() {
        for start_ms in [0, u32::MAX - 1500] {
            for (which, period_ms) in TaskId::ALL.into_iter().zip(PERIOD_MS) {
                let (hangs, fed_ms) = run(start_ms, which, 2000);
                assert_eq!(hangs, Some(which));
                let last_ms = 2000 - period_ms;
                let hung_ms = fed_ms - last_ms;
                let timeout_ms = which.timeout_ms();
                // The check may see the last check-in up to one feeding period late.
                assert!(hung_ms <= timeout_ms + FEED_PERIOD_MS, "{which:?}: {hung_ms}");
                assert!(hung_ms + FEED_PERIOD_MS >= timeout_ms, "{which:?}: {hung_ms}");
            }
        }
    }

    #[test]
    fn task_that_never_checks_in_stops_feeding() {
        for which in TaskId::ALL {
            let (hangs, fed_ms) = run(0, which, 0);
            assert_eq!(hangs, Some(which));
            assert_eq!(fed_ms, which.timeout_ms() / FEED_PERIOD_MS * FEED_PERIOD_MS);
        }
    }

    #[test]
    fn feeding_stays_stopped_after_a_hang() {
        let progress = TaskProgress::new();
        let mut watchdog = TaskWatchdog::new(0);
        assert_eq!(watchdog.check(10, &progress), Ok(()));
        assert!(watchdog.check(11, &progress).is_err());
        for ms in 12..1000 {
            for which in TaskId::ALL {
                progress.check_in(which);
            }
            assert_eq!(watchdog.check(ms, &progress), Err(TaskId::Sense));
        }
    }
}
