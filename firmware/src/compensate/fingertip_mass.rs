//! The fingertip itself pushes on its flexures: its weight and its inertia.

use crate::fixed::share_of;
use crate::surroundings::Surroundings;
use crate::units::Force;

/// Fractional bits of [`Table::mass`].
pub const BITS: u32 = 20;

/// The mass on the flexures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Force units for each mm/s^2.
    pub mass: i32,
}

impl Table {
    /// The forces without the mass' own; `None` where the acceleration is not known.
    pub fn undo(&self, force: [Force; 2], around: &Surroundings) -> Option<[Force; 2]> {
        let [x, _, z] = around.acceleration?;
        let [fx, fz] = force;
        Some([(fx, x), (fz, z)].map(|(force, acceleration)| {
            Force(
                force
                    .0
                    .saturating_sub(share_of(acceleration, self.mass, BITS)),
            )
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_of_a_kilogram_weighs_one_newton() {
        // 0.1 kg is 1e-4 N to a mm/s^2.
        let mass = (1e-4 * Force::PER_NEWTON * f64::from(1 << BITS)) as i32;
        let around = Surroundings {
            acceleration: Some([9810, 0, -9810]),
            ..Default::default()
        };
        let [x, z] = Table { mass }
            .undo([Force(0), Force(1024)], &around)
            .unwrap_or_default();
        assert!((x.newtons() + 0.981).abs() < 2e-3 && (z.newtons() - 1.981).abs() < 2e-3);
    }
}
