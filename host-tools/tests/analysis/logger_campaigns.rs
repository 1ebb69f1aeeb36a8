//! Recordings and tables of other loggers, read in place: sparse references, clocks that differ, bags, one axis, and the formats in
//! which other programs write numbers and times.

use std::path::Path;

use rayon::prelude::*;
use serde_json::Value;

use crate::independent_campaigns::check_names;
use crate::workdir::WorkDir;

/// A folder of a logger and what a diagnosis of it must find.
struct Expected {
    folder: &'static str,
    /// Mapping with which the sources in the folder are imported; absent for campaigns.
    mapping: Option<&'static str>,
    base: &'static str,
    /// Setup error that stops until `--fix` has written a corrected copy.
    setup_error: Option<&'static str>,
    /// One effect of each step, in any order.
    effects: &'static [&'static str],
    /// Columns of the formulas.
    covariates: &'static [&'static str],
    /// Excess of the held-out force error over its noise in newtons, with what was found, at most.
    excess_n: f64,
}

const fn expected(folder: &'static str, excess_n: f64) -> Expected {
    let (effects, covariates): (&[&str], &[&str]) = (&[], &[]);
    Expected {
        folder,
        mapping: None,
        base: "cylinder",
        setup_error: None,
        effects,
        covariates,
        excess_n,
    }
}

/// Loads of the one-axis gauge, whose clock begins 0.38 s before that of the sensors.
const ONE_AXIS: Expected = Expected {
    setup_error: Some("clock_offset"),
    effects: &["creep", "clock_skew"],
    ..expected("one-axis-gauge", 0.02)
};

const CAMPAIGNS: [Expected; 11] = [
    // Both flexures soften by 0.6 %/K.
    Expected {
        mapping: Some("bags.toml"),
        covariates: &["fx_n", "fz_n", "temp_c"],
        ..expected("bags-soft-when-warm", 0.1)
    },
    // The join is no lag of the flexures.
    Expected { mapping: Some("bags.toml"), ..expected("bags-sensors-3ms-apart", 0.1) },
    // A reference that drifts, in recordings whose distances in time are unknown; between the directions of loading the
    // field is 1 to 4 N apart.
    Expected {
        mapping: Some("clocks-from-zero/mn.toml"),
        effects: &["hysteresis"],
        ..expected("clocks-from-zero", 0.25)
    },
    // The differences of a reference at 10 Hz have the motion of the load in them.
    expected("gauge-clean-10Hz", 0.05),
    Expected { covariates: &["fx_n"], ..expected("gauge-bilinear-10Hz", 0.08) },
    Expected {
        covariates: &["fx_n", "fz_n", "opening_mm"],
        ..expected("gauge-openstiff-10Hz", 0.05)
    },
    Expected {
        covariates: &["fx_n", "fz_n", "opening_mm"],
        ..expected("compliance-over-opening", 0.05)
    },
    Expected { setup_error: Some("clock_offset"), ..expected("clock-offset-per-recording", 0.08) },
    Expected {
        base: "polynomial",
        setup_error: Some("clock_offset"),
        effects: &["creep", "clock_skew"],
        ..expected("clocks-370ms-apart", 0.02)
    },
    // The second sensor is mounted turned by 90 degrees, and the other axis is not recorded, or zero.
    Expected { mapping: Some("one-axis-gauge/ma1.toml"), ..ONE_AXIS },
    Expected { mapping: Some("one-axis-gauge/ma2.toml"), ..ONE_AXIS },
];

#[test]
fn what_other_loggers_recorded_is_diagnosed_in_newtons() {
    let Some(root) = tests::case("loggers") else { return };
    CAMPAIGNS.par_iter().for_each(|expected| {
        let dir = WorkDir::empty();
        let folder = root.join(expected.folder);
        let campaign = match expected.mapping {
            None => folder.display().to_string(),
            Some(mapping) => {
                let mapping = root.join(mapping).display().to_string();
                let sources = sources(&folder);
                let mut words = vec!["import", &mapping];
                words.extend(sources.iter().map(String::as_str));
                words.extend(["-o", "campaign"]);
                dir.stdout(&words);
                "campaign".to_owned()
            }
        };
        let base = expected.base;
        dir.stdout(&["fit", &campaign, "--base", base, "-o", "model.toml"]);
        let mut diagnosis = dir.json(&["diagnose", "model.toml", &campaign, "--json"]);
        if let Some(id) = expected.setup_error {
            let who = expected.folder;
            assert_eq!(diagnosis["findings"][0]["id"], id, "{who}");
            assert_eq!(diagnosis["verdicts"], serde_json::json!([]), "{who}");
            dir.stdout(&["fit", &campaign, "--base", base, "--fix", "fixed", "-o", "fixed.toml"]);
            diagnosis = dir.json(&["diagnose", "fixed.toml", "fixed", "--json"]);
        }
        check(expected, &diagnosis);
        for command in diagnosis["next"].as_array().unwrap() {
            let words = shell_words::split(command.as_str().unwrap()).unwrap();
            if words[2] == "add" && !expected.covariates.is_empty() {
                dir.stdout(&words[2..]);
                let better = words.last().unwrap();
                dir.stdout(&["replay", better, &campaign]);
                dir.stdout(&["dev", "export", better, "-o", "tables.rs"]);
            }
        }
    });
}

/// Sources of a logger in a folder: folders or tables, in their order.
fn sources(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<String> = entries
        .filter(|path| path.is_dir() || path.extension().is_some_and(|end| end == "csv"))
        .map(|path| path.display().to_string())
        .collect();
    all.sort();
    all
}

fn check(expected: &Expected, diagnosis: &Value) {
    let who = expected.folder;
    check_names(who, expected.effects, expected.covariates, diagnosis);
    let last = diagnosis["staircase"].as_array().and_then(|steps| steps.last()).unwrap();
    let excess_n = last["force"]["excess_n"].as_f64().unwrap();
    assert!(excess_n <= expected.excess_n, "{who}: {excess_n} N");
}

/// One measurement in eight formats: separators, decimal commas, thousands, quoted numbers, lines before the header, a row of units,
/// another character set, times of day and dates.
#[test]
fn tables_are_read_as_other_programs_write_them() {
    let Some(root) = tests::case("loggers/tables") else { return };
    let tables = ["cp1252", "meta", "mixed", "nounit", "tausend", "uhr", "units_row"];
    tables.par_iter().for_each(|name| {
        let dir = WorkDir::empty();
        let source = root.join(format!("{name}.csv")).display().to_string();
        dir.stdout(&["import", "--guess", &source, "-o", "mapping.toml"]);
        if *name == "nounit" {
            let mapping = dir.read("mapping.toml").replace("\"G\"", "\"uT\"");
            std::fs::write(dir.path("mapping.toml"), mapping).unwrap();
        }
        dir.stdout(&["import", "mapping.toml", &source, "-o", "campaign"]);
        let fit =
            dir.json(&["fit", "campaign", "--base", "polynomial", "--json", "-o", "model.toml"]);
        // The same values give the same error.
        let error_g = fit["held_out_rms_g"].as_f64().unwrap();
        assert!((error_g - 2.455_915).abs() < 1e-5, "{name}: {error_g}");
        assert!(dir.read("model.toml").contains("\nrows = 1500\n"), "{name}");
    });
    let dir = WorkDir::empty();
    let source = root.join("iso-time").display().to_string();
    dir.stdout(&["import", "--guess", &source, "-o", "mapping.toml"]);
    assert!(dir.read("mapping.toml").contains("offset_s = -1777816919.336"));
    dir.stdout(&["import", "mapping.toml", &source, "-o", "campaign"]);
}
