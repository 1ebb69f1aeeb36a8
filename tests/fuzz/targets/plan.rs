//! Plans of recordings.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::plan::read(bytes).counts());
});
