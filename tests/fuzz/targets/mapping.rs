//! Mapping files and tables of other test benches.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::mapping::convert(bytes).counts());
});
