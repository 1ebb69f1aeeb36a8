//! Friction parallel to the flexure.
//!
//! The flexure deflects as if the force were reduced by the friction of elasto-plastic sliders, a Prandtl-Ishlinskii
//! operator. Its inverse is an operator of the same kind; the exporter computes that inverse's sliders
//! (`inverse/compensation.rs` of the host), which add the friction back here.

use crate::fixed_point::{Force, mul_q, saturate};

/// Sliders per axis.
pub const SLIDERS: usize = 3;
/// Fractional bits of [`Slider::share`].
pub const BITS: u32 = 16;

/// Sliders stiffer than 1/8 would amplify measurement noise, by half a newton at half a newton of friction. They follow
/// the low-pass filtered force; its lag matters only while the load reverses.
const STEEP: i32 = 1 << (BITS - 3);
/// Gain of that filter per tick is 2^-3: 8 ms at 1 kHz.
const SMOOTH_SHIFT: u32 = 3;
/// Additional fractional bits of the filtered force.
const SMOOTH_BITS: u32 = 8;

/// A slider of the inverse operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slider {
    /// Stretch at which it slips, in force units.
    pub reach: i32,
    /// Stiffness: added force per unit of stretch.
    pub share: i32,
}

impl Slider {
    /// Friction force while it slips.
    pub fn force(&self) -> Force {
        Force(mul_q(self.reach, self.share, BITS))
    }
}

/// Sliders of both flexures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HysteresisTable {
    /// Sliders for Fx and Fz.
    pub sliders: [[Slider; SLIDERS]; 2],
}

/// State of the sliders; relaxed at the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HysteresisState {
    axes: [SliderState; 2],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct SliderState {
    last: Option<i32>,
    /// Low-pass filtered force.
    smooth: i64,
    stretch: [i32; SLIDERS],
}

impl HysteresisTable {
    /// Adds the friction to the forces derived from the deflection.
    pub fn compensate(&self, force: [Force; 2], state: &mut HysteresisState) -> [Force; 2] {
        let [x, z] = &mut state.axes;
        let [fx, fz] = force;
        let [sx, sz] = &self.sliders;
        [x.update(sx, fx), z.update(sz, fz)]
    }
}

impl SliderState {
    #[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
    #[allow(unsafe_code)] // As of `estimate`.
    fn update(&mut self, sliders: &[Slider; SLIDERS], force: Force) -> Force {
        let now = i64::from(force.0) << SMOOTH_BITS;
        let before = self.last.map_or(now, |_| self.smooth);
        self.smooth = before.saturating_add((now - before) >> SMOOTH_SHIFT);
        let filtered_step = saturate((self.smooth >> SMOOTH_BITS) - (before >> SMOOTH_BITS));
        let step = force.0.saturating_sub(self.last.unwrap_or(force.0));
        self.last = Some(force.0);
        let mut sum = force.0;
        for (slider, stretch) in sliders.iter().zip(&mut self.stretch) {
            let reach = slider.reach.max(0);
            let by = if slider.share > STEEP { filtered_step } else { step };
            *stretch = stretch.saturating_add(by).clamp(-reach, reach);
            sum = sum.saturating_add(mul_q(*stretch, slider.share, BITS));
        }
        Force(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One slider on both axes.
    fn table(reach_n: f64, share: f64) -> HysteresisTable {
        let one = Slider {
            reach: (reach_n * Force::PER_NEWTON) as i32,
            share: (share * f64::from(1 << BITS)) as i32,
        };
        let none = Slider { reach: 0, share: 0 };
        HysteresisTable { sliders: [[one, none, none]; 2] }
    }

    #[test]
    fn friction_is_added_back_on_both_branches() {
        // One newton after 10 N of travel.
        let table = table(10.0, 0.1);
        let mut state = HysteresisState::default();
        for (newtons, expected) in
            [(0, 0.0), (5, 5.5), (50, 51.0), (45, 45.5), (30, 29.0), (50, 51.0)]
        {
            let [found, _] = table.compensate([Force(newtons << 10); 2], &mut state);
            let found = found.newtons();
            assert!((found - expected).abs() < 0.01, "{found} {expected}");
        }
    }

    #[test]
    fn a_stiff_slider_adds_its_friction_but_little_noise() {
        // Half a newton after 0.8 N; the reading alternates by 0.8 N from row to row.
        let table = table(0.8, 0.6);
        let mut state = HysteresisState::default();
        let mut error_at = |row: i32, newtons: f64| {
            let noise = if row % 2 == 0 { 0.4 } else { -0.4 };
            let noisy = Force(((newtons + noise) * Force::PER_NEWTON) as i32);
            table.compensate([noisy; 2], &mut state)[0].newtons() - newtons
        };
        // Unloaded: the reading's own noise, at most 10 % more once settled; unfiltered it would be 60 %.
        let max = (0..200).map(|row| error_at(row, 0.0).abs()).fold(0.0, f64::max);
        assert!(max > 0.39 && max < 0.8, "{max}");
        let settled = (200..300).map(|row| error_at(row, 0.0));
        let (min, max) = settled.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        assert!(max - min < 0.8 * 1.1, "{min} {max}");
        // After a ramp to 50 N the whole friction remains.
        for row in 300..800 {
            error_at(row, 0.1 * f64::from(row - 300));
        }
        let mean = (800..900).map(|row| error_at(row, 50.0)).sum::<f64>() / 100.0;
        assert!((mean - 0.48).abs() < 0.05, "{mean}");
    }
}
