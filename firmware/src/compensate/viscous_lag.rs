//! The flexure follows its force late.
//!
//! The force runs ahead of the deflection by the lag times the deflection's rate. A rate is noisy:
//! it is taken behind two low passes, whose time constant the exporter chooses.

use crate::fixed::clamped;
use crate::fixed::share_of;
use crate::units::Force;

/// Fractional bits of [`Table::lead`] and [`Table::rate`].
pub const BITS: u32 = 16;
/// Fractional bits of the filtered force beyond a force's own.
const STATE_BITS: u32 = 12;

/// The lag of both flexures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Lag over the filter's time constant, for Fx and Fz.
    pub lead: [i32; 2],
    /// Part of the way that the filters go in one tick.
    pub rate: i32,
}

/// The filters, for Fx and Fz; settled at the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State {
    filters: [Option<[i64; 2]>; 2],
}

impl Table {
    /// The forces that act, from those that the deflection shows.
    pub fn undo(&self, force: [Force; 2], state: &mut State) -> [Force; 2] {
        let [x, z] = &mut state.filters;
        let [fx, fz] = force;
        let [lx, lz] = self.lead;
        [self.one(fx, lx, x), self.one(fz, lz, z)]
    }

    fn one(&self, shown: Force, lead: i32, filters: &mut Option<[i64; 2]>) -> Force {
        let now = i64::from(shown.0) << STATE_BITS;
        let [first, second] = filters.unwrap_or([now; 2]);
        let follow = |from: i64, to: i64| {
            from.saturating_add(
                ((to.saturating_sub(from) >> 8) * i64::from(self.rate)) >> (BITS - 8),
            )
        };
        let first = follow(first, now);
        let second = follow(second, first);
        *filters = Some([first, second]);
        // Twice filtered, their distance is the rate of the once filtered force times the time constant.
        let ahead = clamped((first.saturating_sub(second)) >> STATE_BITS);
        Force(shown.0.saturating_add(share_of(ahead, lead, BITS)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_that_arrives_ten_milliseconds_late_is_put_back() {
        let one = f64::from(1 << BITS);
        let table = Table {
            lead: [(0.5 * one) as i32; 2],
            rate: (one / 20.0) as i32,
        };
        let mut state = State::default();
        let mut last = 0.0;
        for ms in 0..2000 {
            // 100 N/s, shown 10 ms late.
            let shown = (0.1 * (f64::from(ms) - 10.0)).max(0.0);
            let [x, _] = table.undo([Force((shown * Force::PER_NEWTON) as i32); 2], &mut state);
            last = x.newtons() - 0.1 * f64::from(ms);
        }
        assert!(last.abs() < 0.06, "{last}");
    }
}
