//! What stands around the weights: inputs from the device's units, forces from the outputs.

use super::super::network::{FORCE_BITS, Input, OUTPUT_BITS, OUTPUTS, Told};
use super::super::table::GAIN_BITS;
use crate::fixed::share_of;
use crate::units::Force;

/// Scaled to Q14, rounded to the nearest; what does not fit stays at the end of the range, twice the
/// span of the training data.
pub fn input(input: Input, value: i32) -> i16 {
    let from_middle = value.saturating_sub(input.offset);
    let scaled = share_of(from_middle, input.gain, GAIN_BITS);
    scaled.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

/// The forces of a sensor from its outputs (Q26). A standard deviation is one unit at the least, so
/// that whoever weighs with it never divides by zero.
pub fn told(force: [i32; 2], [x, z, log_x, log_z]: [i32; OUTPUTS]) -> Told {
    let [force_x, force_z] = force;
    let mean = |output, force| Force(share_of(output, force, OUTPUT_BITS + FORCE_BITS));
    let sigma = |output, force| Force(times_exponential(force, output).max(1));
    Told {
        mean: [mean(x, force_x), mean(z, force_z)],
        sigma: [sigma(log_x, force_x), sigma(log_z, force_z)],
    }
}

/// log2(e) with 30 fractional bits.
const LOG2_E: i64 = 1_549_082_005;
/// Coefficients of the cubic that goes through 2^x for x from 0 to 1 with the least relative error,
/// 30 fractional bits, from the constant up. Their sum stays below 2^31.
const CUBIC: [i32; 4] = [1_073_661_528, 747_145_574, 242_737_764, 83_778_190];
/// Fractional bits of both.
const CUBIC_BITS: u32 = 30;

/// `force * exp(output)`: a force with [`FORCE_BITS`] fractional bits, an output in Q26. The greatest
/// relative error is 8e-5, beside half a unit of rounding; what does not fit stays at the end.
fn times_exponential(force: i32, output: i32) -> i32 {
    let power = (i64::from(output) * LOG2_E) >> CUBIC_BITS;
    let whole = power >> OUTPUT_BITS;
    let below = (power as i32 & ((1 << OUTPUT_BITS) - 1)) << (CUBIC_BITS - OUTPUT_BITS);
    let times_below = |sum: i32| ((i64::from(sum) * i64::from(below)) >> CUBIC_BITS) as i32;
    let cubic = CUBIC.iter().rev();
    let two_to_below = cubic.fold(0_i32, |sum, coefficient| {
        times_below(sum).wrapping_add(*coefficient)
    });
    // At most 2^31 times 2^31.
    let product = i64::from(force) * i64::from(two_to_below);
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
    use super::super::super::network::Source;
    use super::*;

    /// 20 N for an output of one.
    const FORCE: [i32; 2] = [20 << (Force::BITS + FORCE_BITS); 2];

    #[test]
    fn an_input_is_rounded_and_stays_at_the_end_of_its_range() {
        // 16384 for 400 units.
        let scaled = |value| {
            let source = Source::Field { sensor: 0, axis: 0 };
            let gain = (16_384_i64 << GAIN_BITS) / 400;
            input(
                Input {
                    source,
                    offset: 100,
                    gain: gain as i32,
                },
                value,
            )
        };
        assert_eq!(
            [100, 500, -300, 101, 99].map(scaled),
            [0, 16_384, -16_384, 41, -41]
        );
        assert_eq!([i32::MAX, i32::MIN].map(scaled), [i16::MAX, i16::MIN]);
    }

    #[test]
    fn an_input_from_nowhere_is_zero() {
        let none = Input {
            source: Source::None,
            offset: 0,
            gain: 0,
        };
        assert_eq!(
            [i32::MIN, 5, i32::MAX].map(|value| input(none, value)),
            [0; 3]
        );
    }

    #[test]
    fn an_output_of_one_is_its_force_and_a_logarithm_of_zero_too() {
        let one = 1 << OUTPUT_BITS;
        let told = told(FORCE, [one, -one / 2, 0, -one]);
        assert_eq!(told.mean.map(|force| force.0), [20 << 10, -10 << 10]);
        let [x, z] = told.sigma.map(Force::newtons);
        assert!(
            (x - 20.0).abs() < 0.002 && (z - 20.0 / 1_f64.exp()).abs() < 0.001,
            "{x} {z}"
        );
    }

    #[test]
    fn the_exponential_is_exact_to_eight_hundred_thousandths() {
        let mut worst = 0.0_f64;
        for step in -600..500 {
            let output = f64::from(step) / 100.0 + 0.003;
            let fixed = times_exponential(1 << 24, (output * f64::from(1 << OUTPUT_BITS)) as i32);
            // Rounding to a unit shows where there are few units.
            let truth = f64::from(1 << 16) * output.exp();
            worst = worst.max((f64::from(fixed) - truth).abs() / truth - 0.5 / truth);
        }
        assert!(worst < 8e-5, "{worst:e}");
    }

    #[test]
    fn an_absurd_logarithm_gives_the_ends_of_the_range() {
        let [least, greatest] = [i32::MIN, i32::MAX].map(|log| told(FORCE, [0, 0, log, log]));
        assert_eq!(least.sigma, [Force(1); 2]);
        assert_eq!(greatest.sigma, [Force(i32::MAX); 2]);
    }
}
