//! Detection rate, latency and false alarms of the disturbance detector over several grippers.
//!
//! Simulated grippers (hysteresis, cross coupling, a warming magnet, manufacturing tolerances), each with a model
//! fitted by `magpie` to three recordings of 100 s; then [`detection`] on new recordings.

mod detection;
mod event;
mod gripper;
mod simulated_rows;

use analysis::progress;
use anyhow::Result;

use detection::DetectionCounts;
use event::MAX_LATENCY;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, intervals};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 4, quick: 1 };
const HOURS: [f64; 2] = [10.0, 0.2];

/// Evaluate the detection of magnetic disturbances.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance magnetic-disturbance --seeds 1 --hours 1")]
pub struct Args {
    /// Hours of simulated time over all grippers [default: 10; quick: 0.2].
    #[arg(long, value_name = "H")]
    hours: Option<f64>,
    /// Omit the magnet temperature from the models.
    #[arg(long)]
    no_temperature: bool,
}

/// Runs one gripper per seed.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let hours = args.hours.unwrap_or(HOURS[usize::from(options.quick)]);
    let grippers = seeds.end - seeds.start;
    let bar = progress::progress_bar("recordings", 0);
    let mut counts = DetectionCounts::default();
    let mut residuals = Vec::new();
    for seed in seeds.clone() {
        let gripper = gripper::Gripper::new(seed, !args.no_temperature)?;
        residuals.push([seed.to_string(), gripper.residuals()]);
        let hours = hours / grippers as f64;
        let counted = detection::evaluate(&gripper.built, &gripper.world, hours, &bar);
        counts = counts.with(counted);
    }
    bar.finish_and_clear();
    let extent = format!("{} grippers, {}, {hours} hours", grippers, seeds_text(&seeds));
    Ok(Section {
        id: "magnetic-disturbance",
        title: "Magnetic disturbance",
        extent,
        conditions: format!(
            "Models without networks. Specified: at least 99 % detected within {MAX_LATENCY} ms, less than 1 false alarm in 10 h."
        ),
        tables: format!(
            "{}\n{}",
            markdown_table(["figure", "simulated", "95 % confidence limits"], rows(&counts)),
            markdown_table(["gripper", "residual (part of the polynomial), G"], residuals)
        ),
        is_met: Some(counts.meets_requirements()),
    })
}

fn rows(counts: &DetectionCounts) -> Vec<[String; 3]> {
    let (latencies, detected) = (counts.latencies(), counts.detected());
    let relevant = latencies.len();
    let [lower, upper] = intervals::proportion(detected, relevant).map(|share| 100.0 * share);
    let latency = |share: f64| match latencies.get((share * relevant as f64) as usize) {
        Some(ms) if ms.is_finite() => format!("{ms:.0}"),
        _ => "never".to_owned(),
    };
    let [least, most] = intervals::poisson(counts.false_alarms);
    let limit_n = counts.alarm_error_n;
    let none = || "-".to_owned();
    vec![
        [
            format!("magnets that changed a force by more than {limit_n:.0} N"),
            format!("{relevant} of {}", counts.events.len()),
            none(),
        ],
        [
            format!("detected within {MAX_LATENCY} ms of that"),
            format!("{:.2} % ({detected})", 100.0 * detected as f64 / relevant as f64),
            format!("{lower:.2} to {upper:.2} %"),
        ],
        ["latency, median, ms (negative: before the force error)".to_owned(), latency(0.5), none()],
        ["latency, p99, ms".to_owned(), latency(0.99), none()],
        [
            format!("false alarms in {:.2} h", counts.hours),
            counts.false_alarms.to_string(),
            format!("{least:.1} to {most:.1}"),
        ],
    ]
}
