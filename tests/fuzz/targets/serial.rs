//! Bytes on the serial line.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::serial::receive(bytes).counts());
});
