//! MCAP files with changed records, lengths and definitions.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::bag::read_mcap(bytes).counts());
});
