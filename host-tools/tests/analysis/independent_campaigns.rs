//! Campaigns of a simulator that has no code in common with this project, in which an effect was named that was not there, or was
//! not named. They are read in place.

use rayon::prelude::*;
use serde_json::Value;

use crate::workdir::WorkDir;

/// What a diagnosis of a campaign must accept.
struct Expected {
    campaign: &'static str,
    base: &'static str,
    /// One effect of each step, in any order.
    effects: &'static [&'static str],
    /// Columns of the formulas.
    covariates: &'static [&'static str],
}

const fn expected(
    campaign: &'static str,
    effects: &'static [&'static str],
    covariates: &'static [&'static str],
) -> Expected {
    Expected { campaign, base: "cylinder", effects, covariates }
}

const CAMPAIGNS: [Expected; 18] = [
    // Both flexures soften with the temperature: a drift of the sensor of 5 G/K fits, and is ten times too large.
    expected("softer-when-warm", &[], &["fx_n", "temp_c", "fz_n"]),
    // A dead zone: a hard stop stayed in the model next to the formula that explains everything.
    expected("dead-zone", &[], &["fx_n"]),
    // Tiny: below what any effect of the catalogue can be.
    expected("tiny-planar", &[], &[]),
    Expected { base: "polynomial", ..expected("negative-hard-stop", &[], &[]) },
    // Faults of the recorder, no effect.
    expected("spikes-100Hz", &[], &[]),
    expected("stuck-samples", &[], &[]),
    // Neither of two effects lowers the error in every fold alone.
    expected(
        "names-after-strong",
        &["clock_skew", "magnet_temperature", "fingertip_mass", "earth_field"],
        &[],
    ),
    expected("plan-two-effects", &["neighbour_magnet", "earth_field"], &[]),
    // The load's motion and the reference's clock are no noise of the field.
    expected("effect-under-rough", &[], &["motor_iq_a"]),
    expected("effect-under-jitter", &[], &["motor_iq_a"]),
    // Two formulas with nonlinear parameters; a formula that leaves coloured noise.
    expected("two-formulas-p", &[], &["fz_n"]),
    expected("right-formula-no-add", &[], &["opening_mm", "roll_rad"]),
    // One gain: the gains of the other axes imitate a tilt of the magnet. A further formula changes the forces by less than 1 %.
    expected("three-gains", &[], &["fz_n"]),
    expected("three-gains-30s", &[], &["fz_n"]),
    // A shock within a recording: a drift of the field had 17 G.
    expected("step-of-remanence", &["demagnetisation"], &[]),
    // A gap that swells by 3 um.
    expected("swollen-gap", &["demagnetisation"], &[]),
    // Creep of 3 % and 7 s under loads that reverse each second: less creep with less time, or a friction, lowers the error of two
    // recordings of three.
    expected("creep-size", &[], &[]),
    // A ripple of the opening in the second recording only.
    expected("one-recording-only", &[], &[]),
];

/// Drifts that explain the same as the effect of a campaign.
const DRIFTS: [(&str, &[&str]); 2] =
    [("step-of-remanence", &[]), ("swollen-gap", &["a drift of dy_um", "the place of the magnet"])];

/// Coefficient of the planar Hall effect in these campaigns, in percent per newton (sensor 0).
const PLANAR_HALL: f64 = 0.0141;

#[test]
fn effects_and_formulas_of_another_simulator_are_named() {
    CAMPAIGNS.par_iter().for_each(|expected| {
        let Some(folder) = tests::case(&format!("simulated/{}", expected.campaign)) else { return };
        let (dir, folder) = (WorkDir::empty(), folder.display().to_string());
        dir.stdout(&["fit", &folder, "--base", expected.base, "-o", "model.toml"]);
        let diagnosis = dir.json(&["diagnose", "model.toml", &folder, "--json"]);
        check(expected, &diagnosis);
        // What is suggested runs.
        for command in diagnosis["next"].as_array().unwrap() {
            let words = shell_words::split(command.as_str().unwrap()).unwrap();
            if words[2] == "add" {
                dir.stdout(&words[2..]);
            }
        }
    });
}

fn list(of: &Value) -> Vec<Value> {
    of.as_array().cloned().unwrap_or_default()
}

/// Checks the accepted steps of a diagnosis, one effect of each in any order, and the columns of its formulas.
pub fn check_names(who: &str, effects: &[&str], covariates: &[&str], diagnosis: &Value) {
    let steps = list(&diagnosis["accepted"]);
    assert_eq!(steps.len(), effects.len(), "{who}: {steps:?}");
    for effect in effects {
        let names = |step: &Value| list(step).iter().any(|name| name == effect);
        assert!(steps.iter().any(names), "{who}: {effect}, {steps:?}");
    }
    let found: Vec<Value> =
        list(&diagnosis["formulas"]).iter().flat_map(|of| list(&of["covariates"])).collect();
    let is_expected = |column: &Value| covariates.iter().any(|name| column == name);
    assert!(found.iter().all(is_expected), "{who}: {found:?}");
    for column in covariates {
        assert!(found.iter().any(|own| own == column), "{who}: {column}, {found:?}");
    }
}

fn check(expected: &Expected, diagnosis: &Value) {
    let who = expected.campaign;
    check_names(who, expected.effects, expected.covariates, diagnosis);
    let formulas = list(&diagnosis["formulas"]);
    if who.starts_with("three-gains") {
        let effects: Vec<Value> = formulas.iter().flat_map(|of| list(&of["effects"])).collect();
        let [gain] = effects.as_slice() else { panic!("{who}: {effects:?}") };
        assert_eq!(gain["expression"], "formula_1: gain_x_percent = a*fz_n", "{who}");
        let a = &gain["sensor"][0]["parameters"]["a"];
        // The gain follows Bz, which is not quite linear in the force.
        assert!((a["value"].as_f64().unwrap() / PLANAR_HALL - 1.0).abs() < 0.03, "{who}: {a}");
    }
    for (_, drifts) in DRIFTS.iter().filter(|(campaign, _)| *campaign == who) {
        let verdicts = list(&diagnosis["verdicts"]);
        let own = verdicts.iter().find(|verdict| verdict["effect"] == expected.effects[0]).unwrap();
        assert_eq!(own["tied_with"], serde_json::json!(drifts), "{who}");
    }
    let suggests_add = list(&diagnosis["next"])
        .iter()
        .any(|command| command.as_str().is_some_and(|text| text.contains(" add ")));
    assert!(formulas.is_empty() || suggests_add, "{who}: {}", diagnosis["next"]);
}
