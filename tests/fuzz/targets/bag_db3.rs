//! Bags in SQLite with changed pages, cells and schemas.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    fuzz::counters::add(fuzz::bag::read_database(bytes).counts());
});
