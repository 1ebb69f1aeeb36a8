//! `magpie benchmark`: force estimators compared on a held-out recording.

use std::path::PathBuf;

use analysis::benchmark::data::BenchmarkData;
use analysis::benchmark::train_variants::VariantTrainer;
use analysis::benchmark::{evaluate, run_benchmark};
use anyhow::{Result, bail};
use report::html::training;
use report::text::benchmark::{format_report, to_json};
use report::text::terminal;

use crate::commands::train::TrainingArgs;

/// Default weight of rows without force in the weighted variant.
const DEFAULT_ZERO_WEIGHT: f64 = 4.0;

/// Default duration of the disturbance evaluation in hours: a few seconds of computing time.
const DEFAULT_DISTURBANCE_HOURS: f64 = 0.2;
/// Maximum duration of the disturbance evaluation.
const MAX_DISTURBANCE_HOURS: f64 = 1000.0;

/// Compare force estimators on a held-out recording, as in the paper's Table I: the ideal model, networks of 2 and
/// 3 axes, with the ideal model's force, physics with MODEL's effects, alone and with a network.
///
/// All estimators are fitted and trained without the held-out recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie benchmark model.toml my-campaign -o report.html
  cargo magpie benchmark model.toml my-campaign --without-curve --disturbance-hours 10")]
pub struct Args {
    #[command(flatten)]
    common: TrainingArgs,
    /// HTML report to write.
    #[arg(short, long, value_name = "REPORT")]
    output: Option<PathBuf>,
    /// Hours of disturbance-free data for the false-alarm rate, and of data with passing magnets; 0 omits both.
    /// Ten hours take about ten minutes.
    #[arg(long, alias = "magnet-hours", value_name = "H", default_value_t = DEFAULT_DISTURBANCE_HOURS)]
    disturbance_hours: f64,
    /// Omit the error by amount of training data, which doubles the computing time.
    #[arg(long)]
    without_curve: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let common = &args.common;
    common.check()?;
    if !(0.0..=MAX_DISTURBANCE_HOURS).contains(&args.disturbance_hours) {
        bail!(
            "--disturbance-hours {:?} is not possible here; give 0 to {MAX_DISTURBANCE_HOURS}",
            args.disturbance_hours
        );
    }
    if let Some(path) = &args.output {
        model_export::output::check_output(path, report::html::MARK)?;
    }
    let alignment = common.align.alignment()?;
    let data = BenchmarkData::read(
        &common.model,
        &common.campaign,
        common.hold_out,
        alignment,
        common.seed,
        !args.without_curve,
    )?;
    let settings = model_export::gru::train::trainer::TrainingSettings {
        near_zero: 1.0,
        ..common.settings(data.force_range_n())
    };
    let plan = VariantTrainer::new(
        settings,
        common.hidden(false),
        common.zero_weight.unwrap_or(DEFAULT_ZERO_WEIGHT),
    );
    plan.announce(evaluate::trainings(&data).into_iter());
    let table = run_benchmark(&data, &plan, args.disturbance_hours)?;
    terminal::print_result(
        common.json,
        || to_json(&table, &plan),
        || format_report(&table, &plan),
    )?;
    if let Some(path) = &args.output {
        report::html::write_sections(path, &training::title(&table), &training::sections(&table))?;
        if !common.json {
            terminal::print(&format!("Written to {}.\n", path.display()))?;
        }
    }
    Ok(())
}
