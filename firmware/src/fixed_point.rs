//! Fixed-point quantities and saturating integer arithmetic of the estimator. Conversions to floating point are for the host;
//! motor and grip control compute in `f32`.

use core::ops::Neg;

/// Conversion to 32 bits with saturation. Not inlined: used in fifty places, a call is shorter.
#[inline(never)]
#[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
#[allow(unsafe_code)] // As of `estimate`.
pub const fn saturate(value: i64) -> i32 {
    if value > i32::MAX as i64 {
        i32::MAX
    } else if value < i32::MIN as i64 {
        i32::MIN
    } else {
        value as i32
    }
}

/// `value * factor`, where `factor` has `bits` fractional bits (at most 62), rounded to nearest, ties towards plus infinity. Inlined because `bits` is
/// constant in every call, and the shift then takes three instructions.
#[inline(always)]
pub const fn mul_q(value: i32, factor: i32, bits: u32) -> i32 {
    let bits = if bits < 62 { bits } else { 62 };
    let half = (1_i64 << bits) >> 1;
    // At most 2^62 + 2^61.
    saturate((value as i64 * factor as i64).wrapping_add(half) >> bits)
}

/// A magnetic field in 1/16 LSB of the sensor; the fraction is the resolution of the compensation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Field(pub i32);

impl Field {
    /// Fractional bits.
    pub const BITS: u32 = 4;

    /// Conversion from counts of the sensor.
    pub const fn from_counts(counts: i16) -> Self {
        Self((counts as i32) << Self::BITS)
    }

    /// Subtracts an offset in 1/16 LSB, saturating.
    pub const fn saturating_sub(self, offset: i32) -> Self {
        Self(self.0.saturating_sub(offset))
    }

    /// In counts.
    pub fn counts(self) -> f64 {
        f64::from(self.0) / f64::from(1_u32 << Self::BITS)
    }
}

impl Neg for Field {
    type Output = Self;

    /// Saturating.
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

/// A force in 1/1024 N; the range is +-2 MN.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Force(pub i32);

impl Force {
    /// Fractional bits.
    pub const BITS: u32 = 10;
    /// Counts per newton.
    pub const PER_NEWTON: f64 = (1_u32 << Self::BITS) as f64;

    /// In newtons.
    pub fn newtons(self) -> f64 {
        f64::from(self.0) / Self::PER_NEWTON
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mul_q_rounds_to_nearest_and_saturates() {
        assert_eq!([mul_q(3, 1 << 15, 16), mul_q(-3, 1 << 15, 16)], [2, -1]);
        assert_eq!(mul_q(i32::MAX, i32::MAX, 1), i32::MAX);
        assert_eq!(mul_q(i32::MIN, i32::MAX, 0), i32::MIN);
    }
}
