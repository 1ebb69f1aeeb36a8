//! `magpie add`: an effect added to a model, everything refitted, the error before and after.

use anyhow::{Result, bail};

use super::change::{self, Common, named};
use super::formulas::Formulas;

/// Add physical effects to a model, refit everything, and show the error before and after.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie add model.toml tests/data/demo neighbour_magnet -o better.toml
  cargo magpie add model.toml my-campaign hysteresis magnet_temperature -o better.toml
  cargo magpie add model.toml my-campaign -o better.toml --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'

In a formula, names that end in a unit are covariates (the recording's columns, fx_n, fz_n, temp_c, time_s,
session_s), names with a --range are nonlinear parameters, all others are coefficients. It gives a displacement
of the magnet (dx_um, dy_um, dz_um), a force (fx_n, fz_n) or a field (bx_g, by_g, bz_g).")]
pub struct Args {
    #[command(flatten)]
    common: Common,
    /// Effects of the catalogue; `magpie effects` lists them.
    #[arg(value_name = "EFFECT")]
    effects: Vec<String>,
    #[command(flatten)]
    formulas: Formulas,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.effects.is_empty() && args.formulas.is_empty() {
        bail!("name an effect (`magpie effects` lists them), or give a formula with --expr");
    }
    change::run(&args.common, |_, before, campaign| {
        let added = named(&args.effects, &args.formulas.read(campaign)?)?;
        if let Some(twice) = added.iter().find(|effect| before.contains(effect)) {
            bail!(
                "{}: the model already has {}",
                args.common.model.display(),
                twice.name()
            );
        }
        Ok(before.iter().cloned().chain(added).collect())
    })
}
