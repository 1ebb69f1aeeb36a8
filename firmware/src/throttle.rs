//! More frames than anybody may mean: what is beyond a rate is dropped before it costs time.

use crate::limits::Limits;

/// Length of a window.
const WINDOW_US: u64 = 10_000;
/// Windows in a row without a drop after which the flood is over.
const CALM: u8 = 10;

/// The limit of one source.
#[derive(Clone, Copy, Debug)]
pub struct Throttle {
    limit: u8,
    /// When the window ends.
    ends_us: u64,
    heard: u8,
    /// Windows since one with a drop; at its end where there was none.
    calm: u8,
    flooded: bool,
    dropped: u32,
}

impl Throttle {
    /// Nothing has been heard.
    pub const fn new(limits: &Limits) -> Self {
        Self {
            limit: limits.flood_frames,
            ends_us: WINDOW_US,
            heard: 0,
            calm: CALM,
            flooded: false,
            dropped: 0,
        }
    }

    /// Takes a frame; whether it may be heard.
    pub fn admit(&mut self, now_us: u64) -> bool {
        self.turn(now_us);
        self.heard = self.heard.saturating_add(1);
        let admitted = self.heard <= self.limit;
        if !admitted {
            self.dropped = self.dropped.saturating_add(1);
            self.flooded = true;
            self.calm = 0;
        }
        admitted
    }

    /// Whether a flood goes on.
    pub fn is_flooded(&mut self, now_us: u64) -> bool {
        self.turn(now_us);
        self.flooded
    }

    /// Frames dropped since boot.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    fn turn(&mut self, now_us: u64) {
        let Some(beyond_us) = now_us.checked_sub(self.ends_us) else {
            return;
        };
        // Only here is divided: a flood asks many times in a window.
        let passed = (beyond_us / WINDOW_US).saturating_add(1);
        let passed_us = passed.saturating_mul(WINDOW_US);
        self.ends_us = self.ends_us.saturating_add(passed_us);
        self.heard = 0;
        self.calm = self.calm.saturating_add(passed.min(255) as u8);
        self.flooded &= self.calm < CALM;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twenty_frames_in_ten_milliseconds_are_heard_and_no_more() {
        let mut throttle = Throttle::new(&Limits::GRIPPER);
        let admitted = (0..213)
            .filter(|i| throttle.admit(1_000_000 + i * 47))
            .count();
        // 213 frames, 47 us apart, end before 10,011 us: the last one or two are of the next window.
        assert!((20..=21).contains(&admitted), "{admitted}");
        assert_eq!(throttle.dropped(), 213 - admitted as u32);
        assert!(throttle.is_flooded(1_010_000));
    }

    #[test]
    fn a_flood_is_over_after_a_tenth_of_a_second_of_calm() {
        let mut throttle = Throttle::new(&Limits::GRIPPER);
        for _ in 0..21 {
            throttle.admit(5_000);
        }
        assert!(throttle.is_flooded(99_999));
        assert!(!throttle.is_flooded(100_000));
        assert!(throttle.admit(100_001));
    }

    #[test]
    fn two_hundred_commands_a_second_are_no_flood() {
        let mut throttle = Throttle::new(&Limits::GRIPPER);
        for command in 0..2_000 {
            assert!(throttle.admit(command * 5_000));
        }
        assert!(!throttle.is_flooded(10_000_000));
    }
}
