//! The effects and formulas that a page chooses, and the commands that do the same.

use std::collections::BTreeSet;
use std::path::Path;

use analysis::edit_model::parse_formulas;
use analysis::workbench::Workbench;
use anyhow::{Result, anyhow, bail};
use model_export::effects::EffectTerm;
use model_export::model_file::BaseKind;
use model_export::recordings::align::Alignment;
use serde::Deserialize;

use crate::commands::args::parse_range;

/// Effects of the catalogue and formulas of a model. Ranges of a formula follow it after semicolons.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub(super) struct Choice {
    pub(super) effects: Vec<String>,
    pub(super) formulas: Vec<String>,
}

impl Choice {
    /// Formula and ranges of each formula.
    fn parts(&self) -> impl Iterator<Item = (&str, Vec<&str>)> {
        self.formulas.iter().map(|text| {
            let mut parts = text.split(';').map(str::trim);
            (parts.next().unwrap_or_default(), parts.collect())
        })
    }

    /// The commands that fit, evaluate and export this model.
    pub(super) fn commands(
        &self,
        campaign: &Path,
        base: BaseKind,
        alignment: Alignment,
        seed: u64,
    ) -> Vec<String> {
        let campaign = campaign.display().to_string();
        let line = |words: &[&str]| shell_words::join(["cargo", "magpie"].iter().chain(words));
        let (delay_ms, seed) = (format!("{}", alignment.delay_us / 1e3), seed.to_string());
        let delay: &[&str] =
            if alignment.delay_us == 0.0 { &[] } else { &["--delay-ms", &delay_ms] };
        let seed: &[&str] = if seed == "1" { &[] } else { &["--seed", &seed] };
        let polynomial: &[&str] =
            if base == BaseKind::Polynomial { &["--base", "polynomial"] } else { &[] };
        let fit = ["fit", &campaign, "-o", "base.toml"];
        let mut commands = vec![line(&[&fit[..], polynomial, delay, seed].concat())];
        let mut model = "base.toml";
        if !self.effects.is_empty() || !self.formulas.is_empty() {
            let mut words = vec!["add", model, campaign.as_str()];
            words.extend(self.effects.iter().map(String::as_str));
            for (formula, ranges) in self.parts() {
                words.extend(["--expr", formula]);
                words.extend(ranges.into_iter().flat_map(|range| ["--range", range]));
            }
            words.extend(["-o", "model.toml"]);
            commands.push(line(&[&words[..], seed].concat()));
            model = "model.toml";
        }
        for words in [
            ["compare", model, &campaign, "-o", "report.html"],
            ["diagnose", model, &campaign, "--plan", "plan.toml"],
        ] {
            commands.push(line(&[&words[..], seed].concat()));
        }
        commands.push(line(&["replay", model, &campaign]));
        commands.push(line(&["dev", "export", model, "-o", "tables.rs"]));
        commands
    }

    /// The effects and formulas.
    pub(super) fn terms(&self, bench: &Workbench) -> Result<Vec<EffectTerm>> {
        let mut formulas = Vec::new();
        let mut parameters = BTreeSet::new();
        for (formula, ranges) in self.parts() {
            let parsed = ranges
                .into_iter()
                .map(|range| parse_range(range).map_err(|error| anyhow!("{range}: {error}")));
            let ranges = parsed.collect::<Result<Vec<_>>>()?;
            for range in &ranges {
                // The options of a command have one range for each name.
                if !parameters.insert(range.name.clone()) {
                    bail!(
                        "two formulas have a parameter {}: give them different names",
                        range.name
                    );
                }
            }
            let columns = bench.covariates();
            formulas.extend(parse_formulas(&[formula.to_owned()], &ranges, &columns)?);
        }
        analysis::edit_model::find_effects(&self.effects, &formulas)
    }
}
