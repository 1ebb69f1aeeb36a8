//! The force estimators of `magpie benchmark` on one simulated campaign per seed.

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

/// Runs the benchmark.
pub fn evaluate(options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let [seconds, epochs] = if options.quick { QUICK } else { FULL };
    let mut tables = String::new();
    for seed in seeds.clone() {
        let output = benchmark(seed, seconds, epochs)?;
        let rows = output["rows"].as_array().context("rows")?;
        tables += &format!("Seed {seed}:\n\n{}\n{}\n", table(rows), coverage(&output));
    }
    Ok(Section {
        id: "force-estimators",
        title: "Force estimators",
        extent: format!("{}, one campaign each", seeds_text(&seeds)),
        conditions: format!(
            "One sensor, 4 recordings of {seconds} s: three for training, the fourth held out; {epochs} epochs, 16 units; \
             {}. RMSE in newtons, floating point before / fixed point after the tare.",
            EFFECTS.map(|(_, argument)| format!("`{argument}`")).join(", ")
        ),
        tables: tables.trim_end().to_owned() + "\n",
        is_met: None,
    })
}

fn benchmark(seed: u64, seconds: &str, epochs: &str) -> Result<Value> {
    let folder = TempDir::new()?;
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let [campaign, base, model] = ["campaign", "base.toml", "model.toml"].map(path);
    let seed = seed.to_string();
    let mut simulate = vec!["simulate", "--sensors", "1", "--recordings", "4"];
    simulate.extend(["--seconds", seconds, "--seed", &seed, "-o", &campaign]);
    EFFECTS.iter().for_each(|(_, argument)| simulate.extend(["--effect", argument]));
    magpie::run(&simulate, None)?;
    magpie::run(&["fit", &campaign, "-o", &base], None)?;
    let mut add = vec!["add", &base, &campaign, "-o", &model];
    add.extend(EFFECTS.map(|(name, _)| name));
    magpie::run(&add, None)?;
    magpie::json(&["benchmark", &model, &campaign, "--epochs", epochs], None)
}

fn table(rows: &[Value]) -> String {
    let of = |variant: &Value, axis: &str| {
        let row = rows.iter().find(|row| row["variant"] == *variant && row["axis"] == axis);
        let figure = |name: &str| {
            let value = row.and_then(|row| row[name].as_f64());
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
        };
        format!("{} / {}", figure("rmse_n"), figure("fixed_tared_rmse_n"))
    };
    let noise = |axis: &str| {
        let row = rows.iter().find(|row| row["axis"] == axis);
        let value = row.and_then(|row| row["noise_n"].as_f64());
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
    };
    let variants = rows.iter().filter(|row| row["axis"] == "z").map(|row| &row["variant"]);
    let lines = variants.map(|variant| {
        [variant.as_str().unwrap_or("-").to_owned(), of(variant, "z"), of(variant, "x")]
    });
    let noise = ["white noise of one reading".to_owned(), noise("z"), noise("x")];
    markdown_table(["estimator", "Fz", "Fx"], lines.chain([noise]))
}

fn coverage(output: &Value) -> String {
    let share = |sigmas: &str| 100.0 * output["coverage"][sigmas].as_f64().unwrap_or(f64::NAN);
    format!(
        "Coverage of one and two predicted standard deviations of the network of 3 axes: {:.1} and {:.1} % (Gaussian: \
         68.3 and 95.4).\n",
        share("1"),
        share("2")
    )
}
