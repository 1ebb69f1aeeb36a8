//! What `magpie train --table` promises: every way in every column, the figures that other commands
//! print of the same estimates, and a held-out recording that changes no weight.

mod desk;

use std::fs;

use desk::Desk;
use serde_json::Value;

const WAYS: [&str; 8] = [
    "ideal_nominal",
    "ideal_fitted",
    "gru_2axis",
    "gru_3axis",
    "gru_3axis_ideal",
    "gru_3axis_near_zero",
    "physics_effects",
    "physics_effects_gru",
];

/// A campaign of one sensor, the two recordings of it that are learned from, and models.
fn simulated() -> Desk {
    let desk = Desk::empty();
    desk.done("simulate -o bench --seconds 6 --sensors 1 --effect cross_coupling=5");
    copy(&desk, "bench/1", "learned/1");
    copy(&desk, "bench/2", "learned/2");
    desk.done("fit learned -o plain.toml");
    desk.done("add plain.toml learned cross_coupling -o model.toml");
    desk
}

fn copy(desk: &Desk, from: &str, to: &str) {
    let (from, to) = (desk.0.path().join(from), desk.0.path().join(to));
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

/// The row of a way and an axis.
fn row<'a>(told: &'a Value, way: &str, axis: &str) -> &'a Value {
    let mut rows = told["rows"].as_array().unwrap().iter();
    let row = rows.find(|row| row["variant"] == way && row["axis"] == axis);
    row.unwrap_or_else(|| panic!("no row of {way}, {axis}"))
}

const TABLE: &str = "train --table model.toml bench --epochs 2 --hidden 4 --magnet-hours 0 --json";

#[test]
fn every_way_has_a_row_and_the_physics_s_are_those_of_a_replay() {
    let desk = simulated();
    let table = TABLE.replace("--magnet-hours 0", "--magnet-hours 0.01");
    let told = desk.told(&format!("{table} -o report.html"));
    assert_eq!(told["rows"].as_array().unwrap().len(), 2 * WAYS.len());
    for way in WAYS {
        for axis in ["x", "z"] {
            let row = row(&told, way, axis);
            let [rmse, mean, std] = ["rmse_n", "mean_n", "std_n"].map(|key| number(row, key));
            assert!((rmse - mean.hypot(std)).abs() < 1e-9 * rmse, "{row}");
            // The recording begins unloaded, and the board is read every millisecond.
            assert!(number(row, "tared_rmse_n") > 0.0 && number(row, "fixed_tared_rmse_n") > 0.0);
            assert!((5900.0..=6010.0).contains(&number(row, "rows")), "{row}");
        }
    }
    // What another command says of the model fitted to the same two recordings.
    let replayed = |model: &str| desk.told(&format!("replay {model} bench/3 --json"));
    let (plain, model) = (replayed("plain.toml"), replayed("model.toml"));
    let ways = [
        ("ideal_nominal", &plain["nominal"]),
        ("ideal_fitted", &plain["sensors"]),
        ("physics_effects", &model["sensors"]),
    ];
    for (way, replayed) in ways {
        for (place, axis) in ["x", "z"].into_iter().enumerate() {
            let (own, other) = (row(&told, way, axis), &replayed[place]);
            assert_eq!(other["axis"], axis);
            for (key, known) in [
                ("fixed_rmse_n", "rmse_n"),
                ("fixed_mean_n", "mean_n"),
                ("fixed_tared_rmse_n", "tared_rmse_n"),
                ("rmse_n", "float_rmse_n"),
            ] {
                let (own, other) = (number(own, key), number(other, known));
                assert!(
                    (own - other).abs() < 2e-3,
                    "{way} {axis} {key}: {own}, {other}"
                );
            }
        }
    }
    let [one, two, three] = ["1", "2", "3"].map(|width| number(&told["coverage"], width));
    assert!(one > 0.0 && one <= two && two <= three && three <= 1.0);
    let paper = &row(&told, "gru_2axis", "z")["paper"];
    assert_eq!(number(paper, "mean_n"), -20.4);
    // Five seconds of two recordings of six, and all twelve; five ways each, ten seconds as well.
    assert_eq!(told["data_efficiency"].as_array().unwrap().len(), 3 * 5);
    assert_eq!(told["simulated"], true);
    let page = fs::read_to_string(desk.0.path().join("report.html")).unwrap();
    for id in [
        "table",
        "time",
        "spread",
        "calibration",
        "lengths",
        "foreign",
    ] {
        assert!(page.contains(&format!("<section id=\"{id}\">")), "{id}");
    }
    assert!(!page.contains("could not be drawn"));
    foreign_magnets_were_counted(&told["foreign_magnet"]);
}

/// On a hundred seconds of the same gripper, which are in no recording.
fn foreign_magnets_were_counted(told: &Value) {
    assert_eq!(
        (&told["simulated"], &told["variant"]),
        (&true.into(), &"physics_effects_gru".into())
    );
    let hours = number(told, "hours");
    assert!((hours - 100.0 / 3600.0).abs() < 1e-4, "{hours}");
    let (passages, passed) = (number(told, "passages"), number(told, "passed"));
    assert!(passages >= 3.0 && passed >= passages, "{told}");
    assert!(number(told, "detected") > 0.5, "{told}");
    let [least, most] = [0, 1].map(|i| told["detected_interval_95"][i].as_f64().unwrap());
    assert!(least < number(told, "detected") && number(told, "detected") <= most);
    assert!(number(told, "p50_ms") <= number(told, "p99_ms"));
    // By the rule of three, and more where there was an alarm.
    let (alarms, upper) = (
        number(told, "false_alarms"),
        number(told, "false_per_10h_upper_95"),
    );
    assert!((number(told, "false_per_10h") - alarms * 10.0 / hours).abs() < 1e-6);
    assert!(
        upper > 29.9 / hours && (alarms > 0.0 || upper < 30.0 / hours),
        "{told}"
    );
    let curve = told["roc"]["parity"].as_array().unwrap();
    assert!(curve.len() > 5 && curve.iter().all(|point| point[2].as_f64().unwrap() <= 1.0));
}

#[test]
fn another_held_out_recording_changes_its_errors_and_not_a_bit_of_any_network() {
    let desk = simulated();
    let before = desk.told(TABLE);
    let networks = before["networks"].as_array().unwrap();
    assert_eq!(networks.len(), 5);
    // Of another gripper, and without the coupling.
    desk.done("simulate -o other --seconds 6 --sensors 1 --seed 9");
    copy(&desk, "other/3", "bench/3");
    let after = desk.told(TABLE);
    assert_eq!(before["networks"], after["networks"]);
    for way in WAYS {
        let rmse = |told| number(row(told, way, "z"), "rmse_n");
        assert!(rmse(&before) != rmse(&after), "{way}");
    }
    // Another recording that is learned from does change them.
    copy(&desk, "other/2", "bench/2");
    let learned = desk.told(TABLE);
    for (before, after) in networks.iter().zip(learned["networks"].as_array().unwrap()) {
        assert_ne!(before["sha256"], after["sha256"], "{before}");
    }
}

#[test]
fn without_effects_the_physics_with_effects_is_left_out_and_the_reason_is_said() {
    let desk = simulated();
    // Nor is it known any more how the recordings were simulated.
    fs::remove_file(desk.0.path().join("bench-truth.toml")).unwrap();
    let line = "train --table plain.toml bench --epochs 1 --hidden 2 --magnet-hours 0.002 --json";
    let told = desk.told(line);
    let magnet = &told["foreign_magnet"];
    assert_eq!(
        (&magnet["simulated"], &magnet["variant"]),
        (&false.into(), &"gru_3axis_ideal".into())
    );
    // Magnets passed it twice, but the time without them is that of the one recording.
    assert!(
        (number(magnet, "hours") - 6.0 / 3600.0).abs() < 1e-4,
        "{magnet}"
    );
    assert_eq!(told["rows"].as_array().unwrap().len(), 2 * 6);
    assert_eq!(told["network_on_physics"], Value::Null);
    let note = told["notes"][0].as_str().unwrap();
    assert!(
        note.contains("no effects") && note.contains("magpie add"),
        "{note}"
    );
}

#[test]
fn what_the_table_cannot_take_is_refused() {
    let desk = simulated();
    let said = desk.refused("train --table model.toml bench/1");
    assert!(said.contains("there is one recording"), "{said}");
    let said = desk.refused("train --table model.toml bench --axes xz");
    assert!(said.contains("--axes"), "{said}");
    let said = desk.refused("train --table model.toml bench --magnet-hours=-1");
    assert!(said.contains("--magnet-hours"), "{said}");
    let said = desk.refused("train --table model.toml bench --near-zero 0");
    assert!(said.contains("--near-zero 0"), "{said}");
    copy(&desk, "bench/3", "bench/4");
    let said = desk.refused("train --table model.toml bench");
    assert!(said.contains("are the same data"), "{said}");
}
