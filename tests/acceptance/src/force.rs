//! The force error before and after an effect is added, over all effects of the catalogue; and what the workbench predicts of it.

use std::path::Path;

use analysis::compare::ForceError;
use analysis::progress;
use analysis::workbench::Workbench;
use anyhow::{Context, Result, anyhow, bail};
use model_export::effects::{CATALOGUE, EffectTerm, find};
use model_export::fit::FitOptions;
use model_export::recordings::align::Alignment;
use rayon::prelude::*;
use serde_json::Value;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 3, quick: 1 };
/// Sensors of a simulated gripper.
const SENSORS: &str = "2";
/// Largest ratio of the excess after adding an effect to that before, and largest median of all.
const MAX_RATIO: f64 = 0.5;
const MAX_MEDIAN: f64 = 0.15;
/// Excess in multiples of the noise below which a ratio says nothing.
const SMALL_EXCESS: f64 = 0.2;
/// Pairs of effects.
const PAIRS: [[&str; 2]; 10] = [
    ["neighbour_magnet", "magnet_temperature"],
    ["hysteresis", "cross_coupling"],
    ["clock_skew", "softening"],
    ["reference_drift", "magnet_temperature"],
    ["demagnetisation", "motor_leakage"],
    ["field_drift", "neighbour_magnet"],
    ["creep", "reference_drift"],
    ["external_magnet", "cross_coupling"],
    ["softening", "earth_field"],
    ["reference_filter", "hysteresis"],
];
/// Hidden effects of the campaigns of the predictions.
const PREDICTED: [&[&str]; 5] = [
    &[],
    &["hysteresis"],
    &["magnet_temperature"],
    &["neighbour_magnet", "clock_skew"],
    &["softening"],
];
/// Largest error of a prediction relative to the force error's excess, or in multiples of the noise, and the least share of
/// predictions within it.
const PREDICTION: (f64, f64) = (0.2, 0.1);
const MIN_PREDICTED: f64 = 0.9;

/// Add each effect of the catalogue to the model of a gripper that has it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance force softening reference_drift")]
pub struct Args {
    /// Effects, several of one gripper joined by + [default: each of the catalogue, and ten pairs].
    #[arg(value_name = "EFFECTS")]
    effects: Vec<String>,
}

/// Runs all cases.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let singles = CATALOGUE.iter().map(|effect| vec![effect.id]);
    let pairs = PAIRS.iter().map(|pair| pair.to_vec());
    let all: Vec<Vec<&str>> = match args.effects.as_slice() {
        [] => singles.chain(pairs).collect(),
        given => given.iter().map(|effects| effects.split('+').collect()).collect(),
    };
    let cases: Vec<(Vec<&str>, u64)> = all
        .into_iter()
        .flat_map(|effects| seeds.clone().map(move |seed| (effects.clone(), seed)))
        .collect();
    let folder = tempfile::tempdir()?;
    let bar = progress::progress_bar("grippers with an effect", cases.len());
    let of_case = |(place, (effects, seed)): (usize, &(Vec<&str>, u64))| {
        let steps = add(&folder.path().join(place.to_string()), effects, *seed)
            .with_context(|| format!("{}, seed {seed}", effects.join("+")));
        bar.inc(1);
        steps
    };
    let steps: Vec<[ForceStep; 2]> =
        cases.par_iter().enumerate().map(of_case).collect::<Result<_>>()?;
    bar.finish_and_clear();
    let mut ratios: Vec<f64> =
        steps.iter().map(|[before, after]| after.excess_n / before.excess_n).collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN);
    let falls = steps.iter().filter(|[before, after]| after.is_fall(before)).count();
    let predictions =
        if args.effects.is_empty() { predictions(seeds.start, folder.path())? } else { Vec::new() };
    let hits = predictions.iter().filter(|prediction| prediction.is_hit()).count();
    let is_met = falls == steps.len()
        && (!args.effects.is_empty() || median <= MAX_MEDIAN)
        && hits as f64 >= MIN_PREDICTED * predictions.len() as f64;
    let rows = cases.iter().zip(&steps).map(|((effects, seed), [before, after])| {
        [
            effects.join(", "),
            seed.to_string(),
            format!("{:.3}", before.excess_n),
            format!("{:.3}", after.excess_n),
            format!("{:.2}", after.excess_n / before.excess_n),
            format!("{:.3}", after.noise_n),
            format!("{:.3}", after.recorded_n),
            if after.is_fall(before) { "" } else { "MISSED" }.to_owned(),
        ]
    });
    let mut tables = markdown_table(
        [
            "effect",
            "seed",
            "excess before, N",
            "excess after, N",
            "ratio",
            "noise, N",
            "error against the recorded reference, N",
            "",
        ],
        rows,
    );
    if !predictions.is_empty() {
        let misses = predictions.iter().filter(|prediction| !prediction.is_hit());
        let rows = misses.map(|miss| {
            [
                miss.campaign.clone(),
                miss.effect.clone(),
                format!("{:.3}", miss.predicted_n),
                format!("{:.3}", miss.found_n),
                format!("{:.3}", miss.noise_n),
            ]
        });
        tables += &format!(
            "\nPredicted excess of the workbench against that after the click: {hits} of {} within {:.0} % or {} of the noise. Misses:\n\n{}",
            predictions.len(),
            100.0 * PREDICTION.0,
            PREDICTION.1,
            markdown_table(
                ["hidden effects", "clicked", "predicted, N", "found, N", "noise, N"],
                rows
            )
        );
    }
    Ok(Section {
        id: "force",
        title: "Force error by effect",
        extent: format!(
            "{} grippers, {}, three recordings of 30 s each",
            steps.len(),
            seeds_text(&seeds)
        ),
        conditions: format!(
            "Simulated grippers of {SENSORS} sensors with manufacturing tolerances and one effect of typical magnitude, or two. Held-out \
             errors through the device's code, RMS over all forces; excess over the white noise, without what no model of the device \
             could remove. `fit`, then `add` of the effects. Specified: the excess falls to at most {MAX_RATIO} times that before, or \
             below {SMALL_EXCESS} times the noise ({falls} of {}), with a median ratio of at most {MAX_MEDIAN} ({median:.2}).",
            steps.len()
        ),
        tables,
        is_met: Some(is_met),
    })
}

/// A held-out force error in newtons.
pub struct ForceStep {
    pub excess_n: f64,
    pub noise_n: f64,
    recorded_n: f64,
}

impl ForceStep {
    pub fn of(force: &Value) -> Result<Self> {
        let value = |key: &str| force[key].as_f64().ok_or_else(|| anyhow!("no {key} in {force}"));
        Ok(Self {
            excess_n: value("excess_n")?,
            noise_n: value("noise_n")?,
            recorded_n: value("recorded_rms_n")?,
        })
    }

    pub fn is_fall(&self, before: &Self) -> bool {
        self.excess_n <= (MAX_RATIO * before.excess_n).max(SMALL_EXCESS * self.noise_n)
    }
}

/// Simulates a gripper.
pub fn simulate(folder: &Path, effects: &[&str], seed: u64) -> Result<()> {
    let folder = folder.to_string_lossy();
    let seed = seed.to_string();
    let mut command = vec!["simulate", "--seed", &seed, "--sensors", SENSORS, "-o", &folder];
    effects.iter().for_each(|effect| command.extend(["--effect", effect]));
    magpie::run(&command, Some(1)).map(|_| ())
}

/// Fits the base and adds the effects: the error before and after.
fn add(folder: &Path, effects: &[&str], seed: u64) -> Result<[ForceStep; 2]> {
    // Backlash shows in the field of the magnet whose opening it is.
    let present: &[&str] =
        if effects.contains(&"screw_backlash") { &["neighbour_magnet"] } else { &[] };
    simulate(folder, &[present, effects].concat(), seed)?;
    let campaign = folder.to_string_lossy();
    let [model, start, after] =
        ["model", "start", "after"].map(|name| format!("{campaign}.{name}.toml"));
    magpie::run(&["fit", &campaign, "-o", &model], Some(1))?;
    let model = if present.is_empty() {
        model
    } else {
        magpie::run(&[&["add", &model, &campaign, "-o", &start], present].concat(), Some(1))?;
        start
    };
    let found =
        magpie::json(&[&["add", &model, &campaign, "-o", &after], effects].concat(), Some(1))?;
    let force = &found["force"];
    Ok([ForceStep::of(&force["before"])?, ForceStep::of(&force["after"])?])
}

/// A prediction of the workbench, and what came of it.
struct Prediction {
    campaign: String,
    effect: String,
    predicted_n: f64,
    found_n: f64,
    noise_n: f64,
}

impl Prediction {
    fn is_hit(&self) -> bool {
        let (share, noises) = PREDICTION;
        let error_n = (self.predicted_n - self.found_n).abs();
        error_n <= (share * self.found_n).max(noises * self.noise_n)
    }
}

/// Clicks every effect that a campaign can test, each alone.
fn predictions(seed: u64, folder: &Path) -> Result<Vec<Prediction>> {
    let bar = progress::progress_bar("campaigns in the workbench", PREDICTED.len());
    let of_campaign = |(place, hidden): (usize, &&[&str])| {
        let campaign = folder.join(format!("predicted-{place}"));
        simulate(&campaign, hidden, seed)?;
        let found = clicks(&campaign, &hidden.join(", "));
        bar.inc(1);
        found
    };
    let found: Vec<Vec<Prediction>> =
        PREDICTED.par_iter().enumerate().map(of_campaign).collect::<Result<_>>()?;
    bar.finish_and_clear();
    Ok(found.into_iter().flatten().collect())
}

fn clicks(campaign: &Path, hidden: &str) -> Result<Vec<Prediction>> {
    let alignment = Alignment { delay_us: 0.0 };
    let Ok(bench) = Workbench::open(campaign, alignment, FitOptions::default())? else {
        bail!("{}: setup errors", campaign.display());
    };
    let base = bench.fit_model(&[], &[])?;
    let candidates = base.candidates.clone();
    let mut found = Vec::new();
    for candidate in candidates {
        let effects = [EffectTerm::Catalogue(find(&candidate.effect)?)];
        // Backlash needs the magnet whose opening it is.
        if bench.fit_model(&effects, &[]).is_err() {
            continue;
        }
        let model = bench.fitted(&effects, &[]).context("no model")?;
        let force: ForceError =
            model.force().with_context(|| format!("{}: no forces", candidate.effect))?;
        found.push(Prediction {
            campaign: if hidden.is_empty() { "none".to_owned() } else { hidden.to_owned() },
            effect: candidate.effect,
            predicted_n: candidate.excess_n.context("no prediction")?,
            found_n: force.excess_n(),
            noise_n: force.noise_n,
        });
    }
    Ok(found)
}
