//! Calibrations uploaded to a running board without a compiler.

use std::fs;

use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::workdir::running::Running;
use crate::workdir::{WorkDir, campaign, fitted_model};

fn sha256(path: &std::path::Path) -> String {
    Sha256::digest(std::fs::read(path).unwrap()).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A virtual board with the `clean` model, and its line.
fn board(dir: &WorkDir) -> (Running, String) {
    let mut running = Running::start(
        dir,
        "monitor --virtual --model model.toml --press 20,-10 --json --seconds 120",
    );
    running.drop_output();
    let (path, messages) = running.line();
    // The pipe stays open as long as the board writes to it.
    std::mem::forget(messages);
    (running, path.display().to_string())
}

fn shown(dir: &WorkDir, line: &str) -> Value {
    dir.json(&format!("board --port {line} --json"))
}

#[test]
fn an_uploaded_calibration_runs_and_is_described() {
    let dir = WorkDir::with_model("clean");
    let (_board, line) = board(&dir);
    let first = shown(&dir, &line);
    let calibration = &first["calibration"];
    assert_eq!(calibration["slot"], Value::Null);
    assert_eq!(calibration["model_sha256"], sha256(&fitted_model("clean")));
    assert_eq!(calibration["effects"], Value::Array(Vec::new()));
    assert_eq!((&first["motor"], &first["screw"]), (&"assumed".into(), &"unknown".into()));

    // A model with an effect that the board without a motor cannot compensate.
    let demo = fitted_model("demo").display().to_string();
    dir.stdout(&["add", &demo, &campaign("demo"), "neighbour_magnet", "-o", "effect.toml"]);
    let uploaded = dir.json(&format!("upload effect.toml --port {line} --json"));
    assert_eq!(uploaded["running"], true);
    let second = shown(&dir, &line);
    let calibration = &second["calibration"];
    assert_eq!(calibration["slot"], 0);
    assert_eq!(calibration["tables"], uploaded["tables"]);
    assert_eq!(calibration["model_sha256"], sha256(&dir.path("effect.toml")));
    assert_eq!(calibration["campaign"], "demo");
    assert_eq!(calibration["effects"], serde_json::json!(["neighbour_magnet"]));
    assert!(calibration["uploaded"].as_str().unwrap().starts_with("20"));
    assert_eq!(calibration["conditions"]["neighbour_magnet"][0], "after homing");
    assert_eq!(second["missing_inputs"], serde_json::json!([0, 1, 2, 3]));

    // The nominal design of the same file is another calibration.
    let nominal = dir.json(&format!("upload effect.toml --nominal --port {line} --json"));
    assert_ne!(nominal["tables"], uploaded["tables"]);
    let shown_nominal = shown(&dir, &line);
    assert_eq!(shown_nominal["calibration"]["variant"], "nominal design");
    assert_eq!(second["calibration"]["variant"], "fitted parameters");
    let tared = dir.json(&format!("board tare --unloaded --port {line} --json"));
    assert_eq!(tared, serde_json::json!({ "tared": true, "saved": false }));
    dir.stdout(&format!("upload effect.toml --port {line}"));

    // With networks, into the other slot.
    let clean = campaign("clean");
    dir.stdout(&format!("train model.toml {clean} --epochs 1 -o network.safetensors"));
    dir.stdout(&format!("upload model.toml --network network.safetensors --port {line}"));
    let third = shown(&dir, &line);
    let calibration = &third["calibration"];
    assert_eq!(calibration["slot"], 1);
    assert!(calibration["network_sha256"].as_str().unwrap().len() == 64);
    assert_eq!(third["missing_inputs"], Value::Array(Vec::new()));
    let text = String::from_utf8(dir.stdout(&format!("board --port {line}"))).unwrap();
    for part in
        ["uploaded, slot 1", "campaign     clean", "effects      none", "networks     SHA-256"]
    {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn what_a_board_cannot_load_is_refused_with_a_remedy() {
    let dir = WorkDir::with_model("clean");
    let (_board, line) = board(&dir);
    let clean = campaign("clean");
    dir.stdout(&format!("train model.toml {clean} --hidden 24 --epochs 1 -o large.safetensors"));
    let refused =
        dir.failure(&format!("upload model.toml --network large.safetensors --port {line}"));
    assert!(refused.contains("`cargo magpie dev export` and `cargo flash-image`"), "{refused}");
    assert_eq!(shown(&dir, &line)["calibration"]["slot"], Value::Null);
    let nobody = dir.failure("upload model.toml");
    assert!(nobody.contains("--port"), "{nobody}");

    // Tables for counts of another sensor, and a fit far from its own design, as with forces in another unit.
    let model = dir.read("model.toml");
    let scaled = model.replace("gauss_per_lsb = 0.125", "gauss_per_lsb = 0.1");
    fs::write(dir.path("scaled.toml"), &scaled).unwrap();
    for command in
        [format!("upload scaled.toml --port {line}"), "dev export scaled.toml -o t.rs".to_owned()]
    {
        let refused = dir.failure(&command);
        assert!(refused.contains("a count of its sensors is 0.1 G"), "{refused}");
    }
    let softer: String = model
        .lines()
        .map(|line| match line.strip_prefix("stiffness_x_n_per_mm = ") {
            Some(value) => {
                format!("stiffness_x_n_per_mm = {:?}\n", 2.0 * value.parse::<f64>().unwrap())
            }
            None => format!("{line}\n"),
        })
        .collect();
    fs::write(dir.path("softer.toml"), &softer).unwrap();
    let refused = dir.failure(&format!("upload softer.toml --port {line}"));
    assert!(refused.contains("times its design"), "{refused}");
    dir.stdout(&format!("upload softer.toml --far-from-design --port {line}"));
}
