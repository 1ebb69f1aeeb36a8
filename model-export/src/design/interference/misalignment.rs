//! Mounting errors of the magnet: offset, gap, tilt and remanence, by Monte Carlo.
//!
//! A misplaced magnet adds a field at rest, which a tare removes, and changes the sensitivity, which a tare
//! does not.

use firmware::config::constants::{Constant, assumed};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::design::interference::{FieldShift, LocalInverse, SensorUnderTest};
use crate::physics::ForwardModel;

/// Standard deviation of the magnet's offset on each axis across the gap.
pub const OFFSET: Constant = assumed("place of the magnet", 0.05, "mm", "careful work by hand");
/// Standard deviation of the gap.
pub const GAP: Constant = assumed("gap's scatter", 0.05, "mm", "careful work by hand");
/// Standard deviation of the tilt about each axis.
pub const TILT: Constant = assumed("tilt of the magnet", 1.0, "deg", "careful work by hand");
/// Standard deviation of the remanence, relative.
pub const REMANENCE: Constant = assumed("scatter of remanence", 0.02, "", "one grade of NdFeB");

/// Number of samples, for a relative standard error of about 5 % of the 95th percentile.
pub const DRAWS: usize = 128;

/// Random numbers per stratum, of which the median is used.
const NUMBERS_PER_STRATUM: usize = 17;

/// Quantile that is reported.
const QUANTILE: f64 = 0.95;

/// Truncation of samples in standard deviations: worse parts are rejected.
const MAX_SIGMAS: f64 = 3.0;

/// Standard deviations of the mounting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountingScatter {
    /// Offset of the magnet on each axis across the gap.
    pub offset_mm: f64,
    /// Gap.
    pub gap_mm: f64,
    /// Tilt of the magnet about each axis.
    pub tilt_rad: f64,
    /// Remanence, a share.
    pub remanence: f64,
}

impl MountingScatter {
    /// Assumed for careful manual assembly.
    pub fn assumed() -> Self {
        Self {
            offset_mm: OFFSET.value,
            gap_mm: GAP.value,
            tilt_rad: TILT.value.to_radians(),
            remanence: REMANENCE.value,
        }
    }

    /// Sensor of one sample.
    fn sample(&self, model: &ForwardModel, draw: &[f64; 6]) -> ForwardModel {
        let [x, z, gap, tilt_x, tilt_z, remanence] = *draw;
        ForwardModel {
            offset_mm: [x, z].map(|by| self.offset_mm * by),
            // The magnet never touches the sensor.
            gap_mm: (model.gap_mm + self.gap_mm * gap).max(0.1 * model.gap_mm),
            tilt_rad: [tilt_x, tilt_z].map(|by| self.tilt_rad * by),
            remanence_t: model.remanence_t * (1.0 + self.remanence * remanence),
            ..*model
        }
    }
}

/// Standard normal samples of offset x and z, gap, tilt about x and z, remanence: a Latin hypercube (McKay,
/// Beckman and Conover 1979).
#[derive(Clone, Debug)]
pub struct MountingSamples(Vec<[f64; 6]>);

impl MountingSamples {
    /// Draws `count` samples.
    pub fn new(seed: u64, count: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draws = vec![[0.0; 6]; count];
        for part in 0..6 {
            let values = stratified_normals(&mut rng, count);
            for (draw, value) in draws.iter_mut().zip(values) {
                draw[part] = value;
            }
        }
        Self(draws)
    }
}

/// Standard normal numbers, one of each of `count` strata, shuffled.
fn stratified_normals(rng: &mut ChaCha8Rng, count: usize) -> Vec<f64> {
    let mut numbers: Vec<f64> = (0..count * NUMBERS_PER_STRATUM).map(|_| normal(rng)).collect();
    numbers.sort_by(f64::total_cmp);
    let mut values: Vec<f64> =
        numbers.chunks(NUMBERS_PER_STRATUM).map(|share| share[NUMBERS_PER_STRATUM / 2]).collect();
    values.shuffle(rng);
    values
}

/// A truncated standard normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    loop {
        let (u, turn) = (rng.random::<f64>(), rng.random::<f64>());
        let radius = (-2.0 * libm::log(1.0 - u)).sqrt();
        let drawn = radius * libm::cos(std::f64::consts::TAU * turn);
        if drawn.abs() <= MAX_SIGMAS {
            return drawn;
        }
    }
}

/// 95th percentiles at rest, and after a tare with both forces at the end of their range.
pub fn shifts(
    sensor: &SensorUnderTest,
    rest: &LocalInverse,
    draws: &MountingSamples,
) -> [FieldShift; 2] {
    let model = &sensor.model;
    let full = model.force_range_n;
    let loads = [[full, full], [full, -full], [-full, full], [-full, -full]];
    let nominal = loads.map(|load| (model.field(load), LocalInverse::at(model, load)));
    let rest_g = model.field([0.0; 2]);
    let (mut mounted, mut tared) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
    for draw in &draws.0 {
        let sample = sensor.scatter.sample(model, draw);
        let off_g = sample.field([0.0; 2]) - rest_g;
        mounted[0].push(off_g.norm());
        mounted[1].push(rest.max_force_n(off_g));
        let mut worst = [0.0_f64; 2];
        for (load, (nominal_g, inverse)) in loads.iter().zip(&nominal) {
            let error_g = sample.field(*load) - nominal_g - off_g;
            worst[0] = worst[0].max(error_g.norm());
            worst[1] = worst[1].max(inverse.max_force_n(error_g));
        }
        tared[0].push(worst[0]);
        tared[1].push(worst[1]);
    }
    let shift = |words, [gauss, newtons]: [Vec<f64>; 2]| {
        FieldShift::new(words, (percentile(gauss), percentile(newtons)), sensor)
    };
    [
        shift(("misalignment", "95 % below, before a tare"), mounted),
        shift(("asymmetry", "95 % below, at full load, after a tare"), tared),
    ]
}

fn percentile(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let place = (QUANTILE * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(place, f64::total_cmp).1
}
