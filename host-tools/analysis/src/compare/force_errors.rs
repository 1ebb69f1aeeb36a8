//! Errors of the forces through the device's own code, at the board's rate.

use crate::compare::cv_plan::{CvPlan, RecordingFolds};
use crate::compare::{Envelope, ForceAxisErrors, Histogram, MissingForces, Trace};
use crate::notes::UncompensatedEffect;
use crate::progress;
use crate::replay::{RecordingReplay, replay_with};
use crate::statistics::{ErrorAccumulator, Moments};
use anyhow::{Result, anyhow};
use device_run::ReplayModels;
use indicatif::ProgressBar;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::JointFit;
use model_export::inverse::build::{BuildError, DeviceModel, ModelVariant, build_model};
use model_export::model_file::Provenance;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::stream::RawStream;
use rayon::prelude::*;
use std::path::Path;

/// Bins of the displayed histograms.
const BINS: usize = 61;
/// Bins of the histogram during accumulation, over +-[`WIDEST_N`].
const FINE: usize = 4000;
/// Half range of the histogram during accumulation, in newtons.
const WIDEST_N: f64 = 100.0;
/// Fraction of the rows within the displayed range.
const DISPLAYED: f64 = 0.998;
/// Maximum points of all curves.
const POINTS: usize = 200_000;

/// Errors of all forces.
#[derive(Default)]
pub struct ForceEvaluation {
    /// By sensor, lateral then longitudinal.
    pub errors: Vec<ForceAxisErrors>,
    /// Lateral and longitudinal.
    pub histograms: Vec<Histogram>,
    /// Reason for missing forces.
    pub none: Option<MissingForces>,
    /// Effects that the device does not compensate.
    pub uncompensated: Vec<UncompensatedEffect>,
}

/// Held-out error of the forces of a fit with these effects to a whole campaign, and of what the device does not compensate.
///
/// # Errors
/// A recording cannot be read.
pub fn held_out_forces(
    campaign: &Campaign,
    setup: &FitSetup,
    fit: &JointFit,
    effects: &[EffectTerm],
    alignment: Alignment,
    options: FitOptions,
) -> Result<ForceEvaluation> {
    let provenance = Provenance::of(campaign, alignment.delay_us, options)?;
    let plan = CvPlan::of_fit(campaign, setup, fit, effects, &provenance);
    let origins_s: Vec<f64> = campaign
        .recordings
        .iter()
        .map(|recording| recording.time_s.first().copied().unwrap_or(0.0))
        .collect();
    evaluate_forces(&plan, Path::new("the fitted model"), alignment, &origins_s, &mut [])
}

/// Errors of one force of one sensor.
#[derive(Clone, Default)]
struct Channel {
    errors: ErrorAccumulator,
    tared: Moments,
    /// Sum of the squared white noise over the rows.
    noise: f64,
    histogram: Vec<u64>,
}

/// One sensor over one recording.
#[derive(Default)]
struct SensorForces {
    number: u32,
    channels: [Channel; 2],
    time_s: Vec<f64>,
    /// Lateral, longitudinal; each reference, device.
    curves: [[Vec<f64>; 2]; 2],
}

/// Replays every recording with the models of its folds, and adds the forces to `traces`. `origins_s` are the
/// first rows of the recordings on the reference's clock.
///
/// # Errors
/// A model cannot be built, or a recording cannot be read.
pub fn evaluate_forces(
    plan: &CvPlan,
    path: &Path,
    alignment: Alignment,
    origins_s: &[f64],
    traces: &mut [Trace],
) -> Result<ForceEvaluation> {
    let used: Vec<bool> = (0..plan.models.len())
        .map(|model| {
            let of = |recording: &RecordingFolds| recording.folds.iter().any(|(_, m)| *m == model);
            plan.recordings.iter().any(of)
        })
        .collect();
    // Without traces the caller shows the progress.
    let progress_bar = |message, steps| {
        let is_hidden = traces.is_empty();
        if is_hidden { ProgressBar::hidden() } else { progress::progress_bar(message, steps) }
    };
    let bar = progress_bar("building tables", used.iter().filter(|used| **used).count());
    let built = plan
        .models
        .par_iter()
        .zip(&used)
        .map(|(fold, used)| {
            if !used {
                return Ok(None);
            }
            let bytes = toml::to_string(&fold.model)?;
            let built =
                build_model(fold.model.clone(), path, bytes.as_bytes(), ModelVariant::Fitted)?;
            bar.inc(1);
            Ok(Some(built))
        })
        .collect::<Result<Vec<Option<DeviceModel>>>>();
    bar.finish_and_clear();
    let built = match built {
        Ok(built) => built,
        Err(error) => match error.downcast_ref::<BuildError>() {
            Some(BuildError::Polynomial { .. }) => {
                return Ok(none(MissingForces::PolynomialBase));
            }
            Some(BuildError::NotCompensable(why)) => {
                return Ok(none(MissingForces::NotCompensable(why.clone())));
            }
            _ => return Err(error),
        },
    };
    let any = built.iter().flatten().next();
    let uncompensated: Vec<UncompensatedEffect> =
        any.map_or_else(Vec::new, |built| UncompensatedEffect::of(built).collect());
    let bar = progress_bar("replaying on the device's code", plan.recordings.len());
    let mut channels: Vec<(u32, [Channel; 2])> = Vec::new();
    let at_once = 2 * rayon::current_num_threads();
    let points = (POINTS / (4 * traces.len().max(1))).clamp(50, 3000);
    let of_all: Vec<(&RecordingFolds, &f64)> = plan.recordings.iter().zip(origins_s).collect();
    for planned in of_all.chunks(at_once) {
        let replayed = planned
            .par_iter()
            .map(|(planned, origin_s)| {
                let replayed = replay_folds(planned, &built, alignment, **origin_s);
                bar.inc(1);
                replayed
            })
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<Vec<_>>>()?;
        for ((planned, _), sensors) in planned.iter().zip(replayed) {
            for sensor in sensors {
                let matches =
                    |t: &&mut Trace| t.recording == planned.named.name && t.sensor == sensor.number;
                if let Some(trace) = traces.iter_mut().find(matches) {
                    let curve = |values: &Vec<f64>| Envelope::of(&sensor.time_s, values, points);
                    trace.force =
                        sensor.curves.iter().map(|of| [curve(&of[0]), curve(&of[1])]).collect();
                }
                match channels.iter_mut().find(|(number, _)| *number == sensor.number) {
                    Some((_, pooled)) => {
                        pooled.iter_mut().zip(sensor.channels).for_each(|(a, b)| a.add(b));
                    }
                    None => channels.push((sensor.number, sensor.channels)),
                }
            }
        }
    }
    bar.finish_and_clear();
    let mut result = ForceEvaluation { uncompensated, ..finish(&channels) };
    if result.errors.is_empty() {
        result.none = Some(MissingForces::NoValidRow);
    }
    Ok(result)
}

fn none(why: MissingForces) -> ForceEvaluation {
    ForceEvaluation { none: Some(why), ..ForceEvaluation::default() }
}

/// Replays one recording, each segment with the model of its fold.
fn replay_folds(
    planned: &RecordingFolds,
    built: &[Option<DeviceModel>],
    alignment: Alignment,
    origin_s: f64,
) -> Result<Vec<SensorForces>> {
    let mut used: Vec<usize> = planned.folds.iter().map(|(_, model)| *model).collect();
    used.sort_unstable();
    used.dedup();
    let mut sensors: Vec<SensorForces> = Vec::new();
    for model in &used {
        let built = built
            .get(*model)
            .and_then(Option::as_ref)
            .ok_or_else(|| anyhow!("{}: no tables were built", planned.named.name))?;
        let models = ReplayModels::of(built);
        let stream = RawStream::open_folder(&planned.named.folder, alignment)?;
        let mut segment: Vec<SensorForces> = Vec::new();
        let replayed = replay_with(
            models,
            &planned.named.name,
            stream,
            |_| (),
            |row| {
                let time_s = row.time_s - 1e-6 * alignment.delay_us - origin_s;
                let fold = planned.folds.iter().find(|(until, _)| time_s < *until);
                if fold.is_none_or(|(_, of)| of != model) {
                    return;
                }
                while segment.len() <= row.sensor {
                    segment.push(SensorForces::default());
                }
                let sensor = &mut segment[row.sensor];
                sensor.time_s.push(time_s);
                for axis in 0..2 {
                    sensor.curves[axis][0].push(row.reference_n[axis]);
                    sensor.curves[axis][1].push(row.estimate_n[axis]);
                    let error = row.estimate_n[axis] - row.reference_n[axis];
                    sensor.channels[axis].errors.add(row.reference_n[axis], error);
                    sensor.channels[axis].count(error);
                }
            },
        )?;
        add_noise_and_tare(&mut segment, &replayed, used.len() == 1);
        if sensors.is_empty() {
            sensors = segment
        } else {
            sensors.iter_mut().zip(segment).for_each(|(sensor, more)| sensor.append(more))
        }
    }
    sensors.retain(|sensor| !sensor.time_s.is_empty());
    sensors.iter_mut().for_each(SensorForces::sort);
    Ok(sensors)
}

/// Sets number, noise and tare of the sensors; a tare only if one model replayed the `whole` recording.
fn add_noise_and_tare(segment: &mut [SensorForces], replayed: &RecordingReplay, whole: bool) {
    for (sensor, of) in segment.iter_mut().zip(&replayed.sensors) {
        sensor.number = of.number;
        for (channel, track) in sensor.channels.iter_mut().zip(&of.axes) {
            channel.noise = channel.errors.rows() * track.noise_n * track.noise_n;
            if let (true, Some(tared)) = (whole, track.tared()) {
                channel.tared = tared;
            }
        }
    }
}

impl SensorForces {
    fn append(&mut self, other: Self) {
        self.time_s.extend(other.time_s);
        for (own, other) in self.curves.iter_mut().flatten().zip(other.curves.into_iter().flatten())
        {
            own.extend(other);
        }
        self.channels.iter_mut().zip(other.channels).for_each(|(a, b)| a.add(b));
    }

    /// Sorts by time, where several models alternate.
    fn sort(&mut self) {
        if self.time_s.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.time_s.len()).collect();
        order.sort_by(|a, b| self.time_s[*a].total_cmp(&self.time_s[*b]));
        let sorted = |values: &Vec<f64>| order.iter().map(|&row| values[row]).collect();
        self.curves.iter_mut().flatten().for_each(|values| *values = sorted(values));
        self.time_s = sorted(&self.time_s);
    }
}

impl Channel {
    fn count(&mut self, error_n: f64) {
        self.histogram.resize(FINE, 0);
        let place = (error_n / WIDEST_N + 1.0) / 2.0 * FINE as f64;
        self.histogram[(place.max(0.0) as usize).min(FINE - 1)] += 1;
    }

    fn add(&mut self, other: Self) {
        self.errors = std::mem::take(&mut self.errors).with(&other.errors);
        self.tared = self.tared.with(other.tared);
        self.noise += other.noise;
        self.histogram.resize(FINE, 0);
        self.histogram.iter_mut().zip(&other.histogram).for_each(|(a, b)| *a += b);
    }
}

fn finish(channels: &[(u32, [Channel; 2])]) -> ForceEvaluation {
    let axes = [Axis::X, Axis::Z];
    let errors = channels.iter().flat_map(|(sensor, channels)| {
        channels.iter().zip(axes).map(|(channel, axis)| {
            let error = channel.errors.statistics();
            let floor = (channel.noise / channel.errors.rows().max(1.0)).sqrt();
            ForceAxisErrors {
                sensor: *sensor,
                axis,
                error,
                tared_rms: (channel.tared.rows() > 0.0).then(|| channel.tared.rms()),
                floor,
                explainable: (error.rms.powi(2) - floor.powi(2)).max(0.0).sqrt(),
            }
        })
    });
    let histogram = |axis: usize| {
        let mut fine = vec![0; FINE];
        for (_, channels) in channels {
            let own = &channels[axis].histogram;
            fine.iter_mut().zip(own).for_each(|(all, own)| *all += own);
        }
        rebinned(axes[axis], &fine)
    };
    ForceEvaluation {
        errors: errors.collect(),
        histograms: vec![histogram(0), histogram(1)],
        ..ForceEvaluation::default()
    }
}

/// Rebins to [`BINS`] bins over [`DISPLAYED`] of the rows.
fn rebinned(axis: Axis, fine: &[u64]) -> Histogram {
    let all: u64 = fine.iter().sum();
    let middle = FINE / 2;
    let inside = |half: usize| fine[middle - half..middle + half].iter().sum::<u64>();
    let enough = |half: &usize| inside(*half) as f64 >= DISPLAYED * all as f64;
    let half = (1..=middle).find(enough).unwrap_or(middle);
    // A whole number of fine bins in each bin, and an odd number of bins, so that one is centred on zero.
    let each = (2 * half).div_ceil(BINS).max(1);
    let fine_n = 2.0 * WIDEST_N / FINE as f64;
    let first = middle as f64 - (BINS * each) as f64 / 2.0;
    let mut counts = vec![0; BINS];
    for (place, count) in fine.iter().enumerate() {
        let bin = ((place as f64 - first) / each as f64).floor();
        counts[(bin.max(0.0) as usize).min(BINS - 1)] += count;
    }
    Histogram {
        axis,
        edges: (0..=BINS).map(|i| (first + (i * each) as f64 - middle as f64) * fine_n).collect(),
        counts,
    }
}
