//! Sigmoid and tanh of the recurrent network, by one table with linear interpolation, computed at compile time.
//!
//! A word of the table has a value in its upper and a slope in its lower half. The argument's lower 16 bits as a signed
//! number are the distance from the entry: even entries refer to their start, odd ones to their end, without a mask.
//! Arguments beyond the table saturate.
//!
//! The table of the sigmoid serves tanh as well, since `tanh(a) = 2 sigmoid(2 a) - 1`: a shift of the accumulator by
//! one bit less doubles the argument, one fractional bit less in the result doubles the value.
//!
//! | | argument | result | maximum error | rms error |
//! | --- | --- | --- | --- | --- |
//! | [`sigmoid`] | Q26, used within ±16 | Q31 | 4e-5 | 1.8e-5 |
//! | [`tanh`] | Q26, used within ±8 | Q30 | 8e-5 | 3.6e-5 |
//!
//! Near its ends the sigmoid's error is 1.5e-5, half a bit of the table's value: 1 - z of an update gate is accurate to
//! 1.5 % at a time constant of 1000 steps, and to 15 % at 10,000. Slower effects (creep, temperature) are compensated by
//! their own equations.

/// Entries of the table; zero is in the middle.
pub const ENTRIES: usize = 512;
/// Entry of an argument of zero.
pub const MIDDLE: usize = ENTRIES / 2;
/// Bits of an argument between two entries.
const ENTRY_BITS: u32 = 15;
/// Bits of an argument that the table spans: 9 of the entry, 15 below.
const ARGUMENT_BITS: u32 = 24;
/// Right shift of a sigmoid's accumulator (Q26) to Q19: 1/16 between two entries.
pub const SIGMOID_SHIFT: u32 = 7;
/// Right shift of a tanh's accumulator to Q20: 1/32 between two entries.
pub const TANH_SHIFT: u32 = 6;

/// One in tanh's format: the difference of the table's value and tanh.
pub const TANH_ONE: i32 = 1 << 30;

/// Table shared by all kernels.
pub static TABLE: [u32; ENTRIES] = table();

/// 1 / (1 + exp(-a)) of an accumulator in Q26, as Q31.
pub fn sigmoid(accumulator: i32) -> i32 {
    interpolate(accumulator >> SIGMOID_SHIFT)
}

/// tanh(a) of an accumulator in Q26, as Q30.
pub fn tanh(accumulator: i32) -> i32 {
    interpolate(accumulator >> TANH_SHIFT).wrapping_sub(TANH_ONE)
}

fn interpolate(argument: i32) -> i32 {
    let limit = 1 << (ARGUMENT_BITS - 1);
    let argument = argument.clamp(-limit, limit - 1);
    let index = (argument >> ENTRY_BITS) + MIDDLE as i32;
    let entry = TABLE.get(index as usize).copied().unwrap_or(0) as i32;
    let slope = i32::from(entry as i16);
    let distance = i32::from(argument as i16);
    entry.wrapping_add(slope * distance)
}

/// Sigmoid at a distance from the middle of the table.
const fn at(entries: f64) -> f64 {
    1.0 / (1.0 + exponential(-entries / 16.0))
}

/// One in the sigmoid's format.
const ONE: f64 = (1_u32 << 31) as f64;
/// Bounds of a word's upper half. They exclude ±1 of tanh, so that a difference of two states fits 32 bits.
const BOUNDS: [i64; 2] = [1, (1 << 15) - 1];

const fn table() -> [u32; ENTRIES] {
    let mut words = [0; ENTRIES];
    let mut remaining: &mut [u32] = &mut words;
    let mut entry = -(MIDDLE as i64);
    while let Some((word, others)) = remaining.split_first_mut() {
        *word = entry_word(entry);
        entry += 1;
        remaining = others;
    }
    words
}

/// Word of an entry. The line is shifted by half its maximum error to balance the errors.
const fn entry_word(entry: i64) -> u32 {
    let start = at(entry as f64);
    let end = at(entry as f64 + 1.0);
    let sag = 0.5 * (at(entry as f64 + 0.5) - 0.5 * (start + end));
    let slope = rounded((end - start) * ONE / (1_u32 << ENTRY_BITS) as f64);
    // Odd entries refer to their end, with a negative distance.
    let reference = if entry % 2 == 0 { start } else { end };
    let value = rounded((reference + sag) * ONE);
    // The lower half adds to the value: subtracted from it.
    let upper = (value - slope + (1 << 15)) >> 16;
    let [min, max] = BOUNDS;
    let upper = if upper > max {
        max
    } else if upper < min {
        min
    } else {
        upper
    };
    ((upper << 16) + slope) as u32
}

const fn rounded(value: f64) -> i64 {
    (if value < 0.0 { value - 0.5 } else { value + 0.5 }) as i64
}

/// exp(x) for |x| <= 16 at compile time: the series at x / 64, squared six times.
const fn exponential(x: f64) -> f64 {
    let x = x / 64.0;
    let (mut term, mut sum, mut order) = (1.0, 1.0, 1.0);
    while order < 16.0 {
        term *= x / order;
        sum += term;
        order += 1.0;
    }
    let mut squarings = 6;
    while squarings > 0 {
        sum *= sum;
        squarings -= 1;
    }
    sum
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    /// Maximum and rms error, minimum and maximum value over every distinct argument.
    fn errors(
        fixed: fn(i32) -> i32,
        shift: u32,
        one: f64,
        truth: fn(f64) -> f64,
    ) -> (f64, f64, i32, i32) {
        let (mut worst, mut squares) = (0.0_f64, 0.0);
        let (mut min, mut max) = (i32::MAX, i32::MIN);
        let limit = 1_i64 << (ARGUMENT_BITS - 1);
        for argument in -limit..limit {
            let accumulator = (argument << shift).clamp(i32::MIN.into(), i32::MAX.into()) as i32;
            let value = fixed(accumulator);
            (min, max) = (min.min(value), max.max(value));
            let error = f64::from(value) / one - truth(f64::from(accumulator) / 67_108_864.0);
            worst = worst.max(error.abs());
            squares += error * error;
        }
        (worst, (squares / (2 * limit) as f64).sqrt(), min, max)
    }

    #[test]
    fn the_sigmoid_has_an_error_below_4e_5_and_stays_in_0_to_1() {
        let truth = |a: f64| 1.0 / (1.0 + (-a).exp());
        let (worst, rms, min, max) = errors(sigmoid, SIGMOID_SHIFT, 2_147_483_648.0, truth);
        assert!(worst < 4e-5 && rms < 1.8e-5, "{worst:e} {rms:e}");
        assert!(min > 0 && max > 2_147_000_000, "{min} {max}");
    }

    #[test]
    fn tanh_has_an_error_below_8e_5_and_stays_within_plus_minus_1() {
        let (worst, rms, min, max) = errors(tanh, TANH_SHIFT, 1_073_741_824.0, f64::tanh);
        assert!(worst < 8e-5 && rms < 3.6e-5, "{worst:e} {rms:e}");
        assert!(max < TANH_ONE - 4 && min > -TANH_ONE + 4, "{min} {max}");
    }

    #[test]
    fn activations_are_exact_at_zero_and_saturate_beyond_the_table() {
        assert!((sigmoid(0) - (1 << 30)).abs() < 1 << 16);
        assert!(tanh(0).abs() < 1 << 16);
        // Accumulators reach ±32; the table ends at 16, for tanh at 8.
        assert_eq!(sigmoid(i32::MAX), sigmoid(16 << 26));
        assert_eq!(sigmoid(i32::MIN), sigmoid(-(16 << 26)));
        assert_eq!(tanh(i32::MAX), tanh(8 << 26));
    }
}
