//! Detection rate, latency and false alarms of the device's magnetic disturbance detector.
//!
//! Rows of a simulated gripper pass through the device's code twice with the same noise: unmodified, which counts false
//! alarms, and with the added field of magnets that pass at random distances, directions and speeds. The second run
//! counts the magnets that change a force by more than 8 % of its range (20 N of 250 N) and are detected within 20 ms of
//! that. Fields superpose, so magnets can be added to a recording made without any.

use device_run::networks::DeviceNetworks;
use firmware::compensation::Compensation;
use firmware::estimator::{Estimate, Estimator};
use firmware::sensors::hall::{HallFrame, SENSORS};
use indicatif::ProgressBar;
use model_export::inverse::build::DeviceModel;
use model_export::inverse::compensation::OwnedCompensation;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::event::{DisturbanceEvent, DisturbanceSequence, MAX_LATENCY, alarm_error_n};
use super::simulated_rows::SimulatedGripper;

/// Required detection rate.
const MIN_DETECTED: f64 = 0.99;
/// Required upper limit of false alarms in ten hours.
const MAX_FALSE_PER_10H: f64 = 1.0;

/// Counts over any number of recordings.
#[derive(Clone, Debug, Default)]
pub struct DetectionCounts {
    /// Force error above which detection is required, in newtons.
    pub alarm_error_n: f64,
    /// Disturbance-free time in hours.
    pub hours: f64,
    /// Rising edges of the flag in that time.
    pub false_alarms: usize,
    /// Magnets that passed.
    pub events: Vec<DisturbanceEvent>,
}

impl DetectionCounts {
    /// Sum of both.
    pub fn with(mut self, mut other: Self) -> Self {
        self.alarm_error_n = self.alarm_error_n.max(other.alarm_error_n);
        self.hours += other.hours;
        self.false_alarms += other.false_alarms;
        self.events.append(&mut other.events);
        self
    }

    /// Frames from the force error to the flag of the magnets with a force error above the limit, in rising order:
    /// negative if the flag was first, infinite if it was never set.
    pub fn latencies(&self) -> Vec<f64> {
        let relevant = self.events.iter().filter(|event| event.error_at.is_some());
        let mut latencies: Vec<f64> = relevant.map(DisturbanceEvent::latency).collect();
        latencies.sort_by(f64::total_cmp);
        latencies
    }

    /// Number of magnets that were detected in time.
    pub fn detected(&self) -> usize {
        self.latencies().iter().filter(|latency| **latency <= f64::from(MAX_LATENCY)).count()
    }

    /// True if detection rate and false alarms meet the requirements.
    pub fn meets_requirements(&self) -> bool {
        let relevant = self.latencies().len();
        let false_per_10h = self.false_alarms as f64 * 10.0 / self.hours;
        relevant > 0
            && self.detected() as f64 >= MIN_DETECTED * relevant as f64
            && false_per_10h < MAX_FALSE_PER_10H
    }
}

/// Evaluates the detector on `hours` of new recordings of a gripper.
pub fn evaluate(
    built: &DeviceModel,
    gripper: &SimulatedGripper,
    hours: f64,
    bar: &ProgressBar,
) -> DetectionCounts {
    let runs = (hours * 3600.0 / gripper.seconds()).ceil().max(1.0) as u32;
    bar.inc_length(u64::from(runs));
    let counts = |number: u32| {
        let counts = run(built, gripper, number);
        bar.inc(1);
        counts
    };
    let parts = (0..runs).into_par_iter().map(counts);
    parts.reduce(DetectionCounts::default, DetectionCounts::with)
}

/// Maximum difference of a force between two frames, in newtons.
fn max_difference_n(one: &[Estimate; SENSORS], other: &[Estimate; SENSORS]) -> f64 {
    let forces = one.iter().zip(other).flat_map(|(one, other)| {
        [0, 1].map(|axis| (other.force[axis].newtons() - one.force[axis].newtons()).abs())
    });
    forces.fold(0.0, f64::max)
}

fn run(built: &DeviceModel, gripper: &SimulatedGripper, number: u32) -> DetectionCounts {
    let compensations: Vec<Compensation> =
        built.compensations.iter().map(OwnedCompensation::view).collect();
    let tables = built.chosen.tables.tables(&compensations);
    let gauss_per_lsb = built.model.sensor_scale.gauss_per_lsb;
    let [mut clean, mut disturbed] =
        [(); 2].map(|()| Estimator::new(&tables, None::<DeviceNetworks>));
    let mut rows = gripper.rows(number);
    let sensors = built.header.sensors.len().min(SENSORS) as u32;
    let mut magnets = DisturbanceSequence::new(gripper.seed(), number, gripper.seconds(), sensors);
    let mut event: Option<DisturbanceEvent> = None;
    let alarm_error_n = alarm_error_n(built.model.force_range_n());
    let mut counts = DetectionCounts { alarm_error_n, ..DetectionCounts::default() };
    let (mut frame, mut was_set) = (0, false);
    while let Some(row) = rows.next_row() {
        let sensed = |readings| HallFrame { readings, ..HallFrame::default() };
        let readings = row.readings(gauss_per_lsb, |_| Vector3::zeros());
        let undisturbed = clean.update(&sensed(readings), &row.inputs);
        let is_set = clean.detector().flag();
        counts.false_alarms += usize::from(is_set && !was_set);
        counts.hours = row.time_s / 3600.0;
        was_set = is_set;
        if magnets.advance(row.time_s, disturbed.detector().flag()) {
            counts.events.extend(event.take());
            event = Some(DisturbanceEvent::default());
        } else if magnets.magnet.is_none() {
            counts.events.extend(event.take());
        }
        let added = |sensor: usize| {
            let field_g = magnets.field(sensor as u32, row.time_s);
            rows.in_sensor_axes(sensor, field_g)
        };
        let readings = row.readings(gauss_per_lsb, added);
        let estimates = disturbed.update(&sensed(readings), &row.inputs);
        if let Some(event) = &mut event {
            let is_wrong = max_difference_n(&undisturbed, &estimates) > alarm_error_n;
            event.update(frame, is_wrong, disturbed.detector().flag());
        }
        frame += 1;
    }
    counts.events.extend(event);
    counts
}
