//! MCAP files: message definitions and messages of ROS 2, and JSON.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::bag::read(bytes).counts());
});
