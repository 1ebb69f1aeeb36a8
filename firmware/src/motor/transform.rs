//! Three phases, two fixed axes, two axes that turn with the rotor: Clarke's and Park's transforms, which
//! keep amplitudes. Power is therefore 1.5 times the products of the two axes.

use super::number::Direction;

const SQRT_3: f32 = 1.732_050_8;

/// Two fixed axes: alpha along phase U, beta a quarter turn ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AlphaBeta {
    /// Along phase U.
    pub alpha: f32,
    /// A quarter of an electrical turn ahead.
    pub beta: f32,
}

/// Two axes that turn with the rotor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dq {
    /// Along the rotor's magnets: makes no torque.
    pub d: f32,
    /// A quarter turn ahead: makes the torque, closing positive.
    pub q: f32,
}

impl AlphaBeta {
    /// Of the phases U, V, W; what is common to them falls out.
    pub fn of_phases([u, v, w]: [f32; 3]) -> Self {
        Self {
            alpha: (2.0 * u - v - w) * (1.0 / 3.0),
            beta: (v - w) * (1.0 / SQRT_3),
        }
    }

    /// The phases U, V, W, with a sum of zero.
    pub fn phases(self) -> [f32; 3] {
        let (half, side) = (0.5 * self.alpha, 0.5 * SQRT_3 * self.beta);
        [self.alpha, side - half, -side - half]
    }

    /// As seen from the rotor at an electrical angle.
    pub fn turning(self, angle: Direction) -> Dq {
        Dq {
            d: self.alpha * angle.cos + self.beta * angle.sin,
            q: self.beta * angle.cos - self.alpha * angle.sin,
        }
    }
}

impl Dq {
    /// As seen from the windings.
    pub fn fixed(self, angle: Direction) -> AlphaBeta {
        AlphaBeta {
            alpha: self.d * angle.cos - self.q * angle.sin,
            beta: self.d * angle.sin + self.q * angle.cos,
        }
    }

    /// The square of the amplitude.
    pub fn squared(self) -> f32 {
        self.d * self.d + self.q * self.q
    }

    /// Electrical power in watts of this voltage with a current.
    pub fn power_w(self, current: Self) -> f32 {
        1.5 * (self.d * current.d + self.q * current.q)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// An exact direction: what is tested here is not the library's sine.
    fn direction(radians: f64) -> Direction {
        Direction {
            sin: radians.sin() as f32,
            cos: radians.cos() as f32,
        }
    }

    #[test]
    fn known_currents_have_known_axes() {
        // One ampere into U, back through V and W.
        let one = AlphaBeta::of_phases([1.0, -0.5, -0.5]);
        assert_eq!(
            one,
            AlphaBeta {
                alpha: 1.0,
                beta: 0.0
            }
        );
        // Into V, back through W.
        let two = AlphaBeta::of_phases([0.0, 3.0, -3.0]);
        assert!(
            two.alpha == 0.0 && (two.beta - 3.464_101_6).abs() < 1e-6,
            "{two:?}"
        );
        // The rotor a quarter turn ahead of U: a current along U is against the torque.
        let seen = one.turning(Direction { sin: 1.0, cos: 0.0 });
        assert_eq!(seen, Dq { d: 0.0, q: -1.0 });
        // The rotor at 30 degrees.
        let seen = one.turning(direction(std::f64::consts::FRAC_PI_6));
        assert!((seen.d - 0.866_025_4).abs() < 1e-6 && (seen.q + 0.5).abs() < 1e-6);
    }

    #[test]
    fn what_is_common_to_the_phases_falls_out() {
        let with = AlphaBeta::of_phases([3.0, 1.5, 1.5]);
        assert_eq!(
            with,
            AlphaBeta {
                alpha: 1.0,
                beta: 0.0
            }
        );
    }

    proptest! {
        #[test]
        fn power_is_the_same_in_phases_and_in_turning_axes(
            v in prop::array::uniform2(-14_f32..14.0),
            i in prop::array::uniform2(-10_f32..10.0),
            angle in 0_f64..6.3,
        ) {
            let volts = AlphaBeta { alpha: v[0], beta: v[1] };
            let amperes = AlphaBeta { alpha: i[0], beta: i[1] };
            let sum: f32 = volts.phases().iter().zip(amperes.phases()).map(|(v, i)| v * i).sum();
            let angle = direction(angle);
            let turning = volts.turning(angle).power_w(amperes.turning(angle));
            prop_assert!((sum - turning).abs() < 1e-3, "{} {}", sum, turning);
        }

        #[test]
        fn there_and_back_changes_nothing(
            v in prop::array::uniform2(-14_f32..14.0),
            angle in 0_f64..6.3,
        ) {
            let volts = AlphaBeta { alpha: v[0], beta: v[1] };
            let back = volts.turning(direction(angle)).fixed(direction(angle));
            let phases = AlphaBeta::of_phases(back.phases());
            prop_assert!((phases.alpha - v[0]).abs() + (phases.beta - v[1]).abs() < 1e-4);
        }
    }
}
