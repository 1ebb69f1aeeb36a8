//! What the control sees: currents, bus voltage and the rotor's angle, each with its errors, in counts.

use std::f64::consts::TAU;

use firmware::motor::stage::Sensed;
use firmware::params;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::bench::draw::{between, normal};

/// One current sample in so many is drawn from a distribution so much wider: switching that couples in
/// (assumed).
const SPIKES: f64 = 1.0 / 500.0;
const SPIKE_WIDTH: f64 = 10.0;
/// Gain of a current sensor is right within this share (assumed).
const GAIN: f64 = 0.01;
/// Noise of the bus voltage in counts, root mean square (assumed).
const BUS_NOISE: f64 = 1.0;

/// The current converters' middle and end, in counts.
const MIDDLE: f64 = 2048.0;
const END: f64 = 4095.0;

/// The sensors' errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensors {
    /// What each current sensor shows without a current, in A.
    pub offset_a: [f64; 3],
    /// What it makes of an ampere.
    pub gain: [f64; 3],
    /// Noise of a current in A, root mean square, spikes apart.
    pub current_noise_a: f64,
    /// Noise of the bus voltage in counts, root mean square.
    pub bus_noise: f64,
    /// Noise of the rotor's angle in rad, root mean square.
    pub angle_noise_rad: f64,
    /// Error of the angle once a turn, in rad.
    pub eccentricity_rad: f64,
}

impl Sensors {
    /// No errors but that of counting.
    pub fn ideal() -> Self {
        Self {
            offset_a: [0.0; 3],
            gain: [1.0; 3],
            current_noise_a: 0.0,
            bus_noise: 0.0,
            angle_noise_rad: 0.0,
            eccentricity_rad: 0.0,
        }
    }

    /// Noise as the card says, offsets within its bounds, of no particular gripper.
    pub fn nominal() -> Self {
        let offset_a = params::CURRENT_OFFSET.value;
        Self {
            offset_a: [0.5 * offset_a, -0.3 * offset_a, 0.2 * offset_a],
            gain: [1.0; 3],
            current_noise_a: 1e-3 * params::CURRENT_NOISE.value,
            bus_noise: BUS_NOISE,
            angle_noise_rad: params::ENCODER_NOISE.value.to_radians(),
            eccentricity_rad: params::ENCODER_ECCENTRICITY.value.to_radians(),
        }
    }

    /// Offsets and gains of one gripper.
    pub fn drawn(rng: &mut ChaCha8Rng) -> Self {
        let most_a = params::CURRENT_OFFSET.value;
        Self {
            offset_a: [0, 1, 2].map(|_| between(rng, -most_a, most_a)),
            gain: [0, 1, 2].map(|_| between(rng, 1.0 - GAIN, 1.0 + GAIN)),
            ..Self::nominal()
        }
    }

    /// One look at these currents in A, bus voltage in V and rotor's angle in rad.
    pub fn look(
        &self,
        currents_a: &[f64; 3],
        bus_v: f64,
        angle_rad: f64,
        rng: &mut ChaCha8Rng,
    ) -> Sensed {
        let phases = [0, 1, 2].map(|phase| {
            let noise_a = self.current_noise_a * with_spikes(rng);
            let seen_a = self.gain[phase] * currents_a[phase] + self.offset_a[phase] + noise_a;
            counts(MIDDLE + 1e3 * seen_a / params::CURRENT_SCALE.value)
        });
        let bus = 1e3 * bus_v / params::BUS_SCALE.value + self.bus_noise * normal(rng);
        let seen_rad = angle_rad
            + self.eccentricity_rad * libm::sin(angle_rad)
            + self.angle_noise_rad * normal(rng);
        Sensed {
            phases,
            bus: counts(bus),
            angle: Ok(turn_counts(seen_rad)),
        }
    }
}

/// Normal with standard deviation 1, and now and then much wider.
fn with_spikes(rng: &mut ChaCha8Rng) -> f64 {
    match rng.random::<f64>() < SPIKES {
        true => SPIKE_WIDTH * normal(rng),
        false => normal(rng),
    }
}

/// A converter's counts, at its end where there is more.
fn counts(value: f64) -> u16 {
    value.round().clamp(0.0, END) as u16
}

/// Counts of an angle within its turn.
fn turn_counts(angle_rad: f64) -> u16 {
    let turn = libm::exp2(params::ENCODER_BITS.value);
    let within = (angle_rad / TAU).rem_euclid(1.0);
    ((within * turn) as u32 % turn as u32) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::parameters::noise;

    #[test]
    fn an_ampere_is_80_counts_and_24_v_are_1600() {
        let sensed = Sensors::ideal().look(&[1.0, -1.0, 0.0], 24.0, 0.0, &mut noise(1));
        assert_eq!(sensed.phases, [2128, 1968, 2048]);
        assert_eq!((sensed.bus, sensed.angle), (1600, Ok(0)));
    }

    #[test]
    fn an_angle_is_counted_within_its_turn_either_way() {
        assert_eq!(turn_counts(0.25 * TAU), 4096);
        assert_eq!(turn_counts(-0.25 * TAU), 12_288);
        assert_eq!(turn_counts(-1e-18), 0);
        assert_eq!(turn_counts(7.5 * TAU), 8192);
    }

    #[test]
    fn a_current_beyond_the_converter_s_end_reads_its_end() {
        let sensed = Sensors::ideal().look(&[30.0, -30.0, 0.0], 70.0, 0.0, &mut noise(1));
        assert_eq!(sensed.phases, [4095, 0, 2048]);
        assert_eq!(sensed.bus, 4095);
    }

    #[test]
    fn noise_has_the_tails_of_its_spikes() {
        let mut rng = noise(1);
        let drawn: Vec<f64> = (0..400_000).map(|_| with_spikes(&mut rng)).collect();
        let moment = |power| drawn.iter().map(|x| x.powi(power)).sum::<f64>() / drawn.len() as f64;
        // (0.998 + 0.002 * 100) and 3 (0.998 + 0.002 * 10^4); a Gaussian's kurtosis is 3.
        assert!((moment(2) - 1.198).abs() < 0.03, "{}", moment(2));
        let kurtosis = moment(4) / moment(2).powi(2);
        assert!((30.0..60.0).contains(&kurtosis), "{kurtosis}");
    }
}
