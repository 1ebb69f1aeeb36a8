//! `magpie benchmark`: variants, agreement with `replay`, and independence of the held-out recording.

use std::fs;

use serde_json::Value;

use crate::workdir::WorkDir;

const VARIANTS: [&str; 8] = [
    "ideal_nominal",
    "ideal_fitted",
    "gru_2axis",
    "gru_3axis",
    "gru_3axis_ideal",
    "gru_3axis_near_zero",
    "physics_effects",
    "physics_effects_gru",
];

/// Campaign of one sensor, its two training recordings in `learned`, and models.
fn simulated() -> WorkDir {
    let dir = WorkDir::empty();
    dir.stdout("simulate -o bench --seconds 6 --sensors 1 --effect cross_coupling=5");
    copy(&dir, "bench/1", "learned/1");
    copy(&dir, "bench/2", "learned/2");
    dir.stdout("fit learned -o plain.toml");
    dir.stdout("add plain.toml learned cross_coupling -o model.toml");
    dir
}

fn copy(dir: &WorkDir, from: &str, to: &str) {
    let (from, to) = (dir.path(from), dir.path(to));
    fs::create_dir_all(&to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

fn number(row: &Value, key: &str) -> f64 {
    let value = row[key].as_f64();
    value.unwrap_or_else(|| panic!("{key} in {row}"))
}

/// Row of a variant and an axis.
fn row<'a>(output: &'a Value, variant: &str, axis: &str) -> &'a Value {
    let mut rows = output["rows"].as_array().unwrap().iter();
    let row = rows.find(|row| row["variant"] == variant && row["axis"] == axis);
    row.unwrap_or_else(|| panic!("no row of {variant}, {axis}"))
}

const TABLE: &str = "train --table model.toml bench --epochs 2 --hidden 4 --magnet-hours 0 --json";

#[test]
fn every_variant_has_rows_that_match_replay() {
    let dir = simulated();
    let table = TABLE.replace("--magnet-hours 0", "--magnet-hours 0.01");
    let output = dir.json(&format!("{table} -o report.html"));
    assert_eq!(output["rows"].as_array().unwrap().len(), 2 * VARIANTS.len());
    for variant in VARIANTS {
        for axis in ["x", "z"] {
            let row = row(&output, variant, axis);
            let [rmse, mean, std] = ["rmse_n", "mean_n", "std_n"].map(|key| number(row, key));
            assert!((rmse - mean.hypot(std)).abs() < 1e-9 * rmse, "{row}");
            // The recording begins unloaded, and the board is read every millisecond.
            assert!(number(row, "tared_rmse_n") > 0.0 && number(row, "fixed_tared_rmse_n") > 0.0);
            assert!((5900.0..=6010.0).contains(&number(row, "rows")), "{row}");
        }
    }
    // `replay` of the model fitted to the same two recordings.
    let replayed = |model: &str| dir.json(&format!("replay {model} bench/3 --json"));
    let (plain, model) = (replayed("plain.toml"), replayed("model.toml"));
    let variants = [
        ("ideal_nominal", &plain["nominal"]),
        ("ideal_fitted", &plain["sensors"]),
        ("physics_effects", &model["sensors"]),
    ];
    for (variant, replayed) in variants {
        for (place, axis) in ["x", "z"].into_iter().enumerate() {
            let (own, other) = (row(&output, variant, axis), &replayed[place]);
            assert_eq!(other["axis"], axis);
            for (key, known) in [
                ("fixed_rmse_n", "rmse_n"),
                ("fixed_mean_n", "mean_n"),
                ("fixed_tared_rmse_n", "tared_rmse_n"),
                ("rmse_n", "float_rmse_n"),
            ] {
                // `replay` evaluates floating point for the model alone.
                if variant == "ideal_nominal" && known == "float_rmse_n" {
                    assert!(other.get(known).is_none(), "{other}");
                    continue;
                }
                let (own, other) = (number(own, key), number(other, known));
                assert!((own - other).abs() < 2e-3, "{variant} {axis} {key}: {own}, {other}");
            }
        }
    }
    let [one, two, three] = ["1", "2", "3"].map(|width| number(&output["coverage"], width));
    assert!(one > 0.0 && one <= two && two <= three && three <= 1.0);
    let paper = &row(&output, "gru_2axis", "z")["paper"];
    assert_eq!(number(paper, "mean_n"), -20.4);
    // Five seconds of two recordings of six, and all twelve; five ways each, ten seconds as well.
    assert_eq!(output["data_efficiency"].as_array().unwrap().len(), 3 * 5);
    assert_eq!(output["simulated"], true);
    let page = dir.read("report.html");
    for id in ["table", "time", "spread", "calibration", "lengths", "foreign"] {
        assert!(page.contains(&format!("<section id=\"{id}\">")), "{id}");
    }
    assert!(!page.contains("could not be drawn"));
    check_disturbance_counts(&output["foreign_magnet"]);
}

/// On a hundred seconds of the same gripper, which are in no recording.
fn check_disturbance_counts(output: &Value) {
    assert_eq!(
        (&output["simulated"], &output["variant"]),
        (&true.into(), &"physics_effects_gru".into())
    );
    let hours = number(output, "hours");
    assert!((hours - 100.0 / 3600.0).abs() < 1e-4, "{hours}");
    let (passages, passed) = (number(output, "passages"), number(output, "passed"));
    assert!(passages >= 3.0 && passed >= passages, "{output}");
    assert!(number(output, "detected") > 0.5, "{output}");
    let [least, most] = [0, 1].map(|i| output["detected_interval_95"][i].as_f64().unwrap());
    assert!(least < number(output, "detected") && number(output, "detected") <= most);
    assert!(number(output, "p50_ms") <= number(output, "p99_ms"));
    // By the rule of three, and more where there was an alarm.
    let (alarms, upper) =
        (number(output, "false_alarms"), number(output, "false_per_10h_upper_95"));
    assert!((number(output, "false_per_10h") - alarms * 10.0 / hours).abs() < 1e-6);
    assert!(upper > 29.9 / hours && (alarms > 0.0 || upper < 30.0 / hours), "{output}");
    let curve = output["roc"]["parity"].as_array().unwrap();
    assert!(curve.len() > 5 && curve.iter().all(|point| point[2].as_f64().unwrap() <= 1.0));
}

#[test]
fn held_out_recording_does_not_affect_the_networks() {
    let dir = simulated();
    let before = dir.json(TABLE);
    let networks = before["networks"].as_array().unwrap();
    assert_eq!(networks.len(), 5);
    // Of another gripper, and without the coupling.
    dir.stdout("simulate -o other --seconds 6 --sensors 1 --seed 9");
    copy(&dir, "other/3", "bench/3");
    let after = dir.json(TABLE);
    assert_eq!(before["networks"], after["networks"]);
    for variant in VARIANTS {
        let rmse = |output| number(row(output, variant, "z"), "rmse_n");
        assert!(rmse(&before) != rmse(&after), "{variant}");
    }
    // Another training recording does change them.
    copy(&dir, "other/2", "bench/2");
    let learned = dir.json(TABLE);
    for (before, after) in networks.iter().zip(learned["networks"].as_array().unwrap()) {
        assert_ne!(before["sha256"], after["sha256"], "{before}");
    }
}

#[test]
fn model_without_effects_skips_physics_variants() {
    let dir = simulated();
    // Without the truth the recordings count as measured.
    fs::remove_file(dir.path("bench-truth.toml")).unwrap();
    let line = "train --table plain.toml bench --epochs 1 --hidden 2 --magnet-hours 0.002 --json";
    let output = dir.json(line);
    let magnet = &output["foreign_magnet"];
    assert_eq!(
        (&magnet["simulated"], &magnet["variant"]),
        (&false.into(), &"gru_3axis_ideal".into())
    );
    // Magnets passed it twice, but the time without them is that of the one recording.
    assert!((number(magnet, "hours") - 6.0 / 3600.0).abs() < 1e-4, "{magnet}");
    assert_eq!(output["rows"].as_array().unwrap().len(), 2 * 6);
    assert_eq!(output["network_on_physics"], Value::Null);
    let note = output["notes"][0].as_str().unwrap();
    assert!(note.contains("no effects") && note.contains("cargo magpie add"), "{note}");
}

#[test]
fn invalid_benchmark_arguments_are_refused() {
    let dir = simulated();
    for (arguments, words) in [
        ("bench/1", "one recording"),
        ("bench --axes xz", "--axes"),
        ("bench --magnet-hours=-1", "--disturbance-hours"),
        ("bench --near-zero 0", "--zero-weight 0"),
    ] {
        let message = dir.failure(&format!("train --table model.toml {arguments}"));
        assert!(message.contains(words), "{arguments}: {message}");
    }
    copy(&dir, "bench/3", "bench/4");
    let message = dir.failure("train --table model.toml bench");
    assert!(message.contains("are the same data"), "{message}");
}
