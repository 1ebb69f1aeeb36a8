//! Errors of the field over a campaign, in one pass with a few recordings in memory.

use crate::compare::campaign_reader::CampaignReader;
use crate::compare::covariates::all_covariates;
use crate::compare::cv_plan::{CvPlan, RecordingFolds};
use crate::compare::residual_table::{MAX_ROWS, ResidualTable};
use crate::compare::{Envelope, ErrorUnit, Trace};
use crate::model::Model;
use crate::notes::Note;
use crate::progress;
use crate::statistics::ErrorAccumulator;
use anyhow::{Result, bail};
use model_export::effects::excitation::LoadCycleCounter;
use model_export::fit::cross_validation::noise_variance;
use model_export::fit::rows::{RecordingRows, check_forces};
use model_export::model_file::{FieldPrediction, ModelFile};
use model_export::physics::SensorOrientation;
use model_export::physics::sensor::force_per_field;
use model_export::recordings::columns::Axis;
use model_export::recordings::noise_estimate::NoiseEstimate;
use model_export::recordings::{Campaign, DataError, Notice, Recording};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

/// Maximum points of all curves.
const POINTS: usize = 400_000;

/// Results of one sensor over the campaign.
pub struct SensorEvaluation {
    pub sensor: u32,
    orientation: SensorOrientation,
    /// Forces that its model depends on.
    pub forces: Vec<(u32, Axis)>,
    /// Errors of each axis in gauss.
    pub errors: [ErrorAccumulator; 3],
    /// Sums over rows of the squared floor components by axis: white noise, quantisation, reference noise.
    pub floor: [Vector3<f64>; 3],
    /// Residuals for the attribution.
    pub columns: ResidualTable,
    cycles: LoadCycleCounter,
}

/// Results of one pass over the campaign.
pub struct FieldEvaluation {
    /// Sensors in the order of their numbers.
    pub sensors: Vec<SensorEvaluation>,
    /// Field over time.
    pub traces: Vec<Trace>,
    /// First row of each recording on the reference's clock, in seconds.
    pub origins_s: Vec<f64>,
    /// Duration of each recording in seconds.
    pub spans_s: Vec<f64>,
    /// Notices of the reader on the recordings.
    pub notices: Vec<Notice>,
    /// Noise of the recordings.
    pub noise: Vec<NoiseEstimate>,
}

/// Evaluates the field of every sensor that model and recordings have in common; the others are added to `notes`.
///
/// # Errors
/// A recording cannot be read or is of another gripper, or no sensor has field and forces.
pub fn evaluate_fields(
    plan: &CvPlan,
    source: &CampaignReader,
    notes: &mut Vec<Note>,
) -> Result<FieldEvaluation> {
    let campaign = source.folder.as_path();
    let mut evaluation = FieldEvaluation {
        sensors: Vec::new(),
        traces: Vec::new(),
        origins_s: Vec::new(),
        spans_s: Vec::new(),
        notices: Vec::new(),
        noise: Vec::new(),
    };
    let mut first: Option<Recording> = None;
    let mut before_s = 0.0;
    let bar = progress::progress_bar("comparing the field", plan.recordings.len());
    let at_once = 2 * rayon::current_num_threads();
    let places: Vec<usize> = (0..plan.recordings.len()).collect();
    for places in places.chunks(at_once) {
        let read = places
            .par_iter()
            .map(|&place| source.read(place))
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<Vec<Cow<Recording>>, DataError>>()?;
        for (&place, recording) in places.iter().zip(read) {
            match &first {
                None => {
                    let model = &plan.models[0].file;
                    evaluation.sensors = sensors(model, &recording, campaign)?;
                    notes.extend(left_out(model, &recording, &evaluation.sensors));
                }
                Some(first) => same_gripper(campaign, first, &recording)?,
            }
            evaluation.add(plan, place, &recording, before_s)?;
            before_s += recording.span_s();
            let origin_s = recording.time_s.first().copied();
            evaluation.origins_s.push(origin_s.unwrap_or(0.0));
            evaluation.spans_s.push(recording.span_s());
            evaluation.notices.extend(recording.notices.iter().cloned());
            evaluation.noise.push(recording.noise.clone());
            first.get_or_insert_with(|| recording.without_rows());
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    if evaluation.sensors.iter().all(|sensor| sensor.columns.is_empty()) {
        bail!(
            "{}: no sensor of the model has both field and forces in these recordings",
            campaign.display()
        );
    }
    evaluation.sensors.retain(|sensor| !sensor.columns.is_empty());
    Ok(evaluation)
}

/// The sensors that model and recordings have in common.
fn sensors(
    model: &ModelFile,
    recording: &Recording,
    campaign: &Path,
) -> Result<Vec<SensorEvaluation>> {
    if model.sensors.iter().all(|sensor| !sensor.forces().is_empty()) {
        check_forces(recording)?;
    }
    let mut list = Vec::new();
    let covariates = all_covariates(recording);
    for sensor in &model.sensors {
        let number = sensor.number;
        let forces = sensor.forces();
        let has_forces = forces.iter().all(|force| recording.forces.contains_key(force));
        let signal = recording.sensors.get(&number).filter(|_| has_forces);
        if let Some(signal) = signal {
            let mut columns = ResidualTable::new(number, &covariates);
            columns.unit = ErrorUnit::Signal(signal.unit);
            list.push(SensorEvaluation {
                sensor: number,
                orientation: sensor.orientation,
                forces,
                errors: Default::default(),
                floor: [Vector3::zeros(); 3],
                columns,
                cycles: LoadCycleCounter::default(),
            });
        }
    }
    if list.is_empty() {
        let numbers = |numbers: BTreeSet<u32>| {
            let words: Vec<String> = numbers.iter().map(u32::to_string).collect();
            words.join(", ")
        };
        bail!(
            "{}: the model has sensors {}, these recordings have {} with forces on {}: nothing to compare",
            campaign.display(),
            numbers(model.sensors.iter().map(|sensor| sensor.number).collect()),
            numbers(recording.sensors.keys().copied().collect()),
            numbers(recording.forces.keys().map(|(place, _)| *place).collect()),
        );
    }
    list.sort_by_key(|sensor| sensor.sensor);
    Ok(list)
}

/// Notes on the sensors that only the recordings or only the model have.
fn left_out(model: &ModelFile, recording: &Recording, common: &[SensorEvaluation]) -> Vec<Note> {
    let modelled = || model.sensors.iter().map(|sensor| sensor.number);
    let recorded = recording.sensors.keys().copied();
    let not_in_model = recorded.filter(|number| !modelled().any(|own| own == *number));
    let not_recorded = modelled().filter(|number| !common.iter().any(|own| own.sensor == *number));
    let not_in_model = not_in_model.map(|sensor| Note::NotInModel { sensor });
    not_in_model.chain(not_recorded.map(|sensor| Note::NotRecorded { sensor })).collect()
}

impl FieldEvaluation {
    fn add(
        &mut self,
        plan: &CvPlan,
        place: usize,
        recording: &Recording,
        before_s: f64,
    ) -> Result<()> {
        let planned = &plan.recordings[place];
        let all = plan.recordings.len() * recording.time_s.len();
        let stride = all.div_ceil(MAX_ROWS).max(1);
        let points = (POINTS / (10 * self.sensors.len() * plan.recordings.len())).clamp(50, 3000);
        let traces = self
            .sensors
            .par_iter_mut()
            .map(|sensor| {
                let (errors, part) =
                    sensor.evaluate(plan, planned, recording, (place, before_s))?;
                Some(sensor.add(&part, &errors, place, stride, points, recording))
            })
            .collect::<Vec<Option<Trace>>>();
        self.traces.extend(traces.into_iter().flatten());
        Ok(())
    }
}

/// Modelled fields and squared noise floors of one recording.
struct Modelled {
    /// Cross-validated prediction.
    field_g: Vec<Vector3<f64>>,
    /// Prediction by the model's own parameters, used for attribution: it is consistent over all recordings,
    /// whereas the fold models differ.
    own: FieldPrediction,
    /// Squared noise of the reference times dB/dF.
    reference_g2: Vec<Vector3<f64>>,
    floor_g2: Vec<Vector3<f64>>,
}

impl SensorEvaluation {
    /// `None` where a recording lacks the sensor or one of its forces.
    fn evaluate(
        &mut self,
        plan: &CvPlan,
        planned: &RecordingFolds,
        recording: &Recording,
        place: (usize, f64),
    ) -> Option<(Modelled, RecordingRows)> {
        let part = RecordingRows::of(recording, place, self.sensor, &self.forces)?;
        let mut part = part.turned(self.orientation);
        self.cycles.update(&mut part.track);
        let rows = part.len();
        let mut modelled = Modelled {
            field_g: Vec::with_capacity(rows),
            own: self.predict(plan.models.first()?, planned, &mut part)?,
            reference_g2: Vec::with_capacity(rows),
            floor_g2: Vec::with_capacity(rows),
        };
        for &(until, number) in &planned.folds {
            let model = plan.models.get(number)?;
            let end = part.track.time_s.partition_point(|time| *time < until);
            if end <= modelled.field_g.len() {
                continue;
            }
            let predicted = self.predict(model, planned, &mut part)?;
            for row in modelled.field_g.len()..end {
                let slopes = predicted.per_newton[row].iter().copied();
                let floor = noise_variance(&part, Some(row), slopes);
                modelled.field_g.push(predicted.field_g[row]);
                modelled.reference_g2.push(floor - noise_variance(&part, None, []));
                modelled.floor_g2.push(floor);
            }
        }
        (modelled.field_g.len() == rows).then_some((modelled, part))
    }

    fn predict(
        &self,
        model: &Model,
        planned: &RecordingFolds,
        part: &mut RecordingRows,
    ) -> Option<FieldPrediction> {
        let predictor = model.file.predictor(self.sensor, &model.effects)?;
        part.track.recording = model.place_of(&planned.named.sha256);
        Some(predictor.over(part, &self.forces))
    }

    fn add(
        &mut self,
        part: &RecordingRows,
        modelled: &Modelled,
        place: usize,
        stride: usize,
        points: usize,
        recording: &Recording,
    ) -> Trace {
        let minus = |modelled: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            part.field_g.iter().zip(modelled).map(|(b, m)| b - m).collect()
        };
        let (residual, own) = (minus(&modelled.field_g), minus(&modelled.own.field_g));
        let step = recording.description.gauss_per_lsb.unwrap_or(0.0) * recording.noise_gain;
        let steps = Vector3::repeat(step * step / 12.0);
        let white = noise_variance(part, None, []);
        for (row, error) in residual.iter().enumerate() {
            for axis in 0..3 {
                self.errors[axis].add(part.field_g[row][axis], error[axis]);
            }
            self.floor[0] += white;
            self.floor[1] += steps;
            self.floor[2] += modelled.reference_g2[row];
        }
        self.columns.push(place, &part.track, &own, &modelled.floor_g2, stride);
        let rows = own.iter().zip(&modelled.own.per_newton);
        let forces: Option<Vec<_>> = rows
            .map(|(residual, slopes)| {
                let forces = self.forces.iter().map(|(_, axis)| *axis);
                let slopes: Vec<_> = forces.zip(slopes.iter().copied()).collect();
                as_forces(residual, &slopes, modelled.own.weights, part, white)
            })
            .collect();
        self.columns.push_forces(&forces.unwrap_or_default(), stride);
        let curve = |of: &[Vector3<f64>], axis: usize| {
            let values: Vec<f64> = of.iter().map(|field| field[axis]).collect();
            Envelope::of(&part.track.time_s, &values, points)
        };
        Trace {
            recording: recording.name.clone(),
            unit: recording.noise.unit,
            sensor: self.sensor,
            field: (0..3)
                .map(|axis| [curve(&part.field_g, axis), curve(&modelled.field_g, axis)])
                .collect(),
            force: Vec::new(),
        }
    }
}

/// The residual of a row in gauss as the error of the forces that it causes in the device's inverse, and its squared noise, where
/// the device has one. `per_newton` is the derivative of the field to each measured force, `weights` are those of the field axes,
/// `white_g2` is the squared white noise of the field.
fn as_forces(
    residual_g: &Vector3<f64>,
    per_newton: &[(Axis, Vector3<f64>)],
    weights: Vector3<f64>,
    part: &RecordingRows,
    white_g2: Vector3<f64>,
) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let place = [Axis::X, Axis::Z].map(|axis| per_newton.iter().position(|(of, _)| *of == axis));
    let slopes = place.map(|place| place.map_or_else(Vector3::zeros, |place| per_newton[place].1));
    let to_force = force_per_field(&slopes, weights)?;
    let error_n = to_force * residual_g;
    let noise_n2 = to_force.component_mul(&to_force) * white_g2;
    let reference_n2 = |axis: usize| {
        let noise_n = place[axis].and_then(|place| part.force_noise_n.get(place));
        noise_n.filter(|noise| noise.is_finite()).map_or(0.0, |noise| noise.powi(2))
    };
    Some((
        Vector3::new(error_n.x, 0.0, error_n.y),
        Vector3::new(noise_n2.x + reference_n2(0), 0.0, noise_n2.y + reference_n2(1)),
    ))
}

fn same_gripper(campaign: &Path, first: &Recording, other: &Recording) -> Result<(), DataError> {
    Campaign {
        folder: campaign.to_path_buf(),
        recordings: vec![first.clone(), other.without_rows()],
    }
    .check_same_gripper()
}
