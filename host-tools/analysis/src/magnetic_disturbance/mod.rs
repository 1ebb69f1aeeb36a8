//! Detection rate, latency and false alarms of the device's magnetic disturbance detector.
//!
//! Input rows pass through the device's code twice with the same noise: unmodified, which counts false alarms,
//! and with the added field of magnets that pass at random distances, directions and speeds. The second run
//! counts the magnets that change a force by more than 8 % of its range (20 N of 250 N) and are detected
//! within 20 ms of that. Fields superpose, so magnets can be added to a recording made without any.
//!
//! - [`input_rows`]: rows of a recording, or of a simulated gripper for any duration.
//! - [`event`]: the passing magnets and their detection.
//! - [`counts`]: detection rate, latency, false alarms, operating characteristics.

pub mod counts;
pub mod event;
pub mod input_rows;

use anyhow::Result;
use firmware::compensation::Compensation;
use firmware::estimator::disturbance::DisturbanceDetector;
use firmware::estimator::{Estimate, Estimator};
use firmware::sensors::hall::{HallFrame, SENSORS};
use indicatif::ProgressBar;
use model_export::inverse::build::DeviceModel;
use model_export::inverse::compensation::OwnedCompensation;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::magnetic_disturbance::counts::DetectionCounts;
use crate::magnetic_disturbance::event::{DisturbanceEvent, DisturbanceSequence, alarm_error_n};
use crate::magnetic_disturbance::input_rows::RowSource;
use device_run::networks::NetworkSet;

/// Model and networks under test.
#[derive(Clone, Copy)]
pub struct DeviceUnderTest<'a> {
    /// Model with its tables.
    pub built: &'a DeviceModel,
    /// Networks on top of the model.
    pub networks: Option<&'a NetworkSet>,
}

/// Evaluates the detector on `hours` of input rows.
///
/// # Errors
/// A recording cannot be read.
pub fn evaluate_detection(
    device: &DeviceUnderTest,
    source: &RowSource,
    hours: f64,
    bar: &ProgressBar,
) -> Result<DetectionCounts> {
    let runs = (hours * 3600.0 / source.seconds()).ceil().max(1.0) as u32;
    bar.inc_length(u64::from(runs));
    let counts = |number: u32| {
        let counts = run(device, source, number);
        bar.inc(1);
        counts
    };
    let parts = (0..runs).into_par_iter().map(counts);
    parts.try_reduce(DetectionCounts::default, |all, part| Ok(all.with(part)))
}

/// Squared parity residual and common mode, predicted sigma and model disagreement in newtons.
fn measures(detector: &DisturbanceDetector) -> [f64; 4] {
    let measures = detector.measures;
    let square = |square: i32| f64::from(square) / f64::from(1_u32 << 16);
    [
        square(measures.parity),
        square(measures.common),
        measures.sigma.newtons(),
        measures.model_disagreement.newtons(),
    ]
}

/// Maximum difference of a force between two frames, in newtons.
fn max_difference_n(one: &[Estimate; SENSORS], other: &[Estimate; SENSORS]) -> f64 {
    let forces = one.iter().zip(other).flat_map(|(one, other)| {
        [0, 1].map(|axis| (other.force[axis].newtons() - one.force[axis].newtons()).abs())
    });
    forces.fold(0.0, f64::max)
}

fn run(device: &DeviceUnderTest, source: &RowSource, number: u32) -> Result<DetectionCounts> {
    let owned = &device.built.compensations;
    let compensations: Vec<Compensation> = owned.iter().map(OwnedCompensation::view).collect();
    let tables = device.built.chosen.tables.tables(&compensations);
    let gauss_per_lsb = device.built.model.sensor_scale.gauss_per_lsb;
    let [mut clean, mut disturbed] =
        [(); 2].map(|()| Estimator::new(&tables, device.networks.map(NetworkSet::run)));
    let mut rows = source.rows(number)?;
    let sensors = device.built.header.sensors.len().min(SENSORS) as u32;
    let mut magnets = DisturbanceSequence::new(source.seed(), number, source.seconds(), sensors);
    let mut event: Option<DisturbanceEvent> = None;
    let alarm_n = alarm_error_n(device.built.model.force_range_n());
    let mut counts = DetectionCounts::new(alarm_n);
    let is_new = source.has_new_rows(number);
    let (mut frame, mut was_set) = (0, false);
    while let Some(row) = rows.next_row()? {
        let sensed = |readings| HallFrame { readings, ..HallFrame::default() };
        let readings = row.readings(gauss_per_lsb, |_| Vector3::zeros());
        let undisturbed = clean.update(&sensed(readings), &row.inputs);
        let is_set = clean.detector().flag();
        if is_new {
            counts.add_clean_frame(frame, measures(clean.detector()), is_set && !was_set);
            counts.seconds = row.time_s;
        }
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
            let detector = disturbed.detector();
            let is_wrong = max_difference_n(&undisturbed, &estimates) > alarm_n;
            event.update(frame, is_wrong, detector.flag(), measures(detector));
        }
        frame += 1;
    }
    counts.events.extend(event);
    Ok(counts)
}
