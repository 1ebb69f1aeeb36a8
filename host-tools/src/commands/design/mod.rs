//! `magpie design`: sizes a flexure, magnet and gap before anything is made.

pub mod search;
pub mod space;

use std::path::PathBuf;

use anyhow::Result;
use model_export::design::DesignEvaluation;
use model_export::design::SensorDesign;
use model_export::design::interference::{DRAWS, InterferenceSources};
use model_export::design::sweep;
use model_export::output::fingerprint_of;

use crate::commands::args::ForceArg;
use report::html::design as pages;
use report::text::design as summary;
use report::text::terminal;

/// Evaluate flexure, magnet and gap of a sensor, or search the best for a force.
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
    Optimize(search::OptimizeArgs),
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    match &args.command {
        Command::Check(args) => check(args),
        Command::Sweep(args) => search::run_sweep(args),
        Command::Optimize(args) => search::run_optimize(args),
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
    #[command(flatten)]
    force: ForceArg,
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
    let inputs = vec![fingerprint_of(&(&design, args.seed))];
    let page = args.force.page(args.output.as_deref(), inputs)?;
    let evaluation = DesignEvaluation::of(&design);
    let interference = InterferenceSources::assumed(args.seed, DRAWS);
    let shifts = sweep::shifts(&design, design.force_range_n, &interference);
    if let Some(page) = &page {
        let sections = pages::of_one(&design, &evaluation, &shifts);
        report::html::write_sections(page, "magpie: evaluation of a design", &sections)?;
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
