//! Frames on the CAN bus, with their times.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::can::receive(bytes).counts());
});
