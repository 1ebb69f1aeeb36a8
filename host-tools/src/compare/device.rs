//! The forces through the device's own code, beside the reference, at the board's rate.

use std::path::Path;

use anyhow::{Result, anyhow};
use model_export::inverse::build::{BuildError, Built, Variant, build_model};
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;
use rayon::prelude::*;

use super::errors::Errors;
use super::plan::{Plan, Planned};
use super::{Curve, ForceFigures, Histogram, Trace};
use crate::progress;
use crate::replay::{Models, RecordingReplay, replay_watched};
use crate::sums::Sums;

/// Bins of the histograms as they are shown.
const BINS: usize = 61;
/// Bins while the rows go by, over this many newtons either way: far finer and far wider than shown.
const FINE: usize = 4000;
/// See [`FINE`].
const WIDEST_N: f64 = 100.0;
/// Share of the rows within the ends of a histogram as it is shown.
const SHOWN: f64 = 0.998;
/// Points of all curves together.
const POINTS: usize = 200_000;

/// What the forces show.
#[derive(Default)]
pub struct Forces {
    /// Every sensor, lateral then longitudinal.
    pub figures: Vec<ForceFigures>,
    /// Lateral, longitudinal.
    pub histograms: Vec<Histogram>,
    /// Why there are none.
    pub none: Option<String>,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// Errors of one force of one sensor.
#[derive(Clone, Default)]
struct Channel {
    errors: Errors,
    tared: Sums,
    /// Sum of the squared noise over the rows.
    noise: f64,
    histogram: Vec<u64>,
}

/// One sensor over one recording.
struct SensorOf {
    number: u32,
    channels: [Channel; 2],
    time_s: Vec<f64>,
    /// Reference, device; lateral, longitudinal.
    curves: [[Vec<f64>; 2]; 2],
}

/// Replays every recording by its judges; the curves go into the `traces` of the same recordings and
/// sensors.
/// `origins_s` are the first rows on the reference's clock, from which the recordings' times count.
pub fn forces(
    plan: &Plan,
    path: &Path,
    alignment: Alignment,
    origins_s: &[f64],
    traces: &mut [Trace],
) -> Result<Forces> {
    let used: Vec<bool> = (0..plan.judges.len())
        .map(|judge| {
            let of = |recording: &Planned| recording.judges.iter().any(|(_, j)| *j == judge);
            plan.recordings.iter().any(of)
        })
        .collect();
    let bar = progress::bar("building tables", used.iter().filter(|used| **used).count());
    let built = plan
        .judges
        .par_iter()
        .zip(&used)
        .map(|(judge, used)| {
            if !used {
                return Ok(None);
            }
            let bytes = toml::to_string(&judge.model)?;
            let built = build_model(judge.model.clone(), path, bytes.as_bytes(), Variant::Fitted)?;
            bar.inc(1);
            Ok(Some(built))
        })
        .collect::<Result<Vec<Option<Built>>>>();
    bar.finish_and_clear();
    let built = match built {
        Ok(built) => built,
        Err(error) => match error.downcast_ref::<BuildError>() {
            Some(BuildError::Polynomial { .. }) => {
                return Ok(none("a polynomial of the forces has no unique inverse: the device needs a model with the cylinder base".to_owned()));
            }
            Some(BuildError::NotUndone(why)) => return Ok(none(why.to_string())),
            _ => return Err(error),
        },
    };
    let bar = progress::bar("replaying on the device's code", plan.recordings.len());
    let mut channels: Vec<(u32, [Channel; 2])> = Vec::new();
    let mut lacking = 0;
    let at_once = 2 * rayon::current_num_threads();
    let points = (POINTS / (4 * traces.len().max(1))).clamp(50, 3000);
    let of_all: Vec<(&Planned, &f64)> = plan.recordings.iter().zip(origins_s).collect();
    for planned in of_all.chunks(at_once) {
        let replayed = planned
            .par_iter()
            .map(|(planned, origin_s)| {
                let one = one(planned, &built, alignment, **origin_s);
                bar.inc(1);
                one
            })
            .collect::<Result<Vec<_>>>()?;
        for ((planned, _), (sensors, rows_lacking)) in planned.iter().zip(replayed) {
            lacking += rows_lacking;
            for sensor in sensors {
                let matches =
                    |t: &&mut Trace| t.recording == planned.named.name && t.sensor == sensor.number;
                if let Some(trace) = traces.iter_mut().find(matches) {
                    let curve = |values: &Vec<f64>| Curve::of(&sensor.time_s, values, points);
                    trace.force = sensor
                        .curves
                        .iter()
                        .map(|of| [curve(&of[0]), curve(&of[1])])
                        .collect();
                }
                match channels
                    .iter_mut()
                    .find(|(number, _)| *number == sensor.number)
                {
                    Some((_, known)) => {
                        known
                            .iter_mut()
                            .zip(sensor.channels)
                            .for_each(|(a, b)| a.add(b));
                    }
                    None => channels.push((sensor.number, sensor.channels)),
                }
            }
        }
    }
    bar.finish_and_clear();
    let mut result = finish(&channels);
    if lacking > 0 {
        result.notes.push(format!(
            "in {lacking} estimates an effect could not be undone, since the column that it needs was not recorded"
        ));
    }
    if result.figures.is_empty() {
        result.none =
            Some("in no row are a valid estimate and both measured forces together".to_owned());
    }
    Ok(result)
}

fn none(why: String) -> Forces {
    Forces {
        none: Some(why),
        ..Forces::default()
    }
}

/// One recording, each stretch by its judge; and the rows in which something could not be undone.
fn one(
    planned: &Planned,
    built: &[Option<Built>],
    alignment: Alignment,
    origin_s: f64,
) -> Result<(Vec<SensorOf>, u64)> {
    let (description, _) = Description::read(&planned.named.folder)?;
    let mut judges: Vec<usize> = planned.judges.iter().map(|(_, judge)| *judge).collect();
    judges.sort_unstable();
    judges.dedup();
    let (mut sensors, mut lacking): (Vec<SensorOf>, u64) = (Vec::new(), 0);
    for judge in &judges {
        let built = built
            .get(*judge)
            .and_then(Option::as_ref)
            .ok_or_else(|| anyhow!("{}: no tables were built for it", planned.named.name))?;
        let models = Models::of(built);
        let stream = RawStream::open(&planned.named.folder, &description, alignment)?;
        let mut seen: Vec<SensorOf> = Vec::new();
        let replayed = replay_watched(
            models,
            &planned.named.name,
            stream,
            |_| (),
            |row| {
                let time_s = row.time_s - 1e-6 * alignment.delay_us - origin_s;
                let in_charge = planned.judges.iter().find(|(until, _)| time_s < *until);
                if in_charge.is_none_or(|(_, of)| of != judge) {
                    return;
                }
                while seen.len() <= row.sensor {
                    seen.push(SensorOf::new());
                }
                let sensor = &mut seen[row.sensor];
                sensor.time_s.push(time_s);
                for axis in 0..2 {
                    sensor.curves[axis][0].push(row.reference_n[axis]);
                    sensor.curves[axis][1].push(row.found_n[axis]);
                    let error = row.found_n[axis] - row.reference_n[axis];
                    sensor.channels[axis]
                        .errors
                        .add(row.reference_n[axis], error);
                    sensor.channels[axis].count(error);
                }
            },
        )?;
        lacking += replayed
            .sensors
            .iter()
            .map(|sensor| sensor.lacking)
            .sum::<u64>();
        name(&mut seen, &replayed, judges.len() == 1);
        match sensors.is_empty() {
            true => sensors = seen,
            false => sensors
                .iter_mut()
                .zip(seen)
                .for_each(|(sensor, more)| sensor.append(more)),
        }
    }
    sensors.retain(|sensor| !sensor.time_s.is_empty());
    sensors.iter_mut().for_each(SensorOf::sort);
    Ok((sensors, lacking))
}

/// Numbers, noise and tare of the sensors; a tare only where one judge saw the whole recording.
fn name(seen: &mut [SensorOf], replayed: &RecordingReplay, whole: bool) {
    for (sensor, of) in seen.iter_mut().zip(&replayed.sensors) {
        sensor.number = of.number;
        for (channel, track) in sensor.channels.iter_mut().zip(&of.axes) {
            channel.noise = channel.errors.rows() * track.noise_n * track.noise_n;
            if let (true, Some(tared)) = (whole, track.tared()) {
                channel.tared = tared;
            }
        }
    }
}

impl SensorOf {
    fn new() -> Self {
        Self {
            number: 0,
            channels: Default::default(),
            time_s: Vec::new(),
            curves: Default::default(),
        }
    }

    fn append(&mut self, other: Self) {
        self.time_s.extend(other.time_s);
        for (own, other) in self
            .curves
            .iter_mut()
            .flatten()
            .zip(other.curves.into_iter().flatten())
        {
            own.extend(other);
        }
        self.channels
            .iter_mut()
            .zip(other.channels)
            .for_each(|(a, b)| a.add(b));
    }

    /// By time, where several judges took turns.
    fn sort(&mut self) {
        if self.time_s.is_sorted() {
            return;
        }
        let mut order: Vec<usize> = (0..self.time_s.len()).collect();
        order.sort_by(|a, b| self.time_s[*a].total_cmp(&self.time_s[*b]));
        let sorted = |values: &Vec<f64>| order.iter().map(|&row| values[row]).collect();
        self.curves
            .iter_mut()
            .flatten()
            .for_each(|values| *values = sorted(values));
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
        self.histogram
            .iter_mut()
            .zip(&other.histogram)
            .for_each(|(a, b)| *a += b);
    }
}

fn finish(channels: &[(u32, [Channel; 2])]) -> Forces {
    let axes = [Axis::X, Axis::Z];
    let figures = channels.iter().flat_map(|(sensor, channels)| {
        channels.iter().zip(axes).map(|(channel, axis)| {
            let error = channel.errors.figures();
            let floor = (channel.noise / channel.errors.rows().max(1.0)).sqrt();
            ForceFigures {
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
        let of = ["lateral", "longitudinal"][axis];
        shown(format!("error of the {of} force / N"), &fine)
    };
    Forces {
        figures: figures.collect(),
        histograms: vec![histogram(0), histogram(1)],
        ..Forces::default()
    }
}

/// A histogram of as many bins as a person reads, wide enough for nearly all rows.
fn shown(of: String, fine: &[u64]) -> Histogram {
    let all: u64 = fine.iter().sum();
    let middle = FINE / 2;
    let inside = |half: usize| fine[middle - half..middle + half].iter().sum::<u64>();
    let enough = |half: &usize| inside(*half) as f64 >= SHOWN * all as f64;
    let half = (1..=middle).find(enough).unwrap_or(middle);
    // A whole number of fine bins in each shown one; an odd number of them, so that one is about zero.
    let each = (2 * half).div_ceil(BINS).max(1);
    let fine_n = 2.0 * WIDEST_N / FINE as f64;
    let first = middle as f64 - (BINS * each) as f64 / 2.0;
    let mut counts = vec![0; BINS];
    for (place, count) in fine.iter().enumerate() {
        let bin = ((place as f64 - first) / each as f64).floor();
        counts[(bin.max(0.0) as usize).min(BINS - 1)] += count;
    }
    Histogram {
        of,
        edges: (0..=BINS)
            .map(|i| (first + (i * each) as f64 - middle as f64) * fine_n)
            .collect(),
        counts,
    }
}
