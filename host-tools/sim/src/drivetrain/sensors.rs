//! Sensors of motor and gripper with their errors: currents, bus voltage, rotor angle, acceleration and rate.

use crate::random::{Purpose, normal, stream, uniform};
use firmware::config::constants;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Share of current samples with switching interference, and its factor on the noise
/// (assumed).
const OUTLIERS: f64 = 1.0 / 500.0;
const OUTLIER_FACTOR: f64 = 10.0;
/// Gain tolerance of a current sensor (assumed).
const GAIN: f64 = 0.01;
/// RMS noise of the bus voltage in counts (assumed).
const BUS_NOISE: f64 = 1.0;

/// Zero-current and full-scale value of the converters, in counts.
const ZERO_COUNTS: f64 = 2048.0;
const MAX_COUNTS: f64 = 4095.0;

/// Errors of the motor control's sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSensors {
    /// Offset of each current sensor in A.
    pub offset_a: [f64; 3],
    /// Gain of each current sensor.
    pub gain: [f64; 3],
    /// RMS noise of a current in A, without interference.
    pub current_noise_a: f64,
    /// RMS noise of the bus voltage in counts.
    pub bus_noise: f64,
    /// RMS noise of the rotor angle in rad.
    pub angle_noise_rad: f64,
    /// Amplitude of the angle error over one turn, in rad.
    pub eccentricity_rad: f64,
}

impl MotorSensors {
    /// Quantisation only.
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

    /// Nominal noise, typical offsets.
    pub fn nominal() -> Self {
        let offset_a = constants::CURRENT_OFFSET.value;
        Self {
            offset_a: [0.5 * offset_a, -0.3 * offset_a, 0.2 * offset_a],
            gain: [1.0; 3],
            current_noise_a: 1e-3 * constants::CURRENT_NOISE.value,
            bus_noise: BUS_NOISE,
            angle_noise_rad: constants::ENCODER_NOISE.value.to_radians(),
            eccentricity_rad: constants::ENCODER_ECCENTRICITY.value.to_radians(),
        }
    }

    /// Random offsets and gains.
    pub fn random(rng: &mut ChaCha8Rng) -> Self {
        let max_a = constants::CURRENT_OFFSET.value;
        Self {
            offset_a: [0, 1, 2].map(|_| uniform(rng, -max_a, max_a)),
            gain: [0, 1, 2].map(|_| uniform(rng, 1.0 - GAIN, 1.0 + GAIN)),
            ..Self::nominal()
        }
    }

    /// Counts of phase currents in A and bus voltage in V.
    pub fn convert(
        &self,
        currents_a: &[f64; 3],
        bus_v: f64,
        rng: &mut ChaCha8Rng,
    ) -> ([u16; 3], u16) {
        let phases = [0, 1, 2].map(|phase| {
            let noise_a = self.current_noise_a * noise_with_outliers(rng);
            let measured_a = self.gain[phase] * currents_a[phase] + self.offset_a[phase] + noise_a;
            counts(ZERO_COUNTS + 1e3 * measured_a / constants::CURRENT_SCALE.value)
        });
        let bus = 1e3 * bus_v / constants::BUS_SCALE.value + self.bus_noise * normal(rng);
        (phases, counts(bus))
    }

    /// Counts of the rotor angle in rad, within a turn.
    pub fn angle(&self, angle_rad: f64, rng: &mut ChaCha8Rng) -> u16 {
        let measured_rad = angle_rad
            + self.eccentricity_rad * libm::sin(angle_rad)
            + self.angle_noise_rad * normal(rng);
        turn_counts(measured_rad)
    }
}

/// Standard normal with occasional wide outliers.
fn noise_with_outliers(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random::<f64>() < OUTLIERS { OUTLIER_FACTOR * normal(rng) } else { normal(rng) }
}

/// Saturated counts of a converter.
fn counts(value: f64) -> u16 {
    value.round().clamp(0.0, MAX_COUNTS) as u16
}

/// Counts of an angle within its turn.
fn turn_counts(angle_rad: f64) -> u16 {
    let turn = libm::exp2(constants::ENCODER_BITS.value);
    let within = (angle_rad / TAU).rem_euclid(1.0);
    ((within * turn) as u32 % turn as u32) as u16
}

/// Temperature of the room in degrees Celsius.
pub const ROOM_C: f64 = 25.0;
const ZERO_K: f64 = 273.15;

/// Counts of a thermistor between the converter's input and ground at a temperature in degrees Celsius.
pub fn thermistor_counts(celsius: f64) -> u16 {
    let reference_k = ZERO_K + 25.0;
    let ohm = 1e3
        * constants::THERMISTOR_RESISTANCE.value
        * libm::exp(constants::THERMISTOR_B.value * (1.0 / (ZERO_K + celsius) - 1.0 / reference_k));
    counts(MAX_COUNTS * ohm / (ohm + 1e3 * constants::THERMISTOR_PULL_UP.value))
}

/// Counts of the chip's own temperature sensor: linear between those of its calibration at 30 and 130 degrees Celsius, which
/// was at 3.0 V instead of 3.3 V.
pub fn chip_counts(celsius: f64) -> u16 {
    let [cold, hot] = emulator::TEMPERATURE_CALIBRATION.map(f64::from);
    counts((cold + (hot - cold) * (celsius - 30.0) / 100.0) * 3.0 / 3.3)
}

/// Output registers of an LSM6DS3TR-C: rate and acceleration, x to z, little-endian.
pub type InertialRegisters = [u8; 12];

/// Scales of a count at +-4 g, in m/s^2, and at +-2000 degrees per second.
const ACCELERATION_PER_COUNT: f64 = 0.122e-3 * 9.806_65;
const RATE_PER_COUNT_DEG_S: f64 = 0.07;
/// RMS noise at 833 Hz: 90 ug and 5 mdps per root hertz over 417 Hz (datasheet).
const ACCELERATION_NOISE: f64 = 90e-6 * 9.806_65 * 20.4;
const RATE_NOISE_DEG_S: f64 = 5e-3 * 20.4;

/// Measurement noise of an LSM6DS3TR-C.
#[derive(Clone, Debug)]
pub struct SimulatedImu {
    rng: ChaCha8Rng,
}

impl SimulatedImu {
    /// A sensor with noise of this seed.
    pub fn new(seed: u64) -> Self {
        Self { rng: stream(seed, Purpose::Inertial, 0) }
    }

    /// Registers at this specific force in m/s^2 and this rate in degrees per second.
    pub fn sample(&mut self, specific_force: [f64; 3], rate_deg_s: [f64; 3]) -> InertialRegisters {
        let mut noisy = |value, noise| value + noise * normal(&mut self.rng);
        let rate = rate_deg_s.map(|value| noisy(value, RATE_NOISE_DEG_S));
        imu_registers(specific_force.map(|value| noisy(value, ACCELERATION_NOISE)), rate)
    }
}

/// Registers of an LSM6DS3TR-C at this specific force in m/s^2 and this rate in degrees per second.
pub fn imu_registers(specific_force: [f64; 3], rate_deg_s: [f64; 3]) -> InertialRegisters {
    // The casts saturate.
    let counts = |value: f64, per_count: f64| (value / per_count).round() as i16;
    let rate = rate_deg_s.map(|value| counts(value, RATE_PER_COUNT_DEG_S));
    let acceleration = specific_force.map(|value| counts(value, ACCELERATION_PER_COUNT));
    let mut bytes = [0; 12];
    for (place, word) in bytes.chunks_exact_mut(2).zip(rate.iter().chain(&acceleration)) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drivetrain::parameters::noise_stream;
    use firmware::sensors::imu::decode;

    #[test]
    fn one_ampere_is_80_counts_24_v_are_1600_and_both_saturate() {
        for (current_a, bus_v, counts) in
            [(1.0, 24.0, ([2128, 1968, 2048], 1600)), (30.0, 70.0, ([4095, 0, 2048], 4095))]
        {
            let currents_a = [current_a, -current_a, 0.0];
            let converted = MotorSensors::ideal().convert(&currents_a, bus_v, &mut noise_stream(1));
            assert_eq!(converted, counts);
        }
    }

    #[test]
    fn angle_counts_wrap_in_both_directions() {
        assert_eq!(turn_counts(0.25 * TAU), 4096);
        assert_eq!(turn_counts(-0.25 * TAU), 12_288);
        assert_eq!(turn_counts(-1e-18), 0);
        assert_eq!(turn_counts(7.500_01 * TAU), 8192);
    }

    #[test]
    fn current_noise_has_heavy_tails() {
        let mut rng = noise_stream(1);
        let random: Vec<f64> = (0..400_000).map(|_| noise_with_outliers(&mut rng)).collect();
        let moment =
            |power| random.iter().map(|x| x.powi(power)).sum::<f64>() / random.len() as f64;
        // (0.998 + 0.002 * 100) and 3 (0.998 + 0.002 * 10^4); a Gaussian's kurtosis is 3.
        assert!((moment(2) - 1.198).abs() < 0.03, "{}", moment(2));
        let kurtosis = moment(4) / moment(2).powi(2);
        assert!((30.0..60.0).contains(&kurtosis), "{kurtosis}");
    }

    #[test]
    fn level_gripper_reads_gravity_with_noise() {
        let mut inertial = SimulatedImu::new(1);
        let (mut mean, mut squares) = (0.0, 0.0);
        for _ in 0..4000 {
            let motion = decode(inertial.sample([0.0, 0.0, 9.81], [0.0; 3]));
            let off = f64::from(motion.acceleration[2]) - 9810.0;
            (mean, squares) = (mean + off / 4000.0, squares + off * off / 4000.0);
        }
        // 18 mm/s^2 of noise.
        assert!(mean.abs() < 2.0, "{mean}");
        assert!((squares.sqrt() - 18.0).abs() < 1.5, "{}", squares.sqrt());
    }

    #[test]
    fn acceleration_saturates_at_4_g() {
        let motion = decode(SimulatedImu::new(1).sample([100.0, -100.0, 0.0], [0.0; 3]));
        assert!((39_000..39_400).contains(&motion.acceleration[0]));
        assert!((-39_400..-39_000).contains(&motion.acceleration[1]));
    }
}
