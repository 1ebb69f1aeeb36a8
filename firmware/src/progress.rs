//! Whether every loop moves on: only then is the watchdog fed.
//!
//! A loop checks in each time round ([`Progress::check_in`]). Whoever feeds the watchdog asks a [`Guard`]
//! first, every [`FED_EVERY_MS`]; once a loop has not checked in for its own time, or never began, the
//! answer stays no, and the watchdog resets the chip [`WATCHDOG_MS`] after it was last fed. From a loop's last
//! round to the reset it takes at most its patience and the sum of these two.
//!
//! The independent watchdog runs on its own oscillator of 32 kHz, exact to some 10 %, and cannot be stopped.
//! It is for loops that hang; the motor's outputs need something faster.

use core::sync::atomic::{AtomicU32, Ordering};

/// The watchdog is fed this often.
pub const FED_EVERY_MS: u32 = 5;
/// Without food for this time it resets the chip.
pub const WATCHDOG_MS: u32 = 20;
// It outlives a few late meals, and an oscillator that runs fast.
const _: () = assert!(WATCHDOG_MS >= 3 * FED_EVERY_MS);

/// A loop that must move on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loop {
    /// Reads the sensors, 1 kHz.
    Sense,
    /// Computes the forces, 1 kHz.
    Estimate,
    /// Grasps, 1 kHz.
    Grip,
    /// Sends messages; the slowest that always runs is the heartbeat, 10 Hz.
    Report,
    /// Hears messages; checks in while nobody speaks too.
    Command,
}

/// Loops.
pub const LOOPS: usize = 5;

impl Loop {
    /// All of them.
    pub const ALL: [Self; LOOPS] = [
        Self::Sense,
        Self::Estimate,
        Self::Grip,
        Self::Report,
        Self::Command,
    ];

    /// A loop that has not checked in for longer hangs. Assumed: ten ticks at 1 kHz, and three heartbeats.
    pub const fn patience_ms(self) -> u32 {
        match self {
            Self::Sense | Self::Estimate | Self::Grip => 10,
            Self::Report | Self::Command => 300,
        }
    }
}

/// Times round of every loop. One static; every loop writes its own.
#[derive(Debug, Default)]
pub struct Progress {
    rounds: [AtomicU32; LOOPS],
}

impl Progress {
    /// Nobody has checked in.
    pub const fn new() -> Self {
        Self {
            rounds: [const { AtomicU32::new(0) }; LOOPS],
        }
    }

    /// The loop has gone round. Call it from nowhere else: a timer that checks in for a loop hides its end.
    pub fn check_in(&self, which: Loop) {
        if let Some(rounds) = self.rounds.get(which as usize) {
            rounds.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn rounds(&self) -> [u32; LOOPS] {
        self.rounds
            .each_ref()
            .map(|rounds| rounds.load(Ordering::Relaxed))
    }
}

/// Decides whether the watchdog is fed.
#[derive(Clone, Copy, Debug)]
pub struct Guard {
    /// Rounds of every loop when it was last seen to move, and when that was.
    seen: [(u32, u32); LOOPS],
    hanging: Option<Loop>,
}

impl Guard {
    /// Loops have their own patience from here on to begin.
    pub const fn new(now_ms: u32) -> Self {
        Self {
            seen: [(0, now_ms); LOOPS],
            hanging: None,
        }
    }

    /// Looks at every loop; asked every [`FED_EVERY_MS`].
    ///
    /// # Errors
    /// The first loop that hangs: the watchdog must not be fed any more, whatever happens.
    pub fn may_feed(&mut self, now_ms: u32, progress: &Progress) -> Result<(), Loop> {
        let rounds = progress.rounds();
        for ((which, seen), rounds) in Loop::ALL.into_iter().zip(&mut self.seen).zip(rounds) {
            let (before, at_ms) = *seen;
            if rounds != before {
                *seen = (rounds, now_ms);
            } else if now_ms.wrapping_sub(at_ms) > which.patience_ms() {
                self.hanging.get_or_insert(which);
            }
        }
        self.hanging.map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How often each loop checks in, in milliseconds.
    const EVERY_MS: [u32; LOOPS] = [1, 1, 1, 100, 100];

    /// Runs the loops, `which` only for the first `until_ms`. Tells who hangs, and when the last food came.
    fn run(start_ms: u32, which: Loop, until_ms: u32) -> (Option<Loop>, u32) {
        let progress = Progress::new();
        let mut guard = Guard::new(start_ms);
        let mut fed_ms = 0;
        for ms in 0..10_000 {
            for (each, every_ms) in Loop::ALL.into_iter().zip(EVERY_MS) {
                if ms % every_ms == 0 && (each != which || ms < until_ms) {
                    progress.check_in(each);
                }
            }
            if ms % FED_EVERY_MS == 0 {
                match guard.may_feed(start_ms.wrapping_add(ms), &progress) {
                    Ok(()) => fed_ms = ms,
                    Err(hangs) => return (Some(hangs), fed_ms),
                }
            }
        }
        (None, fed_ms)
    }

    #[test]
    fn while_every_loop_moves_on_the_watchdog_is_fed() {
        for start_ms in [0, u32::MAX - 50] {
            assert_eq!(run(start_ms, Loop::Sense, u32::MAX), (None, 9_995));
        }
    }

    #[test]
    fn a_loop_that_hangs_ends_the_feeding_within_its_patience() {
        for start_ms in [0, u32::MAX - 1500] {
            for (which, every_ms) in Loop::ALL.into_iter().zip(EVERY_MS) {
                let (hangs, fed_ms) = run(start_ms, which, 2000);
                assert_eq!(hangs, Some(which));
                let last_ms = 2000 - every_ms;
                let hung_ms = fed_ms - last_ms;
                let patience_ms = which.patience_ms();
                // The guard looks every few milliseconds, so it may have seen the last round late by that.
                assert!(
                    hung_ms <= patience_ms + FED_EVERY_MS,
                    "{which:?}: {hung_ms}"
                );
                assert!(
                    hung_ms + FED_EVERY_MS >= patience_ms,
                    "{which:?}: {hung_ms}"
                );
            }
        }
    }

    #[test]
    fn a_loop_that_never_began_ends_it_too() {
        for which in Loop::ALL {
            let (hangs, fed_ms) = run(0, which, 0);
            assert_eq!(hangs, Some(which));
            assert_eq!(fed_ms, which.patience_ms() / FED_EVERY_MS * FED_EVERY_MS);
        }
    }

    #[test]
    fn who_has_hung_once_is_not_believed_again() {
        let progress = Progress::new();
        let mut guard = Guard::new(0);
        assert_eq!(guard.may_feed(10, &progress), Ok(()));
        assert!(guard.may_feed(11, &progress).is_err());
        for ms in 12..1000 {
            for which in Loop::ALL {
                progress.check_in(which);
            }
            assert_eq!(guard.may_feed(ms, &progress), Err(Loop::Sense));
        }
    }
}
