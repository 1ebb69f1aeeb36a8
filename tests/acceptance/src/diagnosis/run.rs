//! One case: simulate, fit and diagnose by commands of `magpie`.

use std::path::Path;

use anyhow::{Context, Result};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::score_test::ScoreTest;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use serde_json::Value;
use sim::effects::find_kind;
use tempfile::TempDir;

use super::cases::{Case, Expected};
use super::evaluate::{Evaluation, PredictedCounts, evaluate};
use crate::magpie;

/// Block length for a known change; the result does not depend on it.
const BLOCK_S: f64 = 5.0;

/// Result of a case.
pub struct Outcome {
    /// Comparison of the diagnosis with the simulated effects.
    pub evaluation: Evaluation,
    /// Magnitude of the simulated effects in standard errors; NaN without effects.
    pub z: f64,
    /// Noise of the campaign.
    pub noise: &'static str,
    /// Least adjusted p-value of an effect.
    pub least_p: f64,
    /// Accepted effects.
    accepted: String,
    /// Held-out error relative to the noise floor, before and after.
    floors: (f64, f64),
}

impl Outcome {
    /// One line of the log.
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

pub fn run(case: &Case) -> Result<Outcome> {
    let folder = TempDir::new()?;
    let campaign = folder.path().join("campaign");
    let model = folder.path().join("model.toml");
    simulate(case, true, None, &campaign)?;
    // All cores are busy with campaigns.
    magpie::run(&["fit".as_ref(), &*campaign, "-o".as_ref(), &*model], Some(1))?;
    let (output, predicted) = match case.expected {
        Expected::PredictedDecisions => with_plan(case, folder.path(), &campaign, &model)?,
        _ => (magpie::json(&["diagnose".as_ref(), &*model, &*campaign], Some(1))?, None),
    };
    let z = match (&case.expected, case.hidden.is_empty()) {
        (Expected::Names, false) => {
            let clean = folder.path().join("clean");
            simulate(case, false, None, &clean)?;
            effect_size(&clean, &campaign)?
        }
        _ => f64::NAN,
    };
    let floors = |stair: Option<&Value>| {
        let number = |name: &str| stair.and_then(|s| s[name].as_f64()).unwrap_or(f64::NAN);
        number("held_out_rms_g") / number("floor_g")
    };
    let stairs = output["staircase"].as_array();
    Ok(Outcome {
        evaluation: Evaluation { predicted, ..evaluate(case, &output) },
        z,
        noise: case.noise,
        least_p: least_p(&output),
        accepted: output["accepted"].to_string(),
        floors: (floors(stairs.and_then(|s| s.first())), floors(stairs.and_then(|s| s.last()))),
    })
}

/// Least adjusted p-value of an effect; 1 where none was tested.
fn least_p(output: &Value) -> f64 {
    let verdicts = output["verdicts"].as_array().into_iter().flatten();
    verdicts.filter_map(|verdict| verdict["p_adjusted"].as_f64()).fold(1.0, f64::min)
}

/// Diagnosis of the recordings together with the one that a first diagnosis proposes; the first one where it proposes none.
fn with_plan(
    case: &Case,
    folder: &Path,
    campaign: &Path,
    model: &Path,
) -> Result<(Value, Option<PredictedCounts>)> {
    let plan = folder.join("plan.toml");
    let first =
        magpie::json(&["diagnose".as_ref(), model, campaign, "--plan".as_ref(), &*plan], Some(1))?;
    if !plan.exists() {
        let counts = PredictedCounts::new(case, &first, &first);
        return Ok((first, Some(counts)));
    }
    let (longer, again) = (folder.join("longer"), folder.join("again.toml"));
    simulate(case, true, Some(&plan), &longer)?;
    magpie::run(&["fit".as_ref(), &*longer, "-o".as_ref(), &*again], Some(1))?;
    let second = magpie::json(&["diagnose".as_ref(), &*again, &*longer], Some(1))?;
    let counts = PredictedCounts::new(case, &first, &second);
    Ok((second, Some(counts)))
}

fn simulate(case: &Case, hidden: bool, plan: Option<&Path>, to: &Path) -> Result<()> {
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
    if let Some(plan) = plan {
        arguments.extend([Path::new("--plan"), plan]);
    }
    magpie::run(&arguments, Some(1)).map(drop)
}

/// Difference of the fields of two campaigns without the part that a fit absorbs, in standard errors.
fn effect_size(clean: &Path, hidden: &Path) -> Result<f64> {
    let read = |folder: &Path| {
        let campaign = Campaign::read(folder, Alignment { delay_us: 0.0 }, |_| ())?;
        FitSetup::cylinder(&campaign).context("no forces or no design")
    };
    let (clean, hidden) = (read(clean)?, read(hidden)?);
    let fit = clean.fit(&[], clean.split(&[]), FitOptions::default(), |_| ())?;
    let test = ScoreTest::new(&clean, &[], &fit, BLOCK_S);
    Ok(test.change_significance(|sensor, part, row| {
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
    }))
}
