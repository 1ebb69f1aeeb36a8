//! `magpie design`.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn design(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magpie"))
        .arg("design")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    let output = design(folder, &[arguments, &["--json"]].concat());
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn default_design_reaches_250_n_limited_by_stroke() {
    let folder = tempfile::tempdir().unwrap();
    let design = json(folder.path(), &["check"]);
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
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["optimize", "--range", "120", "--count", "400", "-o", "design.toml"];
    let proposed = json(folder.path(), &arguments);
    assert_eq!(proposed["reaches"], true);
    let checked = json(folder.path(), &["check", "design.toml"]);
    for axis in ["lateral", "longitudinal"] {
        let range_n = |design: &Value| design[axis]["range_n"].as_f64().unwrap();
        assert!((range_n(&checked) / range_n(&proposed) - 1.0).abs() < 1e-6);
        assert!(range_n(&checked) > 119.8);
    }
    let simulated = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(["simulate", "--design", "design.toml", "-o", "made"])
        .args(["--recordings", "1", "--seconds", "3"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&simulated.stderr);
    assert!(simulated.status.success(), "{message}");
    let recorded = std::fs::read_to_string(folder.path().join("made/1/recording.toml")).unwrap();
    let recorded: toml::Table = recorded.parse().unwrap();
    let stiffness = recorded["design"]["stiffness_x_n_per_mm"].as_float().unwrap();
    let expected = proposed["design"]["stiffness_x_n_per_mm"].as_f64().unwrap();
    assert_eq!(stiffness, expected);
}

#[test]
fn sweep_front_trades_force_range_for_sensitivity() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = json(folder.path(), &["sweep", "--count", "300", "-o", "sweep.html"]);
    assert_eq!(sweep["designs"], 300);
    let front = sweep["front"].as_array().unwrap();
    let value = |design: &Value, key: &str| design[key].as_f64().unwrap();
    let (first, last) = (front.first().unwrap(), front.last().unwrap());
    assert!(value(first, "range_n") > value(last, "range_n"));
    assert!(value(first, "g_per_n") < value(last, "g_per_n"));
    let page = std::fs::read_to_string(folder.path().join("sweep.html")).unwrap();
    assert!(page.starts_with("<!-- report of magpie -->") && page.contains("<svg"));
}

#[test]
fn grid_combines_all_values_of_free_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let fixed = ["length=30", "width=15", "gap=1.5", "height=2"].map(|size| ["--size", size]);
    let arguments = ["sweep", "--sample", "grid", "--count", "50", "--material", "17-4PH"];
    let sweep = json(folder.path(), &[&arguments[..], &fixed.concat()].concat());
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
    let folder = tempfile::tempdir().unwrap();
    for (arguments, words) in [
        (&["check", "none.toml"][..], "none.toml"),
        (&["optimize", "--range", "-3"], "force in newtons"),
        (&["pick", "--range", "1e6", "--count", "32"], "none of 32 designs"),
        (&["sweep", "--material", "cheese"], "17-4PH"),
        (&["sweep", "--size", "hole=1..2"], "length, width"),
        (&["sweep", "--sample", "random"], "sobol, grid"),
    ] {
        let output = design(folder.path(), arguments);
        assert!(!output.status.success());
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(message.contains(words), "{arguments:?}: {message}");
    }
}
