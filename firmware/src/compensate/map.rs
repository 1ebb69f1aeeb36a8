//! A user's own effect as a table over one or two covariates that the board knows.

use crate::surroundings::Surroundings;

/// A covariate that the board knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Covariate {
    /// Opening in micrometres.
    Opening,
    /// Quadrature current in milliamperes.
    MotorIq,
    /// Mechanical angle of the motor in microradians.
    MotorAngle,
    /// Specific force along an axis of the gripper in mm/s^2.
    Acceleration(u8),
    /// Temperature in counts, with the bits of [`super::temperature::BITS`].
    Temperature,
}

impl Covariate {
    fn value(self, warmer: i32, around: &Surroundings) -> Option<i32> {
        match self {
            Self::Opening => around.opening_um,
            Self::MotorIq => around.motor.map(|motor| motor.iq_ma),
            Self::MotorAngle => around.motor.map(|motor| motor.angle_urad),
            Self::Acceleration(axis) => around.acceleration?.get(usize::from(axis)).copied(),
            Self::Temperature => Some(warmer),
        }
    }
}

/// One side of a table: knots at even distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    /// What it goes along.
    pub covariate: Covariate,
    /// Value at the first knot.
    pub from: i32,
    /// Distance of two knots; above zero.
    pub step: i32,
    /// Number of knots.
    pub knots: u16,
}

impl Side {
    /// Index of the knot before the value, and the share of the way to the next with 15 bits. Beyond
    /// the ends the value stays at the end.
    fn place(&self, warmer: i32, around: &Surroundings) -> Option<(usize, i64)> {
        let value = self.covariate.value(warmer, around)?;
        let step = i64::from(self.step.max(1));
        let cells = i64::from(self.knots.max(2)) - 1;
        let along = (i64::from(value) - i64::from(self.from)).clamp(0, cells * step - 1);
        Some(((along / step) as usize, ((along % step) << 15) / step))
    }
}

/// Values in the unit of what they are taken from. No side: nothing is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table<'a> {
    /// One or two sides.
    pub sides: [Option<Side>; 2],
    /// The first side's knots for each knot of the second.
    pub values: &'a [i32],
}

impl Table<'_> {
    /// Takes nothing.
    pub const NONE: Table<'static> = Table {
        sides: [None; 2],
        values: &[],
    };

    /// The effect now, between the knots by straight lines; `None` where a covariate is not known.
    pub fn value(&self, warmer: i32, around: &Surroundings) -> Option<i32> {
        let [Some(first), second] = self.sides else {
            return Some(0);
        };
        let (i, share) = first.place(warmer, around)?;
        let width = usize::from(first.knots);
        let line = |row: usize| {
            let at = row * width + i;
            let (before, after) = (*self.values.get(at)?, *self.values.get(at + 1)?);
            Some(between(before, after, share))
        };
        match second {
            None => line(0),
            Some(second) => {
                let (row, share) = second.place(warmer, around)?;
                Some(between(line(row)?, line(row + 1)?, share))
            }
        }
    }
}

fn between(before: i32, after: i32, share: i64) -> i32 {
    let way = (i64::from(after) - i64::from(before)) * share + (1 << 14);
    crate::fixed::clamped(i64::from(before) + (way >> 15))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opening(from: i32, step: i32, knots: u16) -> Option<Side> {
        Some(Side {
            covariate: Covariate::Opening,
            from,
            step,
            knots,
        })
    }

    #[test]
    fn a_line_is_followed_between_its_knots_and_kept_beyond_them() {
        let table = Table {
            sides: [opening(1000, 500, 3), None],
            values: &[0, 100, 400],
        };
        let at = |um| {
            table.value(
                0,
                &Surroundings {
                    opening_um: Some(um),
                    ..Default::default()
                },
            )
        };
        assert_eq!(
            [at(0), at(1250), at(1500), at(1750)],
            [Some(0), Some(50), Some(100), Some(250)]
        );
        assert!(at(99_999).is_some_and(|end| (399..=400).contains(&end)));
    }

    #[test]
    fn two_covariates_are_a_surface_and_an_unknown_one_is_said() {
        let warm = Side {
            covariate: Covariate::Temperature,
            from: 0,
            step: 10,
            knots: 2,
        };
        let table = Table {
            sides: [opening(0, 10, 2), Some(warm)],
            values: &[0, 100, 200, 300],
        };
        let around = Surroundings {
            opening_um: Some(5),
            ..Default::default()
        };
        assert_eq!(table.value(5, &around), Some(150));
        assert_eq!(table.value(5, &Surroundings::default()), None);
    }
}
