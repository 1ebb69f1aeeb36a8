//! The Hall element: how it is turned, what it adds, how it compresses, its noise and its counts.

use clap::ValueEnum;
use firmware::params;
use nalgebra::{Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::draw::{Purpose, direction, normals, stream};
use super::effects::Effects;
use super::scatter::Made;

/// Noise of the A31301 at full rate, in gauss, root mean square (measured by others; `hall::watch`).
pub const NOISE_G: f64 = params::SENSOR_NOISE.value;

/// Field at which compression is stated, in gauss: about that of the magnet at rest.
const STATED_G: f64 = 1300.0;

/// Time constant of the field's drift in seconds of the session.
pub const DRIFT_S: f64 = 600.0;

/// Correlated noise: standard deviation in gauss and correlation time in seconds.
const AR1_G: f64 = 0.15;
const AR1_S: f64 = 0.3;

/// Random walk, in gauss per square root of a second.
const WALK_G: f64 = 0.05;

/// The kinds of noise beside white noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseKind {
    /// None.
    White,
    /// 0.15 G with a correlation time of 0.3 s.
    Ar1,
    /// A random walk of 0.05 G per root second.
    Walk,
}

/// What an element does to the field, noise apart.
#[derive(Clone, Debug)]
pub struct Element {
    turn: Rotation3<f64>,
    bias_g: Vector3<f64>,
    /// Drift of the offset with temperature.
    pub per_kelvin_g: Vector3<f64>,
    /// Shift of the field at the end of a long session.
    pub drift_g: Vector3<f64>,
    compression: f64,
}

impl Element {
    /// Draws directions of drifts.
    pub fn draw(made: &Made, effects: &Effects, seed: u64) -> Self {
        let along = |purpose| direction(&mut stream(seed, purpose, made.number));
        let of = |id: &str| effects.each(id, made.number);
        Self {
            turn: Rotation3::from_scaled_axis(made.rotation()),
            bias_g: Vector3::from(made.bias_g),
            per_kelvin_g: along(Purpose::SensorTemperature) * of("sensor_temperature"),
            drift_g: along(Purpose::FieldDrift) * of("field_drift"),
            compression: 0.01 * of("sensor_compression"),
        }
    }

    /// What a small field from outside adds to the reading, in gauss, compression apart.
    pub fn turned(&self, field_g: Vector3<f64>) -> Vector3<f64> {
        self.turn * field_g
    }

    /// Reading in gauss of a field in the gripper's axes, so many kelvin from the reference
    /// temperature and so many seconds into the session.
    pub fn reading(&self, field_g: Vector3<f64>, warm_k: f64, session_s: f64) -> Vector3<f64> {
        let own = self.turn * field_g;
        let compressed = own.map(|b| b * (1.0 - self.compression * (b / STATED_G).powi(2)));
        let drifted = -libm::expm1(-session_s / DRIFT_S);
        compressed + self.bias_g + self.per_kelvin_g * warm_k + self.drift_g * drifted
    }
}

/// Noise of one element's three axes during one recording.
#[derive(Clone, Debug)]
pub struct Noise {
    kind: NoiseKind,
    white_g: f64,
    slow_g: Vector3<f64>,
    rng: ChaCha8Rng,
}

impl Noise {
    /// Noise that begins with a recording.
    pub fn begin(
        kind: NoiseKind,
        white_g: f64,
        seed: u64,
        (recording, sensor): (u32, u32),
    ) -> Self {
        let mut rng = stream(seed, Purpose::FieldNoise, (recording << 16) | sensor);
        let start = normals(&mut rng);
        let slow_g = match kind {
            NoiseKind::Ar1 => start * AR1_G,
            NoiseKind::White | NoiseKind::Walk => Vector3::zeros(),
        };
        Self {
            kind,
            white_g,
            slow_g,
            rng,
        }
    }

    /// Noise in gauss, `dt_s` after the last.
    pub fn next(&mut self, dt_s: f64) -> Vector3<f64> {
        match self.kind {
            NoiseKind::White => {}
            NoiseKind::Ar1 => {
                let keep = libm::exp(-dt_s / AR1_S);
                let fresh = AR1_G * (1.0 - keep * keep).sqrt();
                self.slow_g = self.slow_g * keep + normals(&mut self.rng) * fresh;
            }
            NoiseKind::Walk => self.slow_g += normals(&mut self.rng) * (WALK_G * dt_s.sqrt()),
        }
        self.slow_g + normals(&mut self.rng) * self.white_g
    }
}

/// What a Hall sensor makes of a field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// One count in gauss.
    pub gauss_per_lsb: f64,
    /// Range of each axis, either way, in gauss.
    pub range_gauss: f64,
}

impl Part {
    /// The gripper's own.
    pub fn a31301() -> Self {
        Self {
            gauss_per_lsb: params::SENSOR_SCALE.value,
            range_gauss: params::SENSOR_RANGE.value,
        }
    }

    /// Counts of a field, at the end of the range where it goes beyond.
    pub fn counts(&self, field_g: Vector3<f64>) -> [i32; 3] {
        let scale = self.gauss_per_lsb;
        let most = self.range_gauss / scale;
        field_g
            .map(|gauss| (gauss / scale).round().clamp(-most, most) as i32)
            .into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::recordings::description::Design;

    fn element(wanted: &str) -> Element {
        let made = Made::draw(&Design::magpie(), 0, 5, 0.0);
        let effects = Effects::new(&[wanted.parse().unwrap()], 5, 1, 0.0).unwrap();
        Element::draw(&made, &effects, 5)
    }

    #[test]
    fn a_compressed_element_loses_a_percent_at_1300_gauss() {
        let read = element("sensor_compression").reading(Vector3::new(0.0, 1300.0, 0.0), 0.0, 0.0);
        assert!((read.y - 0.99 * 1300.0).abs() < 1e-9);
    }

    #[test]
    fn drifts_have_the_norm_asked_for() {
        let zero = Vector3::zeros();
        let warm = element("sensor_temperature=0.2").reading(zero, 10.0, 0.0);
        let late = element("field_drift=0.7").reading(zero, 0.0, 600.0);
        assert!((warm.norm() - 2.0).abs() < 1e-12);
        assert!((late.norm() - 0.7 * (1.0 - libm::exp(-1.0))).abs() < 1e-12);
    }

    #[test]
    fn correlated_noise_has_its_deviation_and_its_memory() {
        let mut noise = Noise::begin(NoiseKind::Ar1, 0.0, 5, (1, 0));
        let values: Vec<f64> = (0..400_000).map(|_| noise.next(0.001).x).collect();
        let mean_product = |lag: usize| {
            let pairs = values.iter().zip(&values[lag..]);
            pairs.map(|(a, b)| a * b).sum::<f64>() / (values.len() - lag) as f64
        };
        let (variance, later) = (mean_product(0), mean_product(300));
        assert!((variance.sqrt() / 0.15 - 1.0).abs() < 0.1, "{variance}");
        assert!((later / variance - libm::exp(-1.0)).abs() < 0.1, "{later}");
    }

    #[test]
    fn counts_are_eighths_of_a_gauss_and_stop_at_the_range() {
        let field = Vector3::new(1.0, 2500.0, -0.07);
        assert_eq!(Part::a31301().counts(field), [8, 16_000, -1]);
    }
}
