//! `magpie design sweep` and `magpie design optimize`: searches of the design space.

use analysis::progress;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use model_export::design::design_file;
use model_export::design::optimise::{OptimisedDesign, optimise};
use model_export::design::sweep::{self, Candidate, pareto_front, sweep};
use model_export::output::check_output;
use serde_json::{Value, json};

use crate::commands::design::space::SpaceArgs;
use analysis::numbers::number;
use report::html::design as pages;
use report::text::design::{self as summary, finite};
use report::text::terminal;

/// Printed rows of the Pareto front.
const FRONT_ROWS: usize = 12;

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
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run_sweep(args: &SweepArgs) -> Result<()> {
    let base = args.space.base()?;
    let space = args.space.space(&base)?;
    let interference = args.space.interference();
    let designs = space.points(args.space.count).count();
    let bar = progress::progress_bar("evaluating designs", designs as usize);
    let start = Instant::now();
    let candidates = sweep(&base, &space, args.space.count, &interference, || bar.inc(1));
    let front = pareto_front(&candidates);
    let seconds = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if let Some(path) = &args.output {
        let sections = pages::of_sweep(&candidates, &front, args.space.sample);
        report::html::write_sections(path, "magpie: a sweep of designs", &sections)?;
    }
    terminal::print_result(
        args.json,
        || sweep_json(args, &candidates, &front),
        || sweep_report(args, &candidates, &front, seconds),
    )
}

/// `count` evenly spaced elements, including both ends.
fn evenly_spaced(front: &[usize], count: usize) -> Vec<usize> {
    let last = front.len().saturating_sub(1);
    let rows = count.min(front.len());
    let place = |i: usize| i * last / rows.saturating_sub(1).max(1);
    (0..rows).map(|i| front[place(i)]).collect()
}

fn sweep_report(
    args: &SweepArgs,
    candidates: &[Candidate],
    front: &[usize],
    seconds: f64,
) -> String {
    let mut table = terminal::table(summary::CANDIDATE_HEADS);
    for place in evenly_spaced(front, FRONT_ROWS) {
        table.add_row(summary::candidate_row(&candidates[place]));
    }
    let limits: Vec<String> = summary::causes(candidates)
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(cause, count)| format!("{} {count}", cause.name()))
        .collect();
    let mut page = terminal::paragraph(&format!(
        "{} designs ({}) in {seconds:.1} s, {} of them feasible; Pareto front of range, sensitivity and interference: \
         {} (misalignment seed {}). Range limited by: {}.",
        candidates.len(),
        args.space.sample.name(),
        candidates.iter().filter(|one| one.works()).count(),
        front.len(),
        args.space.seed,
        limits.join(", ")
    ));
    page += &format!("{table}\n");
    if front.len() > FRONT_ROWS {
        page += &terminal::paragraph(&format!(
            "{FRONT_ROWS} evenly spaced designs of the front; all are in the report (-o) and in --json."
        ));
    }
    page += "Next: cargo magpie design optimize --range N -o design.toml\n";
    page += &terminal::report_line(args.output.as_deref());
    page
}

fn sweep_json(args: &SweepArgs, candidates: &[Candidate], front: &[usize]) -> Value {
    let one = |candidate: &Candidate| {
        json!({
            "design": candidate.design,
            "range_n": candidate.range_n,
            "ended_by": candidate.cause.name(),
            "g_per_n": candidate.g_per_n,
            "noise_n": finite(candidate.noise_n),
            "interference_n": finite(candidate.interference_n),
        })
    };
    let causes = summary::causes(candidates)
        .into_iter()
        .map(|(cause, count)| (cause.name().replace(' ', "_"), count.into()));
    json!({
        "designs": candidates.len(),
        "working": candidates.iter().filter(|one| one.works()).count(),
        "seed": args.space.seed,
        "sample": args.space.sample.name(),
        "ended_by": causes.collect::<serde_json::Map<_, _>>(),
        "front": front.iter().map(|place| one(&candidates[*place])).collect::<Vec<_>>(),
        "report": args.output,
    })
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
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run_optimize(args: &OptimizeArgs) -> Result<()> {
    let force_n = args.range;
    if !(force_n.is_finite() && force_n > 0.0) {
        bail!("--range {force_n} is not possible here; give the force in newtons");
    }
    if let Some(path) = &args.output {
        check_output(path, design_file::MARK)?;
    }
    let base = args.space.base()?;
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
    if let Some(path) = &args.output {
        optimum.design.write(path)?;
    }
    let shifts = sweep::shifts(&optimum.design, force_n, &interference);
    if args.json {
        let mut object = summary::to_json(&optimum.design, &optimum.evaluation, &shifts);
        object["error_n"] = optimum.error_n.into();
        object["bearing"] = optimum.feasible.0.into();
        object["designs"] = optimum.feasible.1.into();
        object["seed"] = args.space.seed.into();
        terminal::print(&format!("{object}\n"))?;
        return Ok(());
    }
    let mut page =
        summary::describe(&optimum.design) + "\n" + &summary::tables(&optimum.evaluation, &shifts);
    page += &summary::verdict(&optimum.design, &optimum.evaluation);
    page += &summary::binding_limits(&optimum.evaluation);
    page += &error_sentence(&optimum);
    page += &summary::assumptions(&optimum.design);
    if let Some(path) = &args.output {
        page += &format!(
            "Written to {0}.\nNext: cargo magpie simulate --design {0} -o CAMPAIGN\n",
            path.display()
        );
    }
    terminal::print(&page)?;
    Ok(())
}

/// Error of the optimum, and the size bounds that limit it.
fn error_sentence(optimum: &OptimisedDesign) -> String {
    let (bearing, all) = optimum.feasible;
    let mut text = terminal::paragraph(&format!(
        "{bearing} of {all} designs withstand the force. The optimum, refined from the best of them in manufacturable \
         steps, has an error of {} N (noise and interference).",
        number(optimum.error_n)
    ));
    if !optimum.edges.is_empty() {
        let edges: Vec<String> = optimum
            .edges
            .iter()
            .map(|(name, at_minimum)| {
                if *at_minimum {
                    format!("{name} at its minimum")
                } else {
                    format!("{name} at its maximum")
                }
            })
            .collect();
        text += &terminal::paragraph(&format!("Active size bounds: {}.", edges.join(", ")));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_rows_include_both_ends_of_the_front() {
        let front: Vec<usize> = (100..200).collect();
        let rows = evenly_spaced(&front, 12);
        assert_eq!((rows.len(), rows[0], rows[11]), (12, 100, 199));
        assert_eq!(evenly_spaced(&[7], 12), [7]);
        assert!(evenly_spaced(&[], 12).is_empty());
    }
}
