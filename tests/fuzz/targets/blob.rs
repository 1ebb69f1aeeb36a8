//! Encoded calibrations: mutations of the tables that `MAGPIE_TABLES` names, and any bytes.
#![no_main]

use std::sync::OnceLock;

use fuzz::blob::Seeds;

// The file of the tables names what it needs as the firmware does.
#[allow(unused_imports)]
use firmware::*;

#[allow(unused_imports, dead_code, clippy::all)]
mod tables {
    include!(env!("MAGPIE_TABLES"));
}

static SEEDS: OnceLock<Seeds> = OnceLock::new();

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let seeds = SEEDS.get_or_init(|| Seeds::new(&tables::TABLES));
    fuzz::counters::add(seeds.decode(bytes).counts());
});
