//! `magpie design sweep`: thousands of designs, and those that no other beats.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use model_export::design::limits::Cause;
use model_export::design::sweep::{Candidate, front, sweep};
use model_export::recordings::description::Shape;
use serde_json::{Value, json};

use super::space::SpaceArgs;
use super::words::{self, finite};
use crate::report;
use crate::report::design as pages;
use crate::report::numbers::number;
use crate::{progress, show};

/// Rows of the front that are printed.
const ROWS: usize = 12;

/// Judge thousands of designs; show those that no other beats in range, sensitivity and interference.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design sweep -o sweep.html
  cargo magpie design sweep --sample grid --size gap=1.5 --size width=15
  cargo magpie design sweep --material ABS --size thickness=2..10 --stroke 0.3
  cargo magpie design sweep --support clamped-clamped --count 100000 --json")]
pub struct Args {
    #[command(flatten)]
    space: SpaceArgs,
    /// Where the report goes.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let base = args.space.base()?;
    let space = args.space.space(&base)?;
    let around = args.space.around();
    let designs = space.points(args.space.count).count();
    let bar = progress::bar("judging designs", designs as usize);
    let begun = Instant::now();
    let candidates = sweep(&base, &space, args.space.count, &around, || bar.inc(1));
    let front = front(&candidates);
    let seconds = begun.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if let Some(path) = &args.output {
        let sections = pages::of_sweep(&candidates, &front, args.space.sample);
        report::write_sections(path, "magpie: a sweep of designs", &sections)?;
    }
    let page = match args.json {
        true => format!("{}\n", report_json(args, &candidates, &front)),
        false => text(args, &candidates, &front, seconds),
    };
    show::page(&page)?;
    Ok(())
}

/// Heads of [`row`].
pub const HEADS: [&str; 8] = [
    "range, N",
    "G/N",
    "disturbed, N",
    "ended by",
    "material",
    "beam, mm",
    "magnet, mm",
    "gap, mm",
];

/// A candidate as a row; beam: length, width, thickness; magnet: diameter and length.
pub fn row(one: &Candidate) -> [String; 8] {
    let beam = &one.design.flexure_x;
    let mm = |size: f64| show::plain(size, 1);
    let magnet = match one.design.magnet.shape {
        Shape::Cylinder {
            diameter_mm,
            length_mm,
        } => format!("{} x {}", mm(diameter_mm), mm(length_mm)),
        other => words::magnet(&other),
    };
    [
        number(one.range_n),
        number(one.g_per_n),
        number(one.interference_n),
        one.cause.name().to_owned(),
        beam.material.clone(),
        format!(
            "{:.0} x {:.0} x {}",
            beam.length_mm,
            beam.width_mm,
            mm(beam.thickness_mm)
        ),
        magnet,
        show::plain(one.design.gap_mm, 2),
    ]
}

/// How many designs each cause ends.
pub fn causes(candidates: &[Candidate]) -> Vec<(Cause, usize)> {
    let of = |cause| candidates.iter().filter(|one| one.cause == cause).count();
    Cause::ALL.map(|cause| (cause, of(cause))).to_vec()
}

/// So many of them, evenly spread, both ends included.
fn spread(front: &[usize], count: usize) -> Vec<usize> {
    let last = front.len().saturating_sub(1);
    let rows = count.min(front.len());
    let place = |i: usize| i * last / rows.saturating_sub(1).max(1);
    (0..rows).map(|i| front[place(i)]).collect()
}

fn text(args: &Args, candidates: &[Candidate], front: &[usize], seconds: f64) -> String {
    let mut table = show::table(HEADS);
    for place in spread(front, ROWS) {
        table.add_row(row(&candidates[place]));
    }
    let ended: Vec<String> = causes(candidates)
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(cause, count)| format!("{} {count}", cause.name()))
        .collect();
    let mut page = show::paragraph(&format!(
        "{} designs ({}) in {seconds:.1} s, {} of which measure something; {} are beaten by none in range, \
         sensitivity and interference (seed {} of the misalignment). Ended by: {}.",
        candidates.len(),
        args.space.sample.name(),
        candidates.iter().filter(|one| one.works()).count(),
        front.len(),
        args.space.seed,
        ended.join(", ")
    ));
    page += &format!("{table}\n");
    if front.len() > ROWS {
        page += &show::paragraph(&format!(
            "{ROWS} of them, spread over their ranges; all are in the report (-o) and with --json."
        ));
    }
    page += "Next: cargo magpie design pick --range N -o design.toml\n";
    if let Some(path) = &args.output {
        page += &format!("Report: {}\n", path.display());
    }
    page
}

fn report_json(args: &Args, candidates: &[Candidate], front: &[usize]) -> Value {
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
    let causes = causes(candidates)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_long_front_hold_both_of_its_ends() {
        let front: Vec<usize> = (100..200).collect();
        let rows = spread(&front, 12);
        assert_eq!((rows.len(), rows[0], rows[11]), (12, 100, 199));
        assert_eq!(spread(&[7], 12), [7]);
        assert!(spread(&[], 12).is_empty());
    }
}
