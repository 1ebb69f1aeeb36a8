//! `magpie effects`, `add`, `drop`, and what replay and export make of a model with effects.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use model_export::effects::CATALOGUE;
use serde_json::Value;
use tempfile::TempDir;
use tests::data;

fn magpie(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_magpie")).args(arguments).output().expect("the tool runs")
}

fn json(arguments: &[&str]) -> Value {
    let output = magpie(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn refusal(arguments: &[&str]) -> String {
    let output = magpie(arguments);
    assert!(!output.status.success(), "{arguments:?} was not refused");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// A campaign of the repository with its fitted base.
struct Fitted {
    folder: TempDir,
    campaign: PathBuf,
}

impl Fitted {
    fn of(campaign: PathBuf) -> Self {
        let fitted = Self { folder: TempDir::new().unwrap(), campaign };
        let output = magpie(&["fit", &fitted.campaign(), "-o", &fitted.path("model.toml")]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        fitted
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    fn campaign(&self) -> String {
        self.campaign.display().to_string()
    }

    fn add(&self, more: &[&str]) -> Value {
        let (model, campaign) = (self.path("model.toml"), self.campaign());
        json(&[&["add", &model, &campaign, "--json"], more].concat())
    }
}

fn before_and_after(added: &Value, what: &str) -> (f64, f64) {
    (number(&added["before"][what]), number(&added["after"][what]))
}

/// Held-out error over floor after adding.
fn over_floor(added: &Value) -> f64 {
    number(&added["after"]["held_out_rms_g"]) / number(&added["floor_g"])
}

#[test]
fn added_friction_and_temperature_reach_the_floor() {
    let fitted = Fitted::of(data("friction"));
    let added = fitted.add(&["hysteresis", "magnet_temperature", "-o", &fitted.path("new.toml")]);
    let (before, after) = before_and_after(&added, "held_out_rms_g");
    assert!(before > 3.0 && after < 0.2, "{before} {after}");
    assert!((0.95..=1.1).contains(&over_floor(&added)), "{}", over_floor(&added));
    let (before, after) =
        (number(&added["device"]["before_rmse_n"]), number(&added["device"]["after_rmse_n"]));
    assert!(before > 2.0 && (0.4..0.6).contains(&after), "{before} {after}");
    let effects = added["effects"].as_array().unwrap();
    assert_eq!(effects[1]["unit"], "%/K");
    // What neodymium does: -0.08 to -0.13 % for each kelvin.
    assert!((-0.13..-0.08).contains(&number(&effects[1]["value"])), "{}", effects[1]);
    assert!(effects.iter().all(|effect| effect["plausible"] == true));

    // The replay of the written model says the same, and what the compensation is worth.
    let replayed = json(&["replay", &fitted.path("new.toml"), &fitted.campaign(), "--json"]);
    assert!(number(&replayed["rmse_n"]) < 0.6 && number(&replayed["uncompensated_rmse_n"]) > 2.0);

    // Dropped again, the error is back.
    let dropped = json(&[
        "drop",
        &fitted.path("new.toml"),
        &fitted.campaign(),
        "magnet_temperature",
        "--json",
    ]);
    let (with, without) = before_and_after(&dropped, "held_out_rms_g");
    assert!((with - after_g(&added)).abs() < 1e-9 && without > 1.0, "{with} {without}");
}

fn after_g(added: &Value) -> f64 {
    number(&added["after"]["held_out_rms_g"])
}

#[test]
fn added_neighbour_magnet_reaches_the_floor() {
    let added = Fitted::of(data("demo")).add(&["neighbour_magnet"]);
    assert!((0.95..=1.1).contains(&over_floor(&added)), "{}", over_floor(&added));
    let (before, after) =
        (number(&added["device"]["before_rmse_n"]), number(&added["device"]["after_rmse_n"]));
    assert!(after < 0.95 * before && after < 0.5, "{before} {after}");
}

#[test]
fn user_formula_of_a_ripple_runs_on_the_device() {
    let fitted = Fitted::of(data("ripple"));
    let formula = "ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)";
    let new = fitted.path("new.toml");
    let added = fitted.add(&["--expr", formula, "--range", "p=2..5", "-o", &new]);
    assert!((0.95..=1.1).contains(&over_floor(&added)), "{}", over_floor(&added));
    for sensor in added["effects"][0]["sensors"].as_array().unwrap() {
        // The screw of recording.toml: 3.213 mm to a turn.
        let period = number(&sensor["parameters"]["p"]["value"]);
        assert!((3.21..3.216).contains(&period), "{period}");
    }
    let (before, after) =
        (number(&added["device"]["before_rmse_n"]), number(&added["device"]["after_rmse_n"]));
    assert!(before > 2.0 && after < 0.6, "{before} {after}");
    let tables = fitted.path("tables.rs");
    assert!(magpie(&["export", &new, "-o", &tables]).status.success());
    assert!(
        std::fs::read_to_string(Path::new(&tables))
            .unwrap()
            .contains("covariate: Covariate::Opening")
    );
}

#[test]
fn absent_effect_is_reported_without_gain() {
    let fitted = Fitted::of(data("clean"));
    for effect in
        ["hysteresis", "neighbour_magnet", "magnet_temperature", "clock_skew", "tip_slope"]
    {
        let added = fitted.add(&[effect]);
        let (before, after) = before_and_after(&added, "held_out_rms_g");
        assert!(after > 0.995 * before, "{effect}: {before} {after}");
        let verdict = added["verdict"].as_str().unwrap();
        assert!(verdict.starts_with("Nothing gained") && verdict.contains(effect), "{verdict}");
    }
}

#[test]
fn simulated_effect_is_estimated_within_three_sigma() {
    for (effect, seed) in [("viscous_lag", "5"), ("fingertip_mass", "6"), ("thermal_gap", "7")] {
        let folder = TempDir::new().unwrap();
        let campaign = folder.path().join("campaign");
        let shown = campaign.display().to_string();
        let made = magpie(&[
            "simulate",
            "-o",
            &shown,
            "--effect",
            effect,
            "--seed",
            seed,
            "--sensors",
            "2",
            "--seconds",
            "20",
        ]);
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let truth = std::fs::read_to_string(folder.path().join("campaign-truth.toml")).unwrap();
        let truth: toml::Table = toml::from_str(&truth).unwrap();
        let size = truth["effect"][0]["size"].as_float().unwrap();
        let added = Fitted::of(campaign).add(&[effect]);
        let (value, error) =
            (number(&added["effects"][0]["value"]), number(&added["effects"][0]["std_error"]));
        assert!((value - size).abs() <= 3.0 * error, "{effect}: {value} ± {error}, truth {size}");
        assert!(error < 0.2 * size.abs(), "{effect}: an error bar of {error} says nothing");
        assert!(over_floor(&added) <= 1.1, "{effect}: {}", over_floor(&added));
    }
}

#[test]
fn invalid_effect_is_refused_with_a_reason() {
    let fitted = Fitted::of(data("clean"));
    let (model, campaign) = (fitted.path("model.toml"), fitted.campaign());
    for (more, words) in [
        (&["histeresis"][..], "did you mean hysteresis?"),
        (&[][..], "name an effect"),
        (&["creep", "creep"], "given twice"),
        (&["screw_backlash"], "add neighbour_magnet before"),
        (&["--expr", "r: dz_um = a*sin(opening_mm*b)"], "--range b="),
        (&["--expr", "r: dz_um = a*opening_mm", "--range", "q=1..2"], "no formula has such a name"),
    ] {
        let said = refusal(&[&["add", &model, &campaign], more].concat());
        assert!(said.contains(words), "{more:?}: {said}");
    }
    let said = refusal(&["drop", &model, &campaign, "creep"]);
    assert!(said.contains("it has no effects"), "{said}");
}

#[test]
fn export_refuses_formula_unknown_to_the_board() {
    let fitted = Fitted::of(data("ripple"));
    let new = fitted.path("new.toml");
    fitted.add(&["--expr", "slow: by_g = a*time_s", "-o", &new]);
    let said = refusal(&["export", &new, "-o", &fitted.path("tables.rs")]);
    assert!(said.contains("slow") && said.contains("the board does not know time_s"), "{said}");
}

#[test]
fn every_effect_is_listed_and_documented() {
    let listed = json(&["effects", "--json"]);
    let effects = listed["effects"].as_array().unwrap();
    assert_eq!(effects.len(), CATALOGUE.len());
    for effect in effects {
        let name = effect["effect"].as_str().unwrap();
        let output = magpie(&["effects", name]);
        let text = String::from_utf8(output.stdout).unwrap();
        for words in ["Requires:", "Magnitude:", "To identify it:", "Confused with", "Compensated:"]
        {
            assert!(text.contains(words), "{name}: no {words}");
        }
        assert!(text.lines().all(|line| line.chars().count() <= 130), "{name}");
        assert!(effect["physics"].as_str().unwrap().len() > 200, "{name} is hardly explained");
    }
}
