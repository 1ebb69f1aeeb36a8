//! Limits the rate of received frames: excess frames are dropped before they cost time.

use crate::config::limits::DetectionLimits;

/// Length of a counting window.
const WINDOW_US: u64 = 10_000;
/// Windows in a row without a drop that end a flood.
const QUIET_WINDOWS: u8 = 10;

/// Rate limiter of one source.
#[derive(Clone, Copy, Debug)]
pub struct RateLimiter {
    limit: u8,
    /// End of the present window.
    ends_us: u64,
    received: u8,
    /// Windows since the last one with a drop.
    quiet_windows: u8,
    flooded: bool,
    dropped: u32,
}

impl RateLimiter {
    /// No frame received yet.
    pub const fn new(limits: &DetectionLimits) -> Self {
        Self {
            limit: limits.flood_frames,
            ends_us: WINDOW_US,
            received: 0,
            quiet_windows: QUIET_WINDOWS,
            flooded: false,
            dropped: 0,
        }
    }

    /// Counts a frame; false if it must be dropped.
    pub fn admit(&mut self, now_us: u64) -> bool {
        self.advance(now_us);
        self.received = self.received.saturating_add(1);
        let admitted = self.received <= self.limit;
        if !admitted {
            self.dropped = self.dropped.saturating_add(1);
            self.flooded = true;
            self.quiet_windows = 0;
        }
        admitted
    }

    /// Whether frames were dropped within the last `QUIET_WINDOWS` windows.
    pub fn is_flooded(&mut self, now_us: u64) -> bool {
        self.advance(now_us);
        self.flooded
    }

    /// Frames dropped since boot.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    fn advance(&mut self, now_us: u64) {
        let Some(beyond_us) = now_us.checked_sub(self.ends_us) else {
            return;
        };
        // The only division: in a flood this is reached once per window.
        let passed = (beyond_us / WINDOW_US).saturating_add(1);
        let passed_us = passed.saturating_mul(WINDOW_US);
        self.ends_us = self.ends_us.saturating_add(passed_us);
        self.received = 0;
        self.quiet_windows = self.quiet_windows.saturating_add(passed.min(255) as u8);
        self.flooded &= self.quiet_windows < QUIET_WINDOWS;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_most_20_frames_are_admitted_in_10_ms() {
        let mut limiter = RateLimiter::new(&DetectionLimits::GRIPPER);
        let admitted = (0..213).filter(|i| limiter.admit(1_000_000 + i * 47)).count();
        // 213 frames, 47 us apart, end before 10,011 us: the last one or two are of the next window.
        assert!((20..=21).contains(&admitted), "{admitted}");
        assert_eq!(limiter.dropped(), 213 - admitted as u32);
        assert!(limiter.is_flooded(1_010_000));
    }

    #[test]
    fn flood_ends_after_100_ms_without_drops() {
        let mut limiter = RateLimiter::new(&DetectionLimits::GRIPPER);
        for _ in 0..21 {
            limiter.admit(5_000);
        }
        assert!(limiter.is_flooded(99_999));
        assert!(!limiter.is_flooded(100_000));
        assert!(limiter.admit(100_001));
    }

    #[test]
    fn commands_at_200_hz_are_admitted() {
        let mut limiter = RateLimiter::new(&DetectionLimits::GRIPPER);
        for command in 0..2_000 {
            assert!(limiter.admit(command * 5_000));
        }
        assert!(!limiter.is_flooded(10_000_000));
    }
}
