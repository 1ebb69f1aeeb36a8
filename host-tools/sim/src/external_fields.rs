//! Fields from outside the finger: opposite finger, motor, Earth, a passing magnet.

use crate::effects::Effects;
use crate::finger::{MagnetPose, SensorSpecimen};
use crate::motion::{MotionState, Orientation, POLE_PAIRS};
use crate::random::{Purpose, normal, stream, uniform, unit_vector};
use model_export::effects::catalogue::{EARTH_FIELD, MOTOR_LEAKAGE};
use model_export::physics::{Cylinder, Magnet, MagnetBody, Magnetisation};
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// Opening at which the neighbour's field is specified, in mm.
const NEIGHBOUR_OPENING_MM: f64 = 10.0;

/// Distance between the magnets of the closed gripper in mm, and their misalignment.
const CLOSED_MM: [f64; 2] = [9.0, 11.0];
const MISALIGNMENT_MM: f64 = 1.0;

/// Current for which the leakage is specified, in A.
const LEAKAGE_CURRENT_A: f64 = 10.0;

/// Inclination of the Earth's field (middle latitudes).
const INCLINATION_DEG: f64 = 60.0;

/// The magnet of the opposite finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeighbourMagnet {
    magnet: Magnet,
    rotation: Rotation3<f64>,
    remanence_t: f64,
    /// Sign of the direction to the opposite finger.
    side: f64,
    /// Its centre relative to the element with the gripper closed; x is a distance.
    pub closed_mm: Vector3<f64>,
}

impl NeighbourMagnet {
    /// Draws its position; `field_g` is its field at an opening of 10 mm.
    pub fn draw(specimen: &SensorSpecimen, seed: u64, scatter: f64, field_g: f64) -> Self {
        let mut rng = stream(seed, Purpose::Neighbour, specimen.number);
        let mut out = || scatter * MISALIGNMENT_MM * normal(&mut rng);
        let (y, z) = (specimen.gap_mm + specimen.reach_mm + out(), out());
        let mut neighbour = Self {
            magnet: specimen.magnet,
            rotation: specimen.upright,
            remanence_t: 1.0,
            side: if specimen.number.is_multiple_of(2) { 1.0 } else { -1.0 },
            closed_mm: Vector3::new(uniform(&mut rng, CLOSED_MM[0], CLOSED_MM[1]), y, z),
        };
        neighbour.remanence_t = field_g / neighbour.field(NEIGHBOUR_OPENING_MM).norm();
        neighbour
    }

    /// Field at the element, gripper axes, in gauss.
    pub fn field(&self, opening_mm: f64) -> Vector3<f64> {
        if self.remanence_t == 0.0 {
            return Vector3::zeros();
        }
        let distance = self.closed_mm + Vector3::new(opening_mm, 0.0, 0.0);
        let pose = MagnetPose {
            centre_mm: Vector3::new(self.side * distance.x, distance.y, distance.z),
            rotation: self.rotation,
        };
        pose.unit_field(&self.magnet) * self.remanence_t
    }
}

/// Leakage matrix in G/A: axes by alpha, beta and quadrature current.
pub fn motor_leakage(specimen: &SensorSpecimen, effects: &Effects, seed: u64) -> Matrix3<f64> {
    let mut rng = stream(seed, Purpose::Leakage, specimen.number);
    let raw = Matrix3::from_fn(|_, _| normal(&mut rng));
    raw * (effects.each(MOTOR_LEAKAGE.id, specimen.number) / (LEAKAGE_CURRENT_A * raw.norm()))
}

/// The motor's phase currents (alpha, beta) and its quadrature current, in A.
pub fn motor_currents(motion: &MotionState) -> Vector3<f64> {
    let (sin, cos) = libm::sincos(POLE_PAIRS * motion.angle_rad);
    Vector3::new(-motion.current_a * sin, motion.current_a * cos, motion.current_a)
}

/// Earth's field in world axes (z up), in gauss, with a random bearing.
pub fn earth_field(effects: &Effects, seed: u64) -> Vector3<f64> {
    let mut rng = stream(seed, Purpose::Earth, 0);
    let (sin, cos) = libm::sincos(uniform(&mut rng, 0.0, std::f64::consts::TAU));
    let (down, level) = libm::sincos(INCLINATION_DEG.to_radians());
    Vector3::new(level * cos, level * sin, -down) * effects.size(EARTH_FIELD.id)
}

/// Transforms a world vector to body axes.
pub fn in_body(world: Vector3<f64>, orientation: &Orientation) -> Vector3<f64> {
    orientation.to_world.inverse() * world
}

/// A magnet of a tool or a holder.
const MAGNET: Magnet = Magnet {
    body: MagnetBody::Cylinder(Cylinder { diameter_mm: 10.0, length_mm: 10.0 }),
    magnetised: Magnetisation::Axial,
};

/// Closest distance to the gripper's centre in mm, and duration of the passage in seconds.
const CLOSEST_MM: [f64; 2] = [80.0, 140.0];
const PASS_S: [f64; 2] = [1.0, 3.0];

/// The field is non-zero within this multiple of the duration around the closest approach.
const SUPPORT: f64 = 6.0;

/// Positions of the Hall elements, in mm from the gripper's centre along x and z.
const SENSOR_MM: [f64; 2] = [35.0, 20.0];

/// A magnet on a straight path.
#[derive(Clone, Debug, Serialize)]
pub struct PassingMagnet {
    /// Number of the recording in which it passes.
    recording: u32,
    /// Time of the closest approach in that recording, in seconds.
    closest_s: f64,
    /// Duration of the passage.
    pass_s: f64,
    /// Closest point to the gripper's centre.
    closest_mm: [f64; 3],
    /// Velocity.
    velocity_mm_per_s: [f64; 3],
    /// Remanence that gives the specified maximum field; 0 without the effect.
    remanence_t: f64,
    #[serde(skip)]
    rotation: Rotation3<f64>,
}

/// Position of a sensor's Hall element in mm from the gripper's centre, body axes: left and right,
/// then the next pair below.
fn sensor_position(sensor: u32) -> Vector3<f64> {
    let side = if sensor.is_multiple_of(2) { -1.0 } else { 1.0 };
    let row = f64::from(sensor / 2);
    Vector3::new(side * SENSOR_MM[0], 0.0, SENSOR_MM[1] * (1.0 - 2.0 * row))
}

impl PassingMagnet {
    /// Draws a passage with a maximum field of `max_g` at any sensor.
    pub fn draw(seed: u64, max_g: f64, sensors: u32, recordings: u32, seconds: f64) -> Self {
        let mut rng = stream(seed, Purpose::ExternalMagnet, 0);
        let recording =
            1 + (uniform(&mut rng, 0.0, f64::from(recordings)) as u32).min(recordings - 1);
        let pass_s = uniform(&mut rng, PASS_S[0], PASS_S[1]);
        let distance_mm = uniform(&mut rng, CLOSEST_MM[0], CLOSEST_MM[1]);
        let closest_s = seconds * uniform(&mut rng, 0.25, 0.75);
        let at = (recording, closest_s);
        Self::on_random_path(&mut rng, at, (distance_mm, pass_s), max_g, sensors)
    }

    /// Draws a path in a recording with its closest approach to the gripper's centre
    /// at `closest_s`, at this distance and duration, with a maximum field of `max_g` at any sensor.
    pub fn on_random_path(
        rng: &mut ChaCha8Rng,
        (recording, closest_s): (u32, f64),
        (distance_mm, pass_s): (f64, f64),
        max_g: f64,
        sensors: u32,
    ) -> Self {
        let closest = unit_vector(rng);
        let along = closest.cross(&unit_vector(rng)).normalize();
        let mut magnet = Self {
            recording,
            closest_s,
            pass_s,
            closest_mm: (closest * distance_mm).into(),
            // A dipole's field halves half a distance from its closest approach, roughly.
            velocity_mm_per_s: (along * distance_mm / pass_s).into(),
            remanence_t: 1.0,
            rotation: Rotation3::rotation_between(&Vector3::z(), &unit_vector(rng))
                .unwrap_or_else(Rotation3::identity),
        };
        magnet.remanence_t = max_g / magnet.max_field(sensors);
        magnet
    }

    /// Interval in which its field at a sensor exceeds `min_g`, in seconds of its recording.
    pub fn interval_above_s(&self, min_g: f64, sensors: u32) -> Option<[f64; 2]> {
        let [from_s, to_s] = self.support_s();
        let steps = 2000;
        let times =
            (0..=steps).map(|step| from_s + (to_s - from_s) * f64::from(step) / f64::from(steps));
        let exceeds = |time_s: &f64| {
            let of = |sensor| self.field(self.recording, sensor, *time_s).norm();
            (0..sensors).any(|sensor| of(sensor) > min_g)
        };
        let mut times = times.filter(exceeds);
        let first = times.next()?;
        Some([first, times.next_back().unwrap_or(first)])
    }

    /// Interval with a non-zero field, in seconds of its recording.
    pub fn support_s(&self) -> [f64; 2] {
        [-SUPPORT, SUPPORT].map(|passes| self.closest_s + passes * self.pass_s)
    }

    /// Field at a sensor in gauss, body axes.
    pub fn field(&self, recording: u32, sensor: u32, time_s: f64) -> Vector3<f64> {
        let since_s = time_s - self.closest_s;
        if recording != self.recording
            || self.remanence_t == 0.0
            || since_s.abs() > SUPPORT * self.pass_s
        {
            return Vector3::zeros();
        }
        let at = Vector3::from(self.closest_mm) + since_s * Vector3::from(self.velocity_mm_per_s);
        let pose = MagnetPose { centre_mm: at - sensor_position(sensor), rotation: self.rotation };
        pose.unit_field(&MAGNET) * self.remanence_t
    }

    fn max_field(&self, sensors: u32) -> f64 {
        let times =
            (-2000..=2000).map(|step| self.closest_s + f64::from(step) * 1e-3 * self.pass_s);
        let norms = times.flat_map(|time_s| {
            (0..sensors).map(move |sensor| self.field(self.recording, sensor, time_s).norm())
        });
        norms.fold(f64::MIN_POSITIVE, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::recordings::description::NominalDesign;
    use nalgebra::Rotation3;

    fn specimen() -> SensorSpecimen {
        SensorSpecimen::draw(&NominalDesign::magpie(), 1, 5, 1.0)
    }

    #[test]
    fn neighbour_field_decays_like_a_dipole() {
        let neighbour = NeighbourMagnet::draw(&specimen(), 5, 1.0, 2.0);
        assert!((neighbour.field(10.0).norm() - 2.0).abs() < 1e-9);
        let r = |opening: f64| (neighbour.closed_mm + Vector3::new(opening, 0.0, 0.0)).norm();
        let dipole = 2.0 * (r(10.0) / r(40.0)).powi(3);
        let found = neighbour.field(40.0).norm();
        assert!((found / dipole - 1.0).abs() < 0.1, "{found} {dipole}");
    }

    #[test]
    fn leakage_is_specified_at_ten_amperes() {
        let effects = Effects::new(&["motor_leakage=1".parse().unwrap()], 5, 2, 0.0).unwrap();
        assert!((motor_leakage(&specimen(), &effects, 5).norm() * 10.0 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn earth_field_is_fixed_to_the_world() {
        let effects = Effects::new(&["earth_field".parse().unwrap()], 5, 1, 0.0).unwrap();
        let world = earth_field(&effects, 5);
        let down = -0.48 * libm::sin(60.0_f64.to_radians());
        let on_its_side = Orientation {
            angles_rad: [0.0; 3],
            to_world: Rotation3::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.0),
            specific_force: Vector3::zeros(),
        };
        assert!((world.norm() - 0.48).abs() < 1e-12 && (world.z - down).abs() < 1e-12);
        // Rolled by a quarter rotation, the body's y points up.
        assert!((in_body(world, &on_its_side).y - down).abs() < 1e-12);
    }

    #[test]
    fn phase_currents_rotate_with_the_electrical_angle() {
        let at =
            |angle_rad| motor_currents(&MotionState { opening_mm: 0.0, angle_rad, current_a: 2.0 });
        let quarter = std::f64::consts::FRAC_PI_2 / 7.0;
        assert!((at(0.0) - Vector3::new(0.0, 2.0, 2.0)).norm() < 1e-12);
        assert!((at(quarter) - Vector3::new(-2.0, 0.0, 2.0)).norm() < 1e-12);
    }

    #[test]
    fn magnet_passes_once_with_the_specified_field() {
        let magnet = PassingMagnet::draw(3, 5.0, 4, 3, 30.0);
        let max_field = |recording: u32| {
            let fields = (0..30_000).flat_map(|ms| {
                let time_s = f64::from(ms) * 1e-3;
                (0..4).map(move |sensor| (sensor, time_s))
            });
            let norms = fields.map(|(sensor, t)| magnet.field(recording, sensor, t).norm());
            norms.fold(0.0, f64::max)
        };
        let mut peaks: Vec<f64> = (1..=3).map(max_field).collect();
        peaks.sort_by(f64::total_cmp);
        assert!(peaks[1] == 0.0 && (peaks[2] - 5.0).abs() < 0.01, "{peaks:?}");
    }
}
