//! Through the recordings one after the other: residuals of the field, with what they may depend on.
//! Memory holds a few recordings at a time.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Result, bail};
use model_export::effects::track::Cycles;
use model_export::fit::rows::{Part, own_forces};
use model_export::fit::score::floor_squared;
use model_export::model_file::{ModelFile, Predicted};
use model_export::recordings::columns::Axis;
use model_export::recordings::{Campaign, Notice, Problem, Recording};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::covariate::all;
use super::errors::Errors;
use super::plan::{Judge, Plan, Planned};
use super::rows::{MOST_ROWS, SensorColumns};
use super::source::Source;
use super::{Curve, Trace};
use crate::progress;

/// Points of all curves together.
const POINTS: usize = 400_000;

/// One sensor over the campaign.
pub struct SensorSeen {
    /// Its number.
    pub sensor: u32,
    /// The forces that its model takes.
    pub forces: Vec<(u32, Axis)>,
    /// Errors of each axis in gauss.
    pub errors: [Errors; 3],
    /// Sums of the squared parts of the floor over the rows, each axis: the sensor's white noise, its
    /// steps, the reference's noise.
    pub floor: [Vector3<f64>; 3],
    /// Rows for the search.
    pub columns: SensorColumns,
    cycles: Cycles,
}

/// Everything that one pass over the campaign tells.
pub struct Seen {
    /// In the order of their numbers.
    pub sensors: Vec<SensorSeen>,
    /// Curves of the field.
    pub traces: Vec<Trace>,
    /// The first row of each recording on the reference's clock, in seconds.
    pub origins_s: Vec<f64>,
    /// Span of each recording in seconds.
    pub spans_s: Vec<f64>,
    /// What a person should know of the recordings.
    pub notices: Vec<Notice>,
}

/// Reads the recordings of `plan` and judges the field of every sensor that model and recordings share.
pub fn collect(plan: &Plan, source: &Source) -> Result<Seen> {
    let campaign = source.folder.as_path();
    let mut seen = Seen {
        sensors: Vec::new(),
        traces: Vec::new(),
        origins_s: Vec::new(),
        spans_s: Vec::new(),
        notices: Vec::new(),
    };
    let mut first: Option<Recording> = None;
    let mut before_s = 0.0;
    let bar = progress::bar("comparing the field", plan.recordings.len());
    let at_once = 2 * rayon::current_num_threads();
    let places: Vec<usize> = (0..plan.recordings.len()).collect();
    for places in places.chunks(at_once) {
        let read = places
            .par_iter()
            .map(|&place| source.read(place))
            .collect::<Result<Vec<Cow<Recording>>, Problem>>()?;
        for (&place, recording) in places.iter().zip(read) {
            match &first {
                None => seen.sensors = sensors(&plan.judges[0].model, &recording, campaign)?,
                Some(first) => same_gripper(campaign, first, &recording)?,
            }
            seen.take(plan, place, &recording, before_s)?;
            before_s += recording.span_s();
            let origin_s = recording.time_s.first().copied();
            seen.origins_s.push(origin_s.unwrap_or(0.0));
            seen.spans_s.push(recording.span_s());
            seen.notices.extend(recording.notices.iter().cloned());
            first.get_or_insert_with(|| emptied(&recording));
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    if seen.sensors.iter().all(|sensor| sensor.columns.is_empty()) {
        bail!(
            "{}: no sensor of the model has its field and its forces in these recordings",
            campaign.display()
        );
    }
    seen.sensors.retain(|sensor| !sensor.columns.is_empty());
    Ok(seen)
}

/// The sensors that the model knows and the recordings have.
fn sensors(model: &ModelFile, recording: &Recording, campaign: &Path) -> Result<Vec<SensorSeen>> {
    let mut list = Vec::new();
    let covariates = all(recording);
    for sensor in &model.sensors {
        let number = sensor.number;
        let forces = match sensor.polynomial() {
            Some(polynomial) => polynomial.forces,
            None => own_forces(number).to_vec(),
        };
        let has = forces
            .iter()
            .all(|force| recording.forces.contains_key(force));
        if recording.sensors.contains_key(&number) && has {
            list.push(SensorSeen {
                sensor: number,
                forces,
                errors: Default::default(),
                floor: [Vector3::zeros(); 3],
                columns: SensorColumns::new(number, &covariates),
                cycles: Cycles::default(),
            });
        }
    }
    if list.is_empty() {
        let numbers = |numbers: BTreeSet<u32>| {
            let words: Vec<String> = numbers.iter().map(u32::to_string).collect();
            words.join(", ")
        };
        bail!(
            "{}: the model knows sensors {}, these recordings have {} with forces on {}: nothing can be compared",
            campaign.display(),
            numbers(model.sensors.iter().map(|sensor| sensor.number).collect()),
            numbers(recording.sensors.keys().copied().collect()),
            numbers(recording.forces.keys().map(|(place, _)| *place).collect()),
        );
    }
    list.sort_by_key(|sensor| sensor.sensor);
    for number in recording.sensors.keys() {
        if !model.sensors.iter().any(|sensor| sensor.number == *number) {
            eprintln!(
                "note: sensor {number} of the recordings is not in the model, and is left out"
            );
        }
    }
    for sensor in &model.sensors {
        if !list.iter().any(|seen| seen.sensor == sensor.number) {
            let number = sensor.number;
            eprintln!(
                "note: sensor {number} of the model has not its field and its forces in these recordings, and is left out"
            );
        }
    }
    Ok(list)
}

impl Seen {
    fn take(
        &mut self,
        plan: &Plan,
        place: usize,
        recording: &Recording,
        before_s: f64,
    ) -> Result<()> {
        let planned = &plan.recordings[place];
        let all = plan.recordings.len() * recording.time_s.len();
        let stride = all.div_ceil(MOST_ROWS).max(1);
        let points = (POINTS / (10 * self.sensors.len() * plan.recordings.len())).clamp(50, 3000);
        let traces = self
            .sensors
            .par_iter_mut()
            .map(|sensor| {
                let (errors, part) = sensor.judge(plan, planned, recording, (place, before_s))?;
                Some(sensor.add(&part, &errors, place, stride, points, recording))
            })
            .collect::<Vec<Option<Trace>>>();
        self.traces.extend(traces.into_iter().flatten());
        Ok(())
    }
}

/// Modelled fields and squared floors of the rows of one recording.
struct Modelled {
    /// By values that have not seen the row.
    field_g: Vec<Vector3<f64>>,
    /// By the model's own values. What an error depends on is sought in these: they are the same for
    /// all recordings, where those that leave one out are each wrong in a way of their own.
    own_g: Vec<Vector3<f64>>,
    /// Of the reference's noise through dB/dF.
    reference_g2: Vec<Vector3<f64>>,
    floor_g2: Vec<Vector3<f64>>,
}

impl SensorSeen {
    /// `None` where a recording has not the sensor or a force of it.
    fn judge(
        &mut self,
        plan: &Plan,
        planned: &Planned,
        recording: &Recording,
        place: (usize, f64),
    ) -> Option<(Modelled, Part)> {
        let mut part = Part::of(recording, place, self.sensor, &self.forces)?;
        self.cycles.count(&mut part.track);
        let rows = part.len();
        let mut modelled = Modelled {
            field_g: Vec::with_capacity(rows),
            own_g: self
                .predict(plan.judges.first()?, planned, &mut part)?
                .field_g,
            reference_g2: Vec::with_capacity(rows),
            floor_g2: Vec::with_capacity(rows),
        };
        for &(until, number) in &planned.judges {
            let judge = plan.judges.get(number)?;
            let end = part.track.time_s.partition_point(|time| *time < until);
            if end <= modelled.field_g.len() {
                continue;
            }
            let predicted = self.predict(judge, planned, &mut part)?;
            for row in modelled.field_g.len()..end {
                let slopes = predicted.per_newton[row].iter().copied();
                let floor = floor_squared(&part, slopes);
                modelled.field_g.push(predicted.field_g[row]);
                modelled.reference_g2.push(floor - floor_squared(&part, []));
                modelled.floor_g2.push(floor);
            }
        }
        (modelled.field_g.len() == rows).then_some((modelled, part))
    }

    /// What a judge says of a recording.
    fn predict(&self, judge: &Judge, planned: &Planned, part: &mut Part) -> Option<Predicted> {
        let predictor = judge.model.predictor(self.sensor, &judge.additions)?;
        part.track.recording = judge.place_of(planned);
        Some(predictor.over(part, &self.forces))
    }

    fn add(
        &mut self,
        part: &Part,
        modelled: &Modelled,
        place: usize,
        stride: usize,
        points: usize,
        recording: &Recording,
    ) -> Trace {
        let minus = |modelled: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            part.field_g
                .iter()
                .zip(modelled)
                .map(|(b, m)| b - m)
                .collect()
        };
        let (residual, own) = (minus(&modelled.field_g), minus(&modelled.own_g));
        let step = recording.description.gauss_per_lsb.unwrap_or(0.0) * recording.noise_gain;
        let steps = Vector3::repeat(step * step / 12.0);
        let white = floor_squared(part, []);
        for (row, error) in residual.iter().enumerate() {
            for axis in 0..3 {
                self.errors[axis].add(part.field_g[row][axis], error[axis]);
            }
            self.floor[0] += white;
            self.floor[1] += steps;
            self.floor[2] += modelled.reference_g2[row];
        }
        self.columns
            .push(place, &part.track, &own, &modelled.floor_g2, stride);
        let curve = |of: &[Vector3<f64>], axis: usize| {
            let values: Vec<f64> = of.iter().map(|field| field[axis]).collect();
            Curve::of(&part.track.time_s, &values, points)
        };
        Trace {
            recording: recording.name.clone(),
            sensor: self.sensor,
            field: (0..3)
                .map(|axis| [curve(&part.field_g, axis), curve(&modelled.field_g, axis)])
                .collect(),
            force: Vec::new(),
        }
    }
}

/// A recording without its rows.
fn emptied(recording: &Recording) -> Recording {
    Recording {
        name: recording.name.clone(),
        folder: recording.folder.clone(),
        description: recording.description.clone(),
        time_s: Vec::new(),
        sensors: recording
            .sensors
            .keys()
            .map(|number| (*number, Default::default()))
            .collect(),
        forces: Default::default(),
        covariates: Default::default(),
        notices: Vec::new(),
        ..*recording
    }
}

fn same_gripper(campaign: &Path, first: &Recording, other: &Recording) -> Result<(), Problem> {
    Campaign {
        folder: campaign.to_path_buf(),
        recordings: vec![first.clone(), emptied(other)],
    }
    .check_same_gripper()
}
