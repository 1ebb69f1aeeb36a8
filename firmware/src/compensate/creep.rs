//! Under a steady load the flexure gives way a little more, and comes back slowly.
//!
//! A fast and a slow part follow the force that acts, each with its own pace, and their sum is taken
//! off what the deflection shows.

use crate::fixed::clamped;
use crate::units::Force;

/// Parts of each axis: a fast and a slow one.
pub const PARTS: usize = 2;
/// Fractional bits of [`Table::share`] and [`Table::rate`].
pub const BITS: u32 = 30;
/// Fractional bits of the remembered force beyond a force's own.
const STATE_BITS: u32 = 20;

/// Delayed shares and paces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Delayed share of the deflection of each part, for Fx and Fz.
    pub share: [[i32; PARTS]; 2],
    /// Part of the way that each delayed deflection goes in one tick.
    pub rate: [i32; PARTS],
}

/// The force as each delayed part remembers it, for Fx and Fz; settled at the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State {
    delayed: [Option<[i64; PARTS]>; 2],
}

impl Table {
    /// The forces that act, from those that the deflection shows.
    pub fn undo(&self, force: [Force; 2], state: &mut State) -> [Force; 2] {
        let [x, z] = &mut state.delayed;
        let [fx, fz] = force;
        let [sx, sz] = &self.share;
        [self.one(fx, sx, x), self.one(fz, sz, z)]
    }

    fn one(&self, shown: Force, share: &[i32; PARTS], delayed: &mut Option<[i64; PARTS]>) -> Force {
        let mut parts = delayed.unwrap_or([i64::from(shown.0) << STATE_BITS; PARTS]);
        // Each is below 2^33: their sum with a force is far from the end of 64 bits.
        let taken: i64 = parts
            .iter()
            .zip(share)
            .map(|(part, share)| {
                (i64::from(clamped(part >> STATE_BITS)) * i64::from(*share)) >> BITS
            })
            .sum();
        let acts = clamped(i64::from(shown.0) - taken);
        for (part, rate) in parts.iter_mut().zip(&self.rate) {
            *part = follow(*part, acts, *rate);
        }
        *delayed = Some(parts);
        Force(acts)
    }
}

/// A remembered force, one tick on its way to `acts`.
fn follow(from: i64, acts: i32, rate: i32) -> i64 {
    let way = (i64::from(acts) << STATE_BITS).saturating_sub(from);
    // In whole force units, so that the product with the rate fits 64 bits.
    let way = i64::from(clamped(way >> STATE_BITS));
    from.saturating_add((way * i64::from(rate)) >> (BITS - STATE_BITS))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: f64 = (1 << BITS) as f64;

    #[test]
    fn a_deflection_that_creeps_by_two_percent_in_two_times_shows_a_steady_force() {
        // 1.2 % with 1 s and 0.8 % with 10 s at 1 kHz.
        let share = [0.012, 0.008];
        let rate = [1e-3, 1e-4];
        let table = Table {
            share: [share.map(|share| (share * ONE) as i32); 2],
            rate: rate.map(|rate| (rate * ONE) as i32),
        };
        let mut state = State::default();
        table.undo([Force(0); 2], &mut state);
        let mut delayed = [0.0; PARTS];
        for tick in 0..60_000 {
            let shown = 100.0 + share[0] * delayed[0] + share[1] * delayed[1];
            for (delayed, rate) in delayed.iter_mut().zip(rate) {
                *delayed += (100.0 - *delayed) * rate;
            }
            let force = Force((shown * Force::PER_NEWTON) as i32);
            let [x, z] = table.undo([force; 2], &mut state);
            assert_eq!(x, z);
            assert!(
                (x.newtons() - 100.0).abs() < 0.02,
                "{tick}: {}",
                x.newtons()
            );
        }
    }

    #[test]
    fn the_greatest_forces_shares_and_rates_do_not_overflow() {
        for share in [i32::MIN, i32::MAX] {
            for rate in [i32::MIN, i32::MAX] {
                let table = Table {
                    share: [[share; PARTS]; 2],
                    rate: [rate; PARTS],
                };
                let mut state = State::default();
                for force in [i32::MIN, i32::MAX, 0].into_iter().cycle().take(300) {
                    table.undo([Force(force); 2], &mut state);
                }
            }
        }
    }

    #[test]
    fn what_is_added_beyond_the_greatest_force_saturates() {
        // A share below zero adds: by half, twice.
        let table = Table {
            share: [[-(1 << (BITS - 1)); PARTS]; 2],
            rate: [0; PARTS],
        };
        let shown = [Force(i32::MAX), Force(i32::MIN)];
        assert_eq!(table.undo(shown, &mut State::default()), shown);
    }
}
