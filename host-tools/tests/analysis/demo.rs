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

/// Models of the last table with the excess of their error over the noise, the error and the noise, in newtons.
fn errors(report: &str) -> Vec<(String, [f64; 3])> {
    let (_, table) = report.split_once("7. The error by effect.").unwrap();
    let (table, _) = table.split_once("Models: better").unwrap();
    let row = |line: &str| {
        let mut words: Vec<&str> = line.split_whitespace().collect();
        let newtons: Vec<f64> =
            words.split_off(words.len().checked_sub(3)?).iter().flat_map(|n| n.parse()).collect();
        Some((words.join(" "), newtons.try_into().ok()?))
    };
    table.lines().filter_map(row).collect()
}

#[test]
fn demo_finds_the_neighbour_magnet_and_reduces_the_error() {
    let (report, files) = demo(None);
    let errors = errors(&report);
    assert_eq!(errors.len(), 2, "{report}");
    assert_eq!(errors[1].0, "+ neighbour_magnet");
    let ([before, ..], [after, error, noise]) = (errors[0].1, errors[1].1);
    assert!(before > 0.2 && after < 0.15 && (0.40..0.44).contains(&noise), "{errors:?}");
    assert!((error.powi(2) - noise.powi(2) - after.powi(2)).abs() < 0.002, "{errors:?}");
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
    assert!(errors[2].1[0] < 0.2 * errors[0].1[0], "{errors:?}");
    assert!(files.contains(&"better-2.toml".to_owned()));
}

#[test]
fn demo_refuses_fewer_than_three_recordings() {
    let message = WorkDir::empty().failure(&["demo", &campaign("demo/1")]);
    assert!(message.contains("1 recordings") && message.contains("needs three"), "{message}");
}
