//! Single-precision arithmetic; NaN propagates.

use core::f32::consts::TAU;

use micromath::F32;

/// Angle units per turn, where an angle is an integer of 32 bits that wraps around.
pub const TURN_UNITS: f32 = 4_294_967_296.0;

/// Clamps to `low..=high`; NaN stays NaN.
pub fn within(value: f32, low: f32, high: f32) -> f32 {
    if value > high {
        high
    } else if value < low {
        low
    } else {
        value
    }
}

/// The greater of two numbers; unlike `f32::max` inlined and without special handling of NaN.
pub fn greater(one: f32, other: f32) -> f32 {
    if one > other { one } else { other }
}

/// The lesser of two numbers.
pub fn lesser(one: f32, other: f32) -> f32 {
    if one < other { one } else { other }
}

/// Linear ramp from 0 at `start` to 1 at `end`, clamped; `end` may be below `start`.
pub fn share(value: f32, start: f32, end: f32) -> f32 {
    within((value - start) / (end - start), 0.0, 1.0)
}

/// Inverse square root of a positive number; relative error at most 5e-6. Refines the library's estimate (3.5 %) by two
/// Newton steps. Undefined for other numbers.
pub fn inverse_sqrt(value: f32) -> f32 {
    let step = |root: f32| root * (1.5 - 0.5 * value * root * root);
    step(step(F32(value).invsqrt().0))
}

/// Square root, 0 for negative numbers; relative error as [`inverse_sqrt`].
pub fn sqrt(value: f32) -> f32 {
    if value <= 0.0 { 0.0 } else { value * inverse_sqrt(value) }
}

/// Natural logarithm of a positive normal number; error below 1e-6. That of the library is wrong by up to 0.07.
pub fn ln(value: f32) -> f32 {
    // The number is a power of two times 0.707 to 1.414.
    let shift = value.to_bits().wrapping_sub(0x3F35_04F3) >> 23 << 23;
    let mantissa = f32::from_bits(value.to_bits().wrapping_sub(shift));
    let exponent = (shift as i32 >> 23) as f32;
    let ratio = (mantissa - 1.0) / (mantissa + 1.0);
    let square = ratio * ratio;
    let series = 1.0 + square * (1.0 / 3.0 + square * (0.2 + square / 7.0));
    exponent * core::f32::consts::LN_2 + 2.0 * ratio * series
}

/// Angle of the point (x, y) in radians, -pi to pi, with an error of at most 0.004.
pub fn atan2(y: f32, x: f32) -> f32 {
    F32(y).atan2(F32(x)).0
}

/// Sine and cosine of an angle, each with an error of at most 0.0011, which is also the relative torque ripple.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Direction {
    /// Sine.
    pub sin: f32,
    /// Cosine.
    pub cos: f32,
}

impl Direction {
    /// Of an angle in 2^-32 turns.
    pub fn of(angle: u32) -> Self {
        // `F32` explicitly: on hosts the methods of `f32` would give other results than on the device.
        let angle = F32(angle as i32 as f32 * (TAU / TURN_UNITS));
        Self { sin: angle.sin().0, cos: angle.cos().0 }
    }

    /// Rotated by a small angle in radians; the error at 0.1 rad is 2e-4.
    pub fn rotated(self, angle: f32) -> Self {
        let along = 1.0 - 0.5 * angle * angle;
        Self { sin: self.sin * along + self.cos * angle, cos: self.cos * along - self.sin * angle }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_error_is_within_its_bound() {
        let worst = (1..200_000).map(|step| {
            let value = 1e-4 * step as f32;
            (f64::from(ln(value)) - f64::from(value).ln()).abs()
        });
        assert!(worst.fold(0.0, f64::max) < 1e-6);
        assert!((ln(1e30) - 69.077_55).abs() < 1e-4 && (ln(1e-30) + 69.077_55).abs() < 1e-4);
    }

    #[test]
    fn arctangent_error_is_within_its_bound() {
        let worst = (0..36_000).map(|step| {
            let angle = (f64::from(step) * 0.01 - 180.0).to_radians();
            let found = f64::from(atan2(angle.sin() as f32, angle.cos() as f32));
            let off = (found - angle).abs();
            off.min(2.0 * std::f64::consts::PI - off)
        });
        let worst = worst.fold(0.0, f64::max);
        assert!(worst < 0.004, "{worst}");
    }

    #[test]
    fn sine_and_cosine_errors_are_within_bounds() {
        let mut worst = 0_f64;
        for step in 0..=65_536_u32 {
            let angle = step.wrapping_mul(65_521);
            let direction = Direction::of(angle);
            let radians = f64::from(angle) / 4_294_967_296.0 * std::f64::consts::TAU;
            worst = worst.max((f64::from(direction.sin) - radians.sin()).abs());
            worst = worst.max((f64::from(direction.cos) - radians.cos()).abs());
        }
        assert!((0.0005..0.0011).contains(&worst), "{worst}");
    }

    #[test]
    fn rotation_by_a_small_angle_adds_angles() {
        let turned = Direction { sin: 0.6, cos: 0.8 }.rotated(0.1);
        let angle = 0.6_f64.asin() + 0.1;
        assert!((f64::from(turned.sin) - angle.sin()).abs() < 2e-4);
        assert!((f64::from(turned.cos) - angle.cos()).abs() < 2e-4);
    }

    #[test]
    fn square_root_is_accurate_over_all_magnitudes() {
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
    fn clamping_is_two_sided_and_propagates_nan() {
        assert_eq!([within(3.0, -1.0, 2.0), within(-3.0, -1.0, 2.0)], [2.0, -1.0]);
        assert!(within(f32::NAN, -1.0, 2.0).is_nan());
        assert_eq!([share(27.0, 26.0, 28.0), share(27.0, 28.0, 24.0)], [0.5, 0.25]);
        assert_eq!([share(30.0, 26.0, 28.0), share(30.0, 28.0, 24.0)], [1.0, 0.0]);
    }
}
