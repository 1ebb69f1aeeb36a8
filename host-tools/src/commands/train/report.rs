//! What `magpie train` shows.

use std::time::Duration;

use anyhow::Result;
use model_export::gru::train::course::{Best, Course};
use model_export::gru::train::judge::Told;
use model_export::gru::train::lesson::Sequence;
use serde_json::{Value, json};

use super::sigma::Sigma;
use crate::show;
use crate::sums::Sums;

const FORCES: [(&str, &str); 2] = [("Fx", "x"), ("Fz", "z")];
/// Shares of a Gaussian within one and two standard deviations.
const EXPECTED: [f64; 2] = [0.682_689_492_137_085_9, 0.954_499_736_103_641_6];

/// One force of one sensor on the held-out recording.
pub struct Row {
    sensor: u32,
    axis: usize,
    /// The mean minus the reference, in newtons.
    error: Sums,
    /// The ideal model minus the reference, in newtons.
    ideal: Sums,
    /// The standard deviations that are told, in newtons.
    sigma: Sums,
    /// Least and greatest force of the reference, in newtons.
    range_n: [f64; 2],
    /// Shares of the rows within one and two standard deviations.
    covered: [f64; 2],
    /// Mean negative logarithm of the likelihood of a force in newtons, in nats.
    nats: f64,
}

/// What a training came to.
pub struct Outcome {
    rows: Vec<Row>,
    held_out: String,
    seed: u64,
    epochs: u32,
    sensors: Vec<Vec<u32>>,
    found: Vec<Best>,
    spent: Duration,
    /// How the standard deviations were calibrated.
    pub sigma: Sigma,
}

impl Outcome {
    /// Judges the best weights on the held-out recording.
    pub fn of(course: &Course, held_out: &Sequence, sigma: Sigma, spent: Duration) -> Result<Self> {
        let mut rows = Vec::new();
        for (sensors, forces) in course.groups.iter().zip(course.told()?) {
            for (force, told) in forces.iter().enumerate() {
                let (sensor, axis) = (sensors[force / 2], force % 2);
                let factor = sigma.factor(sensor, axis);
                rows.push(Row::of(course, held_out, (sensor, axis), told, factor));
            }
        }
        Ok(Self {
            rows,
            held_out: held_out.name.clone(),
            seed: course.settings.seed,
            epochs: course.epoch,
            sensors: course.groups.clone(),
            found: course.found.clone(),
            spent,
            sigma,
        })
    }
}

impl Row {
    /// Standard deviations are multiplied by `factor`.
    fn of(
        course: &Course,
        held_out: &Sequence,
        (sensor, axis): (u32, usize),
        told: &[Told],
        factor: f64,
    ) -> Self {
        let scale_n = course.scaling.force_n[axis];
        let mut row = Self {
            sensor,
            axis,
            error: Sums::default(),
            ideal: Sums::default(),
            sigma: Sums::default(),
            range_n: [f64::INFINITY, f64::NEG_INFINITY],
            covered: [0.0; 2],
            nats: 0.0,
        };
        let mut covered = [0_usize; 2];
        for one in told {
            let error = scale_n * (one.mean - one.truth);
            let sigma = factor * scale_n * one.log_sigma.exp();
            row.error.add(error);
            row.sigma.add(sigma);
            for (count, width) in covered.iter_mut().zip([1.0, 2.0]) {
                *count += usize::from(error.abs() <= width * sigma);
            }
            let share = error / sigma;
            row.nats += 0.5 * share * share + sigma.ln() + 0.5 * std::f64::consts::TAU.ln();
        }
        let track = held_out.tracks.iter().find(|track| track.number == sensor);
        for (at, truth) in track.iter().flat_map(|track| {
            let ideal = |row: usize| track.ideal_n[row][axis];
            track
                .truth_n
                .iter()
                .map(move |(at, n)| (ideal(*at), n[axis]))
        }) {
            let truth = f64::from(truth);
            row.ideal.add(f64::from(at) - truth);
            row.range_n = [row.range_n[0].min(truth), row.range_n[1].max(truth)];
        }
        row.covered = covered.map(|count| count as f64 / told.len() as f64);
        row.nats /= told.len() as f64;
        row
    }
}

/// The page.
pub fn text(outcome: &Outcome) -> String {
    let mut table = show::table([
        "sensor",
        "force",
        "range",
        "RMSE",
        "mean",
        "ideal RMSE",
        "told sigma",
        "within 1",
        "within 2",
        "nats",
    ]);
    for row in &outcome.rows {
        table.add_row([
            row.sensor.to_string(),
            FORCES[row.axis].0.to_owned(),
            format!("{:.0} to {:.0}", row.range_n[0], row.range_n[1]),
            format!("{:.3}", row.error.rms()),
            format!("{:+.3}", row.error.mean()),
            format!("{:.3}", row.ideal.rms()),
            format!("{:.3}", row.sigma.rms()),
            format!("{:.1} %", 100.0 * row.covered[0]),
            format!("{:.1} %", 100.0 * row.covered[1]),
            format!("{:.3}", row.nats),
        ]);
    }
    show::right_align(&mut table, 2);
    let head = show::paragraph(&format!(
        "Recording {}, which was not learned from but by which the weights were chosen, in newtons: mean \
         of the network minus reference at the reference's rows, beside the ideal model of the same \
         rows. Within 1 and 2 of the standard deviations that it tells there should be {:.1} and {:.1} % \
         of the rows; nats: mean negative logarithm of the likelihood of a force in N, the less the better.",
        outcome.held_out,
        100.0 * EXPECTED[0],
        100.0 * EXPECTED[1],
    ));
    let end = verdict(outcome) + &outcome.sigma.text() + &ending(outcome);
    format!("{head}{table}\n{}", show::paragraph(&end))
}

/// Beside the ideal model, which needs no training.
fn verdict(outcome: &Outcome) -> String {
    let pooled = |of: fn(&Row) -> Sums| {
        let sums = outcome.rows.iter().map(of);
        sums.fold(Sums::default(), Sums::with).rms()
    };
    let (own, ideal) = (pooled(|row| row.error), pooled(|row| row.ideal));
    let worth = match own < ideal {
        true => "the networks are better",
        false => {
            "the networks are worse than the model alone: train longer, on more or longer recordings, or leave them out"
        }
    };
    format!("Over all forces: {own:.3} N, the ideal model {ideal:.3} N: {worth}. ")
}

fn ending(outcome: &Outcome) -> String {
    let epochs: Vec<String> = outcome
        .found
        .iter()
        .map(|best| best.epoch.to_string())
        .collect();
    format!(
        "{} epochs in {:.0} s (reading and all); best after {}; seed {}.",
        outcome.epochs,
        outcome.spent.as_secs_f64(),
        epochs.join(", "),
        outcome.seed,
    )
}

/// The object of `--json`.
pub fn json(outcome: &Outcome, notes: &[String]) -> Value {
    let rows = outcome.rows.iter().map(|row| {
        json!({
            "sensor": row.sensor, "axis": FORCES[row.axis].1, "rows": row.error.rows(),
            "range_n": row.range_n, "rmse_n": row.error.rms(), "mean_n": row.error.mean(),
            "ideal_rmse_n": row.ideal.rms(), "sigma_n": row.sigma.rms(),
            "within_1": row.covered[0], "within_2": row.covered[1], "nats": row.nats,
        })
    });
    let networks = outcome
        .sensors
        .iter()
        .zip(&outcome.found)
        .map(|(sensors, best)| {
            json!({
                "sensors": sensors, "epoch": best.epoch,
                "training_loss": best.training_loss, "held_out_loss": best.held_out_loss,
            })
        });
    json!({
        "sensors": rows.collect::<Vec<_>>(),
        "networks": networks.collect::<Vec<_>>(),
        "sigma": outcome.sigma.json(),
        "held_out": outcome.held_out, "epochs": outcome.epochs, "seed": outcome.seed,
        "seconds": outcome.spent.as_secs_f64(), "notes": notes,
    })
}
