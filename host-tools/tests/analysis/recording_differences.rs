//! Recordings that differ by what no covariate explains: the zero of the reference, the offset of the field.

use serde_json::Value;
use tests::campaign_copy::{CampaignCopy, CsvTable};
use tests::{RECORDING_TOML, SyntheticCampaign, nominal, write_recording};

use crate::workdir::{WorkDir, diagnosis};

/// Gauss per count of the recordings.
const GAUSS_PER_LSB: f64 = 0.125;

/// A copy of a campaign with values added to columns of some recordings.
fn shifted(campaign: &str, table: &str, shifts: &[(u32, &str, f64)]) -> CampaignCopy {
    shifts.iter().fold(CampaignCopy::of(campaign), |copy, &(recording, column, offset)| {
        copy.change(&[recording], table, |cells| {
            cells.change(column, |_, value| (value + offset).to_string());
        })
    })
}

/// A base model fitted to a campaign, and its diagnosis.
fn diagnosed(dir: &WorkDir, campaign: &str) -> Value {
    diagnosed_with("cylinder", dir, campaign)
}

fn diagnosed_with(base: &str, dir: &WorkDir, campaign: &str) -> Value {
    dir.stdout(&["fit", campaign, "--base", base, "-o", "model.toml", "--force"]);
    dir.json(&["diagnose", "model.toml", campaign, "--json"])
}

/// The message on what differs between the recordings.
fn difference(diagnosis: &Value) -> Option<String> {
    let findings = diagnosis["findings"].as_array().unwrap();
    let found = findings.iter().find(|finding| finding["id"] == "recording_difference")?;
    Some(found["message"].as_str().unwrap().to_owned())
}

fn assert_nothing_else(diagnosis: &Value) {
    for list in ["accepted", "formulas"] {
        assert_eq!(diagnosis[list], Value::Array(Vec::new()), "{list}");
    }
    assert_eq!(diagnosis["at_floor"], true);
    // The forces are compared with the corrected reference, and estimated from the corrected field.
    let force = &diagnosis["staircase"][0]["force"];
    let [excess_n, noise_n] = ["excess_n", "noise_n"].map(|name| force[name].as_f64().unwrap());
    assert!(excess_n < 0.5 * noise_n, "{force}");
}

#[test]
fn zeros_of_the_reference_are_found_and_corrected() {
    let shifts = [(2, "f0_x_n", 4.0), (3, "f0_x_n", -3.0), (3, "f1_z_n", 0.5)];
    let spoilt = shifted("clean", "force.csv", &shifts);
    let (dir, campaign) = (WorkDir::empty(), spoilt.path().display().to_string());
    let diagnosis = diagnosed(&dir, &campaign);
    let message = difference(&diagnosis).expect("a finding");
    for part in ["the zero of the reference", "f0_x_n by +3.9", "f0_x_n by -3.0", "f1_z_n by +0."] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_nothing_else(&diagnosis);
    let next: Vec<&str> =
        diagnosis["next"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    assert_eq!(next.len(), 2, "{next:?}");
    for command in &next {
        dir.stdout(&shell_words::split(command).unwrap()[2..]);
    }
    let repaired = std::path::PathBuf::from(format!("{campaign}-corrected"));
    for (recording, column, _) in shifts {
        let mean = |folder: &std::path::Path| {
            let path = folder.join(recording.to_string()).join("force.csv.gz");
            let values = CsvTable::read(&path).numbers(column);
            values.iter().sum::<f64>() / values.len() as f64
        };
        let left = mean(&repaired) - mean(&tests::data("clean"));
        assert!(left.abs() < 0.1, "{column} of recording {recording}: {left}");
    }
    let again = diagnosed(&dir, &repaired.display().to_string());
    assert_eq!(difference(&again), None);
    assert_nothing_else(&again);
}

/// Zeros that a drift explains as much, to first order, and less in a fit.
#[test]
fn zeros_that_jump_are_no_drift() {
    let shifts = [(3, "f0_x_n", -1.0), (2, "f0_z_n", 0.8), (3, "f0_z_n", 0.2)];
    let spoilt = shifted("clean", "force.csv", &shifts);
    let diagnosis = diagnosed(&WorkDir::empty(), &spoilt.path().display().to_string());
    let message = difference(&diagnosis).expect("a finding");
    for part in ["f0_x_n by -", "f0_z_n by +0.", "no effect of the catalogue explains as much"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_nothing_else(&diagnosis);
}

/// Causes with which the first verdict is tied.
fn tied_with(diagnosis: &Value) -> Vec<&str> {
    let tied = diagnosis["verdicts"][0]["tied_with"].as_array().unwrap();
    tied.iter().filter_map(Value::as_str).collect()
}

#[test]
fn zeros_that_rise_evenly_are_tied_with_a_drift() {
    let shifts = [(2, "f0_x_n", 0.6), (3, "f0_x_n", 1.1), (2, "f0_z_n", -0.3), (3, "f0_z_n", -0.7)];
    let spoilt = shifted("clean", "force.csv", &shifts);
    let diagnosis = diagnosed(&WorkDir::empty(), &spoilt.path().display().to_string());
    let message = difference(&diagnosis).expect("a finding");
    assert!(message.contains("reference_drift explain as much"), "{message}");
    assert_eq!(diagnosis["verdicts"][0]["verdict"], "tied");
    assert!(tied_with(&diagnosis).contains(&"the zero of the reference"), "{message}");
}

/// A drift of a few of its noise floors differs little from an offset of each recording.
#[test]
fn a_drift_is_found_or_tied_with_an_offset_of_the_recordings() {
    let dir = WorkDir::empty();
    for (magnitude, is_tied) in [("3", false), ("0.6", true)] {
        let campaign = format!("drift-{magnitude}");
        dir.stdout(&format!("simulate -o {campaign} --effect field_drift={magnitude} --sensors 1"));
        let diagnosis = diagnosed(&dir, &campaign);
        assert_eq!(diagnosis["verdicts"][0]["effect"], "field_drift", "{magnitude}");
        let tied = tied_with(&diagnosis).contains(&"the offset of the field");
        assert_eq!((tied, difference(&diagnosis).is_some()), (is_tied, is_tied), "{magnitude}");
    }
}

#[test]
fn a_polynomial_has_no_place_of_a_magnet() {
    let spoilt = shifted("clean", "force.csv", &[(2, "f0_x_n", 4.0)]);
    let (dir, campaign) = (WorkDir::empty(), spoilt.path().display().to_string());
    let diagnosis = diagnosed_with("polynomial", &dir, &campaign);
    let message = difference(&diagnosis).expect("a finding");
    assert!(message.contains("f0_x_n by +3.9") && !message.contains("as much. On"), "{message}");
    let [.., fit] = &diagnosis["next"].as_array().unwrap()[..] else { panic!("{diagnosis}") };
    assert!(fit.as_str().unwrap().contains("--base polynomial"), "{fit}");
}

#[test]
fn a_zero_is_found_next_to_an_effect() {
    let spoilt = shifted("demo", "force.csv", &[(2, "f0_x_n", 2.0)]);
    let diagnosis = diagnosed(&WorkDir::empty(), &spoilt.path().display().to_string());
    let message = difference(&diagnosis).expect("a finding");
    assert!(message.contains("f0_x_n by +1.99"), "{message}");
    assert_eq!(diagnosis["accepted"], serde_json::json!([["neighbour_magnet"]]));
    assert_eq!(diagnosis["formulas"], Value::Array(Vec::new()));
}

#[test]
fn an_offset_of_the_field_is_found() {
    let counts = |gauss: f64| (gauss / GAUSS_PER_LSB).round();
    let shifts = [(2, "s0_x_lsb", counts(2.0)), (2, "s0_y_lsb", counts(-3.0))];
    let spoilt = shifted("clean", "hall.csv", &shifts);
    let diagnosis = diagnosed(&WorkDir::empty(), &spoilt.path().display().to_string());
    let message = difference(&diagnosis).expect("a finding");
    for part in ["the offset of the field", "Bx of sensor 0 by +2.0", "By of sensor 0 by -2.99"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_nothing_else(&diagnosis);
}

/// A magnet that was mounted again: effects are sought on the recordings without the other place, the forces are those as recorded.
#[test]
fn another_place_of_a_magnet_is_found_and_nothing_else() {
    let dir = WorkDir::empty();
    for (recording, [x_mm, y_mm]) in [(1, [0.0, 0.0]), (2, [0.004, 0.007]), (3, [0.0, -0.006])] {
        let mut model = nominal();
        model.gap_mm += y_mm;
        model.offset_mm[0] += x_mm;
        let bench = SyntheticCampaign { model, seconds: 30.0, noise: (0.3, 0.15), seed: 4 };
        let (hall, force) = bench.tables(recording);
        let folder = dir.path("moved").join(recording.to_string());
        write_recording(&folder, RECORDING_TOML, &hall, &force);
    }
    let diagnosis = diagnosed(&dir, "moved");
    let message = difference(&diagnosis).expect("a finding");
    for part in ["the place of the magnet", "on the recordings without it"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let moved_um = message.split(" by ").skip(1).filter_map(|rest| rest.split('±').next());
    let moved_um: Vec<f64> = moved_um.filter_map(|value| value.parse().ok()).collect();
    assert_eq!(moved_um.len(), 3, "{message}");
    for (found, set) in moved_um.iter().zip([4.0, 7.0, -6.0]) {
        assert!((found - set).abs() < 0.05, "{message}");
    }
    for list in ["accepted", "formulas"] {
        assert_eq!(diagnosis[list], Value::Array(Vec::new()), "{list}");
    }
    assert_eq!(diagnosis["at_floor"], true);
    let force = &diagnosis["staircase"][0]["force"];
    let [excess_n, noise_n] = ["excess_n", "noise_n"].map(|name| force[name].as_f64().unwrap());
    assert!(excess_n > 2.0 * noise_n, "{force}");
}

#[test]
fn effects_are_no_differences() {
    for campaign in ["clean", "demo", "friction", "ripple"] {
        assert_eq!(difference(diagnosis(campaign)), None, "{campaign}");
    }
}
