//! Under a steady load the flexure gives way a little more, and comes back slowly.

use crate::fixed::clamped;
use crate::units::Force;

/// Fractional bits of [`Table::share`] and [`Table::rate`].
pub const BITS: u32 = 30;
/// Fractional bits of the remembered force beyond a force's own.
const STATE_BITS: u32 = 20;

/// Delayed share and pace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Delayed share of the deflection, for Fx and Fz.
    pub share: [i32; 2],
    /// Part of the way that the delayed deflection goes in one tick.
    pub rate: i32,
}

/// The force as the delayed part remembers it, for Fx and Fz; settled at the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State {
    delayed: [Option<i64>; 2],
}

impl Table {
    /// The forces that act, from those that the deflection shows.
    pub fn undo(&self, force: [Force; 2], state: &mut State) -> [Force; 2] {
        let [x, z] = &mut state.delayed;
        let [fx, fz] = force;
        let [sx, sz] = self.share;
        [self.one(fx, sx, x), self.one(fz, sz, z)]
    }

    fn one(&self, shown: Force, share: i32, delayed: &mut Option<i64>) -> Force {
        let before = delayed.unwrap_or(i64::from(shown.0) << STATE_BITS);
        let slow = clamped(before >> STATE_BITS);
        let taken = (i64::from(slow) * i64::from(share)) >> BITS;
        let acts = clamped(i64::from(shown.0) - taken);
        let way = (i64::from(acts) << STATE_BITS) - before;
        // 2^51 at the most, times a rate below one: the product is taken in two halves.
        let step = ((way >> 20) * i64::from(self.rate)) >> (BITS - 20);
        *delayed = Some(before.saturating_add(step));
        Force(acts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deflection_that_creeps_by_two_percent_shows_a_steady_force() {
        let one = f64::from(1 << BITS);
        let table = Table {
            share: [(0.02 * one) as i32; 2],
            rate: (0.001 / 10.0 * one) as i32,
        };
        let mut state = State::default();
        table.undo([Force(0); 2], &mut state);
        let mut delayed = 0.0;
        for tick in 0..60_000 {
            let shown = 100.0 + 0.02 * delayed;
            delayed += (100.0 - delayed) * 1e-4;
            let force = Force((shown * Force::PER_NEWTON) as i32);
            let [x, _] = table.undo([force; 2], &mut state);
            assert!(
                (x.newtons() - 100.0).abs() < 0.02,
                "{tick}: {}",
                x.newtons()
            );
        }
    }
}
