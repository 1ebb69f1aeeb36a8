//! Bytes on the serial line.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::serial::receive(bytes);
});
