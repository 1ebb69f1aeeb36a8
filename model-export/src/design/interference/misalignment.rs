//! How the magnet is mounted: its place, gap, tilt and strength, each drawn many times.
//!
//! A misplaced magnet gives a field without any load, which a tare takes off, and another sensitivity,
//! which it does not.

use firmware::params::{Constant, assumed};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Inverse, Sensed, Shift};
use crate::physics::ForwardModel;

/// Magnet's place across the gap, one standard deviation on each axis.
pub const OFFSET: Constant = assumed("place of the magnet", 0.05, "mm", "careful work by hand");
/// Gap, one standard deviation.
pub const GAP: Constant = assumed("gap's scatter", 0.05, "mm", "careful work by hand");
/// Tilt of the magnet, one standard deviation about each axis.
pub const TILT: Constant = assumed("tilt of the magnet", 1.0, "deg", "careful work by hand");
/// Remanence, one standard deviation.
pub const REMANENCE: Constant = assumed("scatter of remanence", 0.02, "", "one grade of NdFeB");

/// Draws that tell the 95th percentile to some 5 %, one standard deviation.
pub const DRAWS: usize = 128;

/// Numbers drawn for each that is taken: their middle stands for its share of all.
const FINER: usize = 17;

/// Share of the sensors that are better than what is stated.
const SHARE: f64 = 0.95;

/// Greatest draw, in standard deviations: what is further off is not sold.
const MOST: f64 = 3.0;

/// How far the made differs from the meant: one standard deviation of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scatter {
    /// Magnet's place across the gap, each axis.
    pub offset_mm: f64,
    /// Gap.
    pub gap_mm: f64,
    /// Tilt of the magnet about each axis.
    pub tilt_rad: f64,
    /// Remanence, a share.
    pub remanence: f64,
}

impl Scatter {
    /// Careful work by hand.
    pub fn assumed() -> Self {
        Self {
            offset_mm: OFFSET.value,
            gap_mm: GAP.value,
            tilt_rad: TILT.value.to_radians(),
            remanence: REMANENCE.value,
        }
    }

    /// A sensor as one draw makes it.
    fn made(&self, model: &ForwardModel, draw: &[f64; 6]) -> ForwardModel {
        let [x, z, gap, tilt_x, tilt_z, remanence] = *draw;
        ForwardModel {
            offset_mm: [x, z].map(|by| self.offset_mm * by),
            // However bad, the magnet stays out of the sensor.
            gap_mm: (model.gap_mm + self.gap_mm * gap).max(0.1 * model.gap_mm),
            tilt_rad: [tilt_x, tilt_z].map(|by| self.tilt_rad * by),
            remanence_t: model.remanence_t * (1.0 + self.remanence * remanence),
            ..*model
        }
    }
}

/// Standard normal draws, six for each sensor: place along x and z, gap, tilt about x and z, remanence. A
/// Latin hypercube (McKay, Beckman and Conover 1979): each of the six is spread evenly over its
/// distribution, however few draws there are.
#[derive(Clone, Debug)]
pub struct Draws(Vec<[f64; 6]>);

impl Draws {
    /// So many of this seed.
    pub fn new(seed: u64, count: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draws = vec![[0.0; 6]; count];
        for part in 0..6 {
            let values = spread(&mut rng, count);
            for (draw, value) in draws.iter_mut().zip(values) {
                draw[part] = value;
            }
        }
        Self(draws)
    }
}

/// Standard normal numbers, one from each of `count` equal shares of all, in any order.
fn spread(rng: &mut ChaCha8Rng, count: usize) -> Vec<f64> {
    let mut fine: Vec<f64> = (0..count * FINER).map(|_| normal(rng)).collect();
    fine.sort_by(f64::total_cmp);
    let mut values: Vec<f64> = fine.chunks(FINER).map(|share| share[FINER / 2]).collect();
    values.shuffle(rng);
    values
}

/// A standard normal number (Box and Muller), of the middle 99.7 %.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    loop {
        let (u, turn) = (rng.random::<f64>(), rng.random::<f64>());
        let radius = (-2.0 * libm::log(1.0 - u)).sqrt();
        let drawn = radius * libm::cos(std::f64::consts::TAU * turn);
        if drawn.abs() <= MOST {
            return drawn;
        }
    }
}

/// What 95 % of the sensors stay below: at rest, and after a tare with both forces at their greatest.
pub fn shifts(sensed: &Sensed, rest: &Inverse, draws: &Draws) -> [Shift; 2] {
    let model = &sensed.model;
    let full = model.force_range_n;
    let loads = [[full, full], [full, -full], [-full, full], [-full, -full]];
    let meant = loads.map(|load| (model.field(load), Inverse::at(model, load)));
    let rest_g = model.field([0.0; 2]);
    let (mut mounted, mut tared) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
    for draw in &draws.0 {
        let made = sensed.scatter.made(model, draw);
        let off_g = made.field([0.0; 2]) - rest_g;
        mounted[0].push(off_g.norm());
        mounted[1].push(rest.greatest_n(off_g));
        let mut worst = [0.0_f64; 2];
        for (load, (meant_g, inverse)) in loads.iter().zip(&meant) {
            let left_g = made.field(*load) - meant_g - off_g;
            worst[0] = worst[0].max(left_g.norm());
            worst[1] = worst[1].max(inverse.greatest_n(left_g));
        }
        tared[0].push(worst[0]);
        tared[1].push(worst[1]);
    }
    let told = |words, [gauss, newtons]: [Vec<f64>; 2]| {
        Shift::new(words, (percentile(gauss), percentile(newtons)), sensed)
    };
    [
        told(("misalignment", "95 % below, before a tare"), mounted),
        told(
            ("asymmetry", "95 % below, at full load, after a tare"),
            tared,
        ),
    ]
}

fn percentile(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let place = (SHARE * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(place, f64::total_cmp).1
}
