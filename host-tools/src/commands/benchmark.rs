//! `magpie benchmark`: force estimators compared on a held-out recording.

use analysis::numbers;
use std::path::PathBuf;

use anyhow::{Result, bail};
use serde_json::{Value, json};

use crate::commands::train::{DEFAULT_HIDDEN, TrainingArgs};
use analysis::benchmark::data::BenchmarkData;
use analysis::benchmark::disturbance::DisturbanceResult;
use analysis::benchmark::evaluate::{self, LEARNING_VARIANTS, VariantResult};
use analysis::benchmark::train_variants::VariantTrainer;
use analysis::benchmark::variants::{self, EstimatorVariant};
use analysis::benchmark::{Benchmark, NetworkBenefit, network_benefit, run_benchmark};
use analysis::calibration::Coverage;
use analysis::statistics::Moments;
use report::html::training;
use report::text::disturbance::summary;
use report::text::terminal;

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
            "--disturbance-hours {} is not possible here; give 0 to {MAX_DISTURBANCE_HOURS}",
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
        common.hidden.map_or(DEFAULT_HIDDEN, usize::from),
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

/// The order of the paper.
const FORCES: [(usize, &str); 2] = [(1, "Fz"), (0, "Fx")];

fn format_report(table: &Benchmark, plan: &VariantTrainer) -> String {
    let parts = [
        heading(table),
        error_tables(table),
        terminal::paragraph(&notes(table, plan)),
        "\n".to_owned(),
        data_efficiency(table),
        terminal::paragraph(&network_gain(table)),
        disturbance_report(table),
    ];
    parts.concat()
}

fn heading(table: &Benchmark) -> String {
    terminal::paragraph(&format!(
        "Held-out recording {} in newtons, estimate minus reference at every row. Training data: recording {} \
         ({:.0} s), all of it for the physics; the networks use the last {:.0} s for early stopping. Column \
         \"paper\": Table I of the paper (RMSE, mean, standard deviation, there called variance).",
        table.recordings.1,
        table.recordings.0.join(", "),
        table.training_s,
        table.validation_s,
    ))
}

fn error_tables(table: &Benchmark) -> String {
    let tables = FORCES.map(|(axis, name)| format!("{name}\n{}\n", of_force(table, axis)));
    tables.concat()
}

fn of_force(table: &Benchmark, axis: usize) -> comfy_table::Table {
    let mut rows = terminal::table([
        "estimator",
        "RMSE",
        "mean",
        "std",
        "tared",
        "fixed",
        "tared",
        "noise",
        "paper",
    ]);
    for result in &table.results {
        let figures = &result.axes[axis];
        let tared = |sums: Option<Moments>| {
            sums.map_or_else(|| "-".to_owned(), |s| format!("{:.3}", s.rms()))
        };
        let stated = variants::published(result.variant, axis);
        rows.add_row([
            result.variant.words().to_owned(),
            format!("{:.3}", figures.float.rms()),
            format!("{:+.3}", figures.float.mean()),
            format!("{:.3}", figures.float.std()),
            tared(figures.float_tared),
            format!("{:.3}", figures.fixed.rms()),
            tared(figures.fixed_tared),
            format!("{:.3}", figures.noise_n),
            stated.map_or_else(String::new, |paper| {
                format!("{:.1} {:+.1} {:.1}", paper.rmse_n, paper.mean_n, paper.std_n)
            }),
        ]);
    }
    terminal::right_align(&mut rows, 1);
    rows
}

fn notes(table: &Benchmark, plan: &VariantTrainer) -> String {
    let data = if table.simulated {
        "These recordings are simulated; the paper's are measured and not public, so its results are not directly comparable. "
    } else {
        "The paper's recordings are not public (another gripper, other loads). "
    };
    let coverage = table
        .of(EstimatorVariant::Gru3Axis)
        .and_then(|result| result.coverage.as_ref())
        .map_or_else(String::new, |coverage| {
            let [one, two, three] = [0, 1, 2].map(|width| coverage.words(width));
            format!(
                "Coverage of 1, 2 and 3 predicted standard deviations by the 3-axis network after the tare: {one}, {two} and {three} (Gaussian: 68.3, 95.4, 99.7 %; 95 % intervals by block bootstrap). "
            )
        });
    format!(
        "Fixed: device code; previous columns: floating point. Tared: minus the mean estimate over the first unloaded \
         segment (at most 1 s) of each sensor, except within the friction deadband of the physics with effects; \
         the device does not tare. Networks are in steady state at rest when the recording begins. Noise: error of \
         a single reading due to white noise of sensor and reference; networks average over readings. Weighted \
         rows: 1 + {} exp(-(F / W)^2 / 2), where W is a tenth of the force range. {coverage}{data}Seed {}.",
        numbers::decimal(plan.zero_weight - 1.0, 2),
        plan.seed(),
    )
}

fn data_efficiency(table: &Benchmark) -> String {
    let mut seconds: Vec<f64> = table.learning_curve.iter().map(|point| point.seconds).collect();
    seconds.dedup();
    if seconds.len() < 2 {
        return String::new();
    }
    let heads = seconds.iter().map(|seconds| format!("{seconds:.0} s"));
    let mut rows = terminal::table(std::iter::once("estimator".to_owned()).chain(heads));
    for variant in LEARNING_VARIANTS {
        let cell = |seconds: &f64| {
            let mut points = table.learning_curve.iter();
            points
                .find(|point| point.variant == variant && point.seconds == *seconds)
                .map_or_else(|| "-".to_owned(), |point| format!("{:.3}", point.rmse_n))
        };
        let cells = seconds.iter().map(cell);
        let row: Vec<String> = std::iter::once(variant.words().to_owned()).chain(cells).collect();
        if row.iter().skip(1).any(|cell| cell != "-") {
            rows.add_row(row);
        }
    }
    terminal::right_align(&mut rows, 1);
    format!(
        "Device RMSE over both forces on recording {} by seconds of training data\n{rows}\n",
        table.recordings.1
    )
}

/// Benefit of the networks.
fn network_gain(table: &Benchmark) -> String {
    let physics = match network_benefit(table) {
        None => "The model has no effects, so physics with effects is not evaluated. `magpie diagnose` identifies missing effects, `magpie add` adds them.".to_owned(),
        Some(NetworkBenefit::Floor) => "Physics with effects reaches the noise floor on both forces: a network has no benefit.".to_owned(),
        Some(NetworkBenefit::Nothing) => "Physics with effects is above the floor, but a network reduces its error by less than 2 %: no significant benefit.".to_owned(),
        Some(NetworkBenefit::Share(share)) => format!("A network after physics with effects reduces the error by {:.0} %.", 100.0 * share),
        Some(NetworkBenefit::Harm(share)) => format!("A network after physics with effects increases the error by {:.0} %: omit it.", 100.0 * share),
    };
    format!("{}{physics}", axes_gain(table))
}

/// Detection of magnetic disturbances.
fn disturbance_report(table: &Benchmark) -> String {
    table.disturbance.as_ref().map_or_else(String::new, |magnet| {
        let words = summary(&magnet.counts);
        format!(
            "\n{}",
            terminal::paragraph(&format!("Magnetic disturbance. {} {words}", magnet.description))
        )
    })
}

/// The 3-axis network compared with the fitted ideal model and with 2 axes, after the tare.
fn axes_gain(table: &Benchmark) -> String {
    let gains = |other: EstimatorVariant| -> Option<[f64; 2]> {
        let (own, other) = (table.of(EstimatorVariant::Gru3Axis)?, table.of(other)?);
        let [x, z] = [0, 1].map(|axis| {
            let tared = |result: &analysis::benchmark::evaluate::VariantResult| {
                result.axes[axis].fixed_tared
            };
            Some(100.0 * (tared(own)?.rms() / tared(other)?.rms() - 1.0))
        });
        Some([x?, z?])
    };
    let words = |name: &str, [x, z]: [f64; 2]| format!("{z:+.0} % (Fz) and {x:+.0} % (Fx) {name}");
    let both = (gains(EstimatorVariant::IdealFitted), gains(EstimatorVariant::Gru2Axis));
    let (Some(ideal), Some(two)) = both else {
        return String::new();
    };
    format!(
        "After the tare the error of the 3-axis network differs by {}, and by {}. ",
        words("from the fitted ideal model", ideal),
        words("from 2 axes", two)
    )
}

const AXES: [&str; 2] = ["x", "z"];

/// The object of `--json`.
fn to_json(table: &Benchmark, plan: &VariantTrainer) -> Value {
    let rows = table.results.iter().flat_map(rows_json);
    let coverage = table
        .of(EstimatorVariant::Gru3Axis)
        .and_then(|result| result.coverage.as_ref())
        .map(Coverage::json);
    let lengths = table.learning_curve.iter().map(|point| {
        json!({
            "variant": point.variant.id(), "seconds": point.seconds,
            "rmse_n": point.rmse_n, "tared_rmse_n": point.tared_rmse_n,
        })
    });
    let networks = table.trained.iter().map(|trained| {
        let epochs: Vec<u32> = trained.found.iter().map(|best| best.epoch).collect();
        json!({ "variant": trained.variant.id(), "epochs": epochs, "sha256": trained.sha256 })
    });
    json!({
        "rows": rows.collect::<Vec<_>>(),
        "coverage": coverage,
        "noise_n": table.noise_n().map(|[x, z]| json!({ "x": x, "z": z })),
        "network_on_physics": network_benefit(table).map(gain_json),
        "data_efficiency": lengths.collect::<Vec<_>>(),
        "networks": networks.collect::<Vec<_>>(),
        "foreign_magnet": table.disturbance.as_ref().map(DisturbanceResult::json),
        "recordings": table.recordings.0, "held_out": table.recordings.1,
        "training_s": table.training_s, "stopping_s": table.validation_s,
        "effects": table.effects, "simulated": table.simulated,
        "near_zero": plan.zero_weight, "seed": plan.seed(), "epochs": plan.max_epochs(),
        "notes": table.notes,
    })
}

fn rows_json(result: &VariantResult) -> Vec<Value> {
    let row = |(axis, name): (usize, &str)| {
        let figures = &result.axes[axis];
        let stated = variants::published(result.variant, axis);
        json!({
            "variant": result.variant.id(), "axis": name, "rows": figures.fixed.rows(),
            "rmse_n": figures.float.rms(), "mean_n": figures.float.mean(),
            "std_n": figures.float.std(),
            "tared_rmse_n": figures.float_tared.map(|sums| sums.rms()),
            "fixed_rmse_n": figures.fixed.rms(), "fixed_mean_n": figures.fixed.mean(),
            "fixed_std_n": figures.fixed.std(),
            "fixed_tared_rmse_n": figures.fixed_tared.map(|sums| sums.rms()),
            "noise_n": figures.noise_n, "invalid": result.invalid,
            "paper": stated.map(|paper| json!({
                "rmse_n": paper.rmse_n, "mean_n": paper.mean_n, "std_n": paper.std_n,
            })),
        })
    };
    AXES.into_iter().enumerate().map(row).collect()
}

fn gain_json(worth: NetworkBenefit) -> Value {
    match worth {
        NetworkBenefit::Floor => json!({ "adds": "nothing", "why": "the physics is at the floor" }),
        NetworkBenefit::Nothing => {
            json!({ "adds": "nothing", "why": "less than 2 % of the error" })
        }
        NetworkBenefit::Share(share) => json!({ "adds": "accuracy", "share": share }),
        NetworkBenefit::Harm(share) => json!({ "adds": "error", "share": share }),
    }
}
