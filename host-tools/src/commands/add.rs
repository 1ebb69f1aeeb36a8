//! `magpie add`: an effect added to a model, everything refitted, the error before and after.

use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use model_export::effects::expression::Range;
use model_export::effects::{Addition, Expression};
use model_export::recordings::Campaign;

use super::change::{self, Common, named};

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
    /// An effect of your own: 'NAME: TARGET = FORMULA'.
    #[arg(long, value_name = "FORMULA")]
    expr: Vec<String>,
    /// Range of a nonlinear parameter in the formulas: NAME=FROM..TO.
    #[arg(long, value_name = "NAME=FROM..TO", value_parser = range)]
    range: Vec<Range>,
}

fn range(text: &str) -> Result<Range, String> {
    let advice = || "write NAME=FROM..TO, as in p=2..5".to_owned();
    let (name, ends) = text.split_once('=').ok_or_else(advice)?;
    let (from, to) = ends.split_once("..").ok_or_else(advice)?;
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| advice());
    Ok(Range {
        name: name.trim().to_owned(),
        from: number(from)?,
        to: number(to)?,
    })
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.effects.is_empty() && args.expr.is_empty() {
        bail!("name an effect (`magpie effects` lists them), or give a formula with --expr");
    }
    change::run(&args.common, |_, before, campaign| {
        let added = named(&args.effects, &formulas(&args.expr, &args.range, campaign)?)?;
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

/// Reads formulas; each takes the ranges that it names.
fn formulas(texts: &[String], ranges: &[Range], campaign: &Campaign) -> Result<Vec<Addition>> {
    let first = campaign
        .recordings
        .first()
        .context("the campaign is empty")?;
    let columns: Vec<String> = first.covariates.keys().cloned().collect();
    let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
    for range in ranges {
        if !texts
            .iter()
            .any(|text| text.split(word).any(|name| name == range.name))
        {
            bail!("--range {}: no formula has such a name", range.name);
        }
    }
    let read = |text: &String| {
        let own: Vec<Range> = ranges
            .iter()
            .filter(|range| text.split(word).any(|name| name == range.name))
            .cloned()
            .collect();
        let formula =
            Expression::parse(text, &own, &columns).map_err(|error| anyhow!("--expr: {error}"))?;
        Ok(Addition::Expression(Arc::new(formula)))
    };
    texts.iter().map(read).collect()
}
