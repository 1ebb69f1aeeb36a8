//! What the recurrent networks of a replay are worth.

use serde_json::{Value, json};

use super::Outcome;
use super::report::{FORCES, Pooled, pooled, rmse_n};
use crate::coverage::Coverage;
use crate::replay::{RecordingReplay, coverage};
use crate::show;

/// The model with the networks and without them, on recordings that neither has seen where there are
/// some.
struct Sides {
    held_out: bool,
    with: Vec<RecordingReplay>,
    without: Vec<RecordingReplay>,
}

impl Sides {
    fn of(outcome: &Outcome) -> Option<Self> {
        let alone = outcome.alone.as_ref()?;
        let unseen = |recordings: &[RecordingReplay]| -> Vec<RecordingReplay> {
            let unseen = recordings
                .iter()
                .filter(|recording| !outcome.seen.contains(&recording.name));
            unseen.cloned().collect()
        };
        let (with, without) = (unseen(&outcome.fitted), unseen(alone));
        Some(match with.is_empty() {
            true => Self {
                held_out: false,
                with: outcome.fitted.clone(),
                without: alone.clone(),
            },
            false => Self {
                held_out: true,
                with,
                without,
            },
        })
    }
}

/// Shares of the errors within one and two standard deviations, of the rows that have one.
fn covered(pooled: &Pooled) -> Option<[f64; 2]> {
    let told = pooled.sum(|track| track.sigma).rows();
    let within = |width: usize| -> u64 { pooled.tracks.iter().map(|t| t.within[width]).sum() };
    (told > 0.0).then(|| [0, 1].map(|width| within(width) as f64 / told))
}

fn coverage_line(recordings: &[RecordingReplay]) -> String {
    coverage(recordings).map_or_else(String::new, |found| {
        show::paragraph(&format!(
            "After the tare, over all forces, within 1, 2 and 3 sigma: {}, {}, {} (a Gaussian: 68.3, 95.4, \
             99.7 %; {} blocks of 5 s drawn 1000 times, 95 %).",
            found.words(0),
            found.words(1),
            found.words(2),
            found.blocks,
        ))
    })
}

/// Share of a sensor's rows in which the device did not believe its network.
fn not_believed(recordings: &[RecordingReplay], number: u32) -> f64 {
    let (mut astray, mut rows) = (0, 0);
    for recording in recordings {
        for sensor in recording.sensors.iter().filter(|s| s.number == number) {
            astray += sensor.astray;
            rows += recording.rows;
        }
    }
    astray as f64 / rows.max(1) as f64
}

fn belief_line(recordings: &[RecordingReplay]) -> String {
    let mut numbers: Vec<u32> = pooled(recordings).iter().map(|p| p.sensor).collect();
    numbers.dedup();
    let said: Vec<String> = numbers
        .into_iter()
        .map(|number| (number, not_believed(recordings, number)))
        .filter(|(_, share)| *share > 0.0)
        .map(|(number, share)| format!("{:.2} % of the time at sensor {number}", 100.0 * share))
        .collect();
    if said.is_empty() {
        return String::new();
    }
    show::paragraph(&format!(
        "Far from the ideal model for {}: the device tells the ideal model's forces then, and no \
         standard deviation; both columns \"with\" and \"float\" have these.",
        said.join(", ")
    ))
}

/// The table, where there are networks.
pub fn text(outcome: &Outcome) -> Option<String> {
    let sides = Sides::of(outcome)?;
    let mut table = show::table([
        "sensor",
        "force",
        "without",
        "with",
        "float",
        "fixed - float",
        "noise",
        "sigma",
        "1 sigma",
        "2 sigma",
    ]);
    for (with, without) in pooled(&sides.with).iter().zip(pooled(&sides.without)) {
        let rms = |value: f64| format!("{value:.3}");
        let share = |share: f64| format!("{:.1} %", 100.0 * share);
        let [one, two] =
            covered(with).map_or_else(|| [(); 2].map(|()| "-".to_owned()), |c| c.map(share));
        table.add_row([
            with.sensor.to_string(),
            FORCES[with.axis].0.to_owned(),
            rms(without.sum(|track| track.error).rms()),
            rms(with.sum(|track| track.error).rms()),
            rms(with.sum(|track| track.float).rms()),
            format!("{:.4}", with.sum(|track| track.fixed_minus_float).rms()),
            rms(with.noise_n()),
            rms(with.sum(|track| track.sigma).rms()),
            one,
            two,
        ]);
    }
    show::right_align(&mut table, 2);
    Some(format!(
        "With the recurrent networks behind the model, in newtons,\n\
         on {}:\n\
         RMSE without and with them, the same networks in floating point, the standard deviation that\n\
         they tell and the share of errors within one and two of it (a Gaussian has 68.3 and 95.4 %).\n{table}\n\
         Over all forces there: RMSE {:.3} N without, {:.3} N with. {}\n{}{}\n",
        match sides.held_out {
            true => "recordings that neither has seen",
            false => "recordings that they were fitted to or learned from",
        },
        rmse_n(&sides.without),
        rmse_n(&sides.with),
        verdict(rmse_n(&sides.without), rmse_n(&sides.with)),
        belief_line(&sides.with),
        coverage_line(&sides.with),
    ))
}

/// Less than this share is no difference worth a network.
const WORTH: f64 = 0.02;

fn verdict(without_n: f64, with_n: f64) -> &'static str {
    match with_n / without_n {
        ratio if ratio < 1.0 - WORTH => "They help.",
        ratio if ratio > 1.0 + WORTH => "They harm: leave them out.",
        _ => "They add nothing here: leave them out.",
    }
}

/// For `--json`; null without networks.
pub fn json(outcome: &Outcome) -> Value {
    let Some(sides) = Sides::of(outcome) else {
        return Value::Null;
    };
    let rows: Vec<Value> = pooled(&sides.with)
        .iter()
        .zip(pooled(&sides.without))
        .map(|(with, without)| {
            let [one, two] = covered(with).map_or([None; 2], |covered| covered.map(Some));
            json!({
                "sensor": with.sensor, "axis": FORCES[with.axis].1,
                "without_rmse_n": without.sum(|track| track.error).rms(),
                "rmse_n": with.sum(|track| track.error).rms(),
                "float_rmse_n": with.sum(|track| track.float).rms(),
                "fixed_minus_float_rms_n": with.sum(|track| track.fixed_minus_float).rms(),
                "sigma_n": with.sum(|track| track.sigma).rms(),
                "not_believed": not_believed(&sides.with, with.sensor),
                "within_1_sigma": one, "within_2_sigma": two,
            })
        })
        .collect();
    json!({
        "held_out": sides.held_out, "sensors": rows,
        "coverage": coverage(&sides.with).as_ref().map(Coverage::json),
        "without_rmse_n": rmse_n(&sides.without), "rmse_n": rmse_n(&sides.with),
    })
}
