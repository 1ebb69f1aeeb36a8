//! Integer arithmetic that saturates instead of wrapping.

/// Into 32 bits; what does not fit stays at the end of the range. A call: in fifty places it is shorter.
#[inline(never)]
pub const fn clamped(value: i64) -> i32 {
    if value > i32::MAX as i64 {
        i32::MAX
    } else if value < i32::MIN as i64 {
        i32::MIN
    } else {
        value as i32
    }
}

/// `value * share`, where `share` has `bits` fractional bits (62 at the most), rounded to the nearest. The bits are
/// a constant wherever it is called: inlined, the shift is three instructions and no call.
#[inline(always)]
pub const fn share_of(value: i32, share: i32, bits: u32) -> i32 {
    let bits = if bits < 62 { bits } else { 62 };
    let half = (1_i64 << bits) >> 1;
    // 2^62 and 2^61 at the most.
    clamped((value as i64 * share as i64).wrapping_add(half) >> bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_rounded_to_the_nearest_and_stays_in_range() {
        assert_eq!(
            [share_of(3, 1 << 15, 16), share_of(-3, 1 << 15, 16)],
            [2, -1]
        );
        assert_eq!(share_of(i32::MAX, i32::MAX, 1), i32::MAX);
        assert_eq!(share_of(i32::MIN, i32::MAX, 0), i32::MIN);
    }
}
