//! Designs, by the command.

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
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_gripper_s_own_design_measures_250_newtons_and_its_stroke_ends_it() {
    let folder = tempfile::tempdir().unwrap();
    let told = json(folder.path(), &["check"]);
    let lateral = &told["lateral"];
    assert!((lateral["range_n"].as_f64().unwrap() - 250.0).abs() < 1e-3);
    assert_eq!(lateral["ended_by"], "stroke");
    assert!((lateral["g_per_n"].as_f64().unwrap() - 1.17).abs() < 1e-3);
    // 120 MPa of 1170 at 250 N.
    assert!((lateral["yield_share"].as_f64().unwrap() - 0.1026).abs() < 1e-3);
    assert_eq!(told["reaches"], true);
}

#[test]
fn a_proposal_is_written_judged_the_same_and_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let few = [
        "pick",
        "--range",
        "120",
        "--count",
        "400",
        "-o",
        "design.toml",
    ];
    let proposed = json(folder.path(), &few);
    assert_eq!(proposed["reaches"], true);
    let checked = json(folder.path(), &["check", "design.toml"]);
    for axis in ["lateral", "longitudinal"] {
        let of = |told: &Value| told[axis]["range_n"].as_f64().unwrap();
        assert!((of(&checked) / of(&proposed) - 1.0).abs() < 1e-6);
        assert!(of(&checked) > 119.8);
    }
    let simulated = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(["simulate", "--design", "design.toml", "-o", "made"])
        .args(["--recordings", "1", "--seconds", "3"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&simulated.stderr).into_owned();
    assert!(simulated.status.success(), "{told}");
    // What is simulated is what was proposed.
    let recorded = std::fs::read_to_string(folder.path().join("made/1/recording.toml")).unwrap();
    let recorded: toml::Table = recorded.parse().unwrap();
    let stiffness = recorded["design"]["stiffness_x_n_per_mm"]
        .as_float()
        .unwrap();
    let expected = proposed["design"]["stiffness_x_n_per_mm"].as_f64().unwrap();
    assert_eq!(stiffness, expected);
}

#[test]
fn a_sweep_leaves_a_page_and_a_front_on_which_more_force_is_told_less_well() {
    let folder = tempfile::tempdir().unwrap();
    let told = json(
        folder.path(),
        &["sweep", "--count", "300", "-o", "sweep.html"],
    );
    assert_eq!(told["designs"], 300);
    let front = told["front"].as_array().unwrap();
    let of = |place: &Value, key: &str| place[key].as_f64().unwrap();
    let (first, last) = (front.first().unwrap(), front.last().unwrap());
    assert!(of(first, "range_n") > of(last, "range_n"));
    assert!(of(first, "g_per_n") < of(last, "g_per_n"));
    let page = std::fs::read_to_string(folder.path().join("sweep.html")).unwrap();
    assert!(page.starts_with("<!-- report of magpie -->") && page.contains("<svg"));
}

#[test]
fn a_grid_of_designs_takes_every_value_with_every_other() {
    let folder = tempfile::tempdir().unwrap();
    let fixed = ["length=30", "width=15", "gap=1.5", "height=2"].map(|size| ["--size", size]);
    let asked = [
        "sweep",
        "--sample",
        "grid",
        "--count",
        "50",
        "--material",
        "17-4PH",
    ];
    let told = json(folder.path(), &[&asked[..], &fixed.concat()].concat());
    // Seven thicknesses and seven diameters come nearest to 50.
    assert_eq!(
        (&told["designs"], &told["sample"]),
        (&49.into(), &"grid".into())
    );
    let front = told["front"].as_array().unwrap();
    for one in front {
        assert_eq!(one["design"]["gap_mm"], 1.5);
        // One of seven values between 1 and 8 mm, evenly by their logarithm.
        let thickness_mm = one["design"]["flexure_x"]["thickness_mm"].as_f64().unwrap();
        let place = 6.0 * thickness_mm.ln() / 8.0_f64.ln();
        assert!((place - place.round()).abs() < 1e-9, "{thickness_mm}");
    }
}

#[test]
fn what_cannot_be_is_said_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, words) in [
        (&["check", "none.toml"][..], "none.toml"),
        (&["pick", "--range", "-3"], "force in newtons"),
        (
            &["pick", "--range", "1e6", "--count", "32"],
            "none of 32 designs",
        ),
        (&["sweep", "--material", "cheese"], "17-4PH"),
        (&["sweep", "--size", "hole=1..2"], "length, width"),
        (&["sweep", "--sample", "random"], "sobol, grid"),
    ] {
        let output = design(folder.path(), arguments);
        assert!(!output.status.success());
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(told.contains(words), "{arguments:?}: {told}");
    }
}
