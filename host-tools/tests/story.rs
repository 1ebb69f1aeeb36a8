//! `magpie demo` tells what the recordings show: another campaign, another story.

use std::process::Command;

use tempfile::TempDir;
use tests::data;

/// The story of a campaign, and the files that it left.
fn story(campaign: Option<&str>) -> (String, Vec<String>) {
    let folder = TempDir::new().unwrap();
    let mut magpie = Command::new(env!("CARGO_BIN_EXE_magpie"));
    magpie.arg("demo").arg("-o").arg(folder.path());
    if let Some(name) = campaign {
        magpie.arg(data(name));
    }
    let output = magpie.output().expect("the tool runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let entries = std::fs::read_dir(folder.path()).unwrap();
    let mut files: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    files.sort();
    (String::from_utf8_lossy(&output.stdout).into_owned(), files)
}

/// Newtons of the last table, from the model as it was fitted downwards.
fn fall(story: &str) -> Vec<(String, f64)> {
    let (_, table) = story.split_once("7. The error by effect.").unwrap();
    let (table, _) = table.split_once("Models: better").unwrap();
    table
        .lines()
        .filter_map(|line| {
            let (with, newtons) = line.trim().rsplit_once(char::is_whitespace)?;
            Some((with.trim().to_owned(), newtons.parse().ok()?))
        })
        .collect()
}

#[test]
fn demo_finds_the_neighbour_magnet_and_reduces_the_error() {
    let (story, files) = story(None);
    let fall = fall(&story);
    assert_eq!(fall.len(), 2, "{story}");
    assert_eq!(fall[1].0, "+ neighbour_magnet");
    // Noise alone leaves 0.42 N.
    assert!(fall[0].1 > 0.46 && fall[1].1 < 0.45, "{fall:?}");
    assert!(story.contains("follows the opening"));
    assert_eq!(files, ["better-1.toml", "model.toml", "report.html", "tables.rs"]);
}

#[test]
fn demo_of_friction_finds_hysteresis_and_temperature() {
    let (story, files) = story(Some("friction"));
    let fall = fall(&story);
    assert_eq!(fall.len(), 3, "{story}");
    let named = |name: &str| fall[1..].iter().any(|(with, _)| with.contains(name));
    assert!(named("hysteresis") && named("magnet_temperature"), "{fall:?}");
    assert!(!story.contains("+ neighbour_magnet"));
    // A tie says so, and which recording would tell.
    assert!(story.contains("Equivalent on these data"), "{story}");
    assert!(fall[2].1 < 0.3 * fall[0].1, "{fall:?}");
    assert!(files.contains(&"better-2.toml".to_owned()));
}

#[test]
fn demo_refuses_fewer_than_three_recordings() {
    let folder = TempDir::new().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(["demo".as_ref(), data("demo").join("1").as_os_str()])
        .current_dir(folder.path())
        .output()
        .expect("the tool runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success());
    assert!(said.contains("1 recordings") && said.contains("needs three"), "{said}");
}
