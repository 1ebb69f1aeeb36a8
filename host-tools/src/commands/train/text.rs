//! Evaluation and report of `magpie train`.

use std::time::Duration;

use anyhow::Result;
use model_export::gru::train::dataset::Sequence;
use model_export::gru::train::forward::Prediction;
use model_export::gru::train::trainer::{BestEpoch, Trainer};
use serde_json::{Value, json};

use analysis::network_calibration::NetworkCalibration;
use analysis::statistics::Moments;
use report::text::terminal;

const FORCES: [(&str, &str); 2] = [("Fx", "x"), ("Fz", "z")];
/// Coverage of one and two standard deviations by a Gaussian.
const GAUSSIAN_COVERAGE: [f64; 2] = [0.682_689_492_137_085_9, 0.954_499_736_103_641_6];

/// One force of one sensor on the held-out recording.
struct ForceEvaluation {
    sensor: u32,
    axis: usize,
    /// Network minus reference in newtons.
    error: Moments,
    /// Ideal model minus reference in newtons.
    ideal: Moments,
    /// Predicted standard deviations in newtons.
    sigma: Moments,
    /// Range of the reference force in newtons.
    range_n: [f64; 2],
    /// Coverage of one and two standard deviations.
    coverage: [f64; 2],
    /// Mean negative log-likelihood of a force in newtons, in nats.
    nats: f64,
}

/// Result of a training.
pub struct Evaluation {
    rows: Vec<ForceEvaluation>,
    held_out: String,
    seed: u64,
    epochs: u32,
    sensors: Vec<Vec<u32>>,
    found: Vec<BestEpoch>,
    spent: Duration,
    /// Calibration of the standard deviations.
    pub sigma: NetworkCalibration,
}

impl Evaluation {
    /// Evaluates the best weights on the held-out recording.
    pub fn of(
        trainer: &Trainer,
        held_out: &Sequence,
        sigma: NetworkCalibration,
        spent: Duration,
    ) -> Result<Self> {
        let mut rows = Vec::new();
        for (sensors, forces) in trainer.groups.iter().zip(trainer.predictions()?) {
            for (force, samples) in forces.iter().enumerate() {
                let (sensor, axis) = (sensors[force / 2], force % 2);
                let factor = sigma.sigma_factor(sensor, axis);
                rows.push(ForceEvaluation::of(trainer, held_out, (sensor, axis), samples, factor));
            }
        }
        Ok(Self {
            rows,
            held_out: held_out.name.clone(),
            seed: trainer.settings.seed,
            epochs: trainer.epoch,
            sensors: trainer.groups.clone(),
            found: trainer.found.clone(),
            spent,
            sigma,
        })
    }
}

impl ForceEvaluation {
    /// Standard deviations are multiplied by `factor`.
    fn of(
        trainer: &Trainer,
        held_out: &Sequence,
        (sensor, axis): (u32, usize),
        samples: &[Prediction],
        factor: f64,
    ) -> Self {
        let scale_n = trainer.scaling.force_n[axis];
        let mut row = Self {
            sensor,
            axis,
            error: Moments::default(),
            ideal: Moments::default(),
            sigma: Moments::default(),
            range_n: [f64::INFINITY, f64::NEG_INFINITY],
            coverage: [0.0; 2],
            nats: 0.0,
        };
        let mut covered = [0_usize; 2];
        for sample in samples {
            let error = scale_n * (sample.mean - sample.truth);
            let sigma = factor * scale_n * sample.log_sigma.exp();
            row.error.add(error);
            row.sigma.add(sigma);
            for (count, width) in covered.iter_mut().zip([1.0, 2.0]) {
                *count += usize::from(error.abs() <= width * sigma);
            }
            let z = error / sigma;
            row.nats += 0.5 * z * z + sigma.ln() + 0.5 * std::f64::consts::TAU.ln();
        }
        let track = held_out.tracks.iter().find(|track| track.number == sensor);
        for (at, truth) in track.iter().flat_map(|track| {
            let ideal = |row: usize| track.ideal_n[row][axis];
            track.truth_n.iter().map(move |(at, n)| (ideal(*at), n[axis]))
        }) {
            let truth = f64::from(truth);
            row.ideal.add(f64::from(at) - truth);
            row.range_n = [row.range_n[0].min(truth), row.range_n[1].max(truth)];
        }
        row.coverage = covered.map(|count| count as f64 / samples.len() as f64);
        row.nats /= samples.len() as f64;
        row
    }
}

/// The report as text.
pub fn format_report(evaluation: &Evaluation) -> String {
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
    for row in &evaluation.rows {
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
        100.0 * GAUSSIAN_COVERAGE[0],
        100.0 * GAUSSIAN_COVERAGE[1],
    ));
    let end = verdict(evaluation) + &evaluation.sigma.text() + &training_summary(evaluation);
    format!("{head}{table}\n{}", terminal::paragraph(&end))
}

/// Comparison with the ideal model.
fn verdict(evaluation: &Evaluation) -> String {
    let pooled = |of: fn(&ForceEvaluation) -> Moments| {
        let sums = evaluation.rows.iter().map(of);
        sums.fold(Moments::default(), Moments::with).rms()
    };
    let (own, ideal) = (pooled(|row| row.error), pooled(|row| row.ideal));
    let conclusion = if own < ideal {
        "the networks reduce the error"
    } else {
        "the networks increase the error: train longer or on more data, or omit them"
    };
    format!("Over all forces: {own:.3} N, the ideal model {ideal:.3} N: {conclusion}. ")
}

fn training_summary(evaluation: &Evaluation) -> String {
    let epochs: Vec<String> = evaluation.found.iter().map(|best| best.epoch.to_string()).collect();
    format!(
        "{} epochs in {:.0} s (including reading); best epoch {}; seed {}.",
        evaluation.epochs,
        evaluation.spent.as_secs_f64(),
        epochs.join(", "),
        evaluation.seed,
    )
}

/// The object of `--json`.
pub fn to_json(evaluation: &Evaluation, notes: &[String]) -> Value {
    let rows = evaluation.rows.iter().map(|row| {
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
        "sensors": rows.collect::<Vec<_>>(),
        "networks": networks.collect::<Vec<_>>(),
        "sigma": evaluation.sigma.json(),
        "held_out": evaluation.held_out, "epochs": evaluation.epochs, "seed": evaluation.seed,
        "seconds": evaluation.spent.as_secs_f64(), "notes": notes,
    })
}
