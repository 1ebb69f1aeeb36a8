//! The programme of the test bench: loads, temperatures and the motion of the arm over the plant's time.

use firmware::sensors::hall::SENSORS;
use nalgebra::Vector3;

use crate::campaign::excitation::Excitation;
use crate::drivetrain::fingertips::AmbientConditions;
use crate::effects::{Effect, Effects};
use crate::external_fields::{earth_field, in_body};
use crate::motion::{Orientation, Programme};
use crate::mountings::Mountings;
use crate::random::smoothstep;

/// Period of rest and load in seconds.
pub(super) const PERIOD_S: f64 = 3.0;
/// Within a period: the gripper moves until the first time, the load rises until the second.
pub(super) const LOADED_S: [f64; 2] = [0.85, 1.1];
/// Time in which the load falls at the end of a period, in seconds.
const UNLOADING_S: f64 = 0.25;
/// Rest before the first recording, in which the gripper is homed, and between recordings, in seconds.
pub(super) const HOMING_S: f64 = 14.0;
const BETWEEN_S: f64 = 0.5;

/// The hidden gripper and the programme of the bench.
#[derive(Clone, Debug)]
pub struct BenchSetup {
    /// Seed of the gripper: its manufacture, its noise and the parameters of its effects.
    pub seed: u64,
    /// Seed of loads, openings, temperatures and the motion of the arm.
    pub excitation_seed: u64,
    /// Factor on all manufacturing tolerances.
    pub scatter: f64,
    /// Mountings of the sensors.
    pub mountings: Mountings,
    /// Effects with their magnitudes.
    pub effects: Vec<Effect>,
    /// Number of recordings.
    pub recordings: u32,
    /// Length of a recording in seconds.
    pub seconds: f64,
}

/// Loads, temperatures and motion over the plant's time.
#[derive(Debug)]
pub struct BenchProgramme {
    pub(super) excitations: Vec<Excitation>,
    seconds: f64,
    earth_g: Vector3<f64>,
}

impl BenchProgramme {
    pub(super) fn new(setup: &BenchSetup, effects: &Effects) -> Self {
        let excitation = |recording| {
            let seed = setup.excitation_seed;
            Excitation::draw(Programme::Bench, seed, recording, SENSORS as u32, setup.seconds)
        };
        Self {
            excitations: (1..=setup.recordings).map(excitation).collect(),
            seconds: setup.seconds,
            earth_g: earth_field(effects, setup.seed),
        }
    }

    /// Begin of a recording, counted from 0, in seconds.
    pub fn begin_s(&self, recording: usize) -> f64 {
        HOMING_S + recording as f64 * (self.seconds + BETWEEN_S)
    }

    /// The recording at a time, or the next one, and the time since its begin.
    pub(super) fn at(&self, time_s: f64) -> (&Excitation, f64) {
        let index = ((time_s - HOMING_S + BETWEEN_S) / (self.seconds + BETWEEN_S)).floor();
        let index = (index.max(0.0) as usize).min(self.excitations.len() - 1);
        (&self.excitations[index], time_s - self.begin_s(index))
    }

    /// Lateral and longitudinal load on a sensor in newtons.
    pub fn load_n(&self, sensor: usize, time_s: f64) -> [f64; 2] {
        let (excitation, since_s) = self.at(time_s);
        if !(0.0..self.seconds).contains(&since_s) {
            return [0.0; 2];
        }
        let phase_s = since_s.rem_euclid(PERIOD_S);
        let end_s = PERIOD_S.min(self.seconds - (since_s - phase_s));
        let pressed = smoothstep(phase_s, LOADED_S[0], LOADED_S[1])
            * (1.0 - smoothstep(phase_s, end_s - UNLOADING_S, end_s));
        excitation.load(sensor, since_s).map(|load_n| pressed * load_n)
    }

    /// Orientation and specific force: those of one continuous motion.
    pub fn orientation(&self, time_s: f64) -> Orientation {
        self.excitations[0].orientation(time_s)
    }

    /// Angular rate in degrees per second, body axes.
    pub fn rate_deg_s(&self, time_s: f64) -> [f64; 3] {
        self.excitations[0].rate_rad_s(time_s).map(f64::to_degrees).into()
    }

    /// Temperatures and ambient field.
    pub fn ambient(&self, time_s: f64) -> AmbientConditions {
        let (excitation, since_s) = self.at(time_s);
        let orientation = self.orientation(time_s);
        AmbientConditions {
            temperature_c: std::array::from_fn(|sensor| excitation.temperature_c(sensor, since_s)),
            field_g: in_body(self.earth_g, &orientation),
            roll_rad: orientation.angles_rad[0],
        }
    }
}
