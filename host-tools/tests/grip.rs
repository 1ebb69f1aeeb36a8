//! `magpie grip` as a user meets it.

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
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    serde_json::from_slice(&output.stdout).expect("one JSON object on stdout and nothing else")
}

fn figure(json: &Value, name: &str) -> f64 {
    let figures = json["figures"].as_array().unwrap();
    let found = figures.iter().find(|figure| figure["name"] == name);
    found.and_then(|figure| figure["value"].as_f64()).unwrap()
}

#[test]
fn a_place_is_reached_and_the_page_shows_place_speed_current_and_voltage() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("grip.html");
    let path = page.to_str().unwrap();
    let json = json_of(&["--position", "20", "-o", path]);
    assert!((figure(&json, "opening at the end") - 20.0).abs() < 0.05);
    assert!(figure(&json, "current loop, 3 dB") >= 1000.0);
    assert_eq!(json["simulated"], true);
    let page = std::fs::read_to_string(page).unwrap();
    for words in [
        "opening, mm",
        "closing, mm/s",
        "current, A",
        "bus, V",
        "gain, dB",
        "Assumed",
    ] {
        assert!(page.contains(words), "{words}");
    }
    assert!(!page.contains("http://") && !page.contains("https://"));
}

#[test]
fn a_speed_is_run_and_braked_from() {
    let json = json_of(&["--speed", "-30", "--screw", "b"]);
    let points = json["points"].as_array().unwrap();
    let speed_mm_s = points[points.len() / 2]["closing_mm_s"].as_f64().unwrap();
    assert!((speed_mm_s + 30.0).abs() < 1.0, "{speed_mm_s}");
    assert!(figure(&json, "way after the brake") < 0.5);
    assert!(figure(&json, "opening at the end") > 50.0);
}

#[test]
fn a_grasp_and_the_same_by_current_alone_stand_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("grip.html");
    let path = page.to_str().unwrap();
    let json = json_of(&["--force", "50", "--compare", "current-limit", "-o", path]);
    assert!((figure(&json, "greatest force") - 50.0).abs() < 2.0);
    assert!(figure(&json["current_limit"], "greatest force") > 300.0);
    let states = json["points"].as_array().unwrap().iter();
    assert!(states.clone().any(|point| point["state"] == "hold latched"));
    let page = std::fs::read_to_string(page).unwrap();
    for words in [
        "force, N",
        "opening, mm",
        "current, A",
        "state",
        "hold latched",
        "Assumed",
    ] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn a_landing_is_told_with_its_touch_peak_and_centre() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("landing.html");
    let path = page.to_str().unwrap();
    let json = json_of(&["--foot", "150", "-o", path]);
    let touch_ms = figure(&json, "the touch is told in the sample after");
    assert!((0.1..2.0).contains(&touch_ms), "{touch_ms}");
    assert_eq!(figure(&json, "the fingers have moved by"), 0.0);
    let page = std::fs::read_to_string(page).unwrap();
    assert!(page.contains("along the fingers, mm") && page.contains("fingertips that stand"));
}

#[test]
fn the_same_seed_prints_the_same_bytes_and_the_terminal_names_what_is_assumed() {
    let page = |seed| grip(&["--speed", "20", "--scatter", "0.2", "--seed", seed]).stdout;
    assert_eq!(page("3"), page("3"));
    assert_ne!(page("3"), page("4"));
    let text = String::from_utf8(page("3")).unwrap();
    let words: Vec<&str> = text.split_whitespace().collect();
    let text = words.join(" ");
    assert!(
        text.contains("Assumed:") && text.contains("torque constant 0.1 N m/A"),
        "{text}"
    );
}

#[test]
fn what_the_drive_cannot_do_is_said_and_not_done() {
    for (arguments, words) in [
        (vec!["--position", "90"], "give 2 to 78 mm"),
        (vec!["--speed", "100"], "give 0.1 to 58.3 mm/s"),
        (
            vec!["--position", "20", "--speed", "-5"],
            "leave the sign out",
        ),
        (
            vec!["--position", "20", "--speed", "0.1"],
            "greater --speed",
        ),
        (vec!["--speed", "5", "--scatter", "2"], "give 0 to 0.5"),
        (vec!["--force", "400"], "give 5 to 350 N"),
        (vec!["--foot", "5"], "give 20 to 1000"),
        (vec![], "--position"),
    ] {
        let output = grip(&arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && said.contains(words),
            "{arguments:?}: {said}"
        );
    }
}

#[test]
fn options_of_the_simulation_are_refused_with_a_real_gripper() {
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
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && said.contains("cannot be used with"),
            "{option}: {said}"
        );
    }
    for (arguments, expected) in [
        ("--force 80 --home", "--port <PATH>|--can <BUS>"),
        ("--port /dev/nowhere --force 80", "there is no such port"),
        ("--can 127.0.0.1:1 --foot", "no connection"),
        ("--can 127.0.0.1:1 --foot 150", "takes no force"),
        ("--can 127.0.0.1:1 --speed 20", "give --position, too"),
        ("--foot", "--foot 150"),
    ] {
        let output = grip(&arguments.split(' ').collect::<Vec<_>>());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && said.contains(expected),
            "{arguments}: {said}"
        );
    }
}
