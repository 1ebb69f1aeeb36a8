//! The two curves of a gated unit, several values at once.
//!
//! The exponential of a library takes one value after the other, and a third of a training would pass
//! in it. This one is additions and products alone, in a fixed order: the compiler takes as many
//! values at a time as the processor can, and the bits are the same on all of them.

/// Beyond this the sigmoid is 0 or 1 to the last bit, and the exponential still finite.
const GREATEST: f32 = 80.0;
/// Added and taken away again, it leaves the nearest whole number; that number then stands in the
/// lowest bits of the sum.
const ROUNDING: f32 = 12_582_912.0;
/// Upper part of the natural logarithm of two: its product with a whole number below 128 is exact.
const LN_2_UPPER: f32 = 0.693_359_4;
/// What is left of it.
const LN_2_LOWER: f32 = -2.121_944_4e-4;
/// Exponent of one in the format, and its place.
const EXPONENT: (u32, u32) = (127, 23);

/// The exponential, to 3e-7 of its value, between -80 and 80; the value at the end beyond.
fn exp(x: f32) -> f32 {
    let x = x.clamp(-GREATEST, GREATEST);
    let sum = x * std::f32::consts::LOG2_E + ROUNDING;
    let whole = sum - ROUNDING;
    let rest = x - whole * LN_2_UPPER - whole * LN_2_LOWER;
    // The series of Taylor; its next term is below 1.2e-7 where the rest is half the logarithm.
    let mut series = 1.0 / 720.0;
    for factor in [1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        series = series * rest + factor;
    }
    let (one, place) = EXPONENT;
    series * f32::from_bits(sum.to_bits().wrapping_add(one) << place)
}

/// `1 / (1 + exp(-x))`, to 2e-7.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// The hyperbolic tangent, to 4e-7.
pub fn tanh(x: f32) -> f32 {
    2.0 * sigmoid(2.0 * x) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_curves_are_exact_to_a_few_parts_in_ten_million() {
        for i in -200_000..=200_000 {
            let x = i as f32 * 1e-4;
            let exact = f64::from(x);
            let error = f64::from(exp(x)) / exact.exp() - 1.0;
            assert!(error.abs() < 3e-7, "{x}: {error}");
            let error = f64::from(sigmoid(x)) - 1.0 / (1.0 + (-exact).exp());
            assert!(error.abs() < 2e-7, "{x}: {error}");
            let error = f64::from(tanh(x)) - exact.tanh();
            assert!(error.abs() < 4e-7, "{x}: {error}");
        }
    }

    #[test]
    fn far_out_they_stay_at_their_ends() {
        for x in [90.0, 1e4, f32::MAX] {
            assert_eq!((sigmoid(x), tanh(x), tanh(-x)), (1.0, 1.0, -1.0));
            assert!(sigmoid(-x) < 1e-30);
        }
        assert!(sigmoid(f32::NAN).is_nan());
    }
}
