//! A foreign magnet that passes the gripper once.

use model_export::physics::{Body, Cylinder, Magnet, Magnetised};
use nalgebra::{Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::draw::{Purpose, between, direction, stream};
use super::finger::Pose;

/// A magnet of a tool or a holder, in mm.
const MAGNET: Magnet = Magnet {
    body: Body::Cylinder(Cylinder {
        diameter_mm: 10.0,
        length_mm: 10.0,
    }),
    magnetised: Magnetised::Axial,
};

/// Closest approach to the gripper's middle in mm, and duration of the pass in seconds.
const CLOSEST_MM: [f64; 2] = [80.0, 140.0];
const PASS_S: [f64; 2] = [1.0, 3.0];

/// Field is looked for and felt within so many durations of the closest approach.
const FAR: f64 = 6.0;

/// Where the Hall elements sit, in mm from the gripper's middle along x and z.
const SEAT_MM: [f64; 2] = [35.0, 20.0];

/// A straight path, once.
#[derive(Clone, Debug, Serialize)]
pub struct ForeignMagnet {
    /// Number of the recording in which it passes.
    recording: u32,
    /// Time of the closest approach in that recording, in seconds.
    closest_s: f64,
    /// Duration of the pass.
    pass_s: f64,
    /// Closest point, from the gripper's middle.
    closest_mm: [f64; 3],
    /// Velocity.
    velocity_mm_per_s: [f64; 3],
    /// Its remanence, so that the greatest field is as asked for; 0 if there is no such magnet.
    remanence_t: f64,
    #[serde(skip)]
    turn: Rotation3<f64>,
}

/// Seat of a sensor's Hall element in mm from the gripper's middle, body's axes: left and right,
/// then the next pair below.
fn seat(sensor: u32) -> Vector3<f64> {
    let side = if sensor.is_multiple_of(2) { -1.0 } else { 1.0 };
    let row = f64::from(sensor / 2);
    Vector3::new(side * SEAT_MM[0], 0.0, SEAT_MM[1] * (1.0 - 2.0 * row))
}

impl ForeignMagnet {
    /// Draws a path whose greatest field at any of the sensors is `greatest_g`.
    pub fn draw(seed: u64, greatest_g: f64, sensors: u32, recordings: u32, seconds: f64) -> Self {
        let mut rng = stream(seed, Purpose::ForeignMagnet, 0);
        let recording =
            1 + (between(&mut rng, 0.0, f64::from(recordings)) as u32).min(recordings - 1);
        let pass_s = between(&mut rng, PASS_S[0], PASS_S[1]);
        let distance_mm = between(&mut rng, CLOSEST_MM[0], CLOSEST_MM[1]);
        let closest_s = seconds * between(&mut rng, 0.25, 0.75);
        let at = (recording, closest_s);
        Self::passing(&mut rng, at, (distance_mm, pass_s), greatest_g, sensors)
    }

    /// A path drawn at random in recording `recording`, whose closest approach to the gripper's middle is
    /// at `closest_s`, so far away, within so many seconds; its greatest field at any of the sensors is
    /// `greatest_g`.
    pub fn passing(
        rng: &mut ChaCha8Rng,
        (recording, closest_s): (u32, f64),
        (distance_mm, pass_s): (f64, f64),
        greatest_g: f64,
        sensors: u32,
    ) -> Self {
        let closest = direction(rng);
        let along = closest.cross(&direction(rng)).normalize();
        let mut magnet = Self {
            recording,
            closest_s,
            pass_s,
            closest_mm: (closest * distance_mm).into(),
            // A dipole's field halves half a distance from its closest approach, roughly.
            velocity_mm_per_s: (along * distance_mm / pass_s).into(),
            remanence_t: 1.0,
            turn: Rotation3::rotation_between(&Vector3::z(), &direction(rng))
                .unwrap_or_else(Rotation3::identity),
        };
        magnet.remanence_t = greatest_g / magnet.greatest(sensors);
        magnet
    }

    /// From when to when its field at a sensor is above so many gauss, in seconds of its recording.
    pub fn above_s(&self, least_g: f64, sensors: u32) -> Option<[f64; 2]> {
        let [from_s, to_s] = self.felt_s();
        let steps = 2000;
        let times =
            (0..=steps).map(|step| from_s + (to_s - from_s) * f64::from(step) / f64::from(steps));
        let felt = |time_s: &f64| {
            let of = |sensor| self.field(self.recording, sensor, *time_s).norm();
            (0..sensors).any(|sensor| of(sensor) > least_g)
        };
        let mut times = times.filter(felt);
        let first = times.next()?;
        Some([first, times.next_back().unwrap_or(first)])
    }

    /// When its field can be felt, in seconds of its recording.
    pub fn felt_s(&self) -> [f64; 2] {
        [-FAR, FAR].map(|passes| self.closest_s + passes * self.pass_s)
    }

    /// Field at a sensor in gauss, body's axes.
    pub fn field(&self, recording: u32, sensor: u32, time_s: f64) -> Vector3<f64> {
        let since_s = time_s - self.closest_s;
        if recording != self.recording
            || self.remanence_t == 0.0
            || since_s.abs() > FAR * self.pass_s
        {
            return Vector3::zeros();
        }
        let at = Vector3::from(self.closest_mm) + since_s * Vector3::from(self.velocity_mm_per_s);
        let pose = Pose {
            centre_mm: at - seat(sensor),
            turn: self.turn,
        };
        pose.unit_field(&MAGNET) * self.remanence_t
    }

    fn greatest(&self, sensors: u32) -> f64 {
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

    #[test]
    fn a_foreign_magnet_passes_once_with_the_greatest_field_asked_for() {
        let magnet = ForeignMagnet::draw(3, 5.0, 4, 3, 30.0);
        let greatest = |recording: u32| {
            let fields = (0..30_000).flat_map(|ms| {
                let time_s = f64::from(ms) * 1e-3;
                (0..4).map(move |sensor| (sensor, time_s))
            });
            let norms = fields.map(|(sensor, t)| magnet.field(recording, sensor, t).norm());
            norms.fold(0.0, f64::max)
        };
        let mut peaks: Vec<f64> = (1..=3).map(greatest).collect();
        peaks.sort_by(f64::total_cmp);
        assert!(
            peaks[1] == 0.0 && (peaks[2] - 5.0).abs() < 0.01,
            "{peaks:?}"
        );
    }
}
