//! Excitation of a recording: load, motion, orientation and temperature over time.

use crate::campaign::plan::RecordingPlan;
use crate::motion::{AttitudeProfile, MotionState, OpeningProfile, Orientation, Programme};
use crate::random::{Purpose, SineSum, smoothstep, stream, uniform};
use model_export::effects::REFERENCE_C;
use model_export::recordings::columns::COVARIATES;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Excitation of one recording as a function of time.
#[derive(Clone, Debug)]
pub struct Excitation {
    source: Source,
    opening: OpeningProfile,
    seconds: f64,
    load_scale: f64,
    offset_k: f64,
}

/// Loads, orientation and temperatures.
#[derive(Clone, Debug)]
enum Source {
    Drawn {
        loads: Vec<[LoadProfile; 2]>,
        attitude: AttitudeProfile,
        temperature: TemperatureProfile,
    },
    Planned(RecordingPlan),
}

impl Excitation {
    /// Draws the excitation of a recording.
    pub fn draw(
        programme: Programme,
        seed: u64,
        recording: u32,
        sensors: u32,
        seconds: f64,
    ) -> Self {
        let load =
            |sensor, axis| LoadProfile::draw(programme, seed, (recording, sensor, axis), seconds);
        Self {
            source: Source::Drawn {
                loads: (0..sensors).map(|s| [load(s, 0), load(s, 1)]).collect(),
                attitude: AttitudeProfile::draw(programme, seed, recording),
                temperature: TemperatureProfile::draw(programme, seed, recording, sensors, seconds),
            },
            opening: OpeningProfile::draw(programme, seed, recording, seconds),
            seconds,
            load_scale: 1.0,
            offset_k: 0.0,
        }
    }

    /// The excitation of a plan; `rotor_rad` is the rotor's angle at the screw's zero.
    pub fn planned(plan: &RecordingPlan, rotor_rad: f64) -> Self {
        Self {
            opening: plan.opening(rotor_rad),
            seconds: plan.seconds(),
            source: Source::Planned(plan.clone()),
            load_scale: 1.0,
            offset_k: 0.0,
        }
    }

    /// The same with a factor on every load and an offset on every temperature.
    pub fn scaled(self, load_scale: f64, offset_k: f64) -> Self {
        Self { load_scale, offset_k, ..self }
    }

    /// Duration in seconds.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Lateral and longitudinal load on a sensor in newtons.
    pub fn load(&self, sensor: usize, time_s: f64) -> [f64; 2] {
        let newtons = match &self.source {
            Source::Drawn { loads, .. } => loads[sensor].each_ref().map(|load| load.at(time_s)),
            Source::Planned(plan) => plan.load_n(sensor, time_s),
        };
        newtons.map(|newtons| self.load_scale * newtons)
    }

    /// Maximum absolute load of each axis of a sensor, in newtons.
    pub fn max_load(&self, sensor: usize) -> [f64; 2] {
        [0, 1].map(|axis| max_abs(|time_s| self.load(sensor, time_s)[axis], self.seconds))
    }

    /// Opening and motor state.
    pub fn motion(&self, time_s: f64) -> MotionState {
        self.opening.at(time_s)
    }

    /// Orientation and specific force.
    pub fn orientation(&self, time_s: f64) -> Orientation {
        match &self.source {
            Source::Drawn { attitude, .. } => attitude.at(time_s),
            Source::Planned(plan) => plan.orientation(time_s),
        }
    }

    /// Specific force in body axes, in m/s^2.
    pub fn specific_force(&self, time_s: f64) -> Vector3<f64> {
        self.orientation(time_s).specific_force
    }

    /// Values of [`COVARIATES`]; the angle of the motor is not wrapped.
    pub fn covariates(&self, time_s: f64) -> [f64; COVARIATES.len()] {
        let motion = self.motion(time_s);
        let orientation = self.orientation(time_s);
        let [x, y, z] = orientation.specific_force.into();
        let [roll, pitch, yaw] = orientation.angles_rad;
        [motion.opening_mm, motion.current_a, motion.angle_rad, x, y, z, roll, pitch, yaw]
    }

    /// Angular rate in body axes, in rad/s.
    pub fn rate_rad_s(&self, time_s: f64) -> Vector3<f64> {
        Orientation::rate_rad_s(|time_s| self.orientation(time_s), time_s)
    }

    /// Temperature of a sensor in C.
    pub fn temperature_c(&self, sensor: usize, time_s: f64) -> f64 {
        self.offset_k
            + match &self.source {
                Source::Drawn { temperature, .. } => temperature.at(sensor, time_s),
                Source::Planned(plan) => REFERENCE_C + plan.warming_k(time_s),
            }
    }
}

/// Every recording starts unloaded for this long.
pub const UNLOADED_S: f64 = 0.5;

/// The load reaches its full amplitude at this time.
const LOADED_S: f64 = 1.5;

/// Frequency range of the load.
const FREQUENCIES_HZ: [f64; 2] = [0.2, 1.2];

/// Range of the maximum load of a recording, at the gripper's own force range.
const PEAK_N: [f64; 2] = [180.0, 205.0];

/// Load on one axis: slowly modulated sines.
#[derive(Clone, Debug)]
pub struct LoadProfile {
    waves: SineSum,
    /// Depth and waveform of the amplitude modulation.
    modulation: (f64, SineSum),
    scale: f64,
}

impl LoadProfile {
    /// Draws the load of axis 0 (lateral) or 1 (longitudinal).
    pub fn draw(
        programme: Programme,
        seed: u64,
        (recording, sensor, axis): (u32, u32, u32),
        seconds: f64,
    ) -> Self {
        let part = (recording << 16) | (sensor << 1) | axis;
        let mut rng = stream(seed, Purpose::Loads, part);
        let peak = uniform(&mut rng, PEAK_N[0], PEAK_N[1]);
        let phase = uniform(&mut rng, 0.0, TAU);
        let mut load = match programme {
            Programme::SingleSine => Self {
                waves: SineSum::one(1.0, 0.5, phase),
                modulation: (0.0, SineSum::one(1.0, 0.1, 0.0)),
                scale: 1.0,
            },
            _ => Self {
                waves: SineSum::draw(&mut rng, 3, FREQUENCIES_HZ, 1.0),
                modulation: (0.35, SineSum::one(1.0, uniform(&mut rng, 0.04, 0.12), phase)),
                scale: 1.0,
            },
        };
        load.scale = peak / load.max(seconds);
        load
    }

    /// Load in newtons at a time in seconds since the recording's start; zero before it.
    pub fn at(&self, time_s: f64) -> f64 {
        if time_s <= UNLOADED_S {
            return 0.0;
        }
        let (depth, modulation) = &self.modulation;
        let slow = 1.0 - depth * (1.0 - modulation.at(time_s));
        self.scale * smoothstep(time_s, UNLOADED_S, LOADED_S) * slow * self.waves.at(time_s)
    }

    /// Maximum absolute load in newtons during a recording.
    pub fn max(&self, seconds: f64) -> f64 {
        max_abs(|time_s| self.at(time_s), seconds)
    }
}

/// Maximum absolute value over a recording, sampled at 100 Hz.
fn max_abs(load_n: impl Fn(f64) -> f64, seconds: f64) -> f64 {
    let steps = (seconds * 100.0) as u32;
    let loads = (0..=steps).map(|step| load_n(f64::from(step) * 0.01).abs());
    loads.fold(f64::MIN_POSITIVE, f64::max)
}

/// Range of the temperature change of a recording, in K.
const CHANGE_K: [f64; 2] = [6.0, 10.0];

/// Maximum offset between sensors, and amplitude of their fluctuation, in K.
const SENSOR_OFFSET_K: f64 = 0.6;
const FLUCTUATION_K: f64 = 0.3;

/// Temperatures of all sensors during one recording.
#[derive(Clone, Debug)]
pub struct TemperatureProfile {
    shape: TemperatureShape,
    start_c: f64,
    change_k: f64,
    seconds: f64,
    sensors: Vec<(f64, f64, SineSum)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TemperatureShape {
    Constant,
    /// Exponential approach to a final temperature.
    OneWay,
    /// To a second temperature and back.
    Return,
}

impl TemperatureProfile {
    /// Draws temperatures for a recording: warm-up in the first, cool-down in the second, both in the
    /// third, then a random shape.
    pub fn draw(
        programme: Programme,
        seed: u64,
        recording: u32,
        sensors: u32,
        seconds: f64,
    ) -> Self {
        let part = match programme {
            Programme::SameWarmUp => 1,
            _ => recording,
        };
        let mut rng = stream(seed, Purpose::Temperature, part);
        let change = uniform(&mut rng, CHANGE_K[0], CHANGE_K[1]);
        let low = uniform(&mut rng, REFERENCE_C - 2.0, REFERENCE_C);
        let kind = uniform(&mut rng, 0.0, 3.0);
        let (shape, start_c, change_k) = match part {
            1 => (TemperatureShape::OneWay, low, change),
            2 => (TemperatureShape::OneWay, low + change, -change),
            3 => (TemperatureShape::Return, low, change),
            _ if kind < 1.0 => (TemperatureShape::OneWay, low, change),
            _ if kind < 2.0 => (TemperatureShape::OneWay, low + change, -change),
            _ => (TemperatureShape::Return, low + change, -change),
        };
        let offset = |rng: &mut _| {
            (
                uniform(rng, -SENSOR_OFFSET_K, SENSOR_OFFSET_K),
                uniform(rng, 0.9, 1.1),
                SineSum::draw(rng, 2, [0.02, 0.08], FLUCTUATION_K),
            )
        };
        let isothermal = programme == Programme::Isothermal;
        Self {
            shape: if isothermal { TemperatureShape::Constant } else { shape },
            start_c,
            change_k,
            seconds,
            sensors: (0..sensors).map(|_| offset(&mut rng)).collect(),
        }
    }

    /// Temperature of a sensor in C at a time in seconds.
    pub fn at(&self, sensor: usize, time_s: f64) -> f64 {
        let share = (time_s / self.seconds).clamp(0.0, 1.0);
        // Two time constants in a recording.
        let warming = |share: f64| libm::expm1(-2.0 * share) / libm::expm1(-2.0);
        let progress = match self.shape {
            TemperatureShape::Constant => return REFERENCE_C,
            TemperatureShape::OneWay => warming(share),
            TemperatureShape::Return => smoothstep(share, 0.0, 0.5) - smoothstep(share, 0.5, 1.0),
        };
        let (offset, gain, fluctuation) = &self.sensors[sensor];
        self.start_c + offset + gain * self.change_k * progress + fluctuation.at(time_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_starts_at_zero_and_peaks_near_200_n() {
        for sensor in 0..4 {
            let load = LoadProfile::draw(Programme::Bench, 1, (1, sensor, 0), 30.0);
            assert!((0..=500).all(|ms| load.at(f64::from(ms) * 1e-3) == 0.0));
            let max = load.max(30.0);
            assert!((180.0..=205.0).contains(&max), "{max}");
        }
    }

    fn change(programme: Programme, recording: u32, to_s: f64) -> f64 {
        let temperature = TemperatureProfile::draw(programme, 1, recording, 4, 30.0);
        temperature.at(0, to_s) - temperature.at(0, 0.0)
    }

    #[test]
    fn recordings_warm_cool_and_return() {
        let bench = Programme::Bench;
        assert!(change(bench, 1, 30.0) > 4.5 && change(bench, 2, 30.0) < -4.5);
        assert!(change(bench, 3, 15.0) > 4.5 && change(bench, 3, 30.0).abs() < 1.5);
    }

    #[test]
    fn warm_up_is_reproducible_and_isothermal_is_constant() {
        let same = Programme::SameWarmUp;
        assert_eq!(change(same, 1, 20.0), change(same, 2, 20.0));
        assert_eq!(change(Programme::Isothermal, 2, 20.0), 0.0);
    }
}
