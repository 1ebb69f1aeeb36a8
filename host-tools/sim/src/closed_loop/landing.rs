//! A landing of the gripper as a foot, flat on closed fingers or on a line between open ones: ground force as a half sine,
//! and the firmware's report.

use crate::closed_loop::drive_result;
use crate::closed_loop::grasp_rig::{GraspRig, TICK_S};
use crate::closed_loop::motor_rig::DriveCase;
use crate::drivetrain::fingertips::{FOOT_KG, Impact};
use crate::drivetrain::sensors::SimulatedImu;
use crate::motion::GRAVITY;
use clap::ValueEnum;
use firmware::config::constants::{self, Constant};
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::TaskState;
use firmware::protocol::messages::{Command, Foot};
use firmware::sensors::hall::SENSORS;
use firmware::sensors::imu::decode;
use serde::Serialize;
use std::f64::consts::PI;

/// Opening of the closed fingers, in mm.
const FLAT_MM: f64 = 0.5;
/// Simulated time before contact, in s.
const BEFORE_S: f64 = 0.02;
/// Simulated time after lift-off, in s.
const AFTER_S: f64 = 0.03;
/// Counts per newton and per millimetre in the CAN message.
const PER_UNIT: [f64; 3] = match Foot::LAYOUT.signals {
    [_, force, centre, _, _, across] => [
        force.counts_per_unit() as f64,
        centre.counts_per_unit() as f64,
        across.counts_per_unit() as f64,
    ],
    _ => panic!("the layout needs a force and both centres of pressure"),
};

/// How the fingertips stand on the ground (paper, multi-modal contact).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum FootContact {
    /// All fingertips together, fingers closed.
    #[default]
    Flat,
    /// Two pairs of fingertips, fingers open: the line between them.
    Line,
}

impl FootContact {
    /// Opening of the fingers in mm.
    pub fn opening_mm(self) -> f64 {
        match self {
            Self::Flat => FLAT_MM,
            Self::Line => constants::LINE_CONTACT_OPENING.value,
        }
    }

    /// The command that enters the mode.
    pub fn command(self) -> Command {
        let flags = if self == Self::Line { flag::LINE } else { 0 };
        Command { mode: mode::FOOT, flags, ..Command::default() }
    }
}

/// Parameters of a landing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    /// Peak ground force in N.
    pub peak_n: f64,
    /// Duration of the contact in s.
    pub lasts_s: f64,
    /// Contact of the fingertips.
    pub contact: FootContact,
    /// Centre of pressure in mm along the fingers from their middle.
    pub along_mm: f64,
    /// Centre of pressure in mm across the fingers, at most half their opening.
    pub across_mm: f64,
    /// Touchdown as a share of a millisecond after a sample.
    pub phase: f64,
}

/// State of the foot at one time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LandingSample {
    /// Time since touchdown, in s.
    pub time_s: f64,
    /// True ground force on all fingertips, in N.
    pub true_n: f64,
    /// Reported ground force in N.
    pub estimated_n: f64,
    /// Reported peak force on one fingertip over the last milliseconds, in N.
    pub peak_n: f64,
    /// Reported centre of pressure in mm along the fingers.
    pub along_mm: f64,
    /// Reported centre of pressure in mm across the fingers.
    pub across_mm: f64,
    /// Fingertips with reported contact, one bit each.
    pub contacts: u8,
}

/// Result of a landing.
#[derive(Clone, Debug, PartialEq)]
pub struct LandingResult {
    /// Gripper.
    pub case: DriveCase,
    /// Parameters of the landing.
    pub landing: Landing,
    /// One per millisecond, at the time of its sample.
    pub points: Vec<LandingSample>,
    /// Maximum motion of the fingers, in mm.
    pub moved_mm: f64,
}

impl Landing {
    /// Shares of the ground force on the fingertips, larger near the centre of pressure.
    fn shares(&self) -> [f64; SENSORS] {
        let half_mm = 0.5 * constants::SENSOR_DISTANCE.value;
        let far = 0.5 * self.along_mm / half_mm;
        let side = self.across_mm / self.contact.opening_mm();
        [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
            .map(|(end, right)| (0.5 + end * far) * (0.5 + right * side))
    }

    /// Share of the most loaded fingertip.
    fn largest_share(&self) -> f64 {
        self.shares().into_iter().fold(0.0, f64::max)
    }

    /// Initial force rate of the most loaded fingertip, in N/s.
    pub fn rises_n_s(&self) -> f64 {
        PI * self.peak_n * self.largest_share() / self.lasts_s
    }

    /// Simulates the landing.
    pub fn run(self, case: &DriveCase) -> LandingResult {
        let opening_mm = self.contact.opening_mm();
        let mut bench = GraspRig::new(case.lead, case.parameters, opening_mm, case.seed);
        bench.order(self.contact.command());
        bench.until(1.0, |bench| bench.grip.task() == TaskState::Foot);
        let mut inertial = SimulatedImu::new(case.seed);
        let from_s = bench.rig.plant.time_s();
        let impact = Impact {
            start_s: BEFORE_S + TICK_S * self.phase,
            lasts_s: self.lasts_s,
            peak_n: self.peak_n,
        };
        let parked_mm = 1e3 * bench.rig.plant.opening_m();
        let mut landed =
            LandingResult { case: *case, landing: self, points: Vec::new(), moved_mm: 0.0 };
        let mut sampled_s = f64::NAN;
        while sampled_s.is_nan() || sampled_s < impact.start_s + self.lasts_s + AFTER_S {
            let now_s = bench.rig.plant.time_s() - from_s;
            let true_n = impact.force_n(now_s);
            let specific_force = GRAVITY + true_n / FOOT_KG;
            // The mass of a fingertip deflects its flexures as well.
            let own_n = constants::FINGERTIP_MASS.value * specific_force;
            bench.ground_n = self.shares().map(|share| share * true_n + own_n);
            bench.tick();
            // The current report and acceleration belong to the previous tick's sample.
            if !sampled_s.is_nan() {
                landed.record(&bench, sampled_s, &impact);
            }
            sampled_s = now_s;
            let motion = decode(inertial.sample([0.0, 0.0, specific_force], [0.0; 3]));
            bench.acceleration = Some(motion.acceleration);
            let moved_mm = (1e3 * bench.rig.plant.opening_m() - parked_mm).abs();
            landed.moved_mm = landed.moved_mm.max(moved_mm);
        }
        landed
    }
}

impl LandingResult {
    fn record(&mut self, bench: &GraspRig, sampled_s: f64, impact: &Impact) {
        let Some(foot) = bench.outputs.as_ref().and_then(|outputs| outputs.foot) else {
            return;
        };
        let [per_n, per_mm, per_mm_across] = PER_UNIT;
        self.points.push(LandingSample {
            time_s: sampled_s - impact.start_s,
            true_n: impact.force_n(sampled_s),
            estimated_n: f64::from(foot.total_fz) / per_n,
            peak_n: f64::from(bench.grip.ground_contact().peak_n),
            along_mm: f64::from(foot.centre) / per_mm,
            across_mm: f64::from(foot.across) / per_mm_across,
            contacts: foot.contacts,
        });
    }

    /// Time in seconds from touchdown to the sample with a reported contact.
    pub fn contact_s(&self) -> Option<f64> {
        let contact = self.points.iter().find(|point| point.contacts != 0);
        contact.map(|point| point.time_s)
    }

    /// Maximum reported force on one fingertip, in N.
    pub fn held_n(&self) -> f64 {
        self.greatest(|point| point.peak_n)
    }

    fn greatest(&self, of: impl Fn(&LandingSample) -> f64) -> f64 {
        self.points.iter().map(of).fold(0.0, f64::max)
    }

    /// Peak force on one fingertip, in N.
    pub fn peak_n(&self) -> f64 {
        self.landing.largest_share() * self.landing.peak_n
    }

    /// Reported centre of pressure at peak force, in mm along and across the fingers.
    pub fn centre_mm(&self) -> Option<[f64; 2]> {
        let peak = self.points.iter().max_by(|a, b| a.estimated_n.total_cmp(&b.estimated_n));
        peak.map(|point| [point.along_mm, point.across_mm])
    }

    /// Figures: name, reported and true value, unit; NaN where nothing was reported.
    pub fn figures(&self) -> Vec<(&'static str, [f64; 2], &'static str)> {
        let estimated_n = self.greatest(|point| point.estimated_n);
        let contact_ms = 1e3 * self.contact_s().unwrap_or(f64::NAN);
        let [along_mm, across_mm] = self.centre_mm().unwrap_or([f64::NAN; 2]);
        vec![
            ("contact detection latency", [contact_ms, 0.0], "ms"),
            ("peak ground force", [estimated_n, self.landing.peak_n], "N"),
            ("peak force on one fingertip, 10 ms hold", [self.held_n(), self.peak_n()], "N"),
            ("centre of pressure along the fingers", [along_mm, self.landing.along_mm], "mm"),
            ("centre of pressure across the fingers", [across_mm, self.landing.across_mm], "mm"),
            ("motion of the fingers", [self.moved_mm, 0.0], "mm"),
        ]
    }

    /// Summary of the simulated case.
    pub fn sentence(&self) -> String {
        let Landing { peak_n, lasts_s, .. } = self.landing;
        format!(
            "A gripper with screw {:?} on {}; ground force as a half sine of {} ms, up to {peak_n} \
             N on {FOOT_KG} kg; seed {}. Forces are measured each millisecond with noise; the weight of the \
             fingertips is compensated by the accelerometer, which saturates at 4 g.",
            self.case.lead,
            match self.landing.contact {
                FootContact::Flat => "closed fingers",
                FootContact::Line => "the line between open fingers",
            },
            1e3 * lasts_s,
            self.case.seed
        )
    }

    /// Assumed constants of the simulation.
    pub fn assumed(&self) -> Vec<Constant> {
        drive_result::assumed_constants(
            self.case.lead,
            &[constants::SENSOR_DISTANCE, constants::FINGERTIP_MASS],
        )
    }
}
