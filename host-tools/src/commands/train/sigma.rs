//! Standard deviations that mean something: calibrated on the held-out recording, and guarded where
//! training has never been.
//!
//! The likelihood chose the weights by all of the held-out recording, and a factor on each standard
//! deviation is chosen by it too. The shares that are told are of blocks of five seconds that had no part
//! in the factor they are judged with: every other block with that which the others ask for, and these in
//! turn. A recording that had no part in anything is judged by `magpie replay`. Errors count after the
//! tare that the device would take, which leaves alone what sigma itself allows for.

use model_export::gru::network::{Guard, Network, OUTPUTS};
use model_export::gru::train::course::Course;
use model_export::gru::train::judge::Told as Share;
use model_export::gru::train::lesson::{Sequence, Track};
use model_export::inverse::build::Built;
use serde_json::{Value, json};

use crate::coverage::{Coverage, Told, factor, tared};
use crate::tare::{Rest, held_n};

/// A second of the board's rows.
const ROWS_PER_S: f64 = firmware::params::SENSE_RATE.value;
/// The held-out recording may part network and ideal model by this much more than was seen.
const SPLIT_MARGIN: f64 = 1.25;

/// Factors and guards of all networks.
pub struct Sigma {
    /// Of each force, in the order of the networks' heads: Fx and Fz.
    pub factors: Vec<(u32, [f64; 2])>,
    /// After the tare: as the networks told them.
    pub before: Option<Coverage>,
    /// The same, each block with the factors that the others ask for.
    pub after: Option<Coverage>,
    guards: Vec<(u32, Guard)>,
}

impl Sigma {
    /// From a training on these lessons, behind the physics that was built, that has come to its end.
    pub fn of(
        course: &Course,
        lessons: &[Sequence],
        held_out: &Sequence,
        built: &Built,
    ) -> anyhow::Result<Self> {
        let mut own = Self {
            factors: Vec::new(),
            before: None,
            after: None,
            guards: Vec::new(),
        };
        let (mut before, mut after) = (Vec::new(), Vec::new());
        for (sensors, forces) in course.groups.iter().zip(course.told()?) {
            for (place, &sensor) in sensors.iter().enumerate() {
                let mut factors = [1.0; 2];
                let mut split_n = [0.0_f64; 2];
                for (axis, chosen) in factors.iter_mut().enumerate() {
                    let scale_n = course.scaling.force_n[axis];
                    let told = in_newtons(&forces, 2 * place + axis, scale_n);
                    let track = held_out.track(sensor);
                    if let Some(track) = track {
                        split_n[axis] = SPLIT_MARGIN * greatest_split(track, axis, &told);
                    }
                    let held_n = held_n(&built.compensations, sensor);
                    let tare = |sigma: f64| {
                        let tare = track.and_then(|track| {
                            let rest = Rest::new(built.model.force_range_n(), held_n);
                            tare(track, axis, &told, rest, sigma)
                        });
                        tared(&told, tare.unwrap_or(0.0))
                    };
                    // What is tared hangs on sigma, and sigma on what is tared: each a second time.
                    let first = factor(&tare(1.0)).unwrap_or(1.0);
                    let errors = tare(first);
                    *chosen = factor(&errors).unwrap_or(first);
                    after.push(judged_by_others(&errors));
                    before.push(errors);
                }
                own.factors.push((sensor, factors));
                own.guards.push((
                    sensor,
                    Guard {
                        departure_g: departures(lessons, sensor),
                        newtons_per_g: newtons_per_g(built, sensor),
                        split_n,
                    },
                ));
            }
        }
        own.before = Coverage::of(before.iter().map(Vec::as_slice));
        own.after = Coverage::of(after.iter().map(Vec::as_slice));
        Ok(own)
    }

    /// Puts factors and guards into the networks: a factor is a step of its logarithm.
    pub fn apply(&self, networks: &mut [Network]) {
        for network in networks {
            let find = |sensor: &u32| {
                let factors = self.factors.iter().find(|(number, _)| number == sensor)?;
                let guard = self.guards.iter().find(|(number, _)| number == sensor)?;
                Some((factors.1, guard.1))
            };
            let found: Option<Vec<([f64; 2], Guard)>> = network.sensors.iter().map(find).collect();
            let heads = network.head_bias.chunks_mut(OUTPUTS);
            let found = found.unwrap_or_default();
            for (bias, (factors, _)) in heads.zip(&found) {
                for (bias, factor) in bias.iter_mut().skip(2).zip(factors) {
                    *bias += factor.ln() as f32;
                }
            }
            network.guards = found.into_iter().map(|(_, guard)| guard).collect();
        }
    }

    /// The factor of a force.
    pub fn factor(&self, sensor: u32, axis: usize) -> f64 {
        let found = self.factors.iter().find(|(number, _)| *number == sensor);
        found.map_or(1.0, |(_, factors)| factors[axis])
    }

    /// For a person.
    pub fn text(&self) -> String {
        let (Some(before), Some(after)) = (&self.before, &self.after) else {
            return String::new();
        };
        let factors = self.factors.iter().flat_map(|(_, factors)| factors);
        let (least, most) =
            factors.fold((f64::INFINITY, 0.0_f64), |(a, b), f| (a.min(*f), b.max(*f)));
        format!(
            "Sigma was multiplied by {least:.2} to {most:.2}, as that recording asks for. Each 5 s of it \
             with the factors that the others ask for, after the tare, over all forces, within 1, 2 \
             and 3 of sigma: {}, {}, {} (a Gaussian: 68.3, 95.4, 99.7 %; blocks drawn 1000 times, \
             95 %); without factors {}, {}. ",
            after.words(0),
            after.words(1),
            after.words(2),
            before.words(0),
            before.words(1),
        )
    }

    /// For `--json`.
    pub fn json(&self) -> Value {
        let factors = self
            .factors
            .iter()
            .map(|(sensor, [x, z])| json!({ "sensor": sensor, "x": x, "z": z }));
        json!({
            "coverage": self.after.as_ref().map(Coverage::json),
            "before": self.before.as_ref().map(Coverage::json),
            "factors": factors.collect::<Vec<_>>(),
        })
    }
}

/// Fx and Fz that a gauss in the plane of a sensor is taken for at rest, in newtons.
fn newtons_per_g(built: &Built, sensor: u32) -> [f64; 2] {
    let mut sensors = built.header.sensors.iter().zip(&built.chosen.forward);
    let newtons = |slope: nalgebra::Vector3<f64>| 1.0 / slope.norm().max(f64::MIN_POSITIVE);
    let found = sensors.find(|(number, _)| **number == sensor);
    found.map_or([0.0; 2], |(_, model)| {
        model.per_newton([0.0; 2]).map(newtons)
    })
}

/// What a network tells of one force, beside the truth.
fn in_newtons(forces: &[Vec<Share>], output: usize, scale_n: f64) -> Vec<Told> {
    let told = forces.get(output).into_iter().flatten();
    let newtons = told.map(|one| Told {
        time_s: one.row as f64 / ROWS_PER_S,
        error_n: scale_n * (one.mean - one.truth),
        sigma_n: scale_n * one.log_sigma.exp(),
    });
    newtons.collect()
}

/// The tare of the network with its sigma times a factor; `None` where the forces never rest.
fn tare(track: &Track, axis: usize, told: &[Told], mut rest: Rest, factor: f64) -> Option<f64> {
    for ((_, truth), one) in track.truth_n.iter().zip(told) {
        let truth = truth.map(f64::from);
        let found = truth.map(|n| n + one.error_n);
        rest.add(one.time_s, truth, found, Some([factor * one.sigma_n; 2]));
    }
    rest.tare().map(|(tare, _)| tare[axis])
}

/// Every other block with the factor that the blocks between ask for.
fn judged_by_others(errors: &[Told]) -> Vec<Told> {
    let of = |odd: usize| -> Vec<Told> {
        let chosen = errors.iter().filter(|one| one.block() % 2 == odd);
        chosen.copied().collect()
    };
    let halves = [of(0), of(1)];
    let factors = [&halves[1], &halves[0]].map(|others| factor(others).unwrap_or(1.0));
    let widened = halves.iter().zip(factors).flat_map(|(half, factor)| {
        half.iter().map(move |one| Told {
            sigma_n: factor * one.sigma_n,
            ..*one
        })
    });
    widened.collect()
}

/// How far network and ideal model were apart at most, in newtons.
fn greatest_split(track: &Track, axis: usize, told: &[Told]) -> f64 {
    let apart = track.truth_n.iter().zip(told).map(|((row, truth), one)| {
        let mean_n = f64::from(truth[axis]) + one.error_n;
        (mean_n - f64::from(track.ideal_n[*row][axis])).abs()
    });
    apart.fold(0.0, f64::max)
}

/// Least and greatest departure of a sensor's field from its surface.
fn departures(lessons: &[Sequence], sensor: u32) -> [f64; 2] {
    let tracks = lessons.iter().flat_map(|lesson| &lesson.tracks);
    let all = tracks
        .filter(|track| track.number == sensor)
        .flat_map(|track| &track.beside_g);
    all.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], g| {
        [least.min(f64::from(*g)), most.max(f64::from(*g))]
    })
}
