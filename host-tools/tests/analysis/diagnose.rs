//! `magpie diagnose` on the repository's campaigns, with and without an effect.

use analysis::diagnose::recording_check::check_recordings;
use model_export::fit::FitOptions;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use serde_json::Value;
use tests::data;

use crate::workdir::{WorkDir, campaign, diagnosis, text};

fn names(step: &Value) -> Vec<&str> {
    step.as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect()
}

fn verdict<'a>(diagnosis: &'a Value, effect: &str) -> &'a Value {
    let verdicts = diagnosis["verdicts"].as_array().unwrap();
    verdicts.iter().find(|verdict| verdict["effect"] == effect).unwrap()
}

/// Held-out error on each step, in floors.
fn staircase(diagnosis: &Value) -> Vec<f64> {
    let number = |value: &Value| value.as_f64().unwrap();
    let stairs = diagnosis["staircase"].as_array().unwrap().iter();
    stairs.map(|stair| number(&stair["held_out_rms_g"]) / number(&stair["floor_g"])).collect()
}

#[test]
fn report_contains_diagnosis_and_comparison() {
    let (dir, campaign) = (WorkDir::with_model("demo"), campaign("demo"));
    let stdout = dir.stdout(&["diagnose", "model.toml", &campaign, "-o", "report.html"]);
    let next = format!("cargo magpie add model.toml {campaign} neighbour_magnet -o ");
    assert!(text(&stdout).contains(&next), "{}", text(&stdout));
    let text = dir.read("report.html");
    assert!(text.starts_with("<!-- report of magpie -->"));
    for part in [
        "<section id=\"diagnosis\">",
        "<section id=\"staircase\">",
        "what neighbour_magnet took away",
        "over the opening",
        "<section id=\"overlay\"",
        // Forces in the data of the curves over time.
        "\"kind\":\"force\"",
    ] {
        assert!(text.contains(part), "{part}");
    }
}

#[test]
fn clean_recordings_give_no_effect() {
    let diagnosis = diagnosis("clean");
    assert_eq!(diagnosis["accepted"], Value::Array(Vec::new()), "{}", diagnosis["verdict"]);
    assert_eq!(diagnosis["at_floor"], true);
    assert_eq!(diagnosis["unexplained"], Value::Array(Vec::new()));
    // Testable here: a neighbour magnet of typical magnitude would be detected.
    assert_eq!(verdict(diagnosis, "neighbour_magnet")["verdict"], "absent");
}

#[test]
fn similarity_of_effects_is_that_of_their_patterns() {
    let share = |one: &str, other: &str| {
        let all = verdict(diagnosis("clean"), one)["reproduces"].as_array().unwrap().iter();
        let own = all.clone().find(|own| own["effect"] == other);
        own.unwrap_or_else(|| panic!("{one}: no {other}"))["share"].as_f64().unwrap()
    };
    // A filter of the reference and a skew of the clocks have the same derivative to first order; a lag of its own on each axis
    // contains both.
    assert!(share("clock_skew", "reference_filter") > 0.99);
    assert!(share("viscous_lag", "clock_skew") > 0.8);
    assert!(share("clock_skew", "viscous_lag") < share("viscous_lag", "clock_skew"));
    // The load and the opening vary independently.
    assert!(share("neighbour_magnet", "hysteresis") < 0.1);
    assert!(share("softening", "cross_coupling") < 0.1);
}

#[test]
fn check_of_recordings_agrees_with_their_diagnosis() {
    let campaign = Campaign::read(&data("clean"), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let check = check_recordings(&campaign, FitOptions::default());
    let expected = |kind: &str| {
        let verdicts = diagnosis("clean")["verdicts"].as_array().unwrap().iter();
        let verdicts = verdicts.filter(|verdict| verdict["verdict"] == kind);
        let pair = |verdict: &Value| {
            (verdict["effect"].as_str().unwrap().to_owned(), verdict["z_typical"].as_f64().unwrap())
        };
        let mut pairs: Vec<(String, f64)> = verdicts.map(pair).collect();
        pairs.sort_by(|a, b| a.0.cmp(&b.0));
        pairs
    };
    let mut decidable = check.decidable.clone();
    decidable.sort_by(|a, b| a.0.cmp(&b.0));
    assert!(!decidable.is_empty());
    assert_eq!(decidable, expected("absent"));
    let inconclusive = check.inconclusive.iter().map(|v| (v.effect.clone(), v.z_typical));
    let mut inconclusive: Vec<(String, f64)> = inconclusive.collect();
    inconclusive.sort_by(|a, b| a.0.cmp(&b.0));
    assert!(!inconclusive.is_empty());
    assert_eq!(inconclusive, expected("not_judgeable"));
}

#[test]
fn neighbour_magnet_is_found() {
    let diagnosis = diagnosis("demo");
    let accepted = diagnosis["accepted"].as_array().unwrap();
    assert_eq!(names(&accepted[0]), ["neighbour_magnet"], "{}", diagnosis["verdict"]);
    let found = verdict(diagnosis, "neighbour_magnet");
    assert_eq!(found["verdict"], "found");
    // As `add` fits it: 2.88 G at an opening of 10 mm.
    let value = found["value"].as_f64().unwrap();
    assert!((2.7..3.1).contains(&value), "{value}");
    let stairs = staircase(diagnosis);
    assert!(stairs[0] > 5.0 && *stairs.last().unwrap() < 1.15, "{stairs:?}");
}

#[test]
fn friction_and_magnet_temperature_are_both_found() {
    let diagnosis = diagnosis("friction");
    let accepted = diagnosis["accepted"].as_array().unwrap();
    let all: Vec<Vec<&str>> = accepted.iter().map(names).collect();
    assert!(all.contains(&vec!["hysteresis"]), "{all:?}");
    assert!(all.iter().any(|step| step.contains(&"magnet_temperature")), "{all:?}");
    assert_eq!(all.len(), 2, "{all:?}");
    assert!(*staircase(diagnosis).last().unwrap() < 1.15);
}

#[test]
fn formula_is_found_where_no_effect_of_the_catalogue_explains_the_residual() {
    let (dir, campaign) = (WorkDir::with_model("ripple"), campaign("ripple"));
    let diagnosis = diagnosis("ripple");
    assert_eq!(diagnosis["accepted"], Value::Array(Vec::new()), "{}", diagnosis["verdict"]);
    assert_eq!(diagnosis["at_floor"], true);
    assert_eq!(diagnosis["unexplained"], Value::Array(Vec::new()));
    let formula = &diagnosis["formulas"][0];
    // The hidden effect is a displacement along z, periodic in the pitch of the screw: one turn of the rotor.
    assert_eq!(formula["covariates"], serde_json::json!(["motor_angle_rad"]), "{formula}");
    assert_eq!(formula["targets"], serde_json::json!(["dz_um"]), "{formula}");
    assert_eq!(formula["partial"], false);
    let runs = serde_json::json!([true, "while the rotor sensor works"]);
    assert_eq!(serde_json::json!([formula["device"]["runs"], formula["device"]["detail"]]), runs);
    assert!(formula["p_value"].as_f64().unwrap() < 0.01, "{formula}");
    let stairs = staircase(diagnosis);
    assert!(stairs[0] > 2.0 && *stairs.last().unwrap() < 1.15, "{stairs:?}");
    // The proposed command does what it states.
    let expression = formula["effects"][0]["expression"].as_str().unwrap();
    let next = diagnosis["next"][0].as_str().unwrap();
    assert!(next.contains(&format!(" --expr '{expression}' -o ")), "{next}");
    dir.stdout(&["add", "model.toml", &campaign, "--expr", expression, "-o", "better.toml"]);
    let after = dir.json(&["diagnose", "better.toml", &campaign, "--json"]);
    assert_eq!((&after["at_floor"], &after["formulas"]), (&true.into(), &serde_json::json!([])));
}

#[test]
fn user_formula_is_found_like_any_effect() {
    let formula = "ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)";
    let campaign = campaign("ripple");
    let arguments = ["diagnose", "model.toml", &campaign, "--json", "--range", "p=2..5"];
    let diagnosis =
        WorkDir::with_model("ripple").json(&[&arguments[..], &["--expr", formula]].concat());
    let accepted = diagnosis["accepted"].as_array().unwrap();
    assert_eq!(names(&accepted[0]), ["ripple"], "{}", diagnosis["verdict"]);
    assert!(*staircase(&diagnosis).last().unwrap() < 1.15);
}
