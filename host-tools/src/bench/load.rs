//! The load on one axis of one sensor during one recording.

use std::f64::consts::TAU;

use super::draw::{Purpose, between, stream};
use super::programme::Programme;
use super::waves::{Waves, rise};

/// Every recording starts without load for this long.
pub const UNLOADED_S: f64 = 0.5;

/// The load then grows to its programme until this time.
const LOADED_S: f64 = 1.5;

/// Frequencies of the sines.
const FREQUENCIES_HZ: [f64; 2] = [0.2, 1.2];

/// Greatest load of a recording lies between these, with the gripper's own force range.
const PEAK_N: [f64; 2] = [180.0, 205.0];

/// Slowly modulated sines.
#[derive(Clone, Debug)]
pub struct Load {
    waves: Waves,
    /// Share of the amplitude that comes and goes, and how.
    modulation: (f64, Waves),
    scale: f64,
}

impl Load {
    /// Draws the load of axis 0 (lateral) or 1 (longitudinal).
    pub fn draw(
        programme: Programme,
        seed: u64,
        (recording, sensor, axis): (u32, u32, u32),
        seconds: f64,
    ) -> Self {
        let part = (recording << 16) | (sensor << 1) | axis;
        let mut rng = stream(seed, Purpose::Loads, part);
        let peak = between(&mut rng, PEAK_N[0], PEAK_N[1]);
        let phase = between(&mut rng, 0.0, TAU);
        let mut load = match programme {
            Programme::SingleSine => Self {
                waves: Waves::one(1.0, 0.5, phase),
                modulation: (0.0, Waves::one(1.0, 0.1, 0.0)),
                scale: 1.0,
            },
            _ => Self {
                waves: Waves::draw(&mut rng, 3, FREQUENCIES_HZ, 1.0),
                modulation: (0.35, Waves::one(1.0, between(&mut rng, 0.04, 0.12), phase)),
                scale: 1.0,
            },
        };
        load.scale = peak / load.greatest(seconds);
        load
    }

    /// Load in newtons at a time in seconds since the recording's start; zero before it.
    pub fn at(&self, time_s: f64) -> f64 {
        if time_s <= UNLOADED_S {
            return 0.0;
        }
        let (depth, modulation) = &self.modulation;
        let slow = 1.0 - depth * (1.0 - modulation.at(time_s));
        self.scale * rise(time_s, UNLOADED_S, LOADED_S) * slow * self.waves.at(time_s)
    }

    /// Greatest load in newtons during a recording, either sign.
    pub fn greatest(&self, seconds: f64) -> f64 {
        let steps = (seconds * 100.0) as u32;
        let loads = (0..=steps).map(|step| self.at(f64::from(step) * 0.01).abs());
        loads.fold(f64::MIN_POSITIVE, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_is_zero_at_first_and_then_reaches_about_200_newtons() {
        for sensor in 0..4 {
            let load = Load::draw(Programme::Bench, 1, (1, sensor, 0), 30.0);
            assert!((0..=500).all(|ms| load.at(f64::from(ms) * 1e-3) == 0.0));
            let greatest = load.greatest(30.0);
            assert!((180.0..=205.0).contains(&greatest), "{greatest}");
        }
    }
}
