//! Text and JSON of a training.

use analysis::calibration::gaussian;
use analysis::network_training::TrainingResult;
use analysis::notes::Note;
use serde_json::{Value, json};

use crate::text::calibration::{calibration_json, calibration_sentence};
use crate::text::{FORCES, notes, terminal};

pub fn format_report(evaluation: &TrainingResult) -> String {
    let mut table = terminal::table([
        "sensor",
        "force",
        "range",
        "RMSE",
        "mean",
        "ideal RMSE",
        "sigma",
        "within 1",
        "within 2",
        "nats",
    ]);
    for row in &evaluation.forces {
        table.add_row([
            row.sensor.to_string(),
            FORCES[row.axis].0.to_owned(),
            format!("{:.0} to {:.0}", row.range_n[0], row.range_n[1]),
            format!("{:.3}", row.error.rms()),
            format!("{:+.3}", row.error.mean()),
            format!("{:.3}", row.ideal.rms()),
            format!("{:.3}", row.sigma.rms()),
            format!("{:.1} %", 100.0 * row.coverage[0]),
            format!("{:.1} %", 100.0 * row.coverage[1]),
            format!("{:.3}", row.nats),
        ]);
    }
    terminal::right_align(&mut table, 2);
    let head = terminal::paragraph(&format!(
        "Held-out recording {} (used to select the epoch), in newtons: network minus reference at the reference's \
         rows, and the ideal model on the same rows. Coverage of 1 and 2 predicted standard deviations \
         (Gaussian: {:.1} and {:.1} %); nats: mean negative log-likelihood of a force in N.",
        evaluation.held_out,
        100.0 * gaussian(1.0),
        100.0 * gaussian(2.0),
    ));
    let end = verdict(evaluation)
        + &calibration_sentence(&evaluation.sigma)
        + &training_summary(evaluation);
    format!("{head}{table}\n{}", terminal::paragraph(&end))
}

/// Comparison with the ideal model.
fn verdict(evaluation: &TrainingResult) -> String {
    let [own, ideal] = evaluation.pooled_rms_n();
    let conclusion = if evaluation.reduces_the_error() {
        "the networks reduce the error"
    } else {
        "the networks increase the error: train longer or on more data, or omit them"
    };
    format!("Over all forces: {own:.3} N, the ideal model {ideal:.3} N: {conclusion}. ")
}

fn training_summary(evaluation: &TrainingResult) -> String {
    let epochs: Vec<String> = evaluation.found.iter().map(|best| best.epoch.to_string()).collect();
    format!(
        "{} epochs in {:.0} s (including reading); best epoch {}; seed {}.",
        evaluation.epochs,
        evaluation.spent.as_secs_f64(),
        epochs.join(", "),
        evaluation.seed,
    )
}

pub fn to_json(evaluation: &TrainingResult, notes: &[Note]) -> Value {
    let rows = evaluation.forces.iter().map(|row| {
        json!({
            "sensor": row.sensor, "axis": FORCES[row.axis].1, "rows": row.error.rows(),
            "range_n": row.range_n, "rmse_n": row.error.rms(), "mean_n": row.error.mean(),
            "ideal_rmse_n": row.ideal.rms(), "sigma_n": row.sigma.rms(),
            "within_1": row.coverage[0], "within_2": row.coverage[1], "nats": row.nats,
        })
    });
    let networks = evaluation.sensors.iter().zip(&evaluation.found).map(|(sensors, best)| {
        json!({
            "sensors": sensors, "epoch": best.epoch,
            "training_loss": best.training_loss, "held_out_loss": best.held_out_loss,
        })
    });
    json!({
        "verdict": verdict(evaluation).trim(),
        "sensors": rows.collect::<Vec<_>>(),
        "networks": networks.collect::<Vec<_>>(),
        "sigma": calibration_json(&evaluation.sigma),
        "held_out": evaluation.held_out, "epochs": evaluation.epochs, "seed": evaluation.seed,
        "seconds": evaluation.spent.as_secs_f64(), "notes": notes::texts(notes),
    })
}
