//! The command `magpie grip`.

use std::process::{Command, Output};

use serde_json::Value;

fn grip(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magpie"))
        .arg("grip")
        .args(arguments)
        .output()
        .expect("the command runs")
}

fn json_of(arguments: &[&str]) -> Value {
    let output = grip(&[arguments, &["--json"]].concat());
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    serde_json::from_slice(&output.stdout).expect("one JSON object on stdout and nothing else")
}

fn figure(json: &Value, name: &str) -> f64 {
    let figures = json["figures"].as_array().unwrap();
    let found = figures.iter().find(|figure| figure["name"] == name);
    found.and_then(|figure| figure["value"].as_f64()).unwrap()
}

#[test]
fn position_run_reaches_its_target_and_writes_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("grip.html");
    let path = page.to_str().unwrap();
    let json = json_of(&["--position", "20", "-o", path]);
    assert!((figure(&json, "final opening") - 20.0).abs() < 0.05);
    assert!(figure(&json, "current loop bandwidth (-3 dB)") >= 1000.0);
    assert_eq!(json["simulated"], true);
    let page = std::fs::read_to_string(page).unwrap();
    for words in ["opening, mm", "closing, mm/s", "current, A", "bus, V", "gain, dB", "Assumed"] {
        assert!(page.contains(words), "{words}");
    }
    assert!(!page.contains("http://") && !page.contains("https://"));
}

#[test]
fn speed_run_brakes_within_0_5_mm() {
    let json = json_of(&["--speed", "-30", "--screw", "b"]);
    let points = json["points"].as_array().unwrap();
    let speed_mm_s = points[points.len() / 2]["closing_mm_s"].as_f64().unwrap();
    assert!((speed_mm_s + 30.0).abs() < 1.0, "{speed_mm_s}");
    assert!(figure(&json, "braking distance") < 0.5);
    assert!(figure(&json, "final opening") > 50.0);
}

#[test]
fn grasp_is_compared_with_a_current_limit() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("grip.html");
    let path = page.to_str().unwrap();
    let json = json_of(&["--force", "50", "--compare", "current-limit", "-o", path]);
    assert!((figure(&json, "peak force") - 50.0).abs() < 2.0);
    assert!(figure(&json["current_limit"], "peak force") > 300.0);
    let states = json["points"].as_array().unwrap().iter();
    assert!(states.clone().any(|point| point["state"] == "hold latched"));
    let page = std::fs::read_to_string(page).unwrap();
    for words in ["force, N", "opening, mm", "current, A", "state", "hold latched", "Assumed"] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn landing_reports_latency_peak_and_centre() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("landing.html");
    let path = page.to_str().unwrap();
    let json = json_of(&["--foot", "150", "-o", path]);
    let latency_ms = figure(&json, "contact detection latency");
    assert!((0.1..2.0).contains(&latency_ms), "{latency_ms}");
    assert_eq!(figure(&json, "motion of the fingers"), 0.0);
    let page = std::fs::read_to_string(page).unwrap();
    assert!(page.contains("along the fingers, mm") && page.contains("fingertips in contact"));
}

#[test]
fn output_is_seeded_and_lists_assumed_constants() {
    let page = |seed| grip(&["--speed", "20", "--scatter", "0.2", "--seed", seed]).stdout;
    assert_eq!(page("3"), page("3"));
    assert_ne!(page("3"), page("4"));
    let text = String::from_utf8(page("3")).unwrap();
    let words: Vec<&str> = text.split_whitespace().collect();
    let text = words.join(" ");
    assert!(text.contains("Assumed:") && text.contains("torque constant 0.1 N m/A"), "{text}");
}

#[test]
fn impossible_targets_are_rejected_with_a_reason() {
    for (arguments, words) in [
        (vec!["--position", "90"], "give 2 to 78 mm"),
        (vec!["--speed", "100"], "give 0.1 to 58.3 mm/s"),
        (vec!["--position", "20", "--speed", "-5"], "must be positive"),
        (vec!["--position", "20", "--speed", "0.1"], "increase --speed"),
        (vec!["--speed", "5", "--scatter", "2"], "give 0 to 0.5"),
        (vec!["--force", "400"], "give 5 to 350 N"),
        (vec!["--foot", "5"], "give 20 to 1000"),
        (vec![], "--position"),
    ] {
        let output = grip(&arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && stderr.contains(words), "{arguments:?}: {stderr}");
    }
}

#[test]
fn simulation_options_are_rejected_with_a_real_gripper() {
    for option in [
        "--object soft",
        "--compare current-limit",
        "--from 20",
        "--screw b",
        "--seed 7",
        "--scatter 0.1",
    ] {
        let mut arguments = vec!["--port", "/dev/nowhere", "--force", "80"];
        arguments.extend(option.split(' '));
        let output = grip(&arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && stderr.contains("cannot be used with"),
            "{option}: {stderr}"
        );
    }
    for (arguments, expected) in [
        ("--force 80 --home", "--port <PATH>|--can <BUS>"),
        ("--port /dev/nowhere --force 80", "there is no such port"),
        ("--can 127.0.0.1:1 --foot", "no connection"),
        ("--can 127.0.0.1:1 --foot 150", "takes no force"),
        ("--can 127.0.0.1:1 --speed 20", "in the simulation only"),
        ("--foot", "--foot 150"),
    ] {
        let output = grip(&arguments.split(' ').collect::<Vec<_>>());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && stderr.contains(expected), "{arguments}: {stderr}");
    }
}
