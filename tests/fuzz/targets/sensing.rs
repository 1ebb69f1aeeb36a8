//! Bytes of the sensors, to forces, by the tables that `MAGPIE_TABLES` names: the committed ones, if it
//! names none.
#![no_main]

use std::sync::OnceLock;

use fuzz::sensing::Chain;

// The file of the tables names what it needs as the firmware does.
#[allow(unused_imports)]
use firmware::*;

#[allow(unused_imports, dead_code, clippy::all)]
mod tables {
    include!(env!("MAGPIE_TABLES"));
}

type Body = Box<dyn Fn(&[u8]) + Send + Sync>;

/// The chain after a reset and after a rest, which takes long.
static BODIES: OnceLock<[Body; 2]> = OnceLock::new();

fn bodies() -> [Body; 2] {
    let new = Chain::new(&tables::TABLES, &tables::NETWORKS);
    let rested = new.clone().rested();
    [new, rested].map(|chain| -> Body {
        Box::new(move |bytes| {
            fuzz::counters::add(chain.clone().sense(bytes).counts());
        })
    })
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let [new, rested] = BODIES.get_or_init(bodies);
    match bytes {
        [choice, story @ ..] if choice & 1 == 0 => new(story),
        [_, story @ ..] => rested(story),
        [] => {}
    }
});
