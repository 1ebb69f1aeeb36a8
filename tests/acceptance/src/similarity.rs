//! How similar the effects of the catalogue are, by the excitation of the recordings: of two effects, the share of the pattern of
//! the second that the first reproduces (`magpie diagnose --json`), on campaigns without hidden effects.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use rayon::prelude::*;
use tempfile::TempDir;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 1, quick: 1 };
/// Excitation programmes of `magpie simulate`.
const PROGRAMMES: [&str; 4] = ["bench", "isothermal", "same-warm-up", "single-sine"];
/// Pairs with at least this share in any programme are listed.
const LISTED: f64 = 0.5;

/// Share of each pair of effects.
type Shares = BTreeMap<(String, String), f64>;

/// Measures the similarity of all pairs.
pub fn evaluate(options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let of_programme = |programme: &&str| -> Result<Shares> {
        let mut mean = Shares::new();
        let count = (seeds.end - seeds.start) as f64;
        for seed in seeds.clone() {
            for (pair, share) in shares(programme, seed)? {
                *mean.entry(pair).or_default() += share / count;
            }
        }
        Ok(mean)
    };
    let all: Vec<Shares> = PROGRAMMES.par_iter().map(of_programme).collect::<Result<_>>()?;
    let mut pairs: Vec<&(String, String)> = all.iter().flat_map(Shares::keys).collect();
    pairs.sort();
    pairs.dedup();
    let listed = pairs.into_iter().filter(|pair| {
        all.iter().any(|shares| shares.get(*pair).is_some_and(|share| *share >= LISTED))
    });
    let rows = listed.map(|pair| {
        let cell = |shares: &Shares| {
            shares.get(pair).map_or_else(|| "-".to_owned(), |share| format!("{share:.2}"))
        };
        let [bench, isothermal, warm, sine] = std::array::from_fn(|i| cell(&all[i]));
        [pair.0.clone(), pair.1.clone(), bench, isothermal, warm, sine]
    });
    Ok(Section {
        id: "similarity",
        title: "Similarity of effects",
        extent: format!("{}, one campaign of each excitation", seeds_text(&seeds)),
        conditions: format!(
            "Simulated campaigns of 3 x 30 s without effects. Share of the squared pattern of the second effect, at typical \
             magnitudes and without what the model's parameters absorb, that the first reproduces; pairs with {LISTED} or more \
             in any excitation. -: not testable there."
        ),
        tables: markdown_table(
            ["effect", "reproduces", "bench", "isothermal", "same warm-up", "single sine"],
            rows,
        ),
        is_met: None,
    })
}

fn shares(programme: &str, seed: u64) -> Result<Shares> {
    let folder = TempDir::new()?;
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let [campaign, model] = ["campaign", "model.toml"].map(path);
    let seed = seed.to_string();
    magpie::run(
        &["simulate", "--programme", programme, "--seed", &seed, "-o", &campaign],
        Some(1),
    )?;
    magpie::run(&["fit", &campaign, "-o", &model], Some(1))?;
    let output = magpie::json(&["diagnose", &model, &campaign], Some(1))?;
    let mut shares = Shares::new();
    for verdict in output["verdicts"].as_array().context("verdicts")? {
        let effect = verdict["effect"].as_str().context("effect")?;
        for other in verdict["reproduces"].as_array().context("reproduces")? {
            let name = other["effect"].as_str().context("effect")?;
            let share = other["share"].as_f64().context("share")?;
            shares.insert((effect.to_owned(), name.to_owned()), share);
        }
    }
    Ok(shares)
}
