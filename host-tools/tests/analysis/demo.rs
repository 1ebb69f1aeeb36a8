//! `magpie demo`: its report follows the campaign.

use crate::workdir::{WorkDir, campaign, text};
use model_export::model_file::TABLES_MARK;

/// Report of the demo, and its folder of output.
fn demo(arguments: &[&str]) -> (String, WorkDir) {
    let dir = WorkDir::empty();
    let output = dir.stdout(&[&["demo", "-o", "."], arguments].concat());
    (text(&output), dir)
}

fn files(dir: &WorkDir) -> Vec<String> {
    let entries = std::fs::read_dir(dir.0.path()).unwrap();
    let mut files: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    files.sort();
    files
}

/// Models of the last table with the excess of their error over the noise, the error and the noise, in newtons.
fn errors(report: &str) -> Vec<(String, [f64; 3])> {
    let (_, table) = report.split_once("4. Add.").unwrap();
    let (table, _) = table.split_once("Open ").unwrap();
    let row = |line: &str| {
        let mut words: Vec<&str> = line.split_whitespace().collect();
        words.pop().filter(|file| file.ends_with(".toml"))?;
        let newtons: Vec<f64> =
            words.split_off(words.len().checked_sub(3)?).iter().flat_map(|n| n.parse()).collect();
        Some((words.join(" "), newtons.try_into().ok()?))
    };
    table.lines().filter_map(row).collect()
}

#[test]
fn demo_adds_an_effect_and_a_formula_and_the_force_error_falls_twice() {
    let (report, dir) = demo(&[]);
    let errors = errors(&report);
    let names: Vec<&str> = errors.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["base model", "+ neighbour_magnet", "+ formula_1"], "{report}");
    let [base, with_magnet, with_both] = [0, 1, 2].map(|step| errors[step].1);
    assert!(with_magnet[0] < 0.6 * base[0] && with_both[0] < 0.1 * with_magnet[0], "{errors:?}");
    let [after, error, noise] = with_both;
    assert!((0.40..0.45).contains(&noise), "{errors:?}");
    assert!((error.powi(2) - noise.powi(2) - after.powi(2)).abs() < 0.002, "{errors:?}");
    assert!(report.contains("follows the opening") && report.contains("sin(2*pi*opening_mm/p)"));
    assert!(report.contains(", p = 2.609 mm\n"), "{report}");
    // What commonly moves with the opening, as a suggestion.
    assert!(report.contains("What commonly moves, to check: with opening_mm: "), "{report}");
    assert!(report.lines().count() <= 32, "{report}");
    for line in report.lines() {
        assert!(line.chars().count() <= 100 || line.contains("MAGPIE_TABLES"), "{line}");
    }
    let written = ["better-1.toml", "better-2.toml", "campaign", "campaign-truth.toml"];
    assert_eq!(files(&dir), [&written[..], &["model.toml", "report.html", "tables.rs"]].concat());
    // The commands print the same numbers.
    let diagnosis = dir.json("diagnose model.toml campaign --json");
    for (step, (_, [excess, error, noise])) in
        diagnosis["staircase"].as_array().unwrap().iter().zip(&errors)
    {
        for (key, shown) in [("excess_n", excess), ("rms_n", error), ("noise_n", noise)] {
            assert!(
                (step["force"][key].as_f64().unwrap() - shown).abs() < 0.0006,
                "{step} {shown}"
            );
        }
    }
    // The last model is that of the last step.
    let compared = dir.json("compare better-2.toml campaign --json");
    let last = diagnosis["staircase"].as_array().unwrap().last().unwrap();
    let [of_step, of_model] = [last, &compared].map(|of| of["force"]["excess_n"].as_f64().unwrap());
    assert!((of_step - of_model).abs() < 1e-6, "{of_step} {of_model}");
    // The tables are those of the last model.
    let tables = std::fs::read_to_string(dir.path("tables.rs")).unwrap();
    assert!(tables.starts_with(TABLES_MARK) && tables.contains("formula_1"));
    // Forces before and after, the curve, the error step by step.
    let page = std::fs::read_to_string(dir.path("report.html")).unwrap();
    let place = |id: &str| page.find(&format!("<section id=\"{id}\"")).unwrap();
    let order = ["scale", "overlay", "found", "staircase", "diagnosis", "errors"].map(place);
    assert!(order.is_sorted(), "{order:?}");
}

#[test]
fn demo_of_friction_finds_hysteresis_and_temperature() {
    let (report, dir) = demo(&["--verbose", &campaign("friction")]);
    let errors = errors(&report);
    assert_eq!(errors.len(), 3, "{report}");
    let named = |name: &str| errors[1..].iter().any(|(with, _)| with.contains(name));
    assert!(named("hysteresis") && named("magnet_temperature"), "{errors:?}");
    assert!(!report.contains("+ neighbour_magnet"));
    // Equivalent effects are reported with a recording that separates them.
    assert!(report.contains("Equivalent on these data"), "{report}");
    assert!(errors[2].1[0] < 0.2 * errors[0].1[0], "{errors:?}");
    // A step that raises the excess is stated below the table.
    let (_, table) = report.split_once("4. Add.").unwrap();
    assert!(errors[1].1[0] > errors[0].1[0], "{errors:?}");
    assert!(table.contains("the excess of the forces rises"), "{report}");
    assert!(files(&dir).contains(&"better-2.toml".to_owned()));
}

#[test]
fn demo_without_missing_effects_says_so() {
    let (report, dir) = demo(&[&campaign("clean")]);
    assert!(report.contains("4. Add. No effect of the catalogue is missing."), "{report}");
    assert!(report.contains("At the noise floor"), "{report}");
    assert_eq!(files(&dir), ["model.toml", "report.html", "tables.rs"]);
}

#[test]
fn demo_refuses_one_recording_before_it_writes() {
    let dir = WorkDir::empty();
    let message = dir.failure(&["demo", &campaign("demo/1")]);
    assert!(message.contains("needs two recordings"), "{message}");
    assert!(files(&dir).is_empty());
}
