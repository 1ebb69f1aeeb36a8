//! The temperature of each sensor.

use super::draw::{Purpose, between, stream};
use super::programme::Programme;
use super::waves::{Waves, rise};

/// Temperature from which all effects of temperature are counted, in C.
pub const REFERENCE_C: f64 = 25.0;

/// A warm-up or cool-down changes the temperature by this, in K.
const CHANGE_K: [f64; 2] = [6.0, 10.0];

/// Sensors differ by up to this, and wander by up to that, in K.
const APART_K: f64 = 0.6;
const WANDER_K: f64 = 0.3;

/// Temperatures during one recording.
#[derive(Clone, Debug)]
pub struct Warmth {
    shape: Shape,
    start_c: f64,
    change_k: f64,
    seconds: f64,
    sensors: Vec<(f64, f64, Waves)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shape {
    Constant,
    /// Towards its end like a warming body: fast first.
    OneWay,
    /// There and back.
    Return,
}

impl Warmth {
    /// Draws temperatures for a recording: up in the first, down in the second, up and down in the
    /// third, then anything.
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
        let mut rng = stream(seed, Purpose::Warmth, part);
        let change = between(&mut rng, CHANGE_K[0], CHANGE_K[1]);
        let low = between(&mut rng, REFERENCE_C - 2.0, REFERENCE_C);
        let lot = between(&mut rng, 0.0, 3.0);
        let (shape, start_c, change_k) = match part {
            1 => (Shape::OneWay, low, change),
            2 => (Shape::OneWay, low + change, -change),
            3 => (Shape::Return, low, change),
            _ if lot < 1.0 => (Shape::OneWay, low, change),
            _ if lot < 2.0 => (Shape::OneWay, low + change, -change),
            _ => (Shape::Return, low + change, -change),
        };
        let apart = |rng: &mut _| {
            (
                between(rng, -APART_K, APART_K),
                between(rng, 0.9, 1.1),
                Waves::draw(rng, 2, [0.02, 0.08], WANDER_K),
            )
        };
        let isothermal = programme == Programme::Isothermal;
        Self {
            shape: if isothermal { Shape::Constant } else { shape },
            start_c,
            change_k,
            seconds,
            sensors: (0..sensors).map(|_| apart(&mut rng)).collect(),
        }
    }

    /// Temperature of a sensor in C at a time in seconds.
    pub fn at(&self, sensor: usize, time_s: f64) -> f64 {
        let share = (time_s / self.seconds).clamp(0.0, 1.0);
        // Two time constants in a recording.
        let warming = |share: f64| libm::expm1(-2.0 * share) / libm::expm1(-2.0);
        let along = match self.shape {
            Shape::Constant => return REFERENCE_C,
            Shape::OneWay => warming(share),
            Shape::Return => rise(share, 0.0, 0.5) - rise(share, 0.5, 1.0),
        };
        let (apart, pace, wander) = &self.sensors[sensor];
        self.start_c + apart + pace * self.change_k * along + wander.at(time_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(programme: Programme, recording: u32, to_s: f64) -> f64 {
        let warmth = Warmth::draw(programme, 1, recording, 4, 30.0);
        warmth.at(0, to_s) - warmth.at(0, 0.0)
    }

    #[test]
    fn the_first_recording_warms_the_second_cools_and_the_third_returns() {
        let bench = Programme::Bench;
        assert!(change(bench, 1, 30.0) > 4.5 && change(bench, 2, 30.0) < -4.5);
        assert!(change(bench, 3, 15.0) > 4.5 && change(bench, 3, 30.0).abs() < 1.5);
    }

    #[test]
    fn the_same_warm_up_is_the_same_and_an_isothermal_bench_stays_at_25_degrees() {
        let same = Programme::SameWarmUp;
        assert_eq!(change(same, 1, 20.0), change(same, 2, 20.0));
        assert_eq!(change(Programme::Isothermal, 2, 20.0), 0.0);
    }
}
