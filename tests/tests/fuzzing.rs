//! The fuzz targets on a fixed set of random inputs (`tests/fuzz/README.md`).

#[path = "../fuzz/src/lib.rs"]
mod fuzz;

// The tables use `crate::` paths of the firmware.
#[allow(unused_imports)]
use firmware::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random inputs of up to `longest` bytes.
fn inputs(seed: u64, count: usize, longest: usize) -> impl Iterator<Item = Vec<u8>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(move |_| {
        let length = rng.random_range(0..=longest);
        (0..length).map(|_| rng.random()).collect()
    })
}

#[test]
fn can_sessions_agree_with_the_reference_model() {
    let (mut armed, mut commands, mut dropped) = (0, 0, 0);
    for input in inputs(1, 20_000, 800) {
        let tally = fuzz::can::receive(&input);
        armed += tally.armed;
        commands += tally.commands;
        dropped += tally.dropped;
    }
    // The inputs reach the code behind the checksums.
    assert!(armed > 3_000 && commands > 3_000 && dropped > 100_000, "{armed} {commands} {dropped}");
}

#[test]
fn the_serial_receiver_resynchronises_after_any_bytes() {
    let (mut packets, mut broken) = (0, 0);
    for input in inputs(2, 20_000, 400) {
        let tally = fuzz::serial::receive(&input);
        packets += tally.packets;
        broken += tally.broken;
    }
    assert!(packets > 40_000 && broken > 20_000, "{packets} {broken}");
}

#[test]
fn interrupted_saves_preserve_old_or_new_parameters() {
    let (mut found, mut cut, mut saved) = (0, 0, 0);
    for input in inputs(5, 5_000, 400) {
        let tally = fuzz::store::keep(&input);
        found += tally.found;
        cut += tally.cut;
        saved += tally.saved;
    }
    assert!(found > 500 && cut > 500 && saved > 500, "{found} {cut} {saved}");
}

mod sensing {
    use super::fuzz::sensing::Chain;
    use super::inputs;
    use firmware::model::formats::Tables;

    #[allow(missing_docs, unused_imports, dead_code, clippy::all)]
    mod tables {
        include!("../../firmware/src/model/tables.rs");
    }

    #[test]
    fn forces_are_bounded_for_any_sensor_data() {
        let new = Chain::new(&tables::TABLES, &tables::NETWORKS);
        let settled = new.clone().rested();
        // Without effects that need an opening, disturbances are detected from the beginning.
        let ideal = Tables { compensations: &[], ..tables::TABLES };
        let ideal = Chain::new(&ideal, &tables::NETWORKS).rested();
        let (mut valid, mut unusable, mut disturbed, mut predicted) = (0, 0, 0, 0);
        for (chain, seed) in [(new, 3), (settled, 4), (ideal, 5)] {
            for input in inputs(seed, 2_000, 400) {
                let tally = chain.clone().sense(&input);
                valid += tally.valid;
                unusable += tally.doubtful;
                disturbed += tally.disturbed;
                predicted += tally.reported;
            }
        }
        assert_eq!(predicted > 0, !tables::NETWORKS.is_empty());
        assert!(
            valid > 1000 && unusable > 1000 && disturbed > 100,
            "{valid} {unusable} {disturbed}"
        );
    }
}
