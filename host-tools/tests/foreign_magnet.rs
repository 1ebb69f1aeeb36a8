//! A magnet passes a simulated gripper: the device's code notices it in a replay, and nothing else.

use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

fn magpie(folder: &TempDir, line: &str) -> Vec<u8> {
    let output = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(line.split_whitespace())
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line}: {said}");
    output.stdout
}

/// When each recording was called disturbed.
fn disturbed(folder: &TempDir, campaign: &str) -> Vec<Vec<[f64; 2]>> {
    let said = magpie(folder, &format!("replay model.toml {campaign} --json"));
    let said: Value = serde_json::from_slice(&said).unwrap();
    let recordings = said["recordings"].as_array().unwrap().iter();
    let stretches =
        |recording: &Value| serde_json::from_value(recording["disturbed_s"].clone()).unwrap();
    recordings.map(stretches).collect()
}

#[test]
fn passing_magnet_is_detected_only_while_present() {
    let folder = TempDir::new().unwrap();
    let world = "simulate --seconds 20 --seed 4 --effect hysteresis --effect cross_coupling";
    magpie(&folder, &format!("{world} -o clean"));
    magpie(&folder, "fit clean -o model.toml");
    assert!(disturbed(&folder, "clean").iter().all(Vec::is_empty));
    magpie(&folder, &format!("{world} --effect external_magnet=60 -o passed"));
    let truth = std::fs::read_to_string(folder.path().join("passed-truth.toml")).unwrap();
    let truth: toml::Table = truth.parse().unwrap();
    let effects = truth["effect"].as_array().unwrap().iter();
    let magnet = effects.clone().find(|e| e["id"].as_str() == Some("external_magnet"));
    let magnet = magnet.unwrap();
    let number = |value: &toml::Value| value.as_float().unwrap();
    let recording = magnet["path"]["recording"].as_integer().unwrap() as usize;
    let there = magnet["above_1_g_s"].as_array().unwrap();
    let [from_s, to_s] = [number(&there[0]), number(&there[1])];
    let closest_s = number(&magnet["path"]["closest_s"]);
    for (place, stretches) in (1..).zip(disturbed(&folder, "passed")) {
        if place == recording {
            let around = stretches.iter().any(|[a, b]| *a < closest_s && *b > closest_s);
            assert!(around, "{stretches:?} and {closest_s}");
            // The flag stays for half a second; far fields count too.
            let all = |[a, b]: &[f64; 2]| *a > from_s - 1.0 && *b < to_s + 3.0;
            assert!(stretches.iter().all(all), "{stretches:?}: {from_s} to {to_s}");
        } else {
            assert!(stretches.is_empty(), "recording {place}: {stretches:?}")
        }
    }
}
