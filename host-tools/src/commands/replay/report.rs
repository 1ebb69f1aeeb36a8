//! What `magpie replay` shows.

use serde_json::{Value, json};

use super::{Outcome, networks};
use crate::replay::{RecordingReplay, Sums, Track};
use crate::show;

/// A tare that multiplies the error by this is worth a word.
const TARE_HARM: f64 = 1.2;

pub(super) const FORCES: [(&str, &str); 2] = [("Fx", "x"), ("Fz", "z")];

/// One force of one sensor over all recordings.
pub(super) struct Pooled {
    pub(super) sensor: u32,
    pub(super) axis: usize,
    pub(super) tracks: Vec<Track>,
}

impl Pooled {
    pub(super) fn sum(&self, of: impl Fn(&Track) -> Sums) -> Sums {
        self.tracks
            .iter()
            .fold(Sums::default(), |sum, track| sum.with(of(track)))
    }

    /// Root mean square of white noise alone, all recordings.
    pub(super) fn noise_n(&self) -> f64 {
        let squares: f64 = self.tracks.iter().map(|track| track.noise_n.powi(2)).sum();
        (squares / self.tracks.len().max(1) as f64).sqrt()
    }

    /// `None` where one of the recordings has no unloaded stretch.
    fn tared(&self) -> Option<Sums> {
        let mut sum = Sums::default();
        for track in &self.tracks {
            sum = sum.with(track.tared()?);
        }
        Some(sum)
    }
}

pub(super) fn pooled(recordings: &[RecordingReplay]) -> Vec<Pooled> {
    let mut numbers: Vec<u32> = recordings
        .iter()
        .flat_map(|r| r.sensors.iter().map(|s| s.number))
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    let tracks = |number: u32, axis: usize| {
        let sensors = recordings.iter().flat_map(|r| &r.sensors);
        sensors
            .filter(|s| s.number == number)
            .map(|s| s.axes[axis])
            .collect()
    };
    numbers
        .into_iter()
        .flat_map(|sensor| {
            [0, 1].map(|axis| Pooled {
                sensor,
                axis,
                tracks: tracks(sensor, axis),
            })
        })
        .collect()
}

/// Seconds of recording for each second spent reading and estimating, on one core.
fn times_real_time(recordings: &[RecordingReplay]) -> f64 {
    let spent: f64 = recordings.iter().map(|r| r.spent.as_secs_f64()).sum();
    recordings.iter().map(|r| r.span_s).sum::<f64>() / spent
}

fn newtons(sums: Option<Sums>) -> String {
    sums.map_or_else(|| "-".to_owned(), |sums| format!("{:.3}", sums.rms()))
}

/// The page.
pub fn text(outcome: &Outcome) -> String {
    format!(
        "{}\n{}{}{}\n{}",
        forces(outcome),
        networks::text(outcome).unwrap_or_default(),
        without_compensation(outcome).unwrap_or_default(),
        by_recording(outcome),
        beside(outcome)
    )
}

/// Errors of the device's code against the reference, all recordings.
pub fn forces(outcome: &Outcome) -> String {
    let mut table = show::table([
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
    for pooled in pooled(&outcome.fitted) {
        let error = pooled.sum(|track| track.error);
        table.add_row([
            pooled.sensor.to_string(),
            FORCES[pooled.axis].0.to_owned(),
            format!("{:.3}", error.rms()),
            format!("{:+.3}", error.mean()),
            format!("{:.3}", error.std()),
            newtons(pooled.tared()),
            format!("{:.3}", pooled.noise_n()),
            format!("{:.3}", pooled.sum(|track| track.float).rms()),
            format!("{:.4}", pooled.sum(|track| track.fixed_minus_float).rms()),
        ]);
    }
    show::right_align(&mut table, 2);
    let rows: u64 = outcome.fitted.iter().map(|r| r.rows).sum();
    format!(
        "Every row through the device's code, in newtons, device minus reference (on a straight line between\n\
         its rows). Noise: what white noise of sensor and reference alone would leave.\n{table}\n\
         {}{}{}{}\n{}{rows} rows, {:.0} times real time on one core (reading and the device's code).\n",
        tare_line(&outcome.fitted),
        tare_harms(outcome).unwrap_or_default(),
        far_off(outcome).unwrap_or_default(),
        invalid_line(&outcome.fitted),
        show::paragraph(&disturbed_line(&outcome.fitted)),
        times_real_time(&outcome.fitted),
    )
}

/// What undoing the effects on the device is worth.
pub fn without_compensation(outcome: &Outcome) -> Option<String> {
    let without = outcome.uncompensated.as_ref()?;
    Some(format!(
        "Over all forces: RMSE {:.3} N with the model's effects undone on the device, {:.3} N without.\n\n",
        rmse_n(&outcome.fitted),
        rmse_n(without),
    ))
}

/// Root mean square error over all forces of all sensors, in newtons.
pub fn rmse_n(recordings: &[RecordingReplay]) -> f64 {
    let axes = recordings
        .iter()
        .flat_map(|r| r.sensors.iter().flat_map(|s| &s.axes));
    axes.fold(Sums::default(), |sum, track| sum.with(track.error))
        .rms()
}

fn tare_line(recordings: &[RecordingReplay]) -> String {
    let tares = recordings
        .iter()
        .flat_map(|r| r.sensors.iter().map(|s| s.axes[0].tare));
    let lengths: Vec<Option<f64>> = tares.map(|tare| tare.map(|(_, length)| length)).collect();
    let shortest = lengths
        .iter()
        .flatten()
        .copied()
        .fold(f64::INFINITY, f64::min);
    if lengths.iter().any(Option::is_none) {
        return "Some recordings never rest without load for 0.2 s: they cannot be tared (-). Record an\n\
                unloaded second at the start.\n"
            .to_owned();
    }
    format!(
        "Tare: the mean over the first unloaded stretch, a second at the most (here {shortest:.2} s);\n\
         none where the model's friction may hold as much at rest.\n"
    )
}

fn invalid_line(recordings: &[RecordingReplay]) -> String {
    let invalid: u64 = recordings
        .iter()
        .flat_map(|r| r.sensors.iter().map(|s| s.invalid))
        .sum();
    match invalid {
        0 => "The device called every estimate valid.".to_owned(),
        n => format!(
            "The device called {n} estimates invalid (saturated, or outside the model): they are not counted."
        ),
    }
}

/// Where the device saw a foreign magnet.
fn disturbed_line(recordings: &[RecordingReplay]) -> String {
    let stretch = |recording: &RecordingReplay, [from, to]: &[f64; 2]| {
        format!("{from:.2} to {to:.2} s of recording {}", recording.name)
    };
    let all = recordings.iter();
    let all: Vec<String> = all
        .flat_map(|recording| recording.disturbed_s.iter().map(|s| stretch(recording, s)))
        .collect();
    match all.len() {
        0 => "It noticed no foreign magnet.".to_owned(),
        n if n > MOST_STRETCHES => format!(
            "It saw a foreign magnet {n} times, first from {}: what moves the field, and is not in the model?",
            all[0]
        ),
        _ => format!("It saw a foreign magnet from {}.", all.join(", ")),
    }
}

/// More are not told one by one.
const MOST_STRETCHES: usize = 3;

fn by_recording(outcome: &Outcome) -> String {
    let heads = outcome.fitted.iter().map(|recording| {
        let seen = outcome.seen.contains(&recording.name);
        format!(
            "{} ({})",
            recording.name,
            if seen { "fitted" } else { "held out" }
        )
    });
    let words = ["sensor", "force"].map(String::from);
    let mut table = show::table(words.into_iter().chain(heads));
    for pooled in pooled(&outcome.fitted) {
        let cells = pooled.tracks.iter().map(|track| newtons(track.tared()));
        let words = [pooled.sensor.to_string(), FORCES[pooled.axis].0.to_owned()];
        table.add_row(words.into_iter().chain(cells).collect::<Vec<_>>());
    }
    show::right_align(&mut table, 2);
    format!("RMSE after tare, each recording (held out: the model has not seen it)\n{table}\n")
}

/// A tare removes what is constant. Where it adds error, the field at rest was not the field at no
/// force.
fn tare_harms(outcome: &Outcome) -> Option<String> {
    let worse = |track: &Track| {
        track
            .tared()
            .is_some_and(|tared| tared.rms() > TARE_HARM * track.error.rms())
    };
    let harmed: Vec<&str> = outcome
        .fitted
        .iter()
        .filter(|recording| recording.sensors.iter().any(|s| s.axes.iter().any(worse)))
        .map(|recording| recording.name.as_str())
        .collect();
    (!harmed.is_empty()).then(|| {
        format!(
            "In recording {} the tare makes it worse: while nothing pushed, something else moved the field.\n",
            harmed.join(", ")
        )
    })
}

/// Errors of a tenth of the range are no model's error but a mistake.
fn far_off(outcome: &Outcome) -> Option<String> {
    let limit = 0.1 * outcome.force_range_n;
    let worst = pooled(outcome.alone.as_ref().unwrap_or(&outcome.fitted))
        .iter()
        .map(|p| p.sum(|t| t.error).std())
        .fold(0.0, f64::max);
    (worst > limit).then(|| {
        format!("Errors beyond {limit:.0} N: is this the model's gripper? Are columns swapped or flipped? `fit` would say.\n")
    })
}

/// The same recordings by simpler models.
pub fn beside(outcome: &Outcome) -> String {
    let mut table = show::table([
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
        pooled(outcome.alone.as_ref().unwrap_or(&outcome.fitted)),
        pooled(&outcome.linear),
        pooled(&outcome.nominal),
    );
    for ((fitted, linear), nominal) in fitted.iter().zip(&linear).zip(&nominal) {
        table.add_row([
            fitted.sensor.to_string(),
            FORCES[fitted.axis].0.to_owned(),
            newtons(Some(nominal.sum(|track| track.error))),
            newtons(nominal.tared()),
            newtons(Some(linear.sum(|track| track.error))),
            newtons(linear.tared()),
            newtons(Some(fitted.sum(|track| track.error))),
            newtons(fitted.tared()),
        ]);
    }
    show::right_align(&mut table, 2);
    format!(
        "RMSE of simpler models through the same code: the nominal design alone (the paper's ideal model),\n\
         and the best linear model of the fit; raw and after the tare\n{table}\n"
    )
}

/// The object of `--json`.
pub fn json(outcome: &Outcome) -> Value {
    let spent = times_real_time(&outcome.fitted);
    json!({
        "sensors": pooled(&outcome.fitted).iter().map(sensor_json).collect::<Vec<_>>(),
        "recordings": outcome.fitted.iter().map(|recording| {
            let own = std::slice::from_ref(recording);
            json!({
                "name": recording.name, "rows": recording.rows,
                "held_out": !outcome.seen.contains(&recording.name),
                "disturbed_s": recording.disturbed_s,
                "invalid": recording.sensors.iter().map(|s| s.invalid).sum::<u64>(),
                "sensors": pooled(own).iter().map(sensor_json).collect::<Vec<_>>(),
            })
        }).collect::<Vec<_>>(),
        "linear": pooled(&outcome.linear).iter().map(sensor_json).collect::<Vec<_>>(),
        "nominal": pooled(&outcome.nominal).iter().map(sensor_json).collect::<Vec<_>>(),
        "rmse_n": rmse_n(&outcome.fitted),
        "uncompensated_rmse_n": outcome.uncompensated.as_deref().map(rmse_n),
        "networks": networks::json(outcome),
        "notes": outcome.notes,
        "rows": outcome.fitted.iter().map(|r| r.rows).sum::<u64>(),
        "times_real_time": spent,
    })
}

fn sensor_json(pooled: &Pooled) -> Value {
    let error = pooled.sum(|track| track.error);
    json!({
        "sensor": pooled.sensor, "axis": FORCES[pooled.axis].1,
        "rmse_n": error.rms(), "mean_n": error.mean(), "std_n": error.std(),
        "tared_rmse_n": pooled.tared().map(|sums| sums.rms()),
        "float_rmse_n": pooled.sum(|track| track.float).rms(),
        "noise_n": pooled.noise_n(),
        "fixed_minus_float_rms_n": pooled.sum(|track| track.fixed_minus_float).rms(),
    })
}
