//! A magnetic disturbance in a simulated campaign: `magpie replay` reports it, and nothing else.

use crate::workdir::WorkDir;

/// Disturbed intervals of each recording.
fn disturbed(dir: &WorkDir, campaign: &str) -> Vec<Vec<[f64; 2]>> {
    let output = dir.json(&format!("replay model.toml {campaign} --json"));
    let recordings = output["recordings"].as_array().unwrap().iter();
    let stretches = |recording: &serde_json::Value| {
        serde_json::from_value(recording["disturbed_s"].clone()).unwrap()
    };
    recordings.map(stretches).collect()
}

#[test]
fn passing_magnet_is_detected_only_while_present() {
    let dir = WorkDir::empty();
    let world = "simulate --seconds 20 --seed 4 --effect hysteresis --effect cross_coupling";
    dir.stdout(&format!("{world} -o clean"));
    dir.stdout("fit clean -o model.toml");
    assert!(disturbed(&dir, "clean").iter().all(Vec::is_empty));
    dir.stdout(&format!("{world} --effect external_magnet=60 -o passed"));
    let truth: toml::Table = dir.read("passed-truth.toml").parse().unwrap();
    let effects = truth["effect"].as_array().unwrap().iter();
    let magnet = effects.clone().find(|e| e["id"].as_str() == Some("external_magnet"));
    let magnet = magnet.unwrap();
    let number = |value: &toml::Value| value.as_float().unwrap();
    let recording = magnet["path"]["recording"].as_integer().unwrap() as usize;
    let there = magnet["above_1_g_s"].as_array().unwrap();
    let [from_s, to_s] = [number(&there[0]), number(&there[1])];
    let closest_s = number(&magnet["path"]["closest_s"]);
    for (place, stretches) in (1..).zip(disturbed(&dir, "passed")) {
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
