//! Rows through the device's code, twice: as they are, and with magnets that pass.

use anyhow::Result;
use firmware::compensate::Compensation;
use firmware::estimator::Estimator;
use firmware::force::Estimate;
use firmware::foreign::Detector;
use firmware::frame::{Frame, SENSORS};
use model_export::inverse::build::Built;
use model_export::inverse::compensation::OwnedCompensation;
use nalgebra::Vector3;

use super::passage::{self, Passage, Passages};
use super::rows::World;
use super::tally::Tally;
use crate::networks::Networks;

/// What runs on the device.
#[derive(Clone, Copy)]
pub struct Device<'a> {
    /// Tables of its model.
    pub built: &'a Built,
    /// Networks behind them.
    pub networks: Option<&'a Networks>,
}

/// Parity and common mode as squares, sigma and split in newtons.
fn measures(detector: &Detector) -> [f64; 4] {
    let measures = detector.measures;
    let square = |square: i32| f64::from(square) / f64::from(1_u32 << 16);
    [
        square(measures.parity),
        square(measures.common),
        measures.sigma.newtons(),
        measures.split.newtons(),
    ]
}

/// The greatest difference of a force between two frames, in newtons.
fn apart_n(own: &[Estimate; SENSORS], other: &[Estimate; SENSORS]) -> f64 {
    let forces = own.iter().zip(other).flat_map(|(own, other)| {
        [0, 1].map(|axis| (other.force[axis].newtons() - own.force[axis].newtons()).abs())
    });
    forces.fold(0.0, f64::max)
}

/// One run.
pub fn run(device: &Device, world: &World, number: u32) -> Result<Tally> {
    let owned = &device.built.compensations;
    let compensations: Vec<Compensation> = owned.iter().map(OwnedCompensation::view).collect();
    let tables = device.built.chosen.tables.tables(&compensations);
    let gauss_per_lsb = device.built.model.sensor_scale.gauss_per_lsb;
    let [mut clean, mut passed] =
        [(); 2].map(|()| Estimator::new(&tables, device.networks.map(Networks::run)));
    let mut rows = world.rows(number)?;
    let sensors = device.built.header.sensors.len().min(SENSORS) as u32;
    let mut passages = Passages::new(world.seed(), number, world.seconds(), sensors);
    let mut passage: Option<Passage> = None;
    let worth_n = passage::worth_n(device.built.model.force_range_n());
    let mut tally = Tally::new(worth_n);
    let fresh = world.is_fresh(number);
    let (mut frame, mut was_up) = (0, false);
    while let Some(row) = rows.next_row()? {
        let sensed = |readings| Frame {
            readings,
            ..Frame::default()
        };
        let own = row.readings(gauss_per_lsb, |_| Vector3::zeros());
        let own = clean.step(&sensed(own), &row.around);
        let up = clean.detector().flag();
        if fresh {
            tally.frame(frame, measures(clean.detector()), up && !was_up);
            tally.seconds = row.time_s;
        }
        was_up = up;
        if passages.at(row.time_s, passed.detector().flag()) {
            tally.passages.extend(passage.take());
            passage = Some(Passage::default());
        } else if passages.magnet.is_none() {
            tally.passages.extend(passage.take());
        }
        let foreign = |sensor: usize| {
            let field_g = passages.field(sensor as u32, row.time_s);
            rows.felt(sensor, field_g)
        };
        let other = row.readings(gauss_per_lsb, foreign);
        let other = passed.step(&sensed(other), &row.around);
        if let Some(passage) = &mut passage {
            let up = passed.detector().flag();
            passage.note(
                frame,
                apart_n(&own, &other) > worth_n,
                up,
                measures(passed.detector()),
            );
        }
        frame += 1;
    }
    tally.passages.extend(passage);
    Ok(tally)
}
