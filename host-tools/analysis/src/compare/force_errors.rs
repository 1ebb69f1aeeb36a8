//! Errors of the forces through the device's own code, at the board's rate.
//!
//! An error belongs to the device or to something else, by what each effect of the model says of its origin
//! ([`ErrorOrigin`]): the reference is corrected for its own errors before it is compared; a recording is replayed with the state
//! that the gripper had at its time; rows in which the device itself detects an event of the model are counted apart; what no
//! model of the device could remove is not part of the excess.

use crate::compare::campaign_excitation::{
    CampaignExcitation, RecordingExcitation, recording_corrections,
};
use crate::compare::cv_plan::{CvPlan, RecordingFolds};
use crate::compare::{Envelope, ErrorRows, FlaggedRows, ForceAxisErrors, ForceError, Histogram};
use crate::model::Model;
use crate::notes::{MissingForces, UncompensatedEffect};
use crate::progress;
use crate::replay::corrections::{Irreducible, RecordingOffsets, SensorCorrections, add_offsets};
use crate::replay::{RecordingReplay, ReplayInput, replay_each};
use crate::statistics::{ErrorAccumulator, Moments};
use anyhow::{Result, anyhow};
use device_run::ReplayModels;
use indicatif::ProgressBar;
use model_export::effects::{EffectTerm, ErrorOrigin};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::JointFit;
use model_export::inverse::build::{BuildError, DeviceModel, ModelVariant, build_model};
use model_export::inverse::grbf::GrbfShape;
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::in_order;
use model_export::recordings::stream::RawStream;
use model_export::recordings::{Campaign, DataError, Recording};
use rayon::prelude::*;
use std::borrow::Cow;
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

/// One sensor over one recording: lateral and longitudinal force in newtons, each reference and device.
pub struct ForceTrace {
    pub recording: String,
    pub sensor: u32,
    pub force: Vec<[Envelope; 2]>,
}

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
    /// Shape of the inverse of all folds.
    pub shape: Option<GrbfShape>,
    /// Error over all forces; `None` without forces.
    pub error: Option<ForceError>,
    /// Forces over time, where they were asked for.
    pub traces: Vec<ForceTrace>,
}

/// Held-out errors of the forces of fits to a whole campaign, each with its effects, and what the device does
/// not compensate; of the first one the forces over time where `has_traces`. `offsets` are those of each recording that the campaign
/// in memory is without; empty if none.
///
/// # Errors
/// A recording cannot be read.
pub fn held_out_forces(
    (campaign, offsets): (&Campaign, &[RecordingOffsets]),
    setup: &FitSetup,
    fits: &[(&JointFit, &[EffectTerm])],
    alignment: Alignment,
    has_traces: bool,
    options: FitOptions,
) -> Result<Vec<ForceEvaluation>> {
    let provenance = Provenance::of(campaign, alignment.delay_us, options)?;
    let plan_of = |(fit, effects): &(&JointFit, &[EffectTerm])| {
        CvPlan::of_fit(campaign, setup, fit, effects, &provenance)
    };
    let plans: Vec<CvPlan> = fits.iter().map(plan_of).collect();
    let origins_s: Vec<f64> = campaign
        .recordings
        .iter()
        .map(|recording| recording.time_s.first().copied().unwrap_or(0.0))
        .collect();
    let recordings = Recordings {
        alignment,
        origins_s: &origins_s,
        offsets,
        read: &|place| Ok(Cow::Borrowed(&campaign.recordings[place])),
    };
    let traces = setup.rows.iter().map(|sensor| sensor.parts.len()).sum();
    // The caller shows the progress.
    let hidden = |_: &'static str, _| ProgressBar::hidden();
    evaluate_plans(&plans, recordings, has_traces.then_some(traces), hidden)
}

/// Recordings on the reference's clock.
#[derive(Clone, Copy)]
pub struct Recordings<'a> {
    pub alignment: Alignment,
    /// First row of each in seconds.
    pub origins_s: &'a [f64],
    /// Offsets of each, to subtract; empty without any.
    pub offsets: &'a [RecordingOffsets],
    /// Reads one of them.
    pub read: &'a (dyn Fn(usize) -> Result<Cow<'a, Recording>, DataError> + Sync),
}

/// Errors of one force of one sensor.
#[derive(Clone, Default)]
struct Channel {
    errors: ErrorAccumulator,
    /// Against the reference as recorded.
    recorded: Moments,
    /// Rows in which the device detects an event of the model.
    flagged: Moments,
    /// Without the field that no model of the device compensates; no rows where the model has no such field.
    reducible: Moments,
    tared: Moments,
    /// Sum of the squared white noise over the rows.
    noise: f64,
    histogram: Vec<u64>,
}

/// One sensor over one recording.
#[derive(Clone, Default)]
struct SensorForces {
    number: u32,
    channels: [Channel; 2],
    /// Of the curves; empty where these are not displayed.
    time_s: Vec<f64>,
    /// Lateral, longitudinal; each reference, device.
    curves: [[Vec<f64>; 2]; 2],
}

/// Replays every recording with the models of its folds, with about this number of traces.
///
/// # Errors
/// A model cannot be built, or a recording cannot be read.
pub fn evaluate_forces(
    plan: &CvPlan,
    recordings: Recordings,
    traces: usize,
) -> Result<ForceEvaluation> {
    let plans = std::slice::from_ref(plan);
    let evaluated = evaluate_plans(plans, recordings, Some(traces), progress::progress_bar)?;
    Ok(evaluated.into_iter().next().unwrap_or_default())
}

/// Evaluates several plans of the same recordings in one pass over these, with about this number of traces of the first plan.
fn evaluate_plans(
    plans: &[CvPlan],
    source: Recordings,
    traces: Option<usize>,
    progress_bar: impl Fn(&'static str, usize) -> ProgressBar,
) -> Result<Vec<ForceEvaluation>> {
    let bar = progress_bar("building tables", plans.len());
    let built = in_order(plans.par_iter().map(|plan| {
        let built = build_tables(plan);
        bar.inc(1);
        built
    }))?;
    bar.finish_and_clear();
    let recordings: &[RecordingFolds] = plans.first().map_or(&[], |plan| &plan.recordings);
    let bar = progress_bar("replaying on the device's code", recordings.len());
    let mut channels: Vec<Vec<(u32, [Channel; 2])>> = vec![Vec::new(); plans.len()];
    let at_once = 2 * rayon::current_num_threads();
    let points = traces.map(|count| (POINTS / (4 * count.max(1))).clamp(50, 3000));
    let mut traces: Vec<ForceTrace> = Vec::new();
    let of_all: Vec<(usize, &f64)> =
        source.origins_s.iter().take(recordings.len()).enumerate().collect();
    let mut excitation =
        CampaignExcitation::of(plans.iter().filter_map(|plan| plan.models.first()));
    for some in of_all.chunks(at_once) {
        let some = some.iter().map(|(recording, origin_s)| {
            Ok((*recording, **origin_s, excitation.next(*recording, source.read)?))
        });
        let some = some.collect::<Result<Vec<_>, DataError>>()?;
        let replayed = some
            .par_iter()
            .map(|(recording, origin_s, excitation)| {
                let offsets = source.offsets.get(*recording);
                let recording = *recording;
                let alignment = source.alignment;
                let replay = FoldReplay { plans, built: &built, recording, offsets, alignment };
                let replayed = replay.run(*origin_s, excitation, points.is_some());
                bar.inc(1);
                replayed
            })
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<Vec<_>>>()?;
        for ((recording, ..), of_plans) in some.iter().zip(replayed) {
            if let Some((sensors, points)) = of_plans.first().zip(points) {
                let name = &recordings[*recording].named.name;
                traces.extend(sensors.iter().map(|sensor| sensor.trace(name, points)));
            }
            channels.iter_mut().zip(of_plans).for_each(|(channels, of)| pool(channels, of));
        }
    }
    bar.finish_and_clear();
    let evaluated = plans.iter().zip(built).zip(&channels);
    let mut evaluated: Vec<ForceEvaluation> = evaluated
        .map(|((plan, built), channels)| match built {
            Err(why) => ForceEvaluation { none: Some(why), ..ForceEvaluation::default() },
            Ok(built) => {
                let any = built.iter().flatten().next();
                let uncompensated =
                    any.map_or_else(Vec::new, |b| UncompensatedEffect::of(b).collect());
                // Without centres no shape was representable.
                let shape = any.map(|built| built.chosen.shape);
                let shape = shape.filter(|shape| shape.centres_across > 0);
                let mut result = ForceEvaluation { uncompensated, shape, ..finish(channels) };
                result.error = ForceError::of(&result.errors, ErrorRows::of(&plan.validation));
                if result.errors.is_empty() {
                    result.none = Some(MissingForces::NoValidRow);
                }
                result
            }
        })
        .collect();
    if let Some(first) = evaluated.first_mut() {
        first.traces = traces;
    }
    Ok(evaluated)
}

/// Adds the errors of one recording to those of all, by sensor.
fn pool(all: &mut Vec<(u32, [Channel; 2])>, sensors: Vec<SensorForces>) {
    for sensor in sensors {
        match all.iter_mut().find(|(number, _)| *number == sensor.number) {
            Some((_, pooled)) => {
                pooled.iter_mut().zip(sensor.channels).for_each(|(a, b)| a.add(b));
            }
            None => all.push((sensor.number, sensor.channels)),
        }
    }
}

/// Tables of the models of a plan, `None` where a model predicts no row, or why there are none.
type FoldTables = Result<Vec<Option<DeviceModel>>, MissingForces>;

/// Tables of the models of a plan that predict any row, all with the shape of the inverse of the file or of the fit to all rows.
fn build_tables(plan: &CvPlan) -> Result<FoldTables> {
    let is_used = |model: &usize| {
        let mut folds = plan.recordings.iter().flat_map(|recording| &recording.folds);
        folds.any(|(_, of)| of == model)
    };
    let build = |path: &Path, file: ModelFile| -> Result<DeviceModel> {
        let bytes = toml::to_string(&file)?;
        Ok(build_model(file, path, bytes.as_bytes(), ModelVariant::Fitted)?)
    };
    let used: Vec<usize> = (0..plan.models.len()).filter(is_used).collect();
    let Some(whole) = plan.models.last().filter(|_| !used.is_empty()) else {
        return Ok(Ok(Vec::new()));
    };
    let stated = plan.models.iter().find_map(|model| model.file.inverse);
    let shape = stated.map_or_else(|| Ok(build(&whole.path, whole.file.clone())?.chosen.shape), Ok);
    let all = shape.and_then(|shape| {
        let build = |place: &usize| {
            let Model { path, file, .. } = &plan.models[*place];
            let file = ModelFile { inverse: Some(shape), ..file.clone() };
            Ok((*place, build(path, file)?))
        };
        used.par_iter().map(build).collect::<Result<Vec<_>>>()
    });
    match all {
        Ok(all) => {
            let mut built: Vec<Option<DeviceModel>> = plan.models.iter().map(|_| None).collect();
            all.into_iter().for_each(|(model, tables)| built[model] = Some(tables));
            Ok(Ok(built))
        }
        Err(error) => match error.downcast_ref::<BuildError>() {
            Some(BuildError::NotInvertible { why, .. }) => {
                Ok(Err(MissingForces::NotInvertible((**why).clone())))
            }
            Some(BuildError::NotCompensable(why)) => {
                Ok(Err(MissingForces::NotCompensable(why.clone())))
            }
            Some(BuildError::TableOverflow { overflow, .. }) => {
                Ok(Err(MissingForces::NotRepresentable(overflow.to_string())))
            }
            _ => Err(error),
        },
    }
}

/// The replay of one recording in one pass, each segment with the model of its fold of each plan.
struct FoldReplay<'a> {
    plans: &'a [CvPlan],
    built: &'a [FoldTables],
    recording: usize,
    offsets: Option<&'a RecordingOffsets>,
    alignment: Alignment,
}

/// A replay of [`FoldReplay`]: its plan and model, and whether the readings are without what no model compensates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct FoldModelReplay {
    plan: usize,
    model: usize,
    is_reducible: bool,
}

impl FoldReplay<'_> {
    /// Sensors by plan; the first plan with its curves where `has_curves`. `origin_s` is the first row of the recording on the
    /// reference's clock.
    fn run(
        &self,
        origin_s: f64,
        excitation: &RecordingExcitation,
        has_curves: bool,
    ) -> Result<Vec<Vec<SensorForces>>> {
        let used = self.replays();
        let named = &self.plans[0].recordings[self.recording].named;
        let corrections: Vec<Vec<SensorCorrections>> =
            used.iter().map(|of| self.corrections(*of, excitation, origin_s)).collect();
        let inputs = used.iter().zip(&corrections).map(|(of, corrections)| {
            let built = self.built[of.plan].as_ref().ok();
            let built = built.and_then(|built| built.get(of.model)?.as_ref());
            let built = built.ok_or_else(|| anyhow!("{}: no tables were built", named.name))?;
            let irreducible =
                if of.is_reducible { Irreducible::Subtracted } else { Irreducible::Kept };
            let counts_events = self.has_origin(of.plan, |origin| origin == ErrorOrigin::Event);
            let models = ReplayModels::of(built);
            Ok(ReplayInput { models, corrections, irreducible, counts_events })
        });
        let inputs = inputs.collect::<Result<Vec<ReplayInput>>>()?;
        let stream = RawStream::open_folder(&named.folder, self.alignment)?;
        let mut segments: Vec<Vec<SensorForces>> = vec![Vec::new(); used.len()];
        let replayed = replay_each(
            &inputs,
            &named.name,
            stream,
            |_| (),
            |place, row| {
                let FoldModelReplay { plan, model, is_reducible } = used[place];
                let time_s = row.time_s - 1e-6 * self.alignment.delay_us - origin_s;
                let folds = &self.plans[plan].recordings[self.recording].folds;
                let fold = folds.iter().find(|(until, _)| time_s < *until);
                if fold.is_none_or(|(_, of)| *of != model) {
                    return;
                }
                let segment = &mut segments[place];
                while segment.len() <= row.sensor {
                    segment.push(SensorForces::default());
                }
                let sensor = &mut segment[row.sensor];
                if has_curves && plan == 0 && !is_reducible {
                    sensor.time_s.push(time_s);
                    for (axis, curves) in sensor.curves.iter_mut().enumerate() {
                        curves[0].push(row.reference_n[axis]);
                        curves[1].push(row.estimate_n[axis]);
                    }
                }
                let measured = sensor.channels.iter_mut().enumerate();
                for (axis, channel) in measured.filter(|(axis, _)| !row.reference_n[*axis].is_nan())
                {
                    let error = row.estimate_n[axis] - row.reference_n[axis];
                    if is_reducible {
                        channel.reducible.add(error);
                    } else if row.is_flagged {
                        channel.flagged.add(error);
                    } else {
                        channel.errors.add(row.reference_n[axis], error);
                        channel.recorded.add(row.estimate_n[axis] - row.recorded_n[axis]);
                        channel.count(error);
                    }
                }
            },
        )?;
        let mut of_plans: Vec<Vec<SensorForces>> = vec![Vec::new(); self.plans.len()];
        for (of, (mut segment, replayed)) in used.iter().zip(segments.into_iter().zip(&replayed)) {
            let is_same = |other: &&FoldModelReplay| {
                (other.plan, other.is_reducible) == (of.plan, of.is_reducible)
            };
            let is_whole = used.iter().filter(is_same).count() == 1 && !of.is_reducible;
            add_noise_and_tare(&mut segment, replayed, is_whole);
            let sensors = &mut of_plans[of.plan];
            if sensors.is_empty() {
                *sensors = segment
            } else {
                sensors.iter_mut().zip(segment).for_each(|(sensor, more)| sensor.append(more))
            }
        }
        for sensors in &mut of_plans {
            sensors.retain(|sensor| sensor.channels.iter().any(|of| of.errors.rows() > 0.0));
            sensors.iter_mut().for_each(SensorForces::sort);
        }
        Ok(of_plans)
    }

    /// Whether the models of a plan, which have the same effects, contain one of such an origin.
    fn has_origin(&self, plan: usize, is_origin: impl Fn(ErrorOrigin) -> bool) -> bool {
        self.plans[plan].models.first().is_some_and(|model| model.has_origin(is_origin))
    }

    /// The replays of all plans with tables.
    fn replays(&self) -> Vec<FoldModelReplay> {
        let mut used = Vec::new();
        for (plan, (of, built)) in self.plans.iter().zip(self.built).enumerate() {
            let is_irreducible = self.has_origin(plan, ErrorOrigin::is_irreducible);
            let kinds: &[bool] = if is_irreducible { &[false, true] } else { &[false] };
            for &(_, model) in of.recordings[self.recording].folds.iter().filter(|_| built.is_ok())
            {
                used.extend(kinds.iter().map(|&is_reducible| FoldModelReplay {
                    plan,
                    model,
                    is_reducible,
                }));
            }
        }
        used.sort_unstable();
        used.dedup();
        used
    }

    /// What separates the recording from the conditions of a model's tables.
    fn corrections(
        &self,
        of: FoldModelReplay,
        excitation: &RecordingExcitation,
        origin_s: f64,
    ) -> Vec<SensorCorrections> {
        let plan = &self.plans[of.plan];
        let (Some(model), planned) = (plan.models.get(of.model), &plan.recordings[self.recording])
        else {
            return Vec::new();
        };
        let clock_s = origin_s + 1e-6 * self.alignment.delay_us;
        let mut corrections = recording_corrections(&planned.named, model, excitation, clock_s);
        if let Some(offsets) = self.offsets {
            add_offsets(&mut corrections, offsets);
        }
        corrections
    }
}

/// Sets number, noise and tare of the sensors; a tare only if one model replayed the `whole` recording.
fn add_noise_and_tare(segment: &mut [SensorForces], replayed: &RecordingReplay, whole: bool) {
    for (sensor, of) in segment.iter_mut().zip(&replayed.sensors) {
        sensor.number = of.number;
        for (channel, track) in sensor.channels.iter_mut().zip(&of.axes) {
            let rows = channel.rows();
            channel.noise = rows * track.noise_n * track.noise_n;
            if let (true, Some(tared)) = (whole, track.tared()) {
                channel.tared = tared;
            }
        }
    }
}

impl SensorForces {
    /// Its curves, of at most this many points.
    fn trace(&self, recording: &str, points: usize) -> ForceTrace {
        let curve = |values: &Vec<f64>| Envelope::of(&self.time_s, values, points);
        ForceTrace {
            recording: recording.to_owned(),
            sensor: self.number,
            force: self.curves.iter().map(|of| [curve(&of[0]), curve(&of[1])]).collect(),
        }
    }

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
    fn rows(&self) -> f64 {
        self.errors.rows() + self.flagged.rows()
    }

    fn count(&mut self, error_n: f64) {
        self.histogram.resize(FINE, 0);
        let place = (error_n / WIDEST_N + 1.0) / 2.0 * FINE as f64;
        self.histogram[(place.max(0.0) as usize).min(FINE - 1)] += 1;
    }

    fn add(&mut self, other: Self) {
        self.errors = std::mem::take(&mut self.errors).with(&other.errors);
        self.recorded = self.recorded.with(other.recorded);
        self.flagged = self.flagged.with(other.flagged);
        self.reducible = self.reducible.with(other.reducible);
        self.tared = self.tared.with(other.tared);
        self.noise += other.noise;
        self.histogram.resize(FINE, 0);
        self.histogram.iter_mut().zip(&other.histogram).for_each(|(a, b)| *a += b);
    }
}

fn finish(channels: &[(u32, [Channel; 2])]) -> ForceEvaluation {
    let axes = [Axis::X, Axis::Z];
    let errors = channels.iter().flat_map(|(sensor, channels)| {
        let measured = channels.iter().zip(axes).filter(|(channel, _)| channel.rows() > 0.0);
        measured.map(|(channel, axis)| {
            let error = channel.errors.statistics();
            let rows = channel.rows();
            let floor = (channel.noise / rows.max(1.0)).sqrt();
            let some = |moments: &Moments| (moments.rows() > 0.0).then(|| moments.rms());
            let reducible_rms = some(&channel.reducible).unwrap_or(error.rms);
            ForceAxisErrors {
                sensor: *sensor,
                axis,
                error,
                recorded_rms: some(&channel.recorded).unwrap_or(error.rms),
                reducible_rms,
                flagged: some(&channel.flagged)
                    .map(|rms| FlaggedRows { share: channel.flagged.rows() / rows, rms_n: rms }),
                tared_rms: some(&channel.tared),
                floor,
                explainable: (reducible_rms.powi(2) - floor.powi(2)).max(0.0).sqrt(),
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
    let is_measured =
        |axis: &usize| channels.iter().any(|(_, channels)| channels[*axis].rows() > 0.0);
    ForceEvaluation {
        errors: errors.collect(),
        histograms: (0..2).filter(is_measured).map(histogram).collect(),
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
