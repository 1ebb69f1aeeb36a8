//! One simulated sensor: Hall element, finger, neighbouring magnet; noise and quantisation of its field.

use clap::ValueEnum;
use firmware::config::constants;
use model_export::effects::catalogue::{
    DEMAGNETISATION, FIELD_DRIFT, MAGNET_TEMPERATURE, NEIGHBOUR_MAGNET, SENSOR_COMPRESSION,
    SENSOR_TEMPERATURE,
};
use model_export::physics::{SensorMounting, SensorOrientation};
use model_export::recordings::description::NominalDesign;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::effects::Effects;
use crate::external_fields::{NeighbourMagnet, motor_leakage};
use crate::finger::{SensorFinger, SensorSpecimen};
use crate::random::{Purpose, normal_vector, stream, unit_vector};
use crate::uncatalogued::{Contribution, UncataloguedEffects};

/// RMS noise of the A31301 at full rate, in gauss.
pub const NOISE_G: f64 = constants::SENSOR_NOISE.value;

/// Field at which the compression is specified, in gauss: about that of the unloaded magnet.
const COMPRESSION_FIELD_G: f64 = 1300.0;

/// Time constant of the field's drift, in seconds since the campaign began.
pub const DRIFT_S: f64 = 600.0;

/// Correlated noise: standard deviation in gauss and correlation time in seconds.
const AR1_G: f64 = 0.15;
const AR1_S: f64 = 0.3;

/// Random walk, in gauss per square root of a second.
const WALK_G: f64 = 0.05;

/// Field noise in addition to white noise.
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

/// What determines the field of a sensor, besides its load.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldConditions {
    /// Temperature above the reference, in kelvin.
    pub warm_k: f64,
    /// Turns of the screw.
    pub screw_turns: f64,
    /// Opening of the fingers in mm.
    pub opening_mm: f64,
    /// Currents of the motor in A, see [`crate::external_fields::motor_currents`].
    pub currents_a: Vector3<f64>,
    /// Share of the demagnetisation.
    pub lost: f64,
    /// Effects outside the catalogue.
    pub uncatalogued: Contribution,
}

/// A sensor with its finger and the sources that depend on its place.
#[derive(Clone)]
pub struct SensorUnit {
    /// Manufactured dimensions.
    pub specimen: SensorSpecimen,
    /// State of the flexures.
    pub finger: SensorFinger,
    /// Errors of the Hall element.
    pub element: HallElement,
    /// Magnet of the opposite finger.
    pub neighbour: NeighbourMagnet,
    /// Motor leakage in G/A: axes by alpha, beta and quadrature current.
    pub leakage: Matrix3<f64>,
    /// Effects outside the catalogue; without influence until they are advanced.
    pub uncatalogued: UncataloguedEffects,
    /// Change of remanence with temperature, in 1/K.
    per_kelvin: f64,
    /// Loss of remanence by demagnetisation.
    loss: f64,
}

impl SensorUnit {
    /// Draws a sensor; `max_n` are the largest loads of each axis, at which a stop engages.
    pub fn new(
        design: &NominalDesign,
        number: u32,
        (seed, scatter): (u64, f64),
        mounting: SensorMounting,
        effects: &Effects,
        max_n: [f64; 2],
    ) -> Self {
        let specimen = SensorSpecimen::draw(design, number, seed, scatter).mounted(mounting);
        let neighbour_g = effects.each(NEIGHBOUR_MAGNET.id, number);
        Self {
            finger: SensorFinger::new(&specimen, effects, max_n),
            element: HallElement::draw(&specimen, effects, seed),
            neighbour: NeighbourMagnet::draw(&specimen, seed, scatter, neighbour_g),
            leakage: motor_leakage(&specimen, effects, seed),
            uncatalogued: UncataloguedEffects::draw(effects, seed, number),
            per_kelvin: 0.01 * effects.size(MAGNET_TEMPERATURE.id),
            loss: 0.01 * effects.each(DEMAGNETISATION.id, number),
            specimen,
        }
    }

    /// Field of both fingers' magnets and of the motor in gauss, gripper axes.
    pub fn field(&self, at: &FieldConditions) -> Vector3<f64> {
        self.own_field(at)
            + self.neighbour.field(at.opening_mm)
            + self.leakage * at.currents_a
            + at.uncatalogued.field_g
    }

    /// Field of the finger's own magnet in gauss, gripper axes.
    pub fn own_field(&self, at: &FieldConditions) -> Vector3<f64> {
        let remanence = self.specimen.remanence_t
            * (1.0 + self.per_kelvin * at.warm_k)
            * (1.0 - self.loss * at.lost);
        let mut pose = self.finger.magnet(at.warm_k, at.screw_turns);
        pose.centre_mm += at.uncatalogued.displacement_mm;
        pose.unit_field(&self.specimen.magnet) * remanence
    }
}

/// Deterministic errors of a Hall element.
#[derive(Clone, Debug)]
pub struct HallElement {
    rotation: Rotation3<f64>,
    orientation: SensorOrientation,
    bias_g: Vector3<f64>,
    /// Temperature drift of the offset.
    pub per_kelvin_g: Vector3<f64>,
    /// Final drift of the field over a long session.
    pub drift_g: Vector3<f64>,
    compression: f64,
}

impl HallElement {
    /// Draws the directions of the drifts.
    pub fn draw(specimen: &SensorSpecimen, effects: &Effects, seed: u64) -> Self {
        let along = |purpose| unit_vector(&mut stream(seed, purpose, specimen.number));
        let of = |id: &str| effects.each(id, specimen.number);
        Self {
            rotation: Rotation3::from_scaled_axis(specimen.rotation()),
            orientation: specimen.orientation,
            bias_g: Vector3::from(specimen.bias_g),
            per_kelvin_g: along(Purpose::SensorTemperature) * of(SENSOR_TEMPERATURE.id),
            drift_g: along(Purpose::FieldDrift) * of(FIELD_DRIFT.id),
            compression: 0.01 * of(SENSOR_COMPRESSION.id),
        }
    }

    /// An external field in the element's axes, in gauss, without compression.
    pub fn rotate(&self, field_g: Vector3<f64>) -> Vector3<f64> {
        self.orientation.to_sensor(self.rotation * field_g)
    }

    /// Reading in gauss of a field in gripper axes, `session_s` after the start of the campaign.
    pub fn reading(
        &self,
        field_g: Vector3<f64>,
        at: &FieldConditions,
        session_s: f64,
    ) -> Vector3<f64> {
        let Contribution { rotation_rad, gain, .. } = at.uncatalogued;
        let turned = Rotation3::from_scaled_axis(-rotation_rad) * field_g;
        let own = self.rotation * turned;
        let own = own + own.component_mul(&gain);
        let compressed =
            own.map(|b| b * (1.0 - self.compression * (b / COMPRESSION_FIELD_G).powi(2)));
        let drifted = -libm::expm1(-session_s / DRIFT_S);
        self.orientation.to_sensor(
            compressed + self.bias_g + self.per_kelvin_g * at.warm_k + self.drift_g * drifted,
        )
    }
}

/// Field noise of one element during one recording.
#[derive(Clone, Debug)]
pub struct HallNoise {
    kind: NoiseKind,
    white_g: f64,
    slow_g: Vector3<f64>,
    rng: ChaCha8Rng,
}

impl HallNoise {
    /// Noise at the start of a recording; correlated noise starts in its stationary distribution.
    pub fn begin(
        kind: NoiseKind,
        white_g: f64,
        seed: u64,
        (recording, sensor): (u32, u32),
    ) -> Self {
        let mut rng = stream(seed, Purpose::FieldNoise, (recording << 16) | sensor);
        let start = normal_vector(&mut rng);
        let slow_g = match kind {
            NoiseKind::Ar1 => start * AR1_G,
            NoiseKind::White | NoiseKind::Walk => Vector3::zeros(),
        };
        Self { kind, white_g, slow_g, rng }
    }

    /// Noise in gauss, `dt_s` after the previous sample.
    pub fn next(&mut self, dt_s: f64) -> Vector3<f64> {
        match self.kind {
            NoiseKind::White => {}
            NoiseKind::Ar1 => {
                let decay = libm::exp(-dt_s / AR1_S);
                let fresh = AR1_G * (1.0 - decay * decay).sqrt();
                self.slow_g = self.slow_g * decay + normal_vector(&mut self.rng) * fresh;
            }
            NoiseKind::Walk => self.slow_g += normal_vector(&mut self.rng) * (WALK_G * dt_s.sqrt()),
        }
        self.slow_g + normal_vector(&mut self.rng) * self.white_g
    }
}

/// Quantisation of a Hall sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HallScale {
    /// One count in gauss.
    pub gauss_per_lsb: f64,
    /// Range of each axis, both signs, in gauss.
    pub range_gauss: f64,
}

impl HallScale {
    /// The gripper's own sensor.
    pub fn a31301() -> Self {
        Self {
            gauss_per_lsb: constants::SENSOR_SCALE.value,
            range_gauss: constants::SENSOR_RANGE.value,
        }
    }

    /// Counts of a field, saturated at the range.
    pub fn counts(&self, field_g: Vector3<f64>) -> [i32; 3] {
        let scale = self.gauss_per_lsb;
        let max = self.range_gauss / scale;
        field_g.map(|gauss| (gauss / scale).round().clamp(-max, max) as i32).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::recordings::description::NominalDesign;

    fn element(effect: &str) -> HallElement {
        let specimen = SensorSpecimen::draw(&NominalDesign::magpie(), 0, 5, 0.0);
        let effects = Effects::new(&[effect.parse().unwrap()], 5, 1, 0.0).unwrap();
        HallElement::draw(&specimen, &effects, 5)
    }

    #[test]
    fn compression_reduces_the_reading_by_1_percent_at_1300_g() {
        let field_g = Vector3::new(0.0, 1300.0, 0.0);
        let read = element("sensor_compression").reading(field_g, &FieldConditions::default(), 0.0);
        assert!((read.y - 0.99 * 1300.0).abs() < 1e-9);
    }

    #[test]
    fn drifts_have_the_specified_norm() {
        let (zero, cool) = (Vector3::zeros(), FieldConditions::default());
        let ten_k = FieldConditions { warm_k: 10.0, ..cool };
        let warm = element("sensor_temperature=0.2").reading(zero, &ten_k, 0.0);
        let late = element("field_drift=0.7").reading(zero, &cool, 600.0);
        assert!((warm.norm() - 2.0).abs() < 1e-12);
        assert!((late.norm() - 0.7 * (1.0 - libm::exp(-1.0))).abs() < 1e-12);
    }

    #[test]
    fn ar1_noise_has_its_deviation_and_correlation_time() {
        let mut noise = HallNoise::begin(NoiseKind::Ar1, 0.0, 5, (1, 0));
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
    fn counts_are_eighths_of_a_gauss_and_saturate() {
        let field = Vector3::new(1.0, 2500.0, -0.07);
        assert_eq!(HallScale::a31301().counts(field), [8, 16_000, -1]);
    }

    #[test]
    fn displacement_outside_the_catalogue_moves_the_magnet() {
        let effects = Effects::new(&[], 5, 1, 0.0).unwrap();
        let specimen = SensorSpecimen::draw(&NominalDesign::magpie(), 0, 5, 1.0);
        let mut unit = SensorUnit::new(
            &NominalDesign::magpie(),
            0,
            (5, 1.0),
            SensorMounting::default(),
            &effects,
            [200.0; 2],
        );
        let moved = SensorSpecimen {
            offset_mm: [specimen.offset_mm[0] + 0.02, specimen.offset_mm[1] - 0.03],
            gap_mm: specimen.gap_mm + 0.01,
            ..specimen
        };
        let displacement_mm = Vector3::new(0.02, 0.01, -0.03);
        let uncatalogued = Contribution { displacement_mm, ..Contribution::default() };
        let conditions = FieldConditions::default();
        let displaced = unit.field(&FieldConditions { uncatalogued, ..conditions });
        let before = unit.field(&conditions);
        unit.finger = SensorFinger::new(&moved, &effects, [200.0; 2]);
        assert!((unit.field(&conditions) - displaced).amax() < 1e-9);
        assert!((displaced - before).amax() > 5.0);
    }

    #[test]
    fn rotation_and_gain_outside_the_catalogue_act_on_the_element() {
        let read = |uncatalogued| {
            let conditions = FieldConditions { uncatalogued, ..FieldConditions::default() };
            let element = element("sensor_compression=0");
            element.reading(Vector3::new(200.0, 1000.0, 0.0), &conditions, 0.0)
        };
        let rotation_rad = Vector3::new(0.01, 0.0, 0.0);
        let turned = read(Contribution { rotation_rad, ..Contribution::default() });
        // The element turns from y towards z, and the field in its axes from y towards -z.
        let (sin, cos) = libm::sincos(0.01);
        assert!((turned - Vector3::new(200.0, 1000.0 * cos, -1000.0 * sin)).amax() < 1e-9);
        let gain = Vector3::new(-0.03, 0.0, 0.0);
        let amplified = read(Contribution { gain, ..Contribution::default() });
        assert!((amplified - Vector3::new(194.0, 1000.0, 0.0)).amax() < 1e-9);
    }
}
