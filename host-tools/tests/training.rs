//! What `magpie train` promises on the command line: the same network whatever the number of threads
//! and however often it was interrupted, a table of what it is worth, and no file but its own
//! overwritten.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;
use tests::data;

fn magpie(arguments: &[&str], threads: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(arguments)
        .env("RAYON_NUM_THREADS", threads)
        .output()
        .expect("the command runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A campaign with little in it, and a model of it.
fn campaign(folder: &TempDir) -> (PathBuf, PathBuf) {
    let (campaign, model) = (folder.path().join("bench"), folder.path().join("model.toml"));
    let path = |path: &Path| path.to_str().unwrap().to_owned();
    let simulate = ["simulate", "-o", &path(&campaign), "--seconds", "6", "--sensors", "2"];
    assert!(magpie(&simulate, "2").status.success());
    let fit = ["fit", &path(&campaign), "-o", &path(&model)];
    assert!(magpie(&fit, "2").status.success());
    (model, campaign)
}

/// Trains with these arguments in addition to the usual ones; returns the output.
fn train(model: &Path, campaign: &Path, more: &[&str], threads: &str) -> Output {
    let usual = ["train", model.to_str().unwrap(), campaign.to_str().unwrap()];
    magpie(&[&usual, more].concat(), threads)
}

#[test]
fn training_is_reproducible_across_threads_and_resume() {
    let folder = TempDir::new().unwrap();
    let (model, campaign) = campaign(&folder);
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let run = |output: &str, more: &[&str], threads: &str| {
        let output = place(output);
        let usual = ["--hidden", "4", "--epochs", "4", "-o", &output];
        let done = train(&model, &campaign, &[&usual, more].concat(), threads);
        assert!(done.status.success(), "{}", text(&done.stderr));
        fs::read(&output).unwrap()
    };
    let one = run("one", &[], "1");
    assert_eq!(one, run("two", &[], "2"));
    let checkpoint = place("checkpoint");
    // A whole training leaves its checkpoint; going on from it leaves nothing to do.
    assert_eq!(one, run("three", &["--checkpoint", &checkpoint], "2"));
    let resumed = ["--checkpoint", &checkpoint, "--resume"];
    assert_eq!(one, run("four", &resumed, "1"));
    let other = train(&model, &campaign, &[&resumed[..], &["--seed", "2"]].concat(), "1");
    assert!(!other.status.success());
    assert!(text(&other.stderr).contains("(--axes"), "{}", text(&other.stderr));
}

#[test]
fn training_report_has_error_and_range_of_every_force() {
    let folder = TempDir::new().unwrap();
    let (model, campaign) = campaign(&folder);
    let more = [
        "--hidden",
        "8",
        "--epochs",
        "30",
        "--inputs",
        "field+ideal",
        "--target",
        "rest",
        "--axes",
        "xz",
        "--hold-out",
        "1",
        "--json",
    ];
    let done = train(&model, &campaign, &more, "2");
    assert!(done.status.success(), "{}", text(&done.stderr));
    let output: Value = serde_json::from_slice(&done.stdout).unwrap();
    let rows = output["sensors"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    assert_eq!(output["held_out"], "1");
    assert_eq!(output["networks"].as_array().unwrap().len(), 2);
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap();
        // Nothing is missing in the model: the network has nothing to add, and must not spoil it.
        assert!(number("ideal_rmse_n") < 1.0, "{row}");
        assert!(number("rmse_n") < 3.0 * number("ideal_rmse_n"), "{row}");
        // The reference has a row every 10 ms.
        assert!((590.0..=601.0).contains(&number("rows")), "{row}");
        assert!(row["range_n"][1].as_f64().unwrap() > 20.0, "{row}");
        assert!(number("within_2") > 0.5, "{row}");
    }
}

#[test]
fn training_refuses_foreign_output_and_single_recording() {
    let folder = TempDir::new().unwrap();
    let notes = folder.path().join("notes.txt");
    fs::write(&notes, "mine").unwrap();
    let (model, clean) = (folder.path().join("none.toml"), data("clean"));
    let done = train(&model, &clean, &["-o", notes.to_str().unwrap()], "1");
    assert!(!done.status.success());
    assert!(text(&done.stderr).contains("not overwritten"), "{}", text(&done.stderr));
    assert_eq!(fs::read_to_string(&notes).unwrap(), "mine");
    let done = train(&model, &clean.join("1"), &[], "1");
    assert!(text(&done.stderr).contains("one recording"), "{}", text(&done.stderr));
    let done = train(&model, &clean, &["--hold-out", "4"], "1");
    assert!(text(&done.stderr).contains("there are 3 recordings"), "{}", text(&done.stderr));
}
