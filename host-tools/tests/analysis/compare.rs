//! `magpie compare` on recordings with effects that the model does not have.

use std::path::Path;
use std::sync::OnceLock;

use analysis::compare::Comparison;
use analysis::compare::{ErrorUnit, Validation, floor_g, rms_g};
use analysis::comparison::compare;
use analysis::model::Model;
use analysis::notes::Note;
use model_export::fit::FitOptions;
use model_export::recordings::align::Alignment;
use report::text::comparison::conclusion::verdict;
use serde_json::Value;
use tests::campaign_copy::CampaignCopy;
use tests::data;

use crate::workdir::{WorkDir, campaign, fitted_model, text};

fn compared(model: &Path, campaign: &Path) -> Comparison {
    let alignment = Alignment { delay_us: 0.0 };
    compare(&Model::read(model).unwrap(), campaign, None, alignment, FitOptions::default()).unwrap()
}

/// Comparison of the model that is fitted to `clean` or `demo` with one of both; compared once.
fn comparison(model: &str, campaign: &str) -> &'static Comparison {
    static COMPARED: [OnceLock<Comparison>; 4] = [const { OnceLock::new() }; 4];
    let place = |name| ["clean", "demo"].iter().position(|known| *known == name).unwrap();
    COMPARED[2 * place(model) + place(campaign)]
        .get_or_init(|| compared(&fitted_model(model), &data(campaign)))
}

fn chosen(comparison: &Comparison) -> Vec<(String, f64)> {
    let chosen = comparison.located.iter().filter(|located| located.chosen);
    chosen.map(|located| (located.covariate.to_string(), located.share)).collect()
}

#[test]
fn neighbour_magnet_is_attributed_to_the_opening() {
    let comparison = comparison("demo", "demo");
    let (covariate, share) = chosen(comparison).remove(0);
    assert_eq!(covariate, "opening_mm");
    // Of the squared force error above the noise, of which the magnet's field causes a smaller part than of the field's error.
    assert!((0.3..=1.0).contains(&share), "{share}");
    let verdict = verdict(comparison);
    assert!(verdict.starts_with("Structure remains"), "{verdict}");
    assert!(verdict.contains("follows the opening, most of it below"), "{verdict}");
}

#[test]
fn friction_is_attributed_before_a_temperature_that_hardly_changes_the_forces() {
    let comparison = compared(&fitted_model("friction"), &data("friction"));
    let chosen = chosen(&comparison);
    // In gauss the warm magnet dominates, along the gap, on which the forces hardly depend.
    let loading = ["loading_x", "loading_z", "fx_rate_n_per_s", "fz_rate_n_per_s"];
    assert!(loading.contains(&chosen[0].0.as_str()) && chosen[0].1 > 0.4, "{chosen:?}");
    assert_eq!(comparison.located[0].error_unit, ErrorUnit::Newton);
}

#[test]
fn screw_ripple_is_attributed_to_the_rotor_angle() {
    let (covariate, share) = chosen(&compared(&fitted_model("ripple"), &data("ripple"))).remove(0);
    assert_eq!(covariate, "motor_angle_rad");
    assert!(share > 0.8, "{share}");
}

#[test]
fn clean_recordings_reach_the_floor_without_attribution() {
    let comparison = comparison("clean", "clean");
    assert!(comparison.located.len() > 15, "every varying covariate is evaluated");
    for located in &comparison.located {
        assert!(located.share < 0.05 && !located.chosen, "{located:?}");
    }
    assert!(verdict(comparison).starts_with("At the noise floor"), "{}", verdict(comparison));
    let ratio = rms_g(&comparison.axes) / floor_g(&comparison.axes);
    assert!((0.9..1.05).contains(&ratio), "{ratio}");
    // The sensor's 0.35 G over some ten averaged rows, and its word of 0.125 G.
    let floor = comparison.axes[0].floor;
    assert!((0.10..0.12).contains(&floor.white), "{floor:?}");
    assert!((0.009..0.013).contains(&floor.quantisation), "{floor:?}");
    for force in &comparison.forces {
        assert!(force.error.rms < 1.2 * force.floor, "{force:?}");
        assert!(force.error.rms > 0.8 * force.floor, "{force:?}");
    }
}

#[test]
fn confidence_intervals_of_noise_contain_zero() {
    let quantities =
        comparison("clean", "clean").located.iter().filter(|located| located.bins.len() == 12);
    let bands = quantities.flat_map(|l| &l.bins).flat_map(|bin| bin.band.iter().flatten());
    let (mut inside, mut all) = (0, 0);
    for (low, high) in bands {
        all += 1;
        inside += usize::from(*low <= 0.0 && 0.0 <= *high);
    }
    let share = f64::from(inside as u32) / f64::from(all as u32);
    assert!(all > 1000 && (0.85..0.99).contains(&share), "{share} of {all}");
}

#[test]
fn worst_interval_is_at_the_smallest_opening() {
    let comparison = comparison("demo", "demo");
    assert_eq!(comparison.worst.len(), 5);
    assert!(comparison.worst.is_sorted_by(|a, b| a.rms >= b.rms));
    let conditions = &comparison.worst[0].conditions;
    let opening = conditions.iter().find(|condition| condition.label == "opening").unwrap();
    assert!(opening.mean < 10.0, "{:?}", comparison.worst[0]);
}

#[test]
fn edited_model_is_evaluated_unchanged() {
    let dir = WorkDir::with_model("clean");
    let mut toml: toml::Table = dir.read("model.toml").parse().unwrap();
    let sensor = &mut toml["sensor"].as_array_mut().unwrap()[0];
    let bias = &mut sensor["parameters"]["bias_y"]["value"];
    *bias = toml::Value::Float(bias.as_float().unwrap() + 5.0);
    let edited = dir.path("edited.toml");
    std::fs::write(&edited, toml.to_string()).unwrap();
    let comparison = compared(&edited, &data("clean"));
    assert!(matches!(comparison.validation, Some(Validation::Edited(worse)) if worse > 1.0));
    let y = &comparison.axes[1];
    assert!((4.9..5.1).contains(&y.error.mean.abs()), "{y:?}");
}

#[test]
fn model_of_another_gripper_is_noted() {
    let is_noted = |comparison: &Comparison| {
        comparison.notes.iter().any(|note| matches!(note, Note::OtherGripper { .. }))
    };
    let other = WorkDir::empty();
    other.stdout("simulate -o other --seconds 5 --sensors 2 --seed 7");
    assert!(is_noted(&compared(&fitted_model("clean"), &other.path("other"))));
    // All of these are of one gripper, with different effects.
    assert!(!is_noted(comparison("clean", "clean")) && !is_noted(comparison("clean", "demo")));
    for campaign in ["friction", "ripple"] {
        assert!(!is_noted(&compared(&fitted_model("clean"), &data(campaign))), "{campaign}");
    }
}

#[test]
fn json_has_all_documented_keys() {
    let dir = WorkDir::with_model("clean");
    let campaign = campaign("clean");
    let arguments = ["compare", "model.toml", &campaign, "--json", "--baseline", "model.toml"];
    let object = dir.json(&arguments);
    assert_eq!(object["axes"].as_array().unwrap().len(), 12);
    assert_eq!(object["forces"].as_array().unwrap().len(), 8);
    let axis = &object["axes"][0];
    assert_eq!((axis["sensor"].as_u64(), axis["axis"].as_str()), (Some(0), Some("x")));
    for key in ["rms_g", "mean_g", "std_g", "p95_g", "max_g", "floor_g", "explainable_g"] {
        assert!(axis[key].is_f64(), "{key}");
    }
    for key in ["rmse_n", "mean_n", "std_n", "p95_n", "max_n", "explainable_n"] {
        assert!(object["forces"][0][key].is_f64(), "{key}");
    }
    assert_eq!(object["findings"], Value::Array(Vec::new()));
    assert_eq!(object["with"]["axes"], object["axes"], "equal models have equal figures");
    assert!(object["where"][0]["bins"].as_array().unwrap().len() > 1);
}

#[test]
fn piped_output_is_narrow_and_without_colour() {
    let dir = WorkDir::with_model("demo");
    let page = text(&dir.run(&["compare", "model.toml", &campaign("demo")]).stdout);
    assert!(!page.contains('\u{1b}'));
    for line in page.lines() {
        assert!(line.chars().count() <= 100, "{line}");
    }
    assert!(page.contains("Structure remains"));
}

#[test]
fn setup_error_stops_the_comparison_until_fixed() {
    let dir = WorkDir::with_model("clean");
    let spoilt = CampaignCopy::new().change(&[1, 2, 3], "hall.csv", |cells| {
        cells.exchange("s1_x_lsb", "s1_z_lsb");
    });
    let shown = spoilt.path().display().to_string();
    let arguments = ["compare", "model.toml", &shown, "--json", "--fix", "corrected"];
    let output = dir.run(&[&arguments[..], &["-o", "page.html"]].concat());
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    let first = &object["findings"][0];
    assert_eq!(first["id"], "axis_permuted");
    assert_eq!(first["column"], "s1_x_lsb");
    assert_eq!(object["axes"], Value::Array(Vec::new()));
    assert!(object["verdict"].as_str().unwrap().starts_with("Not compared"));
    assert!(dir.read("page.html").contains("s1_x_lsb is recorded as"));
    let comparison = compared(&dir.path("model.toml"), &dir.path("corrected"));
    assert!(comparison.findings.is_empty(), "{:?}", comparison.findings);
    assert!(verdict(&comparison).starts_with("At the noise floor"), "{}", verdict(&comparison));
}

#[test]
fn constant_offset_is_not_attributed_to_a_covariate() {
    let comparison = comparison("demo", "clean");
    // The model's own parameters, not refitted.
    assert_eq!(comparison.validation, Some(Validation::UnseenRecordings));
    let (covariate, share) = chosen(comparison).remove(0);
    assert_eq!(covariate, "constant");
    // Two grippers of one design: their forces at rest differ by more than what follows any covariate.
    assert!(share > 0.4, "{share}");
    let verdict = verdict(comparison);
    assert!(verdict.starts_with("Structure remains") && verdict.contains("another gripper"));
}

/// A length of zero in a friction, and an offset beyond the range of the sensor.
#[test]
fn models_without_a_number_or_an_estimate_are_named() {
    let Some(folder) = tests::case("hostile") else { return };
    let (dir, recordings) = (WorkDir::empty(), campaign("clean"));
    let model = |name: &str| folder.join(name).display().to_string();
    let refused = dir.failure(&["compare", &model("model-nan.toml"), &recordings]);
    assert!(refused.contains("no number for the field of sensor 1 along x"), "{refused}");
    assert!(refused.contains("(hysteresis, own)"), "{refused}");
    let replayed = dir.run(&["replay", &model("model-dead-sensor.toml"), &recordings]);
    let notes = String::from_utf8_lossy(&replayed.stderr);
    assert!(notes.contains("no estimate of sensor 0 is valid"), "{notes}");
    assert!(!String::from_utf8_lossy(&replayed.stdout).contains("NaN"));
}
