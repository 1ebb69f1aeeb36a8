//! Formulas of user-defined effects.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::formula::parse(bytes).counts());
});
