//! Arithmetic of the control loops in floating point: nothing in it hides what is not a number.

use core::f32::consts::TAU;

use micromath::F32;

/// Limits a number to `low..=high`; what is not a number stays so, and is found further down.
pub fn within(value: f32, low: f32, high: f32) -> f32 {
    if value > high {
        high
    } else if value < low {
        low
    } else {
        value
    }
}

/// The greater of two numbers; the library's own is a call and hides what is no number.
pub fn greater(one: f32, other: f32) -> f32 {
    if one > other { one } else { other }
}

/// The lesser of two numbers.
pub fn lesser(one: f32, other: f32) -> f32 {
    if one < other { one } else { other }
}

/// The share of the way from `start` to `end`, 0 before and 1 behind; `end` may lie on either side.
pub fn share(value: f32, start: f32, end: f32) -> f32 {
    within((value - start) / (end - start), 0.0, 1.0)
}

/// One over the square root of a positive number; relative error at most 5e-6.
///
/// The library's estimate of 3.5 % and two steps of Newton's. Of what is not positive it is no number or none
/// of use: callers ask first.
pub fn inverse_sqrt(value: f32) -> f32 {
    let step = |root: f32| root * (1.5 - 0.5 * value * root * root);
    step(step(F32(value).invsqrt().0))
}

/// Square root; of what is not positive it is zero. Relative error as [`inverse_sqrt`].
pub fn sqrt(value: f32) -> f32 {
    match value <= 0.0 {
        true => 0.0,
        false => value * inverse_sqrt(value),
    }
}

/// An angle as sine and cosine; each is off by at most 0.0011, which ripples a torque by as much.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Direction {
    /// Sine.
    pub sin: f32,
    /// Cosine.
    pub cos: f32,
}

impl Direction {
    /// Of an angle in 2^-32 turns. The library's functions are named in full: where there is a standard
    /// library, its own would be taken instead, and hosts would compute something else than the device.
    pub fn of(angle: u32) -> Self {
        let angle = F32(angle as i32 as f32 * (TAU / 4_294_967_296.0));
        Self {
            sin: angle.sin().0,
            cos: angle.cos().0,
        }
    }

    /// Turned on by a small angle in radians; the error of a tenth of a radian is 2e-4.
    pub fn turned(self, angle: f32) -> Self {
        let along = 1.0 - 0.5 * angle * angle;
        Self {
            sin: self.sin * along + self.cos * angle,
            cos: self.cos * along - self.sin * angle,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_off_by_at_most_what_is_said() {
        let mut worst = 0_f64;
        for step in 0..=65_536_u32 {
            let angle = step.wrapping_mul(65_521);
            let told = Direction::of(angle);
            let radians = f64::from(angle) / 4_294_967_296.0 * std::f64::consts::TAU;
            worst = worst.max((f64::from(told.sin) - radians.sin()).abs());
            worst = worst.max((f64::from(told.cos) - radians.cos()).abs());
        }
        assert!((0.0005..0.0011).contains(&worst), "{worst}");
    }

    #[test]
    fn a_small_turn_is_the_sum_of_the_angles() {
        let turned = Direction { sin: 0.6, cos: 0.8 }.turned(0.1);
        let angle = 0.6_f64.asin() + 0.1;
        assert!((f64::from(turned.sin) - angle.sin()).abs() < 2e-4);
        assert!((f64::from(turned.cos) - angle.cos()).abs() < 2e-4);
    }

    #[test]
    fn roots_are_right_over_all_sizes() {
        for exponent in -20..20 {
            for mantissa in [1.0, 1.3, 1.7, 2.1, 3.0, 3.9] {
                let value = mantissa * 4_f32.powi(exponent);
                let error = f64::from(sqrt(value)) / f64::from(value).sqrt() - 1.0;
                assert!(error.abs() < 5e-6, "{value}: {error}");
            }
        }
        assert_eq!([sqrt(0.0), sqrt(-1.0)], [0.0; 2]);
        assert!(sqrt(f32::NAN).is_nan());
    }

    #[test]
    fn limits_hold_on_both_sides_and_do_not_hide_what_is_no_number() {
        assert_eq!(
            [within(3.0, -1.0, 2.0), within(-3.0, -1.0, 2.0)],
            [2.0, -1.0]
        );
        assert!(within(f32::NAN, -1.0, 2.0).is_nan());
        assert_eq!(
            [share(27.0, 26.0, 28.0), share(27.0, 28.0, 24.0)],
            [0.5, 0.25]
        );
        assert_eq!(
            [share(30.0, 26.0, 28.0), share(30.0, 28.0, 24.0)],
            [1.0, 0.0]
        );
    }
}
