//! Bytes of the sensors, to forces, by the tables that `MAGPIE_TABLES` names: the committed ones, if it
//! names none.
#![no_main]

use std::sync::OnceLock;

use firmware::model::formats::Tables;
use fuzz::sensing::Chain;

// The file of the tables names what it needs as the firmware does.
#[allow(unused_imports)]
use firmware::*;

#[allow(unused_imports, dead_code, clippy::all)]
mod tables {
    include!(env!("MAGPIE_TABLES"));
}

type Body = Box<dyn Fn(&[u8]) + Send + Sync>;

/// The chain after a reset, after a rest, which takes long, and after a rest without the effects: with those of the opening no
/// magnetic disturbance is detected before homing.
static BODIES: OnceLock<[Body; 3]> = OnceLock::new();
static IDEAL: Tables = Tables { compensations: &[], ..tables::TABLES };

fn bodies() -> [Body; 3] {
    let new = Chain::new(&tables::TABLES, &tables::NETWORKS);
    let rested = new.clone().rested();
    let ideal = Chain::new(&IDEAL, &tables::NETWORKS).rested();
    [new, rested, ideal].map(|chain| -> Body {
        Box::new(move |bytes| {
            fuzz::counters::add(chain.clone().sense(bytes).counts());
        })
    })
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let bodies = BODIES.get_or_init(bodies);
    if let [choice, story @ ..] = bytes {
        bodies[usize::from(*choice) % bodies.len()](story);
    }
});
