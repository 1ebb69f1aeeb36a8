//! Counters that debounce a condition.

/// Next value of a counter of consecutive milliseconds in which a condition is true.
pub(super) const fn next_ms(count: u16, condition: bool) -> u16 {
    if condition { count.saturating_add(1) } else { 0 }
}

/// As [`next_ms`], in ticks.
pub(super) const fn next_ticks(count: u8, condition: bool) -> u8 {
    if condition { count.saturating_add(1) } else { 0 }
}
