//! Training of the benchmark's networks on the same data. A validation set at its end selects the epoch and
//! calibrates the predicted standard deviations.

use crate::benchmark::data::{BenchmarkData, FittedPhysics};
use crate::benchmark::variants::{EstimatorVariant, PhysicsLevel};
use crate::network_calibration::NetworkCalibration;
use crate::progress;
use anyhow::Result;
use device_run::networks::NetworkSet;
use device_run::{ReplayModels, training_sequence};
use indicatif::ProgressBar;
use model_export::gru::file::{NetworkFile, NetworkProvenance};
use model_export::gru::train::dataset::Sequence;
use model_export::gru::train::trainer::{Trainer, TrainingSettings};
use model_export::inverse::build::DeviceModel;
use model_export::recordings::stream::RawStream;
use std::cell::RefCell;
use std::path::Path;

/// Fraction of the training data, at its end, used for early stopping.
const VALIDATION: f64 = 0.2;
/// Maximum fraction of the last recording in the validation set.
const MAX_OF_LAST: f64 = 0.8;
/// Seconds before the validation set that only warm up the state.
const WARM_UP_S: f64 = 1.0;
/// Training on less data takes more epochs, because an epoch has fewer steps.
const FULL_EPOCHS_S: f64 = 50.0;
/// Maximum factor on the number of epochs.
const MAX_EPOCH_FACTOR: f64 = 3.0;

/// Trains the networks of the variants and shows the progress.
pub struct VariantTrainer {
    settings: TrainingSettings,
    hidden: usize,
    /// Weight of a row without force in [`EstimatorVariant::Gru3AxisNearZero`].
    pub zero_weight: f64,
    /// Progress in epochs times seconds of data.
    bar: ProgressBar,
    step: RefCell<(usize, usize)>,
}

/// Training sequences of each physics model.
pub struct TrainingData {
    fitted: SplitData,
    with_effects: Option<SplitData>,
    /// Duration of the validation set.
    pub validation_s: f64,
}

struct SplitData {
    training: Vec<Sequence>,
    validation: Sequence,
}

impl TrainingData {
    /// The first `seconds` of the training data, through the device's code.
    ///
    /// # Errors
    /// A recording cannot be read.
    pub fn of(data: &BenchmarkData, physics: &FittedPhysics, seconds: f64) -> Result<Self> {
        let shares = data.shares_s(seconds);
        let last = shares.last().copied().unwrap_or(0.0);
        let validation_s = (VALIDATION * seconds).min(MAX_OF_LAST * last);
        let split = |level: PhysicsLevel| -> Result<Option<SplitData>> {
            let Some(built) = physics.at(level) else {
                return Ok(None);
            };
            Ok(Some(split_data(data, built, &shares, validation_s)?))
        };
        let Some(fitted) = split(PhysicsLevel::Fitted)? else {
            anyhow::bail!("the ideal model could not be fitted");
        };
        Ok(Self { fitted, with_effects: split(PhysicsLevel::Effects)?, validation_s })
    }

    fn at(&self, level: PhysicsLevel) -> Option<&SplitData> {
        match level {
            PhysicsLevel::Nominal => None,
            PhysicsLevel::Fitted => Some(&self.fitted),
            PhysicsLevel::Effects => self.with_effects.as_ref(),
        }
    }
}

/// Sequences of the recordings' beginnings; the last one is split into training and validation set.
fn split_data(
    data: &BenchmarkData,
    built: &DeviceModel,
    shares_s: &[f64],
    validation_s: f64,
) -> Result<SplitData> {
    let mut training = Vec::new();
    let mut validation = Sequence::default();
    let ends = shares_s.len();
    let recordings = data.campaign.recordings.iter().zip(shares_s);
    for (at, (recording, &share_s)) in recordings.enumerate() {
        let stream = RawStream::open(&recording.folder, &recording.description, data.alignment)?;
        let whole = training_sequence(ReplayModels::of(built), &recording.name, stream, |_| ())?;
        let per_s = whole.rows as f64 / recording.span_s();
        let row = |seconds: f64| (seconds * per_s).round() as usize;
        // The board's rows may continue after the last row of the reference.
        let end = if share_s < recording.span_s() { row(share_s) } else { whole.rows };
        if at + 1 < ends {
            training.push(whole.part(0..end, 0));
        } else {
            let cut = end.saturating_sub(row(validation_s));
            training.push(whole.part(0..cut, 0));
            validation = whole.part(cut.saturating_sub(row(WARM_UP_S))..end, cut);
        }
    }
    Ok(SplitData { training, validation })
}

impl VariantTrainer {
    /// A trainer of networks with `hidden` units per layer.
    pub fn new(settings: TrainingSettings, hidden: usize, zero_weight: f64) -> Self {
        Self {
            settings,
            hidden,
            zero_weight,
            bar: progress::growing_bar(),
            step: RefCell::new((0, 0)),
        }
    }

    /// Seed of all random draws.
    pub fn seed(&self) -> u64 {
        self.settings.seed
    }

    /// Maximum epochs of a training on all data.
    pub fn max_epochs(&self) -> u32 {
        self.settings.epochs
    }

    /// Maximum epochs for a duration of training data.
    fn epochs(&self, seconds: f64) -> u32 {
        let more = (FULL_EPOCHS_S / seconds).sqrt().clamp(1.0, MAX_EPOCH_FACTOR);
        (f64::from(self.settings.epochs) * more).round() as u32
    }

    /// Maximum cost of a training, in epochs times seconds.
    fn cost(&self, seconds: f64) -> u64 {
        (f64::from(self.epochs(seconds)) * seconds.max(1.0)) as u64
    }

    /// Extends the progress bar by trainings on these durations.
    pub fn announce(&self, seconds: impl Iterator<Item = f64>) {
        for seconds in seconds {
            self.bar.inc_length(self.cost(seconds));
            self.step.borrow_mut().1 += 1;
        }
    }

    /// Removes the progress bar.
    pub fn close(&self) {
        self.bar.finish_and_clear();
    }

    /// Trains and calibrates the networks of a variant; `None` where it has none.
    ///
    /// # Errors
    /// A weight exceeds the device's format, or the training diverges.
    pub fn train(
        &self,
        variant: EstimatorVariant,
        training: &TrainingData,
        built: &DeviceModel,
        seconds: f64,
    ) -> Result<Option<NetworkSet>> {
        let (Some(topology), Some(split)) =
            (variant.topology(self.hidden), training.at(variant.physics()))
        else {
            return Ok(None);
        };
        let epochs = self.epochs(seconds);
        let settings = TrainingSettings {
            epochs,
            patience: self.settings.patience.max(epochs / 3),
            near_zero: match variant {
                EstimatorVariant::Gru3AxisNearZero => self.zero_weight,
                _ => self.settings.near_zero,
            },
            ..self.settings.clone()
        };
        let mut course = Trainer::new(settings, topology, &split.training, &split.validation)?;
        let (number, all) = {
            let mut step = self.step.borrow_mut();
            step.0 += 1;
            *step
        };
        let (before, cost) = (self.bar.position(), self.cost(seconds));
        while !course.finished() {
            let progress = course.epoch()?;
            self.bar.set_message(format!("{number} of {all}: {}, {seconds:.0} s", variant.words()));
            let share = f64::from(progress.epoch) / f64::from(epochs);
            self.bar.set_position(before + (share * cost as f64) as u64);
        }
        self.bar.set_position(before + cost);
        let calibration =
            NetworkCalibration::of(&course, &split.training, &split.validation, built)?;
        let mut networks = course.networks();
        calibration.apply(&mut networks);
        let provenance = NetworkProvenance {
            tool: format!("magpie {}", env!("CARGO_PKG_VERSION")),
            model_sha256: built.header.inputs_sha256.clone(),
            campaign: built.header.campaign.clone(),
            recordings: Vec::new(),
            delay_ms: built.model.provenance.delay_ms,
            topology: course.topology.clone(),
            settings: course.settings.clone(),
            found: course.found.clone(),
        };
        let file = NetworkFile { provenance, networks };
        let networks = NetworkSet::of(file, Path::new(variant.words()), built)?.warm_started();
        Ok(Some(networks))
    }
}
