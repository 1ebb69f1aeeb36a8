//! `magpie train`: reproducibility, report, refused arguments.

use std::fs;

use crate::workdir::{WorkDir, campaign, text};

/// Short campaign `bench` of two sensors, and `model.toml` fitted to it.
fn simulated() -> WorkDir {
    let dir = WorkDir::empty();
    dir.stdout("simulate -o bench --seconds 6 --sensors 2");
    dir.stdout("fit bench -o model.toml");
    dir
}

#[test]
fn training_is_reproducible_across_threads_and_resume() {
    let dir = simulated();
    let run = |output: &str, more: &str, threads: &str| {
        let line = format!("train model.toml bench --hidden 4 --epochs 4 -o {output} {more}");
        let done = dir.command(&line).env("RAYON_NUM_THREADS", threads).output().unwrap();
        assert!(done.status.success(), "{}", text(&done.stderr));
        fs::read(dir.path(output)).unwrap()
    };
    let one = run("one", "", "1");
    assert_eq!(one, run("two", "", "2"));
    // A complete training leaves its checkpoint; resuming it changes nothing.
    assert_eq!(one, run("three", "--checkpoint checkpoint", "2"));
    assert_eq!(one, run("four", "--checkpoint checkpoint --resume", "1"));
    let message = dir.failure("train model.toml bench --checkpoint checkpoint --resume --seed 2");
    assert!(message.contains("(--axes"), "{message}");
}

#[cfg(unix)]
#[test]
fn interrupted_training_continues_with_the_printed_command() {
    use std::time::Duration;

    use rustix::process::Signal;

    use crate::workdir::running::Running;

    let dir = simulated();
    let line = "train model.toml bench --hidden 4 --epochs 200 --patience 200";
    dir.stdout(&format!("{line} -o complete.safetensors"));

    let mut running =
        Running::start(&dir, &format!("{line} -o network.safetensors --checkpoint saved"));
    while !dir.path("saved").exists() {
        assert!(running.0.try_wait().unwrap().is_none(), "it ended before its first checkpoint");
        std::thread::sleep(Duration::from_millis(5));
    }
    running.signal(Signal::INT);
    let mut message = String::new();
    std::io::Read::read_to_string(running.0.stderr.as_mut().unwrap(), &mut message).unwrap();
    assert_eq!(running.0.wait().unwrap().code(), Some(130), "{message}");
    assert!(
        message.contains("Interrupted after epoch") && message.contains("saved to saved"),
        "{message}"
    );
    assert!(!dir.path("network.safetensors").exists());

    let command =
        message.lines().find_map(|line| line.trim().strip_prefix("cargo magpie ")).unwrap();
    assert!(command.ends_with("--resume"), "{command}");
    dir.stdout(command);
    let bytes = |name: &str| fs::read(dir.path(name)).unwrap();
    assert_eq!(bytes("network.safetensors"), bytes("complete.safetensors"));
}

#[test]
fn training_report_has_error_and_range_of_every_force() {
    let line = "train model.toml bench --hidden 8 --epochs 30 --inputs field+ideal --target residual --axes xz \
                --hold-out 1 --json";
    let output = simulated().json(line);
    let rows = output["sensors"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    assert_eq!(output["held_out"], "1");
    assert_eq!(output["networks"].as_array().unwrap().len(), 2);
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap();
        // The model is complete: the network must not increase its error.
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
    let dir = WorkDir::empty();
    let clean = campaign("clean");
    fs::write(dir.path("notes"), "mine").unwrap();
    for (more, words) in [
        (&["-o", "notes"][..], "not overwritten"),
        (&["--hold-out", "4"], "there are 3 recordings"),
    ] {
        let message = dir.failure(&[&["train", "none.toml", &clean], more].concat());
        assert!(message.contains(words), "{more:?}: {message}");
    }
    assert_eq!(dir.read("notes"), "mine");
    let message = dir.failure(&["train", "none.toml", &format!("{clean}/1")]);
    assert!(message.contains("one recording"), "{message}");
}
