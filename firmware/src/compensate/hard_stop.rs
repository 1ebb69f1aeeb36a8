//! Beyond a knee the flexure meets a stop.
//!
//! A knee is no shape for smooth basis functions: they miss it by newtons. The ideal model inverts
//! the flexure without its stop, and what the stop took is given back here, exactly.

use crate::fixed::share_of;
use crate::units::Force;

/// Fractional bits of [`Table::beyond`].
pub const BITS: u32 = 16;

/// The stops of both flexures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Where Fx and Fz meet them, in force units, either sign.
    pub knee: [i32; 2],
    /// Force that is added for each unit beyond: of Fx and Fz, where they are positive and negative.
    pub beyond: [[i32; 2]; 2],
}

impl Table {
    /// The forces that act, from those that a flexure without a stop would show.
    pub fn undo(&self, force: [Force; 2]) -> [Force; 2] {
        let [fx, fz] = force;
        let [kx, kz] = self.knee;
        let [bx, bz] = self.beyond;
        [(fx, kx, bx), (fz, kz, bz)].map(|(force, knee, [beyond, back])| {
            let beyond = if force.0 < 0 { back } else { beyond };
            let over = force.0.saturating_abs().saturating_sub(knee).max(0);
            let added = share_of(over, beyond, BITS);
            Force(
                force
                    .0
                    .saturating_add(if force.0 < 0 { -added } else { added }),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_stop_takes_is_given_back_beyond_its_knee_on_its_side() {
        // 60 % lost beyond 100 N: 150 N show as 120.
        let beyond = (1.5 * f64::from(1 << BITS)) as i32;
        let table = Table {
            knee: [100 << 10; 2],
            beyond: [[beyond, 0]; 2],
        };
        let at = |newtons: i32| table.undo([Force(newtons << 10); 2])[0].newtons();
        assert_eq!([at(80), at(120), at(-120)], [80.0, 150.0, -120.0]);
        let both = Table {
            beyond: [[beyond; 2]; 2],
            ..table
        };
        assert_eq!(both.undo([Force(-120 << 10); 2])[1].newtons(), -150.0);
    }
}
