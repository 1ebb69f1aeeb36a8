//! Friction beside the flexure holds it back.
//!
//! The flexure deflects as if the force were less by the sliders' friction. That relation is a
//! Prandtl-Ishlinskii operator, and its inverse is another one with sliders of its own: the exporter
//! computes their reach and force (see the host's `inverse/compensation.rs`), and here they are
//! added back.

use crate::fixed::{clamped, share_of};
use crate::units::Force;

/// Sliders of each axis.
pub const SLIDERS: usize = 3;
/// Fractional bits of [`Slider::share`].
pub const BITS: u32 = 16;

/// A slider that adds more than an eighth of what it is stretched by would multiply the noise of a
/// reading, half of a newton where friction of as much is undone: it follows the force through a low
/// pass, whose lag only counts while the load turns.
const STEEP: i32 = 1 << (BITS - 3);
/// That low pass goes this part of the way in a tick: 8 ms at 1 kHz.
const SMOOTH_SHIFT: u32 = 3;
/// Fractional bits of the filtered force beyond a force's own.
const SMOOTH_BITS: u32 = 8;

/// A slider of the inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slider {
    /// It slips where it is stretched by this, in force units.
    pub reach: i32,
    /// Force that it adds for each unit of stretch.
    pub share: i32,
}

impl Slider {
    /// What it holds where it slips.
    pub fn force(&self) -> Force {
        Force(share_of(self.reach, self.share, BITS))
    }
}

/// The sliders of the lateral and of the longitudinal flexure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// For Fx and Fz.
    pub sliders: [[Slider; SLIDERS]; 2],
}

/// Where the sliders are; at rest before the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct State {
    axes: [Axis; 2],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Axis {
    last: Option<i32>,
    /// The force through the low pass.
    smooth: i64,
    stretch: [i32; SLIDERS],
}

impl Table {
    /// The forces that act, from those that the deflection shows.
    pub fn undo(&self, force: [Force; 2], state: &mut State) -> [Force; 2] {
        let [x, z] = &mut state.axes;
        let [fx, fz] = force;
        let [sx, sz] = &self.sliders;
        [x.follow(sx, fx), z.follow(sz, fz)]
    }
}

impl Axis {
    fn follow(&mut self, sliders: &[Slider; SLIDERS], force: Force) -> Force {
        let now = i64::from(force.0) << SMOOTH_BITS;
        let before = self.last.map_or(now, |_| self.smooth);
        self.smooth = before.saturating_add((now - before) >> SMOOTH_SHIFT);
        let smoothly = clamped((self.smooth >> SMOOTH_BITS) - (before >> SMOOTH_BITS));
        let moved = force.0.saturating_sub(self.last.unwrap_or(force.0));
        self.last = Some(force.0);
        let mut sum = force.0;
        for (slider, stretch) in sliders.iter().zip(&mut self.stretch) {
            let reach = slider.reach.max(0);
            let by = if slider.share > STEEP {
                smoothly
            } else {
                moved
            };
            *stretch = stretch.saturating_add(by).clamp(-reach, reach);
            sum = sum.saturating_add(share_of(*stretch, slider.share, BITS));
        }
        Force(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One slider on both axes.
    fn table(reach_n: f64, share: f64) -> Table {
        let one = Slider {
            reach: (reach_n * Force::PER_NEWTON) as i32,
            share: (share * f64::from(1 << BITS)) as i32,
        };
        let none = Slider { reach: 0, share: 0 };
        Table {
            sliders: [[one, none, none]; 2],
        }
    }

    #[test]
    fn friction_that_was_taken_is_added_back_on_both_branches() {
        // One newton after 10 N of travel.
        let table = table(10.0, 0.1);
        let mut state = State::default();
        let mut at = |newtons: i32| {
            table
                .undo([Force(newtons << 10); 2], &mut state)
                .map(Force::newtons)[0]
        };
        let found = [0, 5, 50, 45, 30, 50].map(&mut at);
        for (found, expected) in found.iter().zip([0.0, 5.5, 51.0, 45.5, 29.0, 51.0]) {
            assert!((found - expected).abs() < 0.01, "{found} {expected}");
        }
    }

    #[test]
    fn a_short_slider_adds_its_whole_friction_and_hardly_any_noise() {
        // Half a newton after 0.8 N, under a reading that jumps by 0.8 N from row to row.
        let table = table(0.8, 0.6);
        let mut state = State::default();
        let mut at = |row: i32, newtons: f64| {
            let noise = if row % 2 == 0 { 0.4 } else { -0.4 };
            let seen = Force(((newtons + noise) * Force::PER_NEWTON) as i32);
            table.undo([seen; 2], &mut state)[0].newtons() - newtons
        };
        // At rest the reading's own noise is left, at most a tenth more; without the low pass, 0.6 more.
        let rest = (0..200).map(|row| at(row, 0.0).abs());
        let greatest = rest.fold(0.0, f64::max);
        assert!(greatest > 0.39 && greatest < 0.8, "{greatest}");
        let late = (200..300).map(|row| at(row, 0.0));
        let (least, most) = late.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        assert!(most - least < 0.8 * 1.1, "{least} {most}");
        // Up by 50 N and held: all of the friction stays.
        let up = (300..800).map(|row| at(row, 0.1 * f64::from(row - 300)));
        let _ = up.last();
        let held: [f64; 100] = core::array::from_fn(|i| at(800 + i as i32, 50.0));
        let mean = held.iter().sum::<f64>() / 100.0;
        assert!((mean - 0.48).abs() < 0.05, "{mean}");
    }
}
