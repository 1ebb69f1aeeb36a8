//! Force estimators on a recording that none of them was fitted to or trained with: Table I of the paper on simulated
//! campaigns.

use anyhow::{Context, Result};
use serde_json::Value;
use tempfile::TempDir;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 11, full: 1, quick: 1 };
/// Effects of the simulated gripper: name, and argument of `--effect`.
const EFFECTS: [(&str, &str); 3] = [
    ("hysteresis", "hysteresis=0.5:both"),
    ("cross_coupling", "cross_coupling=8"),
    ("magnet_temperature", "magnet_temperature=-0.25"),
];
/// Duration of a recording in seconds, and epochs.
const FULL: [&str; 2] = ["100", "40"];
const QUICK: [&str; 2] = ["20", "4"];

/// Networks: name, whether on the physics with effects, options of `train`.
const NETWORKS: [(&str, bool, &[&str]); 5] = [
    ("network of 2 axes", false, &["--axes", "xz"]),
    ("network of 3 axes", false, &[]),
    ("3 axes + ideal", false, &["--inputs", "field+ideal", "--target", "residual"]),
    ("3 axes, small forces weighted", false, &["--zero-weight", "4"]),
    ("physics + network", true, &["--inputs", "field+ideal", "--target", "residual"]),
];

/// RMSE of both forces in newtons: z and x.
type Errors = [f64; 2];

/// Runs one campaign for each seed.
pub fn evaluate(options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let [seconds, epochs] = if options.quick { QUICK } else { FULL };
    let mut tables = String::new();
    for seed in seeds.clone() {
        let rows = errors(seed, seconds, epochs)?
            .into_iter()
            .map(|(name, errors)| [name, cell(errors[0]), cell(errors[1])]);
        tables += &format!("Seed {seed}:\n\n{}\n", markdown_table(["estimator", "Fz", "Fx"], rows));
    }
    Ok(Section {
        id: "force-estimators",
        title: "Force estimators",
        extent: format!("{}, one campaign each", seeds_text(&seeds)),
        conditions: format!(
            "One sensor, 4 recordings of {seconds} s: three for fit and training, of which the third selects the epoch, \
             the fourth held out; at most {epochs} epochs, 16 units; {}. RMSE in newtons through the device's code.",
            EFFECTS.map(|(_, argument)| format!("`{argument}`")).join(", ")
        ),
        tables: tables.trim_end().to_owned() + "\n",
        is_met: None,
    })
}

fn cell(error_n: f64) -> String {
    format!("{error_n:.2}")
}

/// Errors of each estimator on the held-out recording.
fn errors(seed: u64, seconds: &str, epochs: &str) -> Result<Vec<(String, Errors)>> {
    let folder = TempDir::new()?;
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let [campaign, held_out, base, model] =
        ["campaign", "held-out", "base.toml", "model.toml"].map(path);
    let seed = seed.to_string();
    let mut simulate = vec!["simulate", "--sensors", "1", "--recordings", "4"];
    simulate.extend(["--seconds", seconds, "--seed", &seed, "-o", &campaign]);
    EFFECTS.iter().for_each(|(_, argument)| simulate.extend(["--effect", argument]));
    magpie::run(&simulate, None)?;
    std::fs::rename(path("campaign/4"), &held_out)?;
    magpie::run(&["fit", &campaign, "-o", &base], None)?;
    let mut add = vec!["add", &base, &campaign, "-o", &model];
    add.extend(EFFECTS.map(|(name, _)| name));
    magpie::run(&add, None)?;
    let replay = |model: &str| magpie::json(&["replay", model, &held_out], None);
    let (fitted, physics) = (replay(&base)?, replay(&model)?);
    let mut rows = vec![
        ("ideal, nominal".to_owned(), both(&fitted["nominal"], "rmse_n")?),
        ("ideal, fitted".to_owned(), both(&fitted["sensors"], "rmse_n")?),
        ("physics with effects".to_owned(), both(&physics["sensors"], "rmse_n")?),
    ];
    for (number, (name, is_on_effects, options)) in NETWORKS.into_iter().enumerate() {
        let (model, network) =
            (if is_on_effects { &model } else { &base }, path(&format!("{number}.safetensors")));
        let mut train = vec!["train", model, &campaign, "--epochs", epochs, "-o", &network];
        train.extend(options);
        magpie::run(&train, None)?;
        let output = magpie::json(&["replay", model, &held_out, "--network", &network], None)?;
        rows.push((name.to_owned(), both(&output["networks"]["sensors"], "rmse_n")?));
    }
    let noise = both(&fitted["sensors"], "noise_n")?;
    rows.push(("white noise of one reading".to_owned(), noise));
    Ok(rows)
}

/// A figure of both forces in a list of axes.
fn both(axes: &Value, key: &str) -> Result<Errors> {
    let of = |axis: &str| {
        let mut rows = axes.as_array()?.iter();
        rows.find(|row| row["axis"] == axis)?[key].as_f64()
    };
    of("z").zip(of("x")).map(<[f64; 2]>::from).with_context(|| format!("{key} in {axes}"))
}
