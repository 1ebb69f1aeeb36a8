//! A landing of the gripper as a foot: the fingers closed, a half sine of force from the ground, and what the
//! firmware tells of it each millisecond.

use std::f64::consts::PI;

use firmware::frame::SENSORS;
use firmware::grip::order::mode;
use firmware::grip::states::Task;
use firmware::params::{self, Constant};
use firmware::wire::messages::{Command, Foot};

use super::grasp::Bench;
use super::runs::Case;
use super::told;
use crate::bench::attitude::GRAVITY;
use crate::plant::impact::{FOOT_KG, Impact};
use crate::plant::imu::Inertial;

/// Opening of the closed fingers, in mm.
const FLAT_MM: f64 = 0.5;
/// Before and after the contact, in s.
const BEFORE_S: f64 = 0.02;
/// After the ground is left, in s.
const AFTER_S: f64 = 0.03;
/// Seconds from one point to the next.
pub const STEP_S: f64 = 1e-3;
/// Counts of the bus for a newton and a millimetre.
const PER_UNIT: [f64; 2] = match Foot::LAYOUT.fields {
    [_, force, centre, ..] => [
        force.counts_per_unit() as f64,
        centre.counts_per_unit() as f64,
    ],
    _ => [1.0; 2],
};

/// How it lands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    /// Greatest force of the ground, in N.
    pub peak_n: f64,
    /// From touching to leaving, in s.
    pub lasts_s: f64,
    /// Where the ground pushes, in mm along the fingers from their middle.
    pub along_mm: f64,
    /// The touch falls this share of a millisecond after a sample.
    pub phase: f64,
}

/// The foot at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Since the touch, in s.
    pub time_s: f64,
    /// Force of the ground on all fingertips, in N.
    pub true_n: f64,
    /// The same as it is told, in N.
    pub told_n: f64,
    /// The greatest force on one fingertip of the last milliseconds, as the firmware keeps it, in N.
    pub held_n: f64,
    /// Where the ground is told to push, in mm along the fingers.
    pub along_mm: f64,
    /// Fingertips that are told to stand, one bit each.
    pub contacts: u8,
}

/// What became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Landed {
    /// The gripper.
    pub case: Case,
    /// What was done.
    pub landing: Landing,
    /// One for each millisecond, at the time of its sample.
    pub points: Vec<Point>,
    /// The fingers have moved by so much at the most, in mm.
    pub moved_mm: f64,
}

impl Landing {
    /// Shares of the ground's force on the fingertips: those nearer to where it pushes bear more.
    fn shares(&self) -> [f64; SENSORS] {
        let half_mm = 0.5 * params::SENSOR_DISTANCE.value;
        let far = 0.5 * self.along_mm / half_mm;
        [-1.0, 1.0, -1.0, 1.0].map(|end| (0.5 + end * far) / 2.0)
    }

    /// How fast the force of the first fingertip rises as it touches, in N/s.
    pub fn rises_n_s(&self) -> f64 {
        let most = self.shares().into_iter().fold(0.0, f64::max);
        PI * self.peak_n * most / self.lasts_s
    }

    /// Lands on closed fingers.
    pub fn run(self, case: &Case) -> Landed {
        let mut bench = Bench::new(case.lead, case.parameters, FLAT_MM, case.seed);
        bench.order(Command {
            mode: mode::FOOT,
            ..Command::default()
        });
        bench.until(1.0, |bench| bench.grip.task() == Task::Foot);
        let mut inertial = Inertial::new(case.seed);
        let from_s = bench.rig.plant.time_s();
        let impact = Impact {
            start_s: BEFORE_S + STEP_S * self.phase,
            lasts_s: self.lasts_s,
            peak_n: self.peak_n,
        };
        let parked_mm = 1e3 * bench.rig.plant.opening_m();
        let mut landed = Landed {
            case: *case,
            landing: self,
            points: Vec::new(),
            moved_mm: 0.0,
        };
        let mut sampled_s = f64::NAN;
        while sampled_s.is_nan() || sampled_s < impact.start_s + self.lasts_s + AFTER_S {
            let now_s = bench.rig.plant.time_s() - from_s;
            let true_n = impact.force_n(now_s);
            let felt = GRAVITY + true_n / FOOT_KG;
            // A fingertip's own mass pushes on its flexures as well.
            let own_n = params::FINGERTIP_MASS.value * felt;
            bench.ground_n = self.shares().map(|share| share * true_n + own_n);
            bench.tick();
            // What is told now was sampled in the tick before; so was the acceleration.
            if !sampled_s.is_nan() {
                landed.note(&bench, sampled_s, &impact);
            }
            sampled_s = now_s;
            let motion = inertial.look([0.0, 0.0, felt], [0.0; 3]);
            bench.acceleration = Some(motion.acceleration);
            let moved_mm = (1e3 * bench.rig.plant.opening_m() - parked_mm).abs();
            landed.moved_mm = landed.moved_mm.max(moved_mm);
        }
        landed
    }
}

impl Landed {
    fn note(&mut self, bench: &Bench, sampled_s: f64, impact: &Impact) {
        let Some(foot) = bench.said.as_ref().and_then(|said| said.foot) else {
            return;
        };
        let [per_n, per_mm] = PER_UNIT;
        self.points.push(Point {
            time_s: sampled_s - impact.start_s,
            true_n: impact.force_n(sampled_s),
            told_n: f64::from(foot.total_fz) / per_n,
            held_n: f64::from(bench.grip.standing().peak_n),
            along_mm: f64::from(foot.centre) / per_mm,
            contacts: foot.contacts,
        });
    }

    /// Seconds from the touch to the sample in which a fingertip is told to stand.
    pub fn contact_s(&self) -> Option<f64> {
        let stands = self.points.iter().find(|point| point.contacts != 0);
        stands.map(|point| point.time_s)
    }

    /// The greatest force that is told on one fingertip, in N.
    pub fn held_n(&self) -> f64 {
        self.points.iter().map(|p| p.held_n).fold(0.0, f64::max)
    }

    /// The greatest force on one fingertip, in N.
    pub fn peak_n(&self) -> f64 {
        let most = self.landing.shares().into_iter().fold(0.0, f64::max);
        most * self.landing.peak_n
    }

    /// Where the ground is told to push while it pushes hardest, in mm along the fingers.
    pub fn along_mm(&self) -> Option<f64> {
        let hardest = self
            .points
            .iter()
            .max_by(|a, b| a.told_n.total_cmp(&b.told_n));
        hardest.map(|point| point.along_mm)
    }

    /// Figures: name, as told and as it is, unit. What is no number is not told.
    pub fn figures(&self) -> Vec<(&'static str, [f64; 2], &'static str)> {
        let told_n = self.points.iter().map(|point| point.told_n);
        let told_n = told_n.fold(0.0, f64::max);
        let contact_ms = 1e3 * self.contact_s().unwrap_or(f64::NAN);
        let along_mm = self.along_mm().unwrap_or(f64::NAN);
        vec![
            (
                "the touch is told in the sample after",
                [contact_ms, 0.0],
                "ms",
            ),
            (
                "greatest force of the ground",
                [told_n, self.landing.peak_n],
                "N",
            ),
            (
                "peak on one fingertip, kept for 10 ms",
                [self.held_n(), self.peak_n()],
                "N",
            ),
            (
                "centre of pressure, along the fingers",
                [along_mm, self.landing.along_mm],
                "mm",
            ),
            ("the fingers have moved by", [self.moved_mm, 0.0], "mm"),
        ]
    }

    /// The landing in a sentence.
    pub fn sentence(&self) -> String {
        let Landing {
            peak_n, lasts_s, ..
        } = self.landing;
        format!(
            "A gripper with screw {:?} stands flat on closed fingers; the ground pushes for {} ms with up to {peak_n} \
             N, a half sine, on {FOOT_KG} kg; seed {}. Forces are sensed each millisecond with noise; the fingertips' \
             own mass is taken off by the acceleration, which its sensor tells up to 4 g.",
            self.case.lead,
            1e3 * lasts_s,
            self.case.seed
        )
    }

    /// The assumed constants that it rests on.
    pub fn assumed(&self) -> Vec<Constant> {
        told::assumed(
            self.case.lead,
            &[params::SENSOR_DISTANCE, params::FINGERTIP_MASS],
        )
    }
}
