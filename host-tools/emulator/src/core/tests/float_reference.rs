//! The exact arithmetic against the computer's own.

use crate::core::ieee754;
use crate::core::tests::float::{INEXACT, TO_MINUS, TO_PLUS, TO_ZERO};

/// Bit patterns with every kind of number, from a linear congruential sequence.
fn patterns(seed: u32) -> impl FnMut() -> u32 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let bits = state ^ state >> 15;
        // Half of them close to one, so that sums cancel.
        if state >> 30 & 1 == 0 { bits } else { bits & 0x83FF_FFFF | 0x3C00_0000 }
    }
}

#[test]
fn exact_arithmetic_agrees_with_the_computer() {
    let mut next = patterns(1);
    for _ in 0..200_000 {
        let (a, b, c) = (next(), next(), next());
        let (x, y, z) = (f32::from_bits(a), f32::from_bits(b), f32::from_bits(c));
        let mut fpscr = 0;
        let results = [
            (ieee754::add(a, b, &mut fpscr), x + y),
            (ieee754::subtract(a, b, &mut fpscr), x - y),
            (ieee754::multiply(a, b, &mut fpscr), x * y),
            (ieee754::divide(a, b, &mut fpscr), x / y),
            (ieee754::square_root(a, &mut fpscr), x.sqrt()),
            (ieee754::multiply_add(c, a, b, &mut fpscr), x.mul_add(y, z)),
            (ieee754::from_fixed(a as i32 as i64, 0, true, &mut fpscr), a as i32 as f32),
        ];
        for (operation, (exact, computer)) in results.into_iter().enumerate() {
            let nan = f32::from_bits(exact).is_nan() && computer.is_nan();
            assert!(nan || exact == computer.to_bits(), "{operation} of {a:#x} {b:#x} {c:#x}");
        }
    }
}

#[test]
fn inexact_flag_agrees_with_double_precision() {
    let mut next = patterns(2);
    for _ in 0..200_000 {
        let (a, b) = (next(), next());
        let (x, y) = (f32::from_bits(a) as f64, f32::from_bits(b) as f64);
        // A product of two singles is exact in double precision.
        let mut fpscr = 0;
        let product = f32::from_bits(ieee754::multiply(a, b, &mut fpscr));
        if !product.is_nan() {
            let inexact = product as f64 != x * y;
            assert_eq!(fpscr & INEXACT != 0, inexact, "{a:#x} * {b:#x}");
        }
    }
}

#[test]
fn directed_roundings_enclose_the_nearest() {
    let mut next = patterns(3);
    for _ in 0..100_000 {
        let (a, b) = (next(), next());
        let rounded = |mode: u32| {
            let mut fpscr = mode;
            (f32::from_bits(ieee754::divide(a, b, &mut fpscr)), fpscr & INEXACT != 0)
        };
        let (nearest, inexact) = rounded(0);
        let (up, down, zero) = (rounded(TO_PLUS).0, rounded(TO_MINUS).0, rounded(TO_ZERO).0);
        if nearest.is_nan() {
            continue;
        }
        assert!(down <= nearest && nearest <= up, "{a:#x} / {b:#x}");
        assert_eq!(down != up, inexact, "{a:#x} / {b:#x}");
        if inexact {
            // Neighbours, the same ones but for the sign.
            assert_eq!(down.next_up(), up, "{a:#x} / {b:#x}");
            let toward_zero =
                if down < 0.0 || down == 0.0 && down.is_sign_negative() { up } else { down };
            assert_eq!(zero.to_bits(), toward_zero.to_bits(), "{a:#x} / {b:#x}");
        }
    }
}
