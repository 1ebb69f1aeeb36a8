//! The fuzz targets on a fixed set of random inputs (`tests/fuzz/README.md`).

#[path = "../fuzz/src/lib.rs"]
mod fuzz;

// The tables use `crate::` paths of the firmware.
#[allow(unused_imports)]
use firmware::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use fuzz::counters::{Counts, Sums};

#[allow(missing_docs, unused_imports, dead_code, clippy::all)]
mod tables {
    include!("../../firmware/src/model/tables.rs");
}

/// Random inputs of up to `longest` bytes.
fn inputs(seed: u64, count: usize, longest: usize) -> impl Iterator<Item = Vec<u8>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(move |_| {
        let length = rng.random_range(0..=longest);
        (0..length).map(|_| rng.random()).collect()
    })
}

/// Runs a target on random inputs; checks the minimum of each counter in an execution, on average.
fn assert_reached<const N: usize>(
    (seed, count, longest): (u64, usize, usize),
    target: impl Fn(&[u8]) -> Counts<N>,
    least: [(&str, f64); N],
) {
    let mut sums = Sums::default();
    for input in inputs(seed, count, longest) {
        sums.add(target(&input));
    }
    println!("{sums}");
    for (name, least) in least {
        assert!(sums.average(name) >= least, "{name} below {least}: {sums}");
    }
}

#[test]
fn can_sessions_agree_with_the_reference_model() {
    let least = [("armed", 0.15), ("commands", 0.15), ("dropped", 5.0)];
    assert_reached((1, 20_000, 800), |input| fuzz::can::receive(input).counts(), least);
}

#[test]
fn the_serial_receiver_resynchronises_after_any_bytes() {
    let least = [("packets", 2.0), ("broken", 1.0)];
    assert_reached((2, 20_000, 400), |input| fuzz::serial::receive(input).counts(), least);
}

#[test]
fn interrupted_saves_preserve_old_or_new_parameters() {
    let least = [("found", 0.2), ("cut", 0.5), ("saved", 1.0)];
    assert_reached((5, 5_000, 400), |input| fuzz::store::keep(input).counts(), least);
}

#[test]
fn interrupted_uploads_preserve_old_or_new_calibration() {
    let least = [
        ("accepted", 1.0),
        ("wrong_codes", 0.2),
        ("corrupt", 0.3),
        ("interrupted", 0.3),
        ("found", 10.0),
    ];
    assert_reached((6, 5_000, 600), |input| fuzz::upload::upload(input).counts(), least);
}

#[test]
fn any_calibration_is_decoded_or_refused_without_a_panic() {
    let seeds = fuzz::blob::Seeds::new(&tables::TABLES);
    let least = [
        ("decoded", 0.3),
        ("effects", 0.15),
        ("networks", 0.08),
        ("invalid", 0.05),
        ("undecodable", 0.2),
        ("estimates", 8.0),
    ];
    assert_reached((7, 3_000, 300), |input| seeds.decode(input).counts(), least);
}

#[test]
fn any_bag_is_a_table_or_an_error() {
    let least = [("decoded", 0.2), ("refused", 0.2), ("joined", 2.0), ("numbers", 2.0)];
    assert_reached((11, 1_000, 300), |input| fuzz::bag::read(input).counts(), least);
}

#[test]
fn bags_with_changed_records_are_tables_or_errors() {
    let least = [("decoded", 0.3), ("refused", 0.2), ("joined", 5.0), ("numbers", 3.0)];
    assert_reached((12, 2_000, 60), |input| fuzz::bag::read_mcap(input).counts(), least);
}

#[test]
fn databases_with_changed_pages_are_tables_or_errors() {
    let least = [("decoded", 0.3), ("refused", 0.2), ("joined", 5.0), ("numbers", 3.0)];
    assert_reached((13, 2_000, 60), |input| fuzz::bag::read_database(input).counts(), least);
}

#[test]
fn formulas_have_the_values_of_a_second_evaluator() {
    let least = [("accepted", 0.4), ("refused", 0.2), ("compared", 1.0), ("operators", 1.5)];
    assert_reached((8, 20_000, 200), |input| fuzz::formula::parse(input).counts(), least);
}

#[test]
fn an_import_has_all_values_of_its_source_or_leaves_nothing() {
    let least = [("imported", 0.4), ("refused", 0.15), ("compared", 10.0)];
    assert_reached((9, 300, 300), |input| fuzz::mapping::convert(input).counts(), least);
}

#[test]
fn a_plan_is_refused_or_stays_within_its_own_limits() {
    let least = [("accepted", 0.25), ("refused", 0.4), ("compared", 4.5)];
    assert_reached((10, 2_000, 60), |input| fuzz::plan::read(input).counts(), least);
}

mod sensing {
    use super::fuzz::sensing::Chain;
    use super::{inputs, tables};
    use firmware::model::formats::Tables;

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
