//! The inertial sensor: what an LSM6DS3TR-C on the gripper has in its registers.

use firmware::imu::Motion;
use firmware::imu::lsm6ds3::decode;
use rand_chacha::ChaCha8Rng;

use crate::bench::draw::{Purpose, normal, stream};

/// Acceleration of a count at +-4 g, in m/s^2, and turn of a count at +-2000 degrees per second.
const ACCELERATION_PER_COUNT: f64 = 0.122e-3 * 9.806_65;
const TURN_PER_COUNT_DEG_S: f64 = 0.07;
/// Noise at 833 Hz, root mean square: 90 ug and 5 mdps for each root hertz over 417 Hz (datasheet).
const ACCELERATION_NOISE: f64 = 90e-6 * 9.806_65 * 20.4;
const TURN_NOISE_DEG_S: f64 = 5e-3 * 20.4;

/// The sensor.
#[derive(Clone, Debug)]
pub struct Inertial {
    rng: ChaCha8Rng,
}

impl Inertial {
    /// With noise of this seed.
    pub fn new(seed: u64) -> Self {
        Self {
            rng: stream(seed, Purpose::Inertial, 0),
        }
    }

    /// A reading of this specific force in m/s^2 and turn in degrees per second, by way of the registers.
    pub fn look(&mut self, specific_force: [f64; 3], turn_deg_s: [f64; 3]) -> Motion {
        let turn =
            turn_deg_s.map(|value| self.counts(value, TURN_NOISE_DEG_S, TURN_PER_COUNT_DEG_S));
        let acceleration = specific_force
            .map(|value| self.counts(value, ACCELERATION_NOISE, ACCELERATION_PER_COUNT));
        let mut bytes = [0; 12];
        let words = turn.iter().chain(&acceleration);
        for (place, word) in bytes.chunks_exact_mut(2).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        decode(bytes)
    }

    fn counts(&mut self, value: f64, noise: f64, per_count: f64) -> i16 {
        // A conversion from floating point stops at the ends of the range.
        ((value + noise * normal(&mut self.rng)) / per_count).round() as i16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_gripper_feels_gravity_and_its_noise() {
        let mut inertial = Inertial::new(1);
        let (mut mean, mut squares) = (0.0, 0.0);
        for _ in 0..4000 {
            let motion = inertial.look([0.0, 0.0, 9.81], [0.0; 3]);
            let off = f64::from(motion.acceleration[2]) - 9810.0;
            (mean, squares) = (mean + off / 4000.0, squares + off * off / 4000.0);
        }
        // 18 mm/s^2 of noise.
        assert!(mean.abs() < 2.0, "{mean}");
        assert!((squares.sqrt() - 18.0).abs() < 1.5, "{}", squares.sqrt());
    }

    #[test]
    fn beyond_four_g_it_reads_four_g() {
        let motion = Inertial::new(1).look([100.0, -100.0, 0.0], [0.0; 3]);
        assert!((39_000..39_400).contains(&motion.acceleration[0]));
        assert!((-39_400..-39_000).contains(&motion.acceleration[1]));
    }
}
