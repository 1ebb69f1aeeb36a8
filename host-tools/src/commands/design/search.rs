//! `magpie design sweep` and `magpie design optimize`: searches of the design space.

use analysis::progress;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use model_export::design::design_file;
use model_export::design::optimise::optimise;
use model_export::design::sweep::{self, pareto_front, sweep};
use model_export::input::plausible_range;
use model_export::output::{Output, fingerprint_of};

use crate::commands::args::ForceArg;
use crate::commands::design::space::SpaceArgs;
use report::html::design as pages;
use report::text::design_search::{format_optimum, format_sweep, optimum_json, sweep_json};
use report::text::terminal;

/// Evaluate thousands of designs; report the Pareto front of range, sensitivity and interference.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design sweep -o sweep.html
  cargo magpie design sweep --sample grid --size gap=1.5 --size width=15
  cargo magpie design sweep --material ABS --size thickness=2..10 --stroke 0.3
  cargo magpie design sweep --support clamped-clamped --count 100000 --json")]
pub struct SweepArgs {
    #[command(flatten)]
    space: SpaceArgs,
    /// HTML report to write.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArg,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run_sweep(args: &SweepArgs) -> Result<()> {
    let base = args.space.base()?;
    let inputs = vec![fingerprint_of(&(&base, &args.space))];
    let page = args.force.page(args.output.as_deref(), inputs)?;
    let space = args.space.space(&base)?;
    let interference = args.space.interference();
    let designs = space.points(args.space.count).count();
    let bar = progress::progress_bar("evaluating designs", designs as usize);
    let start = Instant::now();
    let candidates = sweep(&base, &space, args.space.count, &interference, || bar.inc(1));
    let front = pareto_front(&candidates);
    let seconds = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if let Some(page) = &page {
        let sections = pages::of_sweep(&candidates, &front, args.space.sample);
        report::html::write_sections(page, "magpie: a sweep of designs", &sections)?;
    }
    let report = args.output.as_deref();
    terminal::print_result(
        args.json,
        || sweep_json(space.sample, args.space.seed, &candidates, &front, report),
        || format_sweep(space.sample, args.space.seed, &candidates, &front, seconds, report),
    )
}

/// Find the design with the minimum force error that withstands a force, and its binding constraints.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design optimize --range 250 -o design.toml
  cargo magpie design optimize --range 40 --material ABS --material POM -o printed.toml
  cargo magpie design optimize --range 800 --size width=15 --size gap=1.5..3 --json
  cargo magpie simulate --design design.toml -o CAMPAIGN   # then fit, export, replay")]
pub struct OptimizeArgs {
    /// Required force range of each axis, both signs.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    range: f64,
    #[command(flatten)]
    space: SpaceArgs,
    /// Design file to write.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArg,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run_optimize(args: &OptimizeArgs) -> Result<()> {
    let force_n = args.range;
    let (min_n, max_n) = plausible_range("range_n");
    if !(min_n..=max_n).contains(&force_n) {
        bail!(
            "--range {force_n:?} is not possible here; give the force in newtons, {min_n} to {max_n:e}"
        );
    }
    let base = args.space.base()?;
    let inputs = vec![fingerprint_of(&(&base, &args.space, force_n))];
    let check = |path| Output::check(path, design_file::MARK, inputs, args.force.overwrite());
    let output = args.output.as_deref().map(check).transpose()?;
    let space = args.space.space(&base)?;
    let interference = args.space.interference();
    let designs = space.points(args.space.count).count();
    let bar = progress::progress_bar("evaluating designs", designs as usize);
    let optimum = optimise(&base, &space, force_n, args.space.count, &interference, || bar.inc(1));
    bar.finish_and_clear();
    let Some(optimum) = optimum else {
        bail!(
            "none of {designs} designs withstands {force_n} N; increase --stroke or the sizes (--size thickness=1..12), or reduce --safety or --life"
        );
    };
    if let Some(output) = &output {
        output.write(optimum.design.to_toml(output.path())?.as_bytes())?;
    }
    let shifts = sweep::shifts(&optimum.design, force_n, &interference);
    terminal::print_result(
        args.json,
        || optimum_json(&optimum, &shifts, args.space.seed),
        || format_optimum(&optimum, &shifts, args.output.as_deref()),
    )
}
