//! What the fuzzer runs, over inputs drawn at random: a small fixed part of it, in every test run. See
//! `tests/fuzz/README.md`.

#[path = "../fuzz/src/lib.rs"]
mod fuzz;

// The tables' file names what it needs as the firmware does.
#[allow(unused_imports)]
use firmware::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// So many inputs of up to so many bytes.
fn inputs(seed: u64, count: usize, longest: usize) -> impl Iterator<Item = Vec<u8>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(move |_| {
        let length = rng.random_range(0..=longest);
        (0..length).map(|_| rng.random()).collect()
    })
}

#[test]
fn no_story_on_the_can_bus_moves_the_gripper_against_the_rules() {
    let (mut armed, mut commands, mut dropped) = (0, 0, 0);
    for input in inputs(1, 20_000, 400) {
        let tally = fuzz::can::hear(&input);
        armed += tally.armed;
        commands += tally.commands;
        dropped += tally.dropped;
    }
    // The stories come where they should: else the rules were never asked.
    assert!(
        armed > 5_000 && commands > 1_000 && dropped > 100_000,
        "{armed} {commands} {dropped}"
    );
}

#[test]
fn whatever_comes_on_the_serial_line_the_next_sound_packet_is_understood() {
    let (mut packets, mut broken) = (0, 0);
    for input in inputs(2, 20_000, 400) {
        let tally = fuzz::serial::receive(&input);
        packets += tally.packets;
        broken += tally.broken;
    }
    assert!(packets > 40_000 && broken > 20_000, "{packets} {broken}");
}

#[test]
fn whatever_flash_holds_and_whenever_the_power_goes_the_old_or_the_new_parameters_are_found() {
    let (mut found, mut cut, mut saved) = (0, 0, 0);
    for input in inputs(5, 5_000, 400) {
        let tally = fuzz::store::keep(&input);
        found += tally.found;
        cut += tally.cut;
        saved += tally.saved;
    }
    assert!(
        found > 500 && cut > 500 && saved > 500,
        "{found} {cut} {saved}"
    );
}

mod sensing {
    use super::fuzz::sensing::Chain;
    use super::inputs;

    #[allow(missing_docs, unused_imports, clippy::all)]
    mod tables {
        include!("../../firmware/src/model/tables.rs");
    }

    #[test]
    fn whatever_the_sensors_send_the_forces_stay_within_the_tables() {
        let new = Chain::new(&tables::TABLES, &tables::NETWORKS);
        let rested = new.clone().rested();
        let (mut valid, mut doubtful, mut disturbed, mut told) = (0, 0, 0, 0);
        for (chain, seed) in [(new, 3), (rested, 4)] {
            for input in inputs(seed, 2_000, 400) {
                let tally = chain.clone().sense(&input);
                valid += tally.valid;
                doubtful += tally.doubtful;
                disturbed += tally.disturbed;
                told += tally.told;
            }
        }
        assert_eq!(told > 0, !tables::NETWORKS.is_empty());
        assert!(
            valid > 1000 && doubtful > 1000 && disturbed > 100,
            "{valid} {doubtful} {disturbed}"
        );
    }
}
