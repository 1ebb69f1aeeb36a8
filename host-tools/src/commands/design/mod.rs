//! `magpie design`: sizes a flexure, magnet and gap before anything is made.

pub mod search;
pub mod space;

use analysis::progress;
use std::path::PathBuf;

use anyhow::Result;
use model_export::design::DesignEvaluation;
use model_export::design::SensorDesign;
use model_export::design::interference::{DRAWS, InterferenceSources};
use model_export::design::paper::{MATERIALS, PaperResults};
use model_export::design::sweep::{self, DEFAULT_COUNT};

use report::html::design as pages;
use report::text::design as summary;
use report::text::design_search::{format_paper, paper_json};
use report::text::terminal;

/// Design a sensor: evaluate a flexure, magnet and gap, sweep the design space, or optimise for a force.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design optimize --range 250 -o design.toml
  cargo magpie design check design.toml
  cargo magpie simulate --design design.toml -o CAMPAIGN")]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Check(CheckArgs),
    Sweep(search::SweepArgs),
    #[command(alias = "pick")]
    Optimize(search::OptimizeArgs),
    Paper(PaperArgs),
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    match &args.command {
        Command::Check(args) => check(args),
        Command::Sweep(args) => search::run_sweep(args),
        Command::Optimize(args) => search::run_optimize(args),
        Command::Paper(args) => reproduce_paper(args),
    }
}

/// Evaluate a design: force range and its limits, sensitivity, interference.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design check                      # the MAGPIE design
  cargo magpie design check design.toml -o design.html
  cargo magpie design check design.toml --json

A design.toml, lengths in mm; sensor, limits, tolerances and material.NAME are optional:
  gap_mm = 1.5
  force_range_n = 250.0         # required; default 250
  stiffness_x_n_per_mm = 500.0  # of the whole axis; default: of the beam alone
  [magnet]
  shape = \"cylinder\"
  diameter_mm = 3.0
  length_mm = 2.0
  remanence_t = 1.2
  axis = \"y\"
  [flexure_x]                   # and the same for [flexure_z]
  support = \"clamped-free\"      # or clamped-clamped, clamped-guided
  material = \"17-4PH\"
  length_mm = 30.0
  width_mm = 15.0
  thickness_mm = 5.0
  [sensor]                      # range_gauss, gauss_per_lsb, noise_gauss, package_mm
  [limits]                      # stroke_mm, life_cycles, safety
  [tolerances]                  # offset_mm, gap_mm, tilt_deg, remanence
  # modulus_gpa, yield_mpa, fatigue_coefficient_mpa, fatigue_exponent
  [material.\"my steel\"]")]
struct CheckArgs {
    /// Design file [default: MAGPIE].
    design: Option<PathBuf>,
    /// HTML report to write.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Seed of the random misalignments.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
fn check(args: &CheckArgs) -> Result<()> {
    let design = SensorDesign::read_or_magpie(args.design.as_deref())?;
    let evaluation = DesignEvaluation::of(&design);
    let interference = InterferenceSources::assumed(args.seed, DRAWS);
    let shifts = sweep::shifts(&design, design.force_range_n, &interference);
    if let Some(path) = &args.output {
        let sections = pages::of_one(&design, &evaluation, &shifts);
        report::html::write_sections(path, "magpie: evaluation of a design", &sections)?;
    }
    terminal::print_result(
        args.json,
        || summary::to_json(&design, &evaluation, &shifts),
        || {
            summary::format_report(&design, &evaluation, &shifts)
                + &summary::assumptions(&design)
                + &terminal::report_line(args.output.as_deref())
        },
    )
}

/// Reproduce the paper's results on fields, sensitivity and materials, and check each of its statements.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design paper -o paper.html
  cargo magpie design paper --json")]
struct PaperArgs {
    /// Number of designs per material.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_COUNT, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    count: u32,
    /// Seed of the random misalignments.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// HTML report to write.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
fn reproduce_paper(args: &PaperArgs) -> Result<()> {
    let interference = InterferenceSources::assumed(args.seed, DRAWS);
    let bar = progress::progress_bar("evaluating designs", args.count as usize * MATERIALS.len());
    let paper = PaperResults::of(args.count, &interference, || bar.inc(1));
    bar.finish_and_clear();
    if let Some(path) = &args.output {
        let sections = pages::of_paper(&paper);
        report::html::write_sections(path, "magpie: reproduction of the paper", &sections)?;
    }
    let report = args.output.as_deref();
    terminal::print_result(
        args.json,
        || paper_json(&paper, report),
        || format_paper(&paper, report),
    )
}
