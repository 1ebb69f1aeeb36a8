//! The tutorials: each command of their `console` blocks runs, in order and in one folder, and prints the lines below it.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crate::workdir::tutorial::{Step, folder, link_data, steps, words};
use crate::workdir::{WorkDir, text};

/// Runs a tutorial; returns the number of its commands.
fn run(name: &str) -> usize {
    let tutorial = std::fs::read_to_string(folder().join(name)).unwrap();
    let dir = WorkDir::empty();
    link_data(&dir);
    let mut commands = 0;
    for step in steps(&tutorial) {
        match step {
            Step::File { name, content } => std::fs::write(dir.path(name), content).unwrap(),
            Step::Command { command, arguments, expected, .. } => {
                let output = dir.run(&arguments.unwrap_or_else(|| panic!("{name}: {command}")));
                let printed = text(&output.stdout) + &text(&output.stderr);
                assert!(output.status.success(), "{name}: {command}\n{printed}");
                let printed = words(&printed);
                for line in expected {
                    let is_printed = printed.contains(&words(line));
                    assert!(
                        is_printed,
                        "{name}: {command}\ndoes not print\n{line}\nbut\n{printed}"
                    );
                }
                commands += 1;
            }
        }
    }
    commands
}

#[test]
fn calibrate() {
    assert!(run("calibrate.md") >= 6);
}

#[test]
fn missing_effects() {
    assert!(run("missing-effects.md") >= 6);
}

#[test]
fn design() {
    assert!(run("design.md") >= 5);
}

#[test]
fn ros2() {
    assert!(run("ros2.md") >= 4);
}

#[test]
fn tutorials_write_to_paths_of_their_own() {
    let mut writers: BTreeMap<String, PathBuf> = BTreeMap::new();
    for entry in std::fs::read_dir(folder()).unwrap() {
        let page = entry.unwrap().path();
        for step in steps(&std::fs::read_to_string(&page).unwrap()) {
            let paths = match step {
                Step::File { name, .. } => vec![name.to_owned()],
                Step::Command { arguments, .. } => {
                    let words = arguments.unwrap_or_default();
                    let is_output = |word: &str| matches!(word, "-o" | "--checkpoint");
                    let pairs = words.windows(2).filter(|pair| is_output(&pair[0]));
                    pairs.map(|pair| pair[1].clone()).collect()
                }
            };
            for path in paths {
                let writer = writers.entry(path.clone()).or_insert_with(|| page.clone());
                assert_eq!(*writer, page, "{path}");
            }
        }
    }
    assert!(writers.len() > 20, "{writers:?}");
}

#[test]
fn every_tutorial_is_run() {
    let mut names: Vec<String> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    // `flash-and-drive` needs the image; the emulation's tests run it.
    assert_eq!(
        names,
        ["calibrate.md", "design.md", "flash-and-drive.md", "missing-effects.md", "ros2.md"]
    );
}
