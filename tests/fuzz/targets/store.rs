//! Pages of flash, and saves that are cut short.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::store::keep(bytes).counts());
});
