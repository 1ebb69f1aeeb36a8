//! Scaling of a network's inputs from device units and of its outputs to forces.

use crate::fixed_point::{Force, mul_q};
use crate::model::formats::{FORCE_BITS, GAIN_BITS, Input, OUTPUT_BITS, OUTPUTS, Prediction};

/// Scales to Q14, rounded to the nearest; saturates at twice the span of the training data.
pub fn input(input: Input, value: i32) -> i16 {
    let centred = value.saturating_sub(input.offset);
    let scaled = mul_q(centred, input.gain, GAIN_BITS);
    scaled.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

/// Forces of a sensor from its outputs (Q26). A standard deviation is at least one unit, so that weights by its
/// inverse are finite.
pub fn prediction(force: [i32; 2], [x, z, log_x, log_z]: [i32; OUTPUTS]) -> Prediction {
    let [force_x, force_z] = force;
    let mean = |output, force| Force(mul_q(output, force, OUTPUT_BITS + FORCE_BITS));
    let sigma = |output, force| Force(times_exponential(force, output).max(1));
    Prediction {
        mean: [mean(x, force_x), mean(z, force_z)],
        sigma: [sigma(log_x, force_x), sigma(log_z, force_z)],
    }
}

/// log2(e) with 30 fractional bits.
const LOG2_E: i64 = 1_549_082_005;
/// Minimax cubic for 2^x on [0, 1] in terms of relative error: coefficients with 30 fractional bits in ascending
/// order. Their sum is below 2^31.
const CUBIC: [i32; 4] = [1_073_661_528, 747_145_574, 242_737_764, 83_778_190];
/// Fractional bits of both.
const CUBIC_BITS: u32 = 30;

/// `force * exp(output)`: a force with [`FORCE_BITS`] fractional bits, an output in Q26. The maximum relative error is
/// 8e-5, plus half a unit of rounding; saturates.
fn times_exponential(force: i32, output: i32) -> i32 {
    let power = (i64::from(output) * LOG2_E) >> CUBIC_BITS;
    let whole = power >> OUTPUT_BITS;
    let fraction = (power as i32 & ((1 << OUTPUT_BITS) - 1)) << (CUBIC_BITS - OUTPUT_BITS);
    let times_fraction = |sum: i32| ((i64::from(sum) * i64::from(fraction)) >> CUBIC_BITS) as i32;
    let cubic = CUBIC.iter().rev();
    let power_of_fraction =
        cubic.fold(0_i32, |sum, coefficient| times_fraction(sum).wrapping_add(*coefficient));
    // At most 2^31 times 2^31.
    let product = i64::from(force) * i64::from(power_of_fraction);
    let shift = i64::from(FORCE_BITS + CUBIC_BITS) - whole;
    match u32::try_from(shift) {
        Ok(0) | Err(_) => i32::MAX,
        Ok(63..) => 0,
        Ok(shift) => {
            let rounded = (product >> (shift - 1)).saturating_add(1) >> 1;
            rounded.clamp(0, i32::MAX.into()) as i32
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::model::formats::InputSource;

    /// 20 N for an output of one.
    const FORCE: [i32; 2] = [20 << (Force::BITS + FORCE_BITS); 2];

    #[test]
    fn an_input_is_rounded_and_saturates() {
        // 16384 for 400 units.
        let gain = ((16_384_i64 << GAIN_BITS) / 400) as i32;
        for (offset, gain, value, expected) in [
            (100, gain, 100, 0),
            (100, gain, 500, 16_384),
            (100, gain, -300, -16_384),
            (100, gain, 101, 41),
            (100, gain, 99, -41),
            (100, gain, i32::MAX, i16::MAX),
            (100, gain, i32::MIN, i16::MIN),
            (0, 0, i32::MIN, 0),
            (0, 0, i32::MAX, 0),
        ] {
            let source = InputSource::None;
            let scaled = input(Input { source, offset, gain }, value);
            assert_eq!(scaled, expected, "{value}");
        }
    }

    #[test]
    fn outputs_scale_to_mean_and_exponential_sigma() {
        let one = 1 << OUTPUT_BITS;
        let found = prediction(FORCE, [one, -one / 2, 0, -one]);
        assert_eq!(found.mean.map(|force| force.0), [20 << 10, -10 << 10]);
        let [x, z] = found.sigma.map(Force::newtons);
        assert!((x - 20.0).abs() < 0.002 && (z - 20.0 / 1_f64.exp()).abs() < 0.001, "{x} {z}");
    }

    #[test]
    fn the_exponential_has_a_relative_error_below_8e_5() {
        let mut worst = 0.0_f64;
        for step in -600..500 {
            let output = f64::from(step) / 100.0 + 0.003;
            let fixed = times_exponential(1 << 24, (output * f64::from(1 << OUTPUT_BITS)) as i32);
            // Less half a unit of rounding, visible at small values.
            let truth = f64::from(1 << 16) * output.exp();
            worst = worst.max((f64::from(fixed) - truth).abs() / truth - 0.5 / truth);
        }
        assert!(worst < 8e-5, "{worst:e}");
    }

    #[test]
    fn extreme_logarithms_saturate_sigma() {
        let [min, max] = [i32::MIN, i32::MAX].map(|log| prediction(FORCE, [0, 0, log, log]));
        assert_eq!(min.sigma, [Force(1); 2]);
        assert_eq!(max.sigma, [Force(i32::MAX); 2]);
    }
}
