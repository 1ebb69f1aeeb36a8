//! `magpie design pick`: proposes a design for a force.

use std::path::PathBuf;

use anyhow::{Result, bail};
use model_export::design::pick::{Picked, pick};
use model_export::design::{design, sweep};
use model_export::output::check_output;

use super::space::SpaceArgs;
use super::{check, words};
use crate::report::numbers::number;
use crate::{progress, show};

/// Propose the design that tells a force best, of those that bear it, and say what binds it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design pick --range 250 -o design.toml
  cargo magpie design pick --range 40 --material ABS --material POM -o printed.toml
  cargo magpie design pick --range 800 --size width=15 --size gap=1.5..3 --json
  cargo magpie simulate --design design.toml -o CAMPAIGN   # then fit, export, replay")]
pub struct Args {
    /// Force that each axis must measure, either sign.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    range: f64,
    #[command(flatten)]
    space: SpaceArgs,
    /// Where the design goes.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let force_n = args.range;
    if !(force_n.is_finite() && force_n > 0.0) {
        bail!("--range {force_n} is not possible here; give the force in newtons");
    }
    if let Some(path) = &args.output {
        check_output(path, design::MARK)?;
    }
    let base = args.space.base()?;
    let space = args.space.space(&base)?;
    let around = args.space.around();
    let designs = space.points(args.space.count).count();
    let bar = progress::bar("judging designs", designs as usize);
    let found = pick(&base, &space, force_n, args.space.count, &around, || {
        bar.inc(1)
    });
    bar.finish_and_clear();
    let Some(picked) = found else {
        bail!(
            "none of {designs} designs bears {force_n} N; allow a longer --stroke, less --safety or --life, or greater sizes (--size thickness=1..12)"
        );
    };
    if let Some(path) = &args.output {
        picked.design.write(path)?;
    }
    let shifts = sweep::shifts(&picked.design, force_n, &around);
    if args.json {
        let mut told = words::report_json(&picked.design, &picked.judged, &shifts);
        told["error_n"] = picked.error_n.into();
        told["bearing"] = picked.bearing.0.into();
        told["designs"] = picked.bearing.1.into();
        told["seed"] = args.space.seed.into();
        show::page(&format!("{told}\n"))?;
        return Ok(());
    }
    let mut page =
        words::described(&picked.design) + "\n" + &words::tables(&picked.judged, &shifts);
    page += &check::verdict(&picked.design, &picked.judged);
    page += &words::binding(&picked.judged);
    page += &why(&picked);
    page += &words::assumed(&picked.design);
    if let Some(path) = &args.output {
        page += &format!(
            "Written to {0}.\nNext: cargo magpie simulate --design {0} -o CAMPAIGN\n",
            path.display()
        );
    }
    show::page(&page)?;
    Ok(())
}

/// Why this one, and what keeps it from being better.
fn why(picked: &Picked) -> String {
    let (bearing, all) = picked.bearing;
    let mut text = show::paragraph(&format!(
        "Of {all} designs {bearing} bear the force; this one, found downhill from the best of them in steps that \
         can be made, tells it best: noise and what interferes are {} N together.",
        number(picked.error_n)
    ));
    if !picked.edges.is_empty() {
        let edges: Vec<String> = picked
            .edges
            .iter()
            .map(|(name, low)| match low {
                true => format!("{name} is the least"),
                false => format!("{name} is the greatest"),
            })
            .collect();
        text += &show::paragraph(&format!(
            "The sizes that are allowed bind it as well: {}.",
            edges.join(", ")
        ));
    }
    text
}
