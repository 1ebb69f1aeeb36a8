//! `magpie design`.

use serde_json::Value;

use crate::workdir::WorkDir;

#[test]
fn default_design_reaches_250_n_limited_by_stroke() {
    let design = WorkDir::empty().json("design check --json");
    let lateral = &design["lateral"];
    assert!((lateral["range_n"].as_f64().unwrap() - 250.0).abs() < 1e-3);
    assert_eq!(lateral["ended_by"], "stroke");
    assert!((lateral["g_per_n"].as_f64().unwrap() - 1.17).abs() < 1e-3);
    // 120 MPa of 1170 at 250 N.
    assert!((lateral["yield_share"].as_f64().unwrap() - 0.1026).abs() < 1e-3);
    assert_eq!(design["reaches"], true);
}

#[test]
fn optimised_design_is_written_checked_and_simulated() {
    let dir = WorkDir::empty();
    let proposed = dir.json("design optimize --range 120 --count 400 -o design.toml --json");
    assert_eq!(proposed["reaches"], true);
    let checked = dir.json("design check design.toml --json");
    for axis in ["lateral", "longitudinal"] {
        let range_n = |design: &Value| design[axis]["range_n"].as_f64().unwrap();
        assert!((range_n(&checked) / range_n(&proposed) - 1.0).abs() < 1e-6);
        assert!(range_n(&checked) > 119.8);
    }
    dir.stdout("simulate --design design.toml -o made --recordings 1 --seconds 3");
    let recorded: toml::Table = dir.read("made/1/recording.toml").parse().unwrap();
    let stiffness = recorded["design"]["stiffness_x_n_per_mm"].as_float().unwrap();
    let expected = proposed["design"]["stiffness_x_n_per_mm"].as_f64().unwrap();
    assert_eq!(stiffness, expected);
}

#[test]
fn sweep_front_trades_force_range_for_sensitivity() {
    let dir = WorkDir::empty();
    let sweep = dir.json("design sweep --count 300 -o sweep.html --json");
    assert_eq!(sweep["designs"], 300);
    let front = sweep["front"].as_array().unwrap();
    let value = |design: &Value, key: &str| design[key].as_f64().unwrap();
    let (first, last) = (front.first().unwrap(), front.last().unwrap());
    assert!(value(first, "range_n") > value(last, "range_n"));
    assert!(value(first, "g_per_n") < value(last, "g_per_n"));
    let page = dir.read("sweep.html");
    assert!(page.starts_with("<!-- report of magpie -->") && page.contains("<svg"));
}

#[test]
fn grid_combines_all_values_of_free_sizes() {
    let sizes = "--size length=30 --size width=15 --size gap=1.5 --size height=2";
    let line = format!("design sweep --sample grid --count 50 --material 17-4PH {sizes} --json");
    let sweep = WorkDir::empty().json(&line);
    // Seven thicknesses by seven diameters is the largest grid below 50.
    assert_eq!((&sweep["designs"], &sweep["sample"]), (&49.into(), &"grid".into()));
    let front = sweep["front"].as_array().unwrap();
    for one in front {
        assert_eq!(one["design"]["gap_mm"], 1.5);
        // One of seven logarithmically spaced values from 1 to 8 mm.
        let thickness_mm = one["design"]["flexure_x"]["thickness_mm"].as_f64().unwrap();
        let step = 6.0 * thickness_mm.ln() / 8.0_f64.ln();
        assert!((step - step.round()).abs() < 1e-9, "{thickness_mm}");
    }
}

#[test]
fn invalid_arguments_are_rejected_with_a_reason() {
    let dir = WorkDir::empty();
    for (arguments, words) in [
        ("check none.toml", "none.toml"),
        ("optimize --range -3", "force in newtons"),
        ("optimize --range 1e6 --count 32", "none of 32 designs"),
        ("sweep --material cheese", "17-4PH"),
        ("sweep --size hole=1..2", "length, width"),
        ("sweep --sample random", "sobol, grid"),
    ] {
        let message = dir.failure(&format!("design {arguments}"));
        assert!(message.contains(words), "{arguments}: {message}");
    }
}
