//! The sensor's temperature without the noise of its counts.
//!
//! A kelvin is 1.4 G of the magnet's field, so a count of noise would be felt. What carries heat is
//! slow: a quarter of a second is no loss.

/// Fractional bits of a filtered temperature.
pub const BITS: u32 = 8;
/// A count reaches the filtered value as 1 / 2^this at each tick: 256 ms at 1 kHz.
const SHIFT: u32 = 8;

/// The filtered temperature, in counts with [`BITS`] fractional bits; none before the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State(Option<i32>);

impl State {
    /// Takes a reading; the counts above the zero of the sensor's scale.
    pub fn follow(&mut self, counts: i16) -> i32 {
        let now = i32::from(counts) << BITS;
        let next = match self.0 {
            None => now,
            Some(before) => {
                // Rounded to the nearest, so that it arrives to half a count.
                let step = now.saturating_sub(before);
                before.saturating_add((step + (1 << (SHIFT - 1))) >> SHIFT)
            }
        };
        self.0 = Some(next);
        next
    }

    /// The newest value.
    pub fn warmer(&self) -> i32 {
        self.0.unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_followed_in_a_quarter_of_a_second_and_reached_to_half_a_count() {
        let mut state = State::default();
        state.follow(0);
        let after: [i32; 2] = [256, 4000].map(|ticks| {
            let mut state = state;
            (0..ticks).map(|_| state.follow(100)).last().unwrap_or(0)
        });
        assert!(
            (after[0] - (6321 << BITS) / 100).abs() < 2 << BITS,
            "{after:?}"
        );
        assert!(
            (after[1] - (100 << BITS)).abs() <= 1 << (BITS - 1),
            "{after:?}"
        );
    }
}
