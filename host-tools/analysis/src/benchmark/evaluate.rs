//! Errors of each variant on the held-out recording, and the learning curve.
//!
//! Every row passes through the device's code and, for comparison, through floating point.

use crate::benchmark::data::{BenchmarkData, FittedPhysics, refit};
use crate::benchmark::train_variants::{TrainingData, VariantTrainer};
use crate::benchmark::variants::EstimatorVariant;
use crate::calibration::Coverage;
use crate::replay::{ForceSample, RecordingReplay, coverage, replay_with};
use crate::statistics::{Moments, pooled_rms};
use anyhow::{Result, bail};
use device_run::ReplayModels;
use device_run::networks::NetworkSet;
use model_export::gru::quantise::QuantiseError;
use model_export::inverse::build::DeviceModel;
use model_export::recordings::stream::RawStream;

/// Row stride of the errors and samples that are stored.
const STRIDE: usize = 10;
/// Interval plotted over time, in seconds since the start of the recording.
pub const PLOTTED_S: [f64; 2] = [2.0, 12.0];

/// Errors of one force over all sensors, in newtons.
#[derive(Clone, Copy, Debug, Default)]
pub struct AxisErrors {
    /// Floating point minus reference.
    pub float: Moments,
    /// The same after the tare; `None` where a sensor has no unloaded interval.
    pub float_tared: Option<Moments>,
    /// The device minus reference.
    pub fixed: Moments,
    /// The same after the tare.
    pub fixed_tared: Option<Moments>,
    /// RMS error from white noise of sensor and reference alone.
    pub noise_n: f64,
}

/// Result of one variant.
#[derive(Clone, Debug)]
pub struct VariantResult {
    /// The variant.
    pub variant: EstimatorVariant,
    /// Fx, Fz.
    pub axes: [AxisErrors; 2],
    /// Coverage of the predicted standard deviations after the tare.
    pub coverage: Option<Coverage>,
    /// Rows with an invalid estimate.
    pub invalid: u64,
    /// Subsample of the device's errors of each force, in newtons.
    pub errors_n: [Vec<f64>; 2],
    /// Samples of the first sensor over [`PLOTTED_S`].
    pub samples: Vec<ForceSample>,
}

impl VariantResult {
    /// RMS error of the device over both forces, in newtons.
    pub fn rmse_n(&self) -> f64 {
        let [x, z] = self.axes;
        x.fixed.with(z.fixed).rms()
    }

    /// The same after the tare.
    pub fn tared_rmse_n(&self) -> Option<f64> {
        let [x, z] = self.axes;
        Some(x.fixed_tared?.with(z.fixed_tared?).rms())
    }
}

/// Evaluates a variant on the held-out recording.
///
/// # Errors
/// The recording cannot be read, or no row has both a valid estimate and a reference.
pub fn evaluate(
    data: &BenchmarkData,
    variant: EstimatorVariant,
    built: &DeviceModel,
    networks: Option<&NetworkSet>,
) -> Result<VariantResult> {
    let stream = RawStream::open_folder(&data.held_out, data.alignment)?;
    let float = Some(built.chosen.models.as_slice());
    let models = ReplayModels { networks, float, ..ReplayModels::of(built) };
    let (mut errors_n, mut samples) = ([Vec::new(), Vec::new()], Vec::new());
    let (mut first_s, mut count) = (None, 0_usize);
    let collect = |sample: ForceSample| {
        let time_s = sample.time_s - *first_s.get_or_insert(sample.time_s);
        if count.is_multiple_of(STRIDE) {
            for (axis, errors) in errors_n.iter_mut().enumerate() {
                errors.push(sample.estimate_n[axis] - sample.reference_n[axis]);
            }
            if sample.sensor == 0 && (PLOTTED_S[0]..=PLOTTED_S[1]).contains(&time_s) {
                samples.push(ForceSample { time_s, ..sample });
            }
        }
        count += 1;
    };
    let replay = replay_with(models, &data.held_out_name(), stream, |_| (), collect)?;
    let axes = [0, 1].map(|axis| pool(&replay, axis));
    if axes.iter().any(|axis| axis.fixed.rows() == 0.0) {
        bail!(
            "{}: no row has both a valid estimate of {} and a reference force",
            data.held_out.display(),
            variant.words()
        );
    }
    Ok(VariantResult {
        variant,
        axes,
        coverage: coverage(std::slice::from_ref(&replay)),
        invalid: replay.sensors.iter().map(|sensor| sensor.invalid).sum(),
        errors_n,
        samples,
    })
}

/// Pools one force over all sensors.
fn pool(replay: &RecordingReplay, axis: usize) -> AxisErrors {
    let tracks = || replay.sensors.iter().map(|sensor| &sensor.axes[axis]);
    let none = || Some(Moments::default());
    let both = |sum: Option<Moments>, tared: Option<Moments>| Some(sum?.with(tared?));
    AxisErrors {
        float: tracks().fold(Moments::default(), |sum, track| sum.with(track.float)),
        float_tared: tracks().fold(none(), |sum, track| both(sum, track.float_tared())),
        fixed: tracks().fold(Moments::default(), |sum, track| sum.with(track.error)),
        fixed_tared: tracks().fold(none(), |sum, track| both(sum, track.tared())),
        noise_n: pooled_rms(tracks().map(|track| track.noise_n)),
    }
}

/// Durations of the training data on the learning curve; those beyond the campaign are skipped.
const SECONDS: [f64; 6] = [5.0, 10.0, 20.0, 50.0, 100.0, 200.0];
/// Durations above this fraction of the training data are skipped.
const MAX_FRACTION: f64 = 0.9;
/// Variants on the learning curve.
pub const LEARNING_VARIANTS: [EstimatorVariant; 5] = [
    EstimatorVariant::IdealFitted,
    EstimatorVariant::Gru3Axis,
    EstimatorVariant::Gru3AxisIdeal,
    EstimatorVariant::Physics,
    EstimatorVariant::PhysicsGru,
];

/// One variant at one duration of training data.
#[derive(Clone, Copy, Debug)]
pub struct LearningPoint {
    /// Duration in seconds; networks use the last fifth for early stopping.
    pub seconds: f64,
    /// The variant.
    pub variant: EstimatorVariant,
    /// RMS error of the device over both forces, in newtons.
    pub rmse_n: f64,
    /// The same after the tare.
    pub tared_rmse_n: Option<f64>,
}

impl LearningPoint {
    fn of(seconds: f64, result: &VariantResult) -> Self {
        Self {
            seconds,
            variant: result.variant,
            rmse_n: result.rmse_n(),
            tared_rmse_n: result.tared_rmse_n(),
        }
    }
}

/// Durations below the whole training data, where a learning curve is requested.
fn durations_s(data: &BenchmarkData) -> Vec<f64> {
    let all = data.training_s();
    let short = SECONDS.into_iter().filter(|s| data.curve && *s < MAX_FRACTION * all);
    short.collect()
}

/// Duration of the training data of every training in the benchmark.
pub fn trainings(data: &BenchmarkData) -> Vec<f64> {
    let networks = |variants: &[EstimatorVariant]| {
        let with_effects = !data.effects.is_empty();
        let trained = variants.iter().filter(|v| v.topology(1).is_some());
        trained.filter(|v| with_effects || **v != EstimatorVariant::PhysicsGru).count()
    };
    let mut all = vec![data.training_s(); networks(&EstimatorVariant::ALL)];
    for seconds in durations_s(data) {
        all.extend(std::iter::repeat_n(seconds, networks(&LEARNING_VARIANTS)));
    }
    all
}

/// Fits, trains and evaluates on increasing durations; `results` are those of all training data.
///
/// # Errors
/// A training fails, or a recording cannot be read.
pub fn learning_curve(
    data: &BenchmarkData,
    trainer: &VariantTrainer,
    results: &[VariantResult],
) -> Result<Vec<LearningPoint>> {
    let mut points = Vec::new();
    for seconds in durations_s(data) {
        // A few seconds may be too few for a fit; the curve then has no point there.
        let Ok(physics) = refit(data, seconds) else {
            continue;
        };
        points.extend(points_at(data, trainer, &physics, seconds)?);
    }
    let whole = results.iter().filter(|result| LEARNING_VARIANTS.contains(&result.variant));
    points.extend(whole.map(|result| LearningPoint::of(data.training_s(), result)));
    Ok(points)
}

fn points_at(
    data: &BenchmarkData,
    trainer: &VariantTrainer,
    physics: &FittedPhysics,
    seconds: f64,
) -> Result<Vec<LearningPoint>> {
    let training = TrainingData::of(data, physics, seconds)?;
    let mut points = Vec::new();
    for variant in LEARNING_VARIANTS {
        if let Some(built) = physics.at(variant.physics()) {
            let networks = match trainer.train(variant, &training, built, seconds) {
                // A network that does not fit the device leaves a gap.
                Err(error) if error.is::<QuantiseError>() => continue,
                networks => networks?,
            };
            let result = evaluate(data, variant, built, networks.as_ref())?;
            points.push(LearningPoint::of(seconds, &result));
        }
    }
    Ok(points)
}
