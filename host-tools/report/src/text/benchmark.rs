//! Text and JSON of the benchmark.

use analysis::benchmark::evaluate::{LEARNING_VARIANTS, VariantResult};
use analysis::benchmark::train_variants::VariantTrainer;
use analysis::benchmark::variants::{self, EstimatorVariant};
use analysis::benchmark::{Benchmark, NetworkBenefit, network_benefit};
use analysis::numbers;
use serde_json::{Value, json};

use crate::text::calibration::{coverage_json, coverage_percent};
use crate::text::disturbance::{self, detector, summary};
use crate::text::{FORCES as AXES, notes, rms_or_dash, terminal};

/// The order of the paper.
const FORCES: [(usize, &str); 2] = [(1, "Fz"), (0, "Fx")];

/// The report as text.
pub fn format_report(table: &Benchmark, plan: &VariantTrainer) -> String {
    let parts = [
        heading(table),
        error_tables(table),
        terminal::paragraph(&explanation(table, plan)),
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
        let stated = variants::published(result.variant, axis);
        rows.add_row([
            result.variant.words().to_owned(),
            format!("{:.3}", figures.float.rms()),
            format!("{:+.3}", figures.float.mean()),
            format!("{:.3}", figures.float.std()),
            rms_or_dash(figures.float_tared),
            format!("{:.3}", figures.fixed.rms()),
            rms_or_dash(figures.fixed_tared),
            format!("{:.3}", figures.noise_n),
            stated.map_or_else(String::new, |paper| {
                format!("{:.1} {:+.1} {:.1}", paper.rmse_n, paper.mean_n, paper.std_n)
            }),
        ]);
    }
    terminal::right_align(&mut rows, 1);
    rows
}

/// How the figures of the tables are computed.
fn explanation(table: &Benchmark, plan: &VariantTrainer) -> String {
    let data = if table.simulated {
        "These recordings are simulated; the paper's are measured and not public, so its results are not directly comparable. "
    } else {
        "The paper's recordings are not public (another gripper, other loads). "
    };
    let coverage = table
        .of(EstimatorVariant::Gru3Axis)
        .and_then(|result| result.coverage.as_ref())
        .map_or_else(String::new, |coverage| {
            let [one, two, three] = coverage_percent(coverage);
            format!(
                "Coverage of 1, 2 and 3 predicted standard deviations by the 3-axis network after the tare: {one}, {two} and {three} (Gaussian: 68.3, 95.4, 99.7 %; 95 % intervals by block bootstrap). "
            )
        });
    format!(
        "Fixed: device code; previous columns: floating point. Tared: minus the mean estimate over the first unloaded \
         segment (at most 1 s) of each sensor, except within the friction deadband of the physics with effects, as the device \
         does on command. Networks are in steady state at rest when the recording begins. Noise: error of \
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
        None => "The model has no effects, so physics with effects is not evaluated. `cargo magpie diagnose` identifies missing effects, `cargo magpie add` adds them.".to_owned(),
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
            terminal::paragraph(&format!(
                "Magnetic disturbance. {} {words}",
                detector(table, magnet)
            ))
        )
    })
}

/// The 3-axis network compared with the fitted ideal model and with 2 axes, after the tare.
fn axes_gain(table: &Benchmark) -> String {
    let gains = |other: EstimatorVariant| -> Option<[f64; 2]> {
        let (own, other) = (table.of(EstimatorVariant::Gru3Axis)?, table.of(other)?);
        let [x, z] = [0, 1].map(|axis| {
            let tared = |result: &VariantResult| result.axes[axis].fixed_tared;
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

/// The object of `--json`.
pub fn to_json(table: &Benchmark, plan: &VariantTrainer) -> Value {
    let rows = table.results.iter().flat_map(rows_json);
    let coverage = table
        .of(EstimatorVariant::Gru3Axis)
        .and_then(|result| result.coverage.as_ref())
        .map(coverage_json);
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
        "foreign_magnet": table.disturbance.as_ref().map(disturbance::result_json),
        "recordings": table.recordings.0, "held_out": table.recordings.1,
        "training_s": table.training_s, "stopping_s": table.validation_s,
        "effects": table.effects, "simulated": table.simulated,
        "near_zero": plan.zero_weight, "seed": plan.seed(), "epochs": plan.max_epochs(),
        "notes": notes::texts(&table.notes),
    })
}

fn rows_json(result: &VariantResult) -> Vec<Value> {
    let row = |(axis, (_, name)): (usize, (&str, &str))| {
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
