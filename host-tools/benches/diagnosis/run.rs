//! One case: simulate, fit, diagnose, by the tool's own commands.

use std::path::Path;
use std::process::Command;

use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::score_test::ScoreTest;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use serde_json::Value;
use sim::effects::find_kind;
use tempfile::TempDir;

use super::cases::{Case, Expected};
use super::evaluate::{Evaluation, evaluate};

/// Block length for a known change; the result does not depend on it.
const BLOCK_S: f64 = 5.0;

/// What came of a case.
pub struct Outcome {
    /// What was output, held against what was hidden.
    pub evaluation: Evaluation,
    /// Magnitude of the simulated effects in standard errors; NaN without effects.
    pub z: f64,
    /// What was accepted.
    accepted: String,
    /// Held-out error in floors, before and after.
    floors: (f64, f64),
}

impl Outcome {
    /// One line.
    pub fn line(&self, case: &Case) -> String {
        let hidden: Vec<String> =
            case.hidden.iter().map(|(id, by)| format!("{id} x {by}")).collect();
        format!(
            "{:<12} {} [{} {} seed {}] z {:.0}: {} ({:.2} -> {:.2} floors)",
            self.evaluation.word(),
            hidden.join(" + "),
            case.programme,
            case.noise,
            case.seed,
            self.z,
            self.accepted,
            self.floors.0,
            self.floors.1,
        )
    }
}

/// Runs a case.
pub fn run(case: &Case) -> Outcome {
    let folder = TempDir::new().expect("a folder for the campaign");
    let campaign = folder.path().join("campaign");
    let model = folder.path().join("model.toml");
    simulate(case, true, &campaign);
    magpie(&["fit".as_ref(), &campaign, "-o".as_ref(), &model]);
    let output = magpie(&["diagnose".as_ref(), &model, &campaign, "--json".as_ref()]);
    let output: Value = serde_json::from_slice(&output).expect("one JSON object");
    let z = match (&case.expected, case.hidden.is_empty()) {
        (Expected::Names, false) => {
            let clean = folder.path().join("clean");
            simulate(case, false, &clean);
            effect_size(&clean, &campaign)
        }
        _ => f64::NAN,
    };
    let floors = |stair: Option<&Value>| {
        let number = |name: &str| stair.and_then(|s| s[name].as_f64()).unwrap_or(f64::NAN);
        number("held_out_rms_g") / number("floor_g")
    };
    let stairs = output["staircase"].as_array();
    Outcome {
        evaluation: evaluate(case, &output),
        z,
        accepted: output["accepted"].to_string(),
        floors: (floors(stairs.and_then(|s| s.first())), floors(stairs.and_then(|s| s.last()))),
    }
}

fn simulate(case: &Case, hidden: bool, to: &Path) {
    let seed = case.seed.to_string();
    let mut arguments = vec!["simulate", "--programme", case.programme, "--noise", case.noise];
    arguments.extend(["--seed", &seed, "-o"]);
    let mut arguments: Vec<&Path> = arguments.into_iter().map(Path::new).collect();
    arguments.push(to);
    let effects: Vec<String> = case
        .hidden
        .iter()
        .map(|(id, factor)| {
            let typical = find_kind(id).map_or(0.0, |kind| kind.typical);
            format!("{id}={}", typical * factor)
        })
        .collect();
    for effect in effects.iter().filter(|_| hidden) {
        arguments.extend([Path::new("--effect"), Path::new(effect)]);
    }
    magpie(&arguments);
}

fn magpie(arguments: &[&Path]) -> Vec<u8> {
    let output = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(arguments)
        // The bench keeps every core busy itself.
        .env("RAYON_NUM_THREADS", "1")
        .output()
        .expect("the tool runs");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {message}");
    output.stdout
}

/// Difference of the fields of two campaigns, after the part that a fit absorbs, in standard errors.
fn effect_size(clean: &Path, hidden: &Path) -> f64 {
    let read = |folder: &Path| {
        let campaign =
            Campaign::read(folder, Alignment { delay_us: 0.0 }, |_| ()).expect("a campaign");
        FitSetup::cylinder(&campaign).expect("forces and a design")
    };
    let (clean, hidden) = (read(clean), read(hidden));
    let fit = clean.fit(&[], clean.split(&[]), FitOptions::default(), |_| ()).expect("a fit");
    let around = ScoreTest::new(&clean, &[], &fit, BLOCK_S);
    around.change_significance(|sensor, part, row| {
        let at = |of: &FitSetup| {
            let part = &of.rows[sensor].parts[part];
            Some((*part.field_g.get(row)?, *part.track.force_n.get(row)?))
        };
        match (at(&hidden), at(&clean)) {
            (Some((field, force)), Some((clean, without))) => {
                (field - clean, [0, 1].map(|axis| force[axis] - without[axis]))
            }
            _ => (nalgebra::Vector3::zeros(), [0.0; 2]),
        }
    })
}
