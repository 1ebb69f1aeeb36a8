//! Effects that no catalogue contains: the formula that represents each, the force error with it, and whether the device runs it.

use std::path::Path;

use analysis::progress;
use anyhow::{Context, Result, anyhow};
use rayon::prelude::*;
use serde_json::Value;

use crate::diagnosis::cases::formulas;
use crate::force::{ForceStep, simulate};
use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 2, quick: 1 };
/// Least share of the formulas that run on the device.
const MIN_ON_DEVICE: f64 = 20.0 / 24.0;

/// Find the formula of each effect outside the catalogue, and compute forces with it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance formulas guide_ripple cable_pull")]
pub struct Args {
    /// Effects outside the catalogue [default: all that recorded columns can represent].
    #[arg(value_name = "EFFECTS")]
    effects: Vec<String>,
}

/// Runs all cases.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let effects: Vec<&str> = match args.effects.as_slice() {
        [] => formulas().map(|kind| kind.id).collect(),
        given => given.iter().map(String::as_str).collect(),
    };
    let cases: Vec<(&str, u64)> =
        effects.iter().flat_map(|effect| seeds.clone().map(|seed| (*effect, seed))).collect();
    let folder = tempfile::tempdir()?;
    let bar = progress::progress_bar("effects outside the catalogue", cases.len());
    let of_case = |(place, (effect, seed)): (usize, &(&str, u64))| {
        let found = find(&folder.path().join(place.to_string()), effect, *seed)
            .with_context(|| format!("{effect}, seed {seed}"));
        bar.inc(1);
        found
    };
    let found: Vec<Found> = cases.par_iter().enumerate().map(of_case).collect::<Result<_>>()?;
    bar.finish_and_clear();
    let has_forces = found.iter().filter(|found| found.after.is_some()).count();
    let on_device = found.iter().filter(|found| found.runs()).count();
    let stated = found.iter().filter(|found| found.runs() || found.states_a_reason()).count();
    let is_fall = |found: &&Found| found.after.as_ref().is_some_and(|of| of.is_fall(&found.before));
    let falls = found.iter().filter(is_fall).count();
    let count = found.len();
    let rows = cases.iter().zip(&found).map(|((effect, seed), found)| {
        let newtons = |of: fn(&ForceStep) -> f64| {
            found.after.as_ref().map_or_else(|| "-".to_owned(), |after| format!("{:.3}", of(after)))
        };
        [
            (*effect).to_owned(),
            seed.to_string(),
            format!("`{}`", found.formulas.join("`, `")),
            format!("{:.3}", found.before.excess_n),
            newtons(|after| after.excess_n),
            newtons(|after| after.noise_n),
            found.device.join("; "),
            if is_fall(&found) { "" } else { "NO FALL" }.to_owned(),
        ]
    });
    Ok(Section {
        id: "formulas",
        title: "Formulas of effects outside the catalogue",
        extent: format!("{count} grippers, {}, three recordings of 30 s each", seeds_text(&seeds)),
        conditions: format!(
            "Simulated grippers of two sensors with manufacturing tolerances and one effect that no catalogue contains. `fit`, then \
             `diagnose`: the formula or the effects that it accepts, and the held-out force error through the device's code. \
             Specified: a force error in newtons ({has_forces} of {count}); the formula runs on the device or the reason is stated \
             ({stated}), and at least {:.0} % run ({on_device}). The excess falls to at most half or a fifth of the noise in {falls}.",
            100.0 * MIN_ON_DEVICE
        ),
        tables: markdown_table(
            [
                "effect",
                "seed",
                "accepted",
                "excess before, N",
                "excess after, N",
                "noise, N",
                "runs on the device",
                "",
            ],
            rows,
        ),
        is_met: Some(
            has_forces == count
                && stated == count
                && on_device as f64 >= MIN_ON_DEVICE * count as f64,
        ),
    })
}

/// What a diagnosis accepts.
struct Found {
    /// Formulas as text, effects of the catalogue by name.
    formulas: Vec<String>,
    before: ForceStep,
    after: Option<ForceStep>,
    /// "yes" or "no", and why, of each.
    device: Vec<String>,
}

impl Found {
    fn runs(&self) -> bool {
        !self.device.is_empty() && self.device.iter().all(|text| text.starts_with("yes"))
    }

    fn states_a_reason(&self) -> bool {
        self.device.iter().any(|text| text.starts_with("no, "))
    }
}

fn find(campaign: &Path, effect: &str, seed: u64) -> Result<Found> {
    simulate(campaign, &[effect], seed)?;
    let model = campaign.with_extension("model.toml");
    magpie::run(&["fit".as_ref(), campaign, "-o".as_ref(), &model], Some(1))?;
    let diagnosis = magpie::json(&["diagnose".as_ref(), &*model, campaign], Some(1))?;
    let list = |of: &Value, key: &str| of[key].as_array().cloned().unwrap_or_default();
    let accepted: Vec<String> = list(&diagnosis, "accepted")
        .iter()
        .filter_map(|step| Some(step[0].as_str()?.to_owned()))
        .collect();
    let effects: Vec<Value> =
        list(&diagnosis, "formulas").iter().flat_map(|formula| list(formula, "effects")).collect();
    let text = |name: &String| {
        let formula = effects.iter().find(|effect| effect["name"] == name.as_str());
        let text = formula.and_then(|effect| effect["expression"].as_str());
        text.unwrap_or(name).to_owned()
    };
    let supports = list(&diagnosis, "device");
    let device = |name: &String| {
        let of = supports.iter().find(|of| of["effect"] == name.as_str())?;
        let answer = if of["runs"].as_bool()? { "yes" } else { "no" };
        Some(of["detail"].as_str().map_or(answer.to_owned(), |why| format!("{answer}, {why}")))
    };
    let steps = list(&diagnosis, "staircase");
    let first = steps.first().ok_or_else(|| anyhow!("no steps"))?;
    let last = steps.last().filter(|_| !accepted.is_empty());
    Ok(Found {
        formulas: accepted.iter().map(text).collect(),
        before: ForceStep::of(&first["force"])?,
        after: last.and_then(|step| ForceStep::of(&step["force"]).ok()),
        device: accepted.iter().filter_map(device).collect(),
    })
}
