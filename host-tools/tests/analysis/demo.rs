//! `magpie demo`: its report follows the campaign.

use crate::workdir::{WorkDir, campaign, text};

/// Report of the demo, and the files that it writes.
fn demo(of: Option<&str>) -> (String, Vec<String>) {
    let dir = WorkDir::empty();
    let campaign = of.map(campaign);
    let arguments = ["demo", "-o", "."].into_iter().chain(campaign.as_deref());
    let output = dir.stdout(&arguments.collect::<Vec<_>>());
    let entries = std::fs::read_dir(dir.0.path()).unwrap();
    let mut files: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    files.sort();
    (text(&output), files)
}

/// Models of the last table with their errors in newtons.
fn errors(report: &str) -> Vec<(String, f64)> {
    let (_, table) = report.split_once("7. The error by effect.").unwrap();
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
    let (report, files) = demo(None);
    let errors = errors(&report);
    assert_eq!(errors.len(), 2, "{report}");
    assert_eq!(errors[1].0, "+ neighbour_magnet");
    // Noise alone leaves 0.42 N.
    assert!(errors[0].1 > 0.46 && errors[1].1 < 0.45, "{errors:?}");
    assert!(report.contains("follows the opening"));
    assert_eq!(files, ["better-1.toml", "model.toml", "report.html", "tables.rs"]);
}

#[test]
fn demo_of_friction_finds_hysteresis_and_temperature() {
    let (report, files) = demo(Some("friction"));
    let errors = errors(&report);
    assert_eq!(errors.len(), 3, "{report}");
    let named = |name: &str| errors[1..].iter().any(|(with, _)| with.contains(name));
    assert!(named("hysteresis") && named("magnet_temperature"), "{errors:?}");
    assert!(!report.contains("+ neighbour_magnet"));
    // Equivalent effects are reported with a recording that separates them.
    assert!(report.contains("Equivalent on these data"), "{report}");
    assert!(errors[2].1 < 0.3 * errors[0].1, "{errors:?}");
    assert!(files.contains(&"better-2.toml".to_owned()));
}

#[test]
fn demo_refuses_fewer_than_three_recordings() {
    let message = WorkDir::empty().failure(&["demo", &campaign("demo/1")]);
    assert!(message.contains("1 recordings") && message.contains("needs three"), "{message}");
}
