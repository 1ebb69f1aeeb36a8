//! The first cause: of all faults that follow each other the one that began it, kept until a host clears it.

use crate::status::Fault;

/// What began it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cause {
    /// The fault.
    pub fault: Fault,
    /// State in which it came, as in the heartbeat.
    pub state: u8,
    /// Milliseconds since the grip began to run.
    pub at_ms: u32,
}

/// Keeps the first.
#[derive(Clone, Copy, Debug, Default)]
pub struct Latch(Option<Cause>);

impl Latch {
    /// Takes a cause; only the first counts.
    pub fn note(&mut self, cause: Cause) {
        self.0.get_or_insert(cause);
    }

    /// The first since it was cleared.
    pub const fn cause(&self) -> Option<Cause> {
        self.0
    }

    /// Forgets it, unless it is still there.
    pub fn clear(&mut self, is_active: impl Fn(Fault) -> bool) {
        self.0 = self.0.filter(|cause| is_active(cause.fault));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_cause_stays_until_it_is_gone_and_cleared() {
        let cause = |fault, at_ms| Cause {
            fault,
            state: 22,
            at_ms,
        };
        let mut latch = Latch::default();
        latch.note(cause(Fault::SensorLost, 5));
        latch.note(cause(Fault::Blind, 6));
        assert_eq!(latch.cause(), Some(cause(Fault::SensorLost, 5)));
        latch.clear(|fault| fault == Fault::SensorLost);
        assert!(latch.cause().is_some());
        latch.clear(|fault| fault == Fault::Blind);
        assert_eq!(latch.cause(), None);
    }
}
