//! What is done to the gripper: load, opening, motor, temperature and orientation in time.

use clap::ValueEnum;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::attitude::{Attitude, Standing};
use super::load::Load;
use super::stroke::{Drive, Stroke};
use super::warmth::Warmth;

/// The programmes of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Programme {
    /// Everything moves: loads, opening, current, temperature, orientation.
    Bench,
    /// One opening, constant motor current.
    Still,
    /// Orientation constant.
    Level,
    /// Temperature constant.
    Isothermal,
    /// The same warm-up in every recording.
    SameWarmUp,
    /// Both forces are one sine of 0.5 Hz.
    SingleSine,
}

/// One recording's excitation, known at any time.
#[derive(Clone, Debug)]
pub struct Excitation {
    loads: Vec<[Load; 2]>,
    stroke: Stroke,
    attitude: Attitude,
    warmth: Warmth,
    seconds: f64,
    harder: f64,
    warmer_k: f64,
}

impl Excitation {
    /// Draws a recording's excitation.
    pub fn draw(
        programme: Programme,
        seed: u64,
        recording: u32,
        sensors: u32,
        seconds: f64,
    ) -> Self {
        let load = |sensor, axis| Load::draw(programme, seed, (recording, sensor, axis), seconds);
        Self {
            loads: (0..sensors).map(|s| [load(s, 0), load(s, 1)]).collect(),
            stroke: Stroke::draw(programme, seed, recording, seconds),
            attitude: Attitude::draw(programme, seed, recording),
            warmth: Warmth::draw(programme, seed, recording, sensors, seconds),
            seconds,
            harder: 1.0,
            warmer_k: 0.0,
        }
    }

    /// The same with every load multiplied, and so much warmer.
    pub fn beyond(self, harder: f64, warmer_k: f64) -> Self {
        Self {
            harder,
            warmer_k,
            ..self
        }
    }

    /// Lateral and longitudinal load on a sensor in newtons.
    pub fn load(&self, sensor: usize, time_s: f64) -> [f64; 2] {
        let [x, z] = &self.loads[sensor];
        [x, z].map(|load| self.harder * load.at(time_s))
    }

    /// Greatest load of each axis of a sensor, either sign, in newtons.
    pub fn greatest_load(&self, sensor: usize) -> [f64; 2] {
        let [x, z] = &self.loads[sensor];
        [x, z].map(|load| (self.harder * load.greatest(self.seconds)).abs())
    }

    /// Opening and motor.
    pub fn drive(&self, time_s: f64) -> Drive {
        self.stroke.at(time_s)
    }

    /// Orientation and specific force.
    pub fn standing(&self, time_s: f64) -> Standing {
        self.attitude.at(time_s)
    }

    /// What an accelerometer feels, body's axes, in m/s^2.
    pub fn specific_force(&self, time_s: f64) -> Vector3<f64> {
        self.attitude.at(time_s).specific_force
    }

    /// Temperature of a sensor in C.
    pub fn temperature_c(&self, sensor: usize, time_s: f64) -> f64 {
        self.warmth.at(sensor, time_s) + self.warmer_k
    }
}
