//! `magpie drop`: the inverse of `add`.

use anyhow::{Result, bail};

use super::change::{self, Common};

/// Take effects out of a model again, refit everything, and show the error before and after.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie drop better.toml my-campaign creep -o model.toml")]
pub struct Args {
    #[command(flatten)]
    common: Common,
    /// Effects of the model, by name.
    #[arg(value_name = "EFFECT", required = true)]
    effects: Vec<String>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    change::run(&args.common, |model, before, _| {
        let has: Vec<&str> = model
            .effects
            .iter()
            .map(|effect| effect.name.as_str())
            .collect();
        for name in &args.effects {
            if !has.contains(&name.as_str()) {
                let has = if has.is_empty() {
                    "no effects".to_owned()
                } else {
                    has.join(", ")
                };
                bail!(
                    "{}: there is no {name} in this model; it has {has}",
                    args.common.model.display()
                );
            }
        }
        let stays = |name: &str| !args.effects.iter().any(|dropped| dropped == name);
        Ok(before
            .iter()
            .filter(|effect| stays(effect.name()))
            .cloned()
            .collect())
    })
}
