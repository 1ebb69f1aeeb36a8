//! Text and JSON of a replay.

use analysis::compare::ForceError;
use analysis::replay::evaluation::{
    NetworkComparison, PooledAxis, ReplayEvaluation, coverage_fractions, pooled, pooled_error,
    rejected_fraction, times_real_time,
};
use analysis::replay::tare::TARE_HARM;
use analysis::replay::{AxisReplay, RecordingReplay, coverage};
use serde_json::{Value, json};

use crate::text::calibration::{coverage_json, coverage_percent};
use crate::text::terminal::{self, or_dash};
use crate::text::{FORCES, force_error, notes, rms_or_dash};

pub fn format_report(evaluation: &ReplayEvaluation) -> String {
    format!(
        "{}\n{}{}{}\n{}",
        force_table(evaluation),
        network_report(evaluation).unwrap_or_default(),
        without_compensation(evaluation).unwrap_or_default(),
        by_recording(evaluation),
        model_table(evaluation)
    )
}

/// Force error of the device code over all recordings.
fn force_table(evaluation: &ReplayEvaluation) -> String {
    let mut table = terminal::table([
        "sensor",
        "force",
        "RMSE",
        "mean",
        "std",
        "RMSE tared",
        "noise",
        "float RMSE",
        "fixed - float",
    ]);
    for pooled in pooled(&evaluation.fitted) {
        let error = pooled.sum(|track| track.error);
        let difference = pooled.sum(|track| track.fixed_minus_float).rms();
        table.add_row([
            pooled.sensor.to_string(),
            FORCES[pooled.axis].0.to_owned(),
            rms_or_dash(Some(error)),
            or_dash(error.mean(), format!("{:+.3}", error.mean())),
            or_dash(error.mean(), format!("{:.3}", error.std())),
            rms_or_dash(pooled.tared()),
            or_dash(error.mean(), format!("{:.3}", pooled.noise_n())),
            rms_or_dash(Some(pooled.sum(|track| track.float))),
            or_dash(difference, format!("{difference:.4}")),
        ]);
    }
    terminal::right_align(&mut table, 2);
    let rows: u64 = evaluation.fitted.iter().map(|r| r.rows).sum();
    let error = force(evaluation);
    let mut headline = terminal::paragraph(&force_error::headline(&error));
    for sentence in force_error::origins(&error, &evaluation.origins) {
        headline += &terminal::paragraph(&sentence);
    }
    format!(
        "{headline}\nForce error of the device code in newtons: device minus (linearly interpolated) reference. Noise:\n\
         the error due to white noise of sensor and reference, and to interpolation between rows of the\n\
         reference, alone.\n{table}\n\
         {}{}{}{}\n{}{rows} rows, {:.0} times real time on one core (including reading).\n",
        tare_line(&evaluation.fitted),
        tare_warning(evaluation).unwrap_or_default(),
        large_error_warning(evaluation).unwrap_or_default(),
        invalid_line(&evaluation.fitted),
        terminal::paragraph(&disturbed_line(&evaluation.fitted)),
        times_real_time(&evaluation.fitted),
    )
}

/// Error over all forces.
fn force(evaluation: &ReplayEvaluation) -> ForceError {
    pooled_error(&evaluation.fitted, evaluation.reducible.as_deref(), evaluation.rows())
}

/// Benefit of the compensation on the device.
fn without_compensation(evaluation: &ReplayEvaluation) -> Option<String> {
    let without = evaluation.uncompensated.as_ref()?;
    let (with, without) = (force(evaluation), pooled_error(without, None, evaluation.rows()));
    Some(format!(
        "Excess over noise without the compensation of the model's effects {:.3} N, with it {:.3} N.\n\n",
        without.excess_n(),
        with.excess_n(),
    ))
}

fn tare_line(recordings: &[RecordingReplay]) -> String {
    let tares = recordings.iter().flat_map(|r| r.sensors.iter().map(|s| s.axes[0].tare));
    let lengths: Vec<Option<f64>> = tares.map(|tare| tare.map(|(_, length)| length)).collect();
    let shortest = lengths.iter().flatten().copied().fold(f64::INFINITY, f64::min);
    if lengths.iter().any(Option::is_none) {
        return "Some recordings have no unloaded segment of 0.2 s and are not tared (-): record an unloaded\n\
                second at the start.\n"
            .to_owned();
    }
    format!(
        "Tare: mean over the first unloaded segment, at most 1 s (here {shortest:.2} s); none within the\n\
         friction deadband.\n"
    )
}

fn invalid_line(recordings: &[RecordingReplay]) -> String {
    let invalid: u64 = recordings.iter().flat_map(|r| r.sensors.iter().map(|s| s.invalid)).sum();
    match invalid {
        0 => "The device reported every estimate as valid.".to_owned(),
        n => format!(
            "The device reported {n} estimates as invalid (saturated, or outside the model): excluded."
        ),
    }
}

/// The magnetic disturbances that the device detected.
fn disturbed_line(recordings: &[RecordingReplay]) -> String {
    let segment = |recording: &RecordingReplay, [from, to]: &[f64; 2]| {
        format!("{from:.2} to {to:.2} s of recording {}", recording.name)
    };
    let all = recordings.iter();
    let all: Vec<String> = all
        .flat_map(|recording| recording.disturbed_s.iter().map(|s| segment(recording, s)))
        .collect();
    match all.len() {
        0 => "It detected no magnetic disturbance.".to_owned(),
        n if n > MAX_SEGMENTS => format!(
            "It detected {n} magnetic disturbances, the first from {}: which effect on the field is not in the model?",
            all[0]
        ),
        _ => format!("It detected a magnetic disturbance from {}.", all.join(", ")),
    }
}

/// Maximum number of disturbances listed individually.
const MAX_SEGMENTS: usize = 3;

fn by_recording(evaluation: &ReplayEvaluation) -> String {
    let heads = evaluation.fitted.iter().map(|recording| {
        let is_training = evaluation.training_recordings.contains(&recording.name);
        format!("{} ({})", recording.name, if is_training { "fitted" } else { "held out" })
    });
    let labels = ["sensor", "force"].map(String::from);
    let mut table = terminal::table(labels.into_iter().chain(heads));
    for pooled in pooled(&evaluation.fitted) {
        let cells = pooled.recordings.iter().map(|track| rms_or_dash(track.tared()));
        let labels = [pooled.sensor.to_string(), FORCES[pooled.axis].0.to_owned()];
        table.add_row(labels.into_iter().chain(cells).collect::<Vec<_>>());
    }
    terminal::right_align(&mut table, 2);
    format!("RMSE after tare by recording\n{table}\n")
}

/// Warning if taring increases the error: the field at rest was then not that of zero force.
fn tare_warning(evaluation: &ReplayEvaluation) -> Option<String> {
    let worse = |track: &AxisReplay| {
        track.tared().is_some_and(|tared| tared.rms() > TARE_HARM * track.error.rms())
    };
    let harmed: Vec<&str> = evaluation
        .fitted
        .iter()
        .filter(|recording| recording.sensors.iter().any(|s| s.axes.iter().any(worse)))
        .map(|recording| recording.name.as_str())
        .collect();
    (!harmed.is_empty()).then(|| {
        format!(
            "In recording {} taring increases the error: another effect changed the field at rest.\n",
            harmed.join(", ")
        )
    })
}

/// Warning at errors above a tenth of the range, which indicate a setup error.
fn large_error_warning(evaluation: &ReplayEvaluation) -> Option<String> {
    let limit = 0.1 * evaluation.force_range_n;
    let worst = pooled(evaluation.without_networks.as_ref().unwrap_or(&evaluation.fitted))
        .iter()
        .map(|p| p.sum(|t| t.error).std())
        .fold(0.0, f64::max);
    (worst > limit).then(|| {
        format!("Errors above {limit:.0} N: is this the model's gripper? Are columns swapped or inverted? `cargo magpie fit` checks this.\n")
    })
}

/// Errors of simpler models on the same recordings.
fn model_table(evaluation: &ReplayEvaluation) -> String {
    let mut table = terminal::table([
        "sensor",
        "force",
        "ideal raw",
        "tared",
        "linear raw",
        "tared",
        "fitted raw",
        "tared",
    ]);
    let (fitted, linear, nominal) = (
        pooled(evaluation.without_networks.as_ref().unwrap_or(&evaluation.fitted)),
        pooled(&evaluation.linear),
        evaluation.nominal.as_deref().map(pooled),
    );
    for (place, (fitted, linear)) in fitted.iter().zip(&linear).enumerate() {
        let nominal = nominal.as_ref().and_then(|nominal| nominal.get(place));
        table.add_row([
            fitted.sensor.to_string(),
            FORCES[fitted.axis].0.to_owned(),
            rms_or_dash(nominal.map(|nominal| nominal.sum(|track| track.error))),
            rms_or_dash(nominal.and_then(PooledAxis::tared)),
            rms_or_dash(Some(linear.sum(|track| track.error))),
            rms_or_dash(linear.tared()),
            rms_or_dash(Some(fitted.sum(|track| track.error))),
            rms_or_dash(fitted.tared()),
        ]);
    }
    terminal::right_align(&mut table, 2);
    format!(
        "RMSE of simpler models in the same code: nominal design (the paper's ideal model) and best linear\n\
         model of the fit; raw and after the tare\n{table}\n"
    )
}

pub fn to_json(evaluation: &ReplayEvaluation) -> Value {
    let spent = times_real_time(&evaluation.fitted);
    json!({
        "sensors": pooled(&evaluation.fitted).iter().map(sensor_json).collect::<Vec<_>>(),
        "recordings": evaluation.fitted.iter().map(|recording| {
            let own = std::slice::from_ref(recording);
            json!({
                "name": recording.name, "rows": recording.rows,
                "held_out": !evaluation.training_recordings.contains(&recording.name),
                "disturbed_s": recording.disturbed_s,
                "invalid": recording.sensors.iter().map(|s| s.invalid).sum::<u64>(),
                "sensors": pooled(own).iter().map(sensor_json).collect::<Vec<_>>(),
            })
        }).collect::<Vec<_>>(),
        "linear": pooled(&evaluation.linear).iter().map(sensor_json).collect::<Vec<_>>(),
        "nominal": evaluation
            .nominal
            .as_deref()
            .map(|nominal| pooled(nominal).iter().map(sensor_json).collect::<Vec<_>>()),
        "force": force(evaluation),
        "force_origins": force_error::origins(&force(evaluation), &evaluation.origins),
        "uncompensated_force": evaluation
            .uncompensated
            .as_deref()
            .map(|without| pooled_error(without, None, evaluation.rows())),
        "networks": network_json(evaluation),
        "notes": notes::texts(&evaluation.notes),
        "rows": evaluation.fitted.iter().map(|r| r.rows).sum::<u64>(),
        "times_real_time": spent,
    })
}

fn sensor_json(pooled: &PooledAxis) -> Value {
    let error = pooled.sum(|track| track.error);
    let mut axis = json!({
        "sensor": pooled.sensor, "axis": FORCES[pooled.axis].1,
        "rmse_n": error.rms(), "mean_n": error.mean(), "std_n": error.std(),
        "tared_rmse_n": pooled.tared().map(|sums| sums.rms()),
        "noise_n": pooled.noise_n(),
    });
    let float = pooled.sum(|track| track.float);
    if float.rows() > 0.0 {
        axis["float_rmse_n"] = json!(float.rms());
        let rounding = pooled.sum(|track| track.fixed_minus_float);
        axis["fixed_minus_float_rms_n"] = json!(rounding.rms());
    }
    axis
}

fn coverage_line(recordings: &[RecordingReplay]) -> String {
    coverage(recordings).map_or_else(String::new, |coverage| {
        let [one, two, three] = coverage_percent(&coverage);
        terminal::paragraph(&format!(
            "Coverage after the tare over all forces, 1, 2 and 3 sigma: {one}, {two}, {three} (Gaussian: 68.3, 95.4, \
             99.7 %; 95 % intervals by bootstrap of {} blocks of 5 s, 1000 draws).",
            coverage.blocks,
        ))
    })
}

fn rejection_sentence(recordings: &[RecordingReplay]) -> String {
    let mut numbers: Vec<u32> = pooled(recordings).iter().map(|p| p.sensor).collect();
    numbers.dedup();
    let fractions: Vec<String> = numbers
        .into_iter()
        .map(|number| (number, rejected_fraction(recordings, number)))
        .filter(|(_, share)| *share > 0.0)
        .map(|(number, share)| format!("{:.2} % of the time at sensor {number}", 100.0 * share))
        .collect();
    if fractions.is_empty() {
        return String::new();
    }
    terminal::paragraph(&format!(
        "Network output rejected for {}: the device then reports the ideal model's forces without a \
         standard deviation; the columns \"with\" and \"float\" include these rows.",
        fractions.join(", ")
    ))
}

fn network_report(evaluation: &ReplayEvaluation) -> Option<String> {
    let comparison = NetworkComparison::of(evaluation)?;
    let mut table = terminal::table([
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
    for (with, without) in pooled(&comparison.with).iter().zip(pooled(&comparison.without)) {
        let rms = |value: f64| format!("{value:.3}");
        let share = |share: f64| format!("{:.1} %", 100.0 * share);
        let [one, two] = coverage_fractions(with)
            .map_or_else(|| [(); 2].map(|()| "-".to_owned()), |c| c.map(share));
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
    terminal::right_align(&mut table, 2);
    let [without_n, with_n] = [&comparison.without, &comparison.with]
        .map(|replays| pooled_error(replays, None, comparison.rows()).rms_n);
    Some(format!(
        "Recurrent networks, in newtons, on {}:\n\
         RMSE without and with networks, with networks in floating point, predicted standard deviation and\n\
         coverage of one and two of it (Gaussian: 68.3 and 95.4 %).\n{table}\n\
         Over all forces: RMSE {:.3} N without, {:.3} N with. {}\n{}{}\n",
        if comparison.held_out { "held-out recordings" } else { "training recordings" },
        without_n,
        with_n,
        network_verdict(without_n, with_n),
        rejection_sentence(&comparison.with),
        coverage_line(&comparison.with),
    ))
}

/// Minimum relative change of the error that counts.
const MIN_BENEFIT: f64 = 0.02;

fn network_verdict(without_n: f64, with_n: f64) -> &'static str {
    match with_n / without_n {
        ratio if ratio < 1.0 - MIN_BENEFIT => "The networks reduce the error.",
        ratio if ratio > 1.0 + MIN_BENEFIT => "The networks increase the error: omit them.",
        _ => "The networks have no significant benefit: omit them.",
    }
}

/// Part of `--json`; null without networks.
fn network_json(evaluation: &ReplayEvaluation) -> Value {
    let Some(comparison) = NetworkComparison::of(evaluation) else {
        return Value::Null;
    };
    let rows: Vec<Value> = pooled(&comparison.with)
        .iter()
        .zip(pooled(&comparison.without))
        .map(|(with, without)| {
            let [one, two] =
                coverage_fractions(with).map_or([None; 2], |covered| covered.map(Some));
            json!({
                "sensor": with.sensor, "axis": FORCES[with.axis].1,
                "without_rmse_n": without.sum(|track| track.error).rms(),
                "rmse_n": with.sum(|track| track.error).rms(),
                "float_rmse_n": with.sum(|track| track.float).rms(),
                "fixed_minus_float_rms_n": with.sum(|track| track.fixed_minus_float).rms(),
                "sigma_n": with.sum(|track| track.sigma).rms(),
                "not_believed": rejected_fraction(&comparison.with, with.sensor),
                "within_1_sigma": one, "within_2_sigma": two,
            })
        })
        .collect();
    json!({
        "held_out": comparison.held_out, "sensors": rows,
        "coverage": coverage(&comparison.with).as_ref().map(coverage_json),
        "without_force": pooled_error(&comparison.without, None, comparison.rows()),
        "force": pooled_error(&comparison.with, None, comparison.rows()),
    })
}
