//! Uploads of calibrations, with power cuts.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::upload::upload(bytes).counts());
});
