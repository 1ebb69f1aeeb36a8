//! Trained networks behind a model: what replay and export say of them.

mod desk;

use std::fs;

use desk::Desk;

/// Most that fixed point may cost: newtons, root mean square, and a share of the error.
const MOST_N: f64 = 0.1;
const MOST_SHARE: f64 = 0.03;

/// A campaign of two sensors, a model, and a network that learned for a few epochs.
fn learned() -> Desk {
    let desk = Desk::empty();
    desk.done("simulate -o bench --seconds 8 --sensors 2 --effect hysteresis=8");
    desk.done("fit bench -o model.toml");
    desk.done("train model.toml bench --epochs 6 -o network");
    desk
}

#[test]
fn in_fixed_point_a_trained_network_tells_the_forces_that_it_tells_in_floating_point() {
    let desk = learned();
    let said = desk.told("replay model.toml bench --network network --json");
    let rows = said["networks"]["sensors"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    for row in rows {
        let number = |name: &str| row[name].as_f64().unwrap();
        assert!(number("fixed_minus_float_rms_n") < MOST_N, "{row}");
        assert!(number("fixed_minus_float_rms_n") > 0.0, "{row}");
        let cost = number("rmse_n") / number("float_rmse_n") - 1.0;
        assert!(cost.abs() < MOST_SHARE, "{row}");
        // It speaks: what it tells is not the ideal model's.
        assert!(number("rmse_n") != number("without_rmse_n"), "{row}");
        assert!(number("sigma_n") > 0.0, "{row}");
    }
}

#[test]
fn the_same_network_gives_the_same_tables_whose_type_names_its_size() {
    let desk = learned();
    for name in ["one.rs", "two.rs"] {
        desk.done(&format!("export model.toml --network network -o {name}"));
    }
    let read = |name: &str| fs::read_to_string(desk.0.path().join(name)).unwrap();
    assert_eq!(read("one.rs"), read("two.rs"));
    // Two pairs of inputs, eight pairs of units, one sensor; two networks.
    assert!(read("one.rs").contains("NETWORKS: [Network<2, 8, 1>; 2]"));
}

#[test]
fn a_network_behind_another_model_and_a_file_that_is_none_are_refused() {
    let desk = learned();
    desk.done("fit bench -o other.toml --seed 7");
    let said = desk.refused("replay other.toml bench --network network");
    assert!(said.contains("another model"), "{said}");
    let said = desk.refused("export model.toml --network model.toml -o tables.rs");
    assert!(said.contains("this is not a network"), "{said}");
    assert!(!desk.0.path().join("tables.rs").exists());
}
