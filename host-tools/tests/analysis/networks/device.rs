//! Trained networks in `magpie replay` and `magpie dev export`.

use crate::workdir::{WorkDir, campaign};

/// Maximum difference of fixed and floating point: RMS in newtons, and relative change of the error.
const MAX_DIFFERENCE_N: f64 = 0.1;
const MAX_RELATIVE_CHANGE: f64 = 0.03;

/// Campaign of two sensors, a model, and a network trained for a few epochs.
fn trained() -> WorkDir {
    let dir = WorkDir::empty();
    dir.stdout("simulate -o bench --seconds 8 --sensors 2 --effect hysteresis=8");
    dir.stdout("fit bench -o model.toml");
    dir.stdout("train model.toml bench --epochs 6 -o network");
    dir
}

#[test]
fn trained_network_is_replayed_exported_and_bound_to_its_model() {
    let dir = trained();
    fixed_point_matches_floating_point(&dir);
    export_is_reproducible_and_typed_by_size(&dir);
    another_model_is_refused(&dir);
}

fn fixed_point_matches_floating_point(dir: &WorkDir) {
    let message = dir.json("replay model.toml bench --network network --json");
    let rows = message["networks"]["sensors"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    for row in rows {
        let number = |name: &str| row[name].as_f64().unwrap();
        assert!(number("fixed_minus_float_rms_n") < MAX_DIFFERENCE_N, "{row}");
        assert!(number("fixed_minus_float_rms_n") > 0.0, "{row}");
        let cost = number("rmse_n") / number("float_rmse_n") - 1.0;
        assert!(cost.abs() < MAX_RELATIVE_CHANGE, "{row}");
        // The estimate is not the ideal model's.
        assert!(number("rmse_n") != number("without_rmse_n"), "{row}");
        assert!(number("sigma_n") > 0.0, "{row}");
    }
}

fn export_is_reproducible_and_typed_by_size(dir: &WorkDir) {
    for name in ["one.rs", "two.rs"] {
        dir.stdout(&format!("dev export model.toml --network network -o {name}"));
    }
    assert_eq!(dir.read("one.rs"), dir.read("two.rs"));
    // Two pairs of inputs, eight pairs of units, one sensor; two networks.
    assert!(dir.read("one.rs").contains("NETWORKS: [Network<2, 8, 1>; 2]"));
}

#[test]
fn the_committed_tables_are_those_of_the_committed_model_and_networks() {
    let dir = WorkDir::empty();
    let [model, network] =
        ["model.toml", "network.safetensors"].map(|name| campaign(&format!("default/{name}")));
    dir.stdout(&["dev", "export", &model, "--network", &network, "-o", "tables.rs"]);
    let committed = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware/src/model/tables.rs");
    let committed = std::fs::read_to_string(committed).unwrap();
    assert!(dir.read("tables.rs") == committed, "export the tables again");
}

fn another_model_is_refused(dir: &WorkDir) {
    dir.stdout("fit bench -o other.toml --seed 7");
    let message = dir.failure("replay other.toml bench --network network");
    assert!(message.contains("another model"), "{message}");
    let message = dir.failure("dev export model.toml --network model.toml -o tables.rs");
    assert!(message.contains("this is not a network"), "{message}");
    assert!(!dir.path("tables.rs").exists());
}
