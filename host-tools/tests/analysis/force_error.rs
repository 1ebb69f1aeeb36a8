//! One force error of one model on the same rows is one number, whichever command states it.

use analysis::workbench::Workbench;
use model_export::effects::{EffectTerm, find};
use model_export::fit::FitOptions;
use model_export::recordings::align::Alignment;
use serde_json::Value;

use crate::workdir::{WorkDir, campaign, diagnosis, text};

/// Largest difference of two statements of one number, in newtons.
const SAME_N: f64 = 1e-6;

/// Error, noise and excess in newtons, and the rows.
fn figures(force: &Value) -> ([f64; 3], String) {
    let keys = ["rms_n", "noise_n", "excess_n"];
    let newtons = keys.map(|key| force[key].as_f64().unwrap_or_else(|| panic!("{key} of {force}")));
    (newtons, force["rows"].to_string())
}

fn assert_same(expected: &Value, found: &Value, who: &str) {
    let ((expected, rows), (found, of_rows)) = (figures(expected), figures(found));
    assert_eq!(rows, of_rows, "{who}");
    for (expected, found) in expected.iter().zip(found) {
        assert!((expected - found).abs() < SAME_N, "{who}: {expected} {found}");
    }
}

#[test]
fn all_commands_state_the_same_force_error() {
    let dir = WorkDir::empty();
    let friction = campaign("friction");
    let fit = dir.json(&format!("fit {friction} -o model.toml --json"));
    let base = &fit["force"];
    assert_eq!(base["rows"], "leave_recording_out");
    assert_same(
        base,
        &dir.json(&format!("compare model.toml {friction} --json"))["force"],
        "compare",
    );
    assert_same(base, &diagnosis("friction")["staircase"][0]["force"], "diagnose");

    let added = dir.json(&format!("add model.toml {friction} hysteresis -o better.toml --json"));
    assert_same(base, &added["force"]["before"], "add, before");
    let better = &added["force"]["after"];
    let both = dir.json(&format!("compare better.toml {friction} --baseline model.toml --json"));
    assert_same(better, &both["force"], "compare, after");
    assert_same(base, &both["with"]["force"], "compare, before");

    let alignment = Alignment { delay_us: 0.0 };
    let folder = std::path::Path::new(&friction);
    let bench = Workbench::open(folder, alignment, FitOptions::default()).unwrap().unwrap();
    for (effects, expected) in [(vec![], base), (vec!["hysteresis"], better)] {
        let terms: Vec<EffectTerm> =
            effects.iter().map(|name| EffectTerm::Catalogue(find(name).unwrap())).collect();
        bench.fit_model(&terms, &[]).unwrap();
        let force = bench.fitted(&terms, &[]).unwrap().force().unwrap();
        assert_same(expected, &serde_json::to_value(force).unwrap(), "workbench");
    }

    // The demo's table, and the page, with three decimals.
    let demo = text(&dir.stdout(&["demo", &friction, "-o", "demo"]));
    let (newtons, _) = figures(base);
    let shown = newtons.map(|value| format!("{value:.3}"));
    let line = demo.lines().find(|line| line.trim_start().starts_with("base model")).unwrap();
    assert!(shown.iter().all(|value| line.contains(value)), "{line} {shown:?}");
    let page = std::fs::read_to_string(dir.path("demo/report.html")).unwrap();
    assert!(page.contains(&format!("{} N →", shown[0])), "{}", shown[0]);
}

#[test]
fn rows_of_other_folds_have_another_name() {
    let dir = WorkDir::empty();
    let friction = campaign("friction");
    dir.stdout(&format!("fit {friction} -o model.toml"));
    // Softening is transient: its folds are blocks, here longer than the quarter of a second of a white residual, because friction
    // is missing.
    let added = dir.json(&format!("add model.toml {friction} softening -o softer.toml --json"));
    let rows = &added["force"]["after"]["rows"]["leave_blocks_out"]["block_ms"];
    assert!(rows.as_u64().unwrap() > 250, "{}", added["force"]);
    assert_eq!(added["force"]["before"]["rows"], added["force"]["after"]["rows"]);
    assert_same(
        &added["force"]["after"],
        &dir.json(&format!("compare softer.toml {friction} --json"))["force"],
        "compare",
    );
}

#[test]
fn replay_and_comparison_of_unseen_recordings_state_the_same_error() {
    let dir = WorkDir::empty();
    // The clock's error is of the recordings, so both correct the reference.
    let simulate = "simulate --sensors 1 --seconds 12 --effect clock_skew=8 --seed";
    dir.stdout(&format!("{simulate} 4 -o fitted"));
    dir.stdout(&format!("{simulate} 4 --load 0.9 -o other"));
    dir.stdout("fit fitted -o model.toml");
    dir.stdout("add model.toml fitted clock_skew -o better.toml");
    let compared = dir.json("compare better.toml other --json");
    let replayed = dir.json("replay better.toml other --json");
    assert_same(&compared["force"], &replayed["force"], "replay");
    assert_eq!(compared["force"]["rows"], "unseen");
    let recorded_n = compared["force"]["recorded_rms_n"].as_f64().unwrap();
    assert!(recorded_n > 2.0 * figures(&compared["force"]).0[0], "{}", compared["force"]);
    let sentence = compared["force_origins"][0].as_str().unwrap();
    let skew = sentence.split_once("The reference's clock differs from the board's by ").unwrap().1;
    let skew_ms: f64 = skew.split_once(' ').unwrap().0.parse().unwrap();
    assert!((skew_ms - 8.0).abs() < 0.1, "{sentence}");
}
