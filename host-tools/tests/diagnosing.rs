//! `magpie diagnose`: the missing effect is named on recordings whose hidden effect nobody tells it, and
//! none where there is none to name.

use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;
use tests::data;

fn magpie(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magpie")).args(arguments).output().expect("the tool runs")
}

/// What is diagnosed of a campaign of the repository with its own fitted base.
fn diagnosed(campaign: &str, more: &[&str]) -> Value {
    let folder = TempDir::new().unwrap();
    let model = folder.path().join("model.toml").display().to_string();
    let campaign = data(campaign).display().to_string();
    let fitted = magpie(&["fit", &campaign, "-o", &model]);
    assert!(fitted.status.success(), "{}", String::from_utf8_lossy(&fitted.stderr));
    let arguments = ["diagnose", &model, &campaign, "--json"];
    let output = magpie(&[&arguments[..], more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn names(step: &Value) -> Vec<&str> {
    step.as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect()
}

fn verdict<'a>(diagnosis: &'a Value, effect: &str) -> &'a Value {
    let verdicts = diagnosis["verdicts"].as_array().unwrap();
    verdicts.iter().find(|verdict| verdict["effect"] == effect).unwrap()
}

/// Held-out error on each step, in floors.
fn staircase(diagnosis: &Value) -> Vec<f64> {
    let number = |value: &Value| value.as_f64().unwrap();
    let stairs = diagnosis["staircase"].as_array().unwrap().iter();
    stairs.map(|stair| number(&stair["held_out_rms_g"]) / number(&stair["floor_g"])).collect()
}

#[test]
fn report_contains_diagnosis_and_comparison() {
    let folder = TempDir::new().unwrap();
    let [model, report] = ["model.toml", "report.html"].map(|name| folder.path().join(name));
    let [model, page] = [&model, &report].map(|path| path.display().to_string());
    let campaign = data("demo").display().to_string();
    assert!(magpie(&["fit", &campaign, "-o", &model]).status.success());
    let output = magpie(&["diagnose", &model, &campaign, "-o", &page]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(
        said.contains(&format!("magpie add {model} {campaign} neighbour_magnet -o ")),
        "{said}"
    );
    let text = std::fs::read_to_string(&report).unwrap();
    assert!(text.starts_with("<!-- report of magpie -->"));
    for part in [
        "<section id=\"diagnosis\">",
        "<section id=\"staircase\">",
        "what neighbour_magnet took away",
        "over the opening",
        "<section id=\"overlay\"",
    ] {
        assert!(text.contains(part), "{part}");
    }
}

#[test]
fn clean_recordings_give_no_effect() {
    let diagnosis = diagnosed("clean", &[]);
    assert_eq!(diagnosis["accepted"], Value::Array(Vec::new()), "{}", diagnosis["verdict"]);
    assert_eq!(diagnosis["at_floor"], true);
    assert_eq!(diagnosis["unexplained"], Value::Array(Vec::new()));
    // Testable here: a neighbour magnet of typical magnitude would be detected.
    assert_eq!(verdict(&diagnosis, "neighbour_magnet")["verdict"], "absent");
}

#[test]
fn neighbour_magnet_is_found() {
    let diagnosis = diagnosed("demo", &[]);
    let accepted = diagnosis["accepted"].as_array().unwrap();
    assert_eq!(names(&accepted[0]), ["neighbour_magnet"], "{}", diagnosis["verdict"]);
    let found = verdict(&diagnosis, "neighbour_magnet");
    assert_eq!(found["verdict"], "found");
    // As `add` fits it: 2.88 G at an opening of 10 mm.
    let value = found["value"].as_f64().unwrap();
    assert!((2.7..3.1).contains(&value), "{value}");
    let stairs = staircase(&diagnosis);
    assert!(stairs[0] > 5.0 && *stairs.last().unwrap() < 1.15, "{stairs:?}");
}

#[test]
fn friction_and_magnet_temperature_are_both_found() {
    let diagnosis = diagnosed("friction", &[]);
    let accepted = diagnosis["accepted"].as_array().unwrap();
    let all: Vec<Vec<&str>> = accepted.iter().map(names).collect();
    assert!(all.contains(&vec!["hysteresis"]), "{all:?}");
    assert!(all.iter().any(|step| step.contains(&"magnet_temperature")), "{all:?}");
    assert_eq!(all.len(), 2, "{all:?}");
    assert!(*staircase(&diagnosis).last().unwrap() < 1.15);
}

#[test]
fn unknown_effect_is_attributed_but_not_named() {
    let diagnosis = diagnosed("ripple", &[]);
    assert_eq!(diagnosis["accepted"], Value::Array(Vec::new()), "{}", diagnosis["verdict"]);
    assert_eq!(diagnosis["at_floor"], false);
    let first = &diagnosis["unexplained"][0];
    assert_eq!(first["covariate"], "motor_angle_rad");
    assert!(first["share"].as_f64().unwrap() > 0.8, "{first}");
}

#[test]
fn user_formula_is_found_like_any_effect() {
    let formula = "ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)";
    let diagnosis = diagnosed("ripple", &["--range", "p=2..5", "--expr", formula]);
    let accepted = diagnosis["accepted"].as_array().unwrap();
    assert_eq!(names(&accepted[0]), ["ripple"], "{}", diagnosis["verdict"]);
    assert!(*staircase(&diagnosis).last().unwrap() < 1.15);
}
