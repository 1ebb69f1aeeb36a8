//! `magpie grasp`, here by its former name `grip`.

use serde_json::Value;

use crate::workdir::{WorkDir, text};

fn figure(json: &Value, name: &str) -> f64 {
    let figures = json["figures"].as_array().unwrap();
    let found = figures.iter().find(|figure| figure["name"] == name);
    found.and_then(|figure| figure["value"].as_f64()).unwrap()
}

#[test]
fn position_run_reaches_its_target_and_writes_a_page() {
    let dir = WorkDir::empty();
    let json = dir.json("grasp --position 20 -o page.html --json");
    assert!((figure(&json, "final opening") - 20.0).abs() < 0.05);
    assert!(figure(&json, "current loop bandwidth (-3 dB)") >= 1000.0);
    assert_eq!(json["simulated"], true);
    let page = dir.read("page.html");
    for words in ["opening, mm", "closing, mm/s", "current, A", "bus, V", "gain, dB", "Assumed"] {
        assert!(page.contains(words), "{words}");
    }
    assert!(!page.contains("http://") && !page.contains("https://"));
}

#[test]
fn speed_run_brakes_within_0_5_mm() {
    let json = WorkDir::empty().json("grasp --speed -30 --screw b --json");
    let points = json["points"].as_array().unwrap();
    let speed_mm_s = points[points.len() / 2]["closing_mm_s"].as_f64().unwrap();
    assert!((speed_mm_s + 30.0).abs() < 1.0, "{speed_mm_s}");
    assert!(figure(&json, "braking distance") < 0.5);
    assert!(figure(&json, "final opening") > 50.0);
}

#[test]
fn grasp_is_compared_with_a_current_limit() {
    let dir = WorkDir::empty();
    let json = dir.json("grasp --force 50 --compare current-limit -o page.html --json");
    assert!((figure(&json, "peak force") - 50.0).abs() < 2.0);
    assert!(figure(&json["current_limit"], "peak force") > 300.0);
    let states = json["points"].as_array().unwrap().iter();
    assert!(states.clone().any(|point| point["state"] == "hold latched"));
    let sentence = "333 N/mm contact stiffness, flexures included, with 50 N; seed 1.";
    let page = dir.read("page.html");
    // In the plot and in the table.
    assert!(page.contains(sentence) && page.matches("hold latched").count() >= 2, "{page}");
    for words in ["force, N", "opening, mm", "current, A", "state", "hold latched", "Assumed"] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn landing_reports_latency_peak_and_centre() {
    let dir = WorkDir::empty();
    let json = dir.json("grasp --foot 150 -o page.html --json");
    let latency_ms = figure(&json, "contact detection latency");
    assert!((0.1..2.0).contains(&latency_ms), "{latency_ms}");
    assert_eq!(figure(&json, "motion of the fingers"), 0.0);
    let page = dir.read("page.html");
    assert!(page.contains("along the fingers, mm") && page.contains("fingertips in contact"));
}

#[test]
fn output_is_seeded_and_lists_assumed_constants() {
    let dir = WorkDir::empty();
    let report =
        |seed: u8| text(&dir.stdout(&format!("grasp --speed 20 --scatter 0.2 --seed {seed}")));
    let first = report(3);
    assert_eq!(first, report(3));
    assert_ne!(first, report(4));
    let words: Vec<&str> = first.split_whitespace().collect();
    let text = words.join(" ");
    assert!(text.contains("Assumed:") && text.contains("torque constant 0.1 N m/A"), "{text}");
}

#[test]
fn impossible_targets_are_rejected_with_a_reason() {
    let dir = WorkDir::empty();
    for (arguments, words) in [
        ("--position 90", "give 2 to 78 mm"),
        ("--speed 100", "give 0.1 to 58.3 mm/s"),
        ("--position 20 --speed -5", "must be positive"),
        ("--position 20 --speed 0.1", "increase --speed"),
        ("--speed 5 --scatter 2", "give 0 to 0.5"),
        ("--force 400", "give 5 to 350 N"),
        ("--foot 5", "give 20 to 1000"),
        ("", "--position"),
        ("--force 80 --home", "--port <PATH>|--can <BUS>"),
        ("--port /dev/nowhere --force 80", "there is no such port"),
        ("--can 127.0.0.1:1 --foot", "no connection"),
        ("--can 127.0.0.1:1 --foot 150", "takes no force"),
        ("--can 127.0.0.1:1 --speed 20", "in the simulation only"),
        ("--foot", "--foot 150"),
    ] {
        let message = dir.failure(&format!("grasp {arguments}"));
        assert!(message.contains(words), "{arguments}: {message}");
    }
}

#[test]
fn width_of_an_object_is_an_option_of_its_own() {
    let dir = WorkDir::empty();
    for line in ["grasp --force 50 --object 40", "dev emulate --object 40"] {
        let message = dir.failure(line);
        assert!(
            message.contains("the width of an emulated object is --object-width-mm 40"),
            "{message}"
        );
    }
    let message = dir.failure("dev emulate none.elf --object-width-mm 40 --object soft");
    assert!(message.contains("none.elf"), "{message}");
}

#[test]
fn simulation_options_are_rejected_with_a_real_gripper() {
    let dir = WorkDir::empty();
    for option in [
        "--object soft",
        "--compare current-limit",
        "--from 20",
        "--screw b",
        "--seed 7",
        "--scatter 0.1",
    ] {
        let message = dir.failure(&format!("grasp --port /dev/nowhere --force 80 {option}"));
        assert!(message.contains("cannot be used with"), "{option}: {message}");
    }
}
