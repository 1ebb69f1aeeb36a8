//! Effects that no catalogue contains: the formula that represents each, the force error with it, and whether the device runs it.

use std::path::Path;

use analysis::progress;
use anyhow::{Context, Result, bail};
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
    let on_device = found.iter().filter(|found| found.runs()).count();
    let reasons = found.iter().filter(|found| found.states_a_reason()).count();
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
            format!("`{}`", found.accepted.join("`, `")),
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
             Specified: the formula runs on the device and has a force error in newtons ({on_device} of {count}, at least {:.0} %), or \
             the reason is stated ({reasons}). The excess falls to at most half or a fifth of the noise in {falls}.",
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
            on_device + reasons == count && on_device as f64 >= MIN_ON_DEVICE * count as f64,
        ),
    })
}

/// What a diagnosis accepts.
struct Found {
    /// Formulas as text, effects of the catalogue by name.
    accepted: Vec<String>,
    before: ForceStep,
    after: Option<ForceStep>,
    /// "yes" or "no", and why, of each.
    device: Vec<String>,
}

impl Found {
    fn runs(&self) -> bool {
        self.after.is_some()
            && !self.device.is_empty()
            && self.device.iter().all(|text| text.starts_with("yes"))
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
    let steps = list(&diagnosis, "staircase");
    let [base, added @ ..] = steps.as_slice() else { bail!("no steps") };
    let mut found = Found {
        accepted: Vec::new(),
        before: ForceStep::of(&base["force"])?,
        after: added.last().and_then(|step| ForceStep::of(&step["force"]).ok()),
        device: Vec::new(),
    };
    let (formulas, verdicts) = (list(&diagnosis, "formulas"), list(&diagnosis, "verdicts"));
    for name in added.iter().filter_map(|step| step["added"][0].as_str()) {
        let device = if let Some(formula) = formulas.iter().find(|of| of["name"] == name) {
            let texts = list(formula, "effects");
            let texts = texts.iter().filter_map(|effect| effect["expression"].as_str());
            found.accepted.push(texts.collect::<Vec<_>>().join("`, `"));
            &formula["device"]
        } else {
            found.accepted.push(name.to_owned());
            verdicts.iter().find(|of| of["effect"] == name).map_or(&Value::Null, |of| &of["device"])
        };
        let answer = match device["runs"].as_bool() {
            Some(true) => "yes",
            Some(false) => "no",
            None => "not stated",
        };
        let detail = device["detail"].as_str().filter(|why| !why.is_empty());
        let detail = detail.map_or_else(String::new, |why| format!(", {why}"));
        found.device.push(format!("{answer}{detail}"));
    }
    Ok(found)
}
