//! Statistical acceptance runs over simulated grippers and campaigns; their tables are in `RESULTS.md`.

mod bus_load;
mod calibration;
mod diagnosis;
mod drive;
mod fault_campaign;
mod force;
mod force_estimators;
mod forged_frames;
mod formulas;
mod grasp;
mod intervals;
mod magnetic_disturbance;
mod magpie;
mod orientations;
mod paper;
mod real;
mod results;
mod robustness;
mod similarity;
#[cfg(test)]
#[path = "tests.rs"]
mod unit_tests;

use std::ops::Range;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::{Parser, Subcommand};

use results::Section;

/// Run an acceptance test over many seeds and write its table into the results file.
///
/// The exit status is 1 if a requirement is not met. All results but those of `real` are simulated.
#[derive(Debug, Parser)]
#[command(
    name = "acceptance",
    arg_required_else_help = true,
    after_help = "\
Examples:
  cargo acceptance drive
  cargo acceptance diagnosis typical --first 100 --seeds 5 --results results.md
  cargo acceptance grasp --quick"
)]
struct Cli {
    #[command(subcommand)]
    run: Run,
    #[command(flatten)]
    options: Options,
}

/// Options of all runs.
#[derive(Clone, Debug, PartialEq, clap::Args)]
struct Options {
    /// Number of seeds [default: as in the published table].
    #[arg(long, value_name = "N", global = true, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    seeds: Option<u64>,
    /// First seed [default: as in the published table].
    #[arg(long, value_name = "SEED", global = true, value_parser = clap::value_parser!(u64).range(..=1_000_000_000))]
    first: Option<u64>,
    /// Small run of at most a few minutes; its table has a section of its own.
    #[arg(long, global = true)]
    quick: bool,
    /// Results file; other sections are preserved.
    #[arg(long, value_name = "FILE", global = true, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/RESULTS.md"))]
    results: PathBuf,
}

/// Seeds of a run without `--seeds` and `--first`.
#[derive(Clone, Copy, Debug)]
struct DefaultSeeds {
    first: u64,
    full: u64,
    quick: u64,
}

impl Options {
    fn seeds(&self, defaults: DefaultSeeds) -> Range<u64> {
        let count = self.seeds.unwrap_or(if self.quick { defaults.quick } else { defaults.full });
        let first = self.first.unwrap_or(defaults.first);
        first..first + count
    }
}

#[derive(Debug, Subcommand)]
enum Run {
    Diagnosis(diagnosis::Args),
    /// Measure how similar the effects of the catalogue are, by excitation.
    #[command(after_help = "Example:\n  cargo acceptance similarity")]
    Similarity,
    MagneticDisturbance(magnetic_disturbance::Args),
    Force(force::Args),
    Formulas(formulas::Args),
    /// Compare eight force estimators on a held-out recording.
    #[command(after_help = "Example:\n  cargo acceptance force-estimators --first 12")]
    ForceEstimators,
    /// Evaluate speed, force, and the current and position loops of perturbed drives.
    #[command(after_help = "Example:\n  cargo acceptance drive --seeds 100")]
    Drive,
    Grasp(grasp::Args),
    FaultCampaign(fault_campaign::Args),
    BusLoad(bus_load::Args),
    Calibration(calibration::Args),
    /// Calibrate emulated boards with sensors in all orientations.
    #[command(after_help = "Example:\n  cargo acceptance orientations --quick")]
    Orientations,
    /// Send crafted and random frames to a gripper whose session another host owns.
    #[command(after_help = "Example:\n  cargo acceptance forged-frames --seeds 3")]
    ForgedFrames,
    Robustness(robustness::Args),
    /// Check the statements of the paper on magnets, sensitivity and materials.
    #[command(after_help = "Example:\n  cargo acceptance paper")]
    Paper,
    /// Diagnose measurements by others, of which something is known.
    #[command(after_help = "Example:\n  cargo acceptance real")]
    Real,
}

impl Run {
    fn evaluate(&self, options: &Options) -> Result<Section> {
        match self {
            Self::Diagnosis(args) => diagnosis::evaluate_groups(args, options),
            Self::Similarity => similarity::evaluate(options),
            Self::MagneticDisturbance(args) => magnetic_disturbance::evaluate(args, options),
            Self::Force(args) => force::evaluate(args, options),
            Self::Formulas(args) => formulas::evaluate(args, options),
            Self::ForceEstimators => force_estimators::evaluate(options),
            Self::Drive => drive::evaluate(options),
            Self::Grasp(args) => grasp::evaluate(args, options),
            Self::FaultCampaign(args) => fault_campaign::evaluate(args, options),
            Self::BusLoad(args) => bus_load::evaluate(args, options),
            Self::Calibration(args) => calibration::evaluate(args, options),
            Self::Orientations => orientations::evaluate(options),
            Self::ForgedFrames => forged_frames::evaluate(options),
            Self::Robustness(args) => robustness::evaluate(args, options),
            Self::Paper => paper::evaluate(options),
            Self::Real => real::evaluate(),
        }
    }
}

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().collect();
    // The runs execute commands of `magpie` in child processes of this program.
    if arguments.get(1).is_some_and(|argument| argument == magpie::SUBCOMMAND) {
        return host_tools::commands::run(arguments.into_iter().skip(1));
    }
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("acceptance: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    results::check(&cli.options.results)?;
    let section = cli.run.evaluate(&cli.options)?;
    let text = section.markdown(&command_line(std::env::args().skip(1)));
    println!("{text}");
    results::write(&cli.options.results, &section.marker(cli.options.quick), &text)?;
    if section.is_met == Some(false) {
        bail!("a requirement is not met");
    }
    Ok(())
}

/// The command that repeats a run, without the path of the results file.
fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let mut words = vec!["cargo acceptance".to_owned()];
    let mut arguments = arguments.peekable();
    while let Some(argument) = arguments.next() {
        if argument == "--results" {
            arguments.next();
        } else if !argument.starts_with("--results=") {
            words.push(argument);
        }
    }
    words.join(" ")
}
