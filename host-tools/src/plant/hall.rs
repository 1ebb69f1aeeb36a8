//! The fingertips: from forces to what the Hall sensors read. The same gripper that `magpie simulate` makes
//! of a seed and effects, pressed by the drive instead of a bench.

use anyhow::Result;
use firmware::frame::SENSORS;
use firmware::hall::Reading;
use firmware::params;
use model_export::recordings::description::Design;
use nalgebra::{Matrix3, Vector3};

use crate::bench::draw::{Purpose, normals, stream};
use crate::bench::effects::{Effect, Effects};
use crate::bench::element::{Element, NOISE_G, Part};
use crate::bench::finger::Finger;
use crate::bench::scatter::Made;
use crate::bench::stroke::{Drive, LEAD_MM};
use crate::bench::surroundings::{Neighbour, currents, leakage};
use crate::board::pressed::Forces;
use rand_chacha::ChaCha8Rng;

/// Forces at the sensors of a grip, met this share of half the sensors' distance from the middle towards the
/// first of each finger, and of a force from the ground. Two sensors carry a finger; fingers are pushed apart.
pub fn shared(grip_n: f64, towards_first: f64, ground_n: f64) -> Forces {
    let first_n = 0.5 * grip_n * (1.0 + towards_first);
    let second_n = grip_n - first_n;
    let ground_n = ground_n / SENSORS as f64;
    [first_n, second_n, -first_n, -second_n].map(|lateral_n| [lateral_n, ground_n])
}

/// One sensor in its finger.
struct Tip {
    made: Made,
    finger: Finger,
    element: Element,
    neighbour: Neighbour,
    leakage: Matrix3<f64>,
}

/// All of them.
pub struct Fingertips {
    tips: Vec<Tip>,
    rng: ChaCha8Rng,
}

impl Fingertips {
    /// A gripper of this seed, its parts scattered by this factor, with effects.
    ///
    /// # Errors
    /// One of the effects is not possible.
    pub fn new(seed: u64, scatter: f64, effects: &[Effect]) -> Result<Self> {
        let effects = Effects::new(effects, seed, SENSORS as u32, scatter)?;
        let design = Design::magpie();
        let greatest_n = [params::FORCE_RANGE.value; 2];
        let tip = |number: u32| {
            let made = Made::draw(&design, number, seed, scatter);
            let neighbour_g = effects.each("neighbour_magnet", number);
            Tip {
                finger: Finger::new(&made, &effects, greatest_n),
                element: Element::draw(&made, &effects, seed),
                neighbour: Neighbour::draw(&made, seed, scatter, neighbour_g),
                leakage: leakage(&made, &effects, seed),
                made,
            }
        };
        Ok(Self {
            tips: (0..SENSORS as u32).map(tip).collect(),
            rng: stream(seed, Purpose::Fingertips, 0),
        })
    }

    /// Goes on by `dt_s` under these forces and this specific force in m/s^2.
    pub fn press(&mut self, forces_n: &Forces, specific_force: Vector3<f64>, dt_s: f64) {
        for (tip, force_n) in self.tips.iter_mut().zip(forces_n) {
            tip.finger.step(*force_n, specific_force, dt_s);
        }
    }

    /// What the sensors read now, with opening, rotor and current of the drive.
    pub fn look(&mut self, drive: &Drive, time_s: f64) -> [Option<Reading>; SENSORS] {
        let mut readings = [None; SENSORS];
        let currents_a = currents(drive);
        for (place, tip) in readings.iter_mut().zip(&self.tips) {
            let pose = tip.finger.magnet(0.0, drive.opening_mm / LEAD_MM);
            let own_g = pose.unit_field(&tip.made.magnet) * tip.made.remanence_t;
            let outside_g = tip.neighbour.field(drive.opening_mm) + tip.leakage * currents_a;
            let seen_g = tip.element.reading(own_g + outside_g, 0.0, time_s);
            let noisy_g = seen_g + normals(&mut self.rng) * NOISE_G;
            *place = Some(Reading {
                // Within the range of the sensor's word.
                field: Part::a31301().counts(noisy_g).map(|count| count as i16),
                temperature: 0,
            });
        }
        readings
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::physics::ForwardModel;

    const OPEN: Drive = Drive {
        opening_mm: 40.0,
        angle_rad: 0.0,
        current_a: 0.0,
    };

    #[test]
    fn a_perfect_gripper_reads_the_forward_model_s_field() {
        let mut tips = Fingertips::new(1, 0.0, &[]).unwrap();
        let forces = shared(100.0, 0.2, 40.0);
        tips.press(&forces, Vector3::zeros(), 1e-3);
        let model = ForwardModel::nominal(&Design::magpie());
        let readings = tips.look(&OPEN, 0.0);
        for (reading, force_n) in readings.iter().zip(forces) {
            let field_g = model.field(force_n);
            for (axis, count) in reading.unwrap().field.iter().enumerate() {
                // Five standard deviations of the noise.
                let off_g = f64::from(*count) * params::SENSOR_SCALE.value - field_g[axis];
                assert!(
                    off_g.abs() < 5.0 * NOISE_G + 0.07,
                    "{force_n:?} {axis}: {off_g}"
                );
            }
        }
    }

    #[test]
    fn a_grip_is_shared_between_the_sensors_of_a_finger_and_pushes_the_fingers_apart() {
        assert_eq!(
            shared(100.0, 0.2, 40.0),
            [[60.0, 10.0], [40.0, 10.0], [-60.0, 10.0], [-40.0, 10.0]]
        );
    }

    #[test]
    fn a_motor_s_current_is_seen_where_it_leaks() {
        let effects = ["motor_leakage=20".parse().unwrap()];
        let mut tips = Fingertips::new(1, 0.0, &effects).unwrap();
        let mut mean = |current_a: f64| {
            let drive = Drive { current_a, ..OPEN };
            let looks = (0..100).map(|_| tips.look(&drive, 0.0)[0].unwrap().field);
            looks.fold([0.0; 3], |sum, field| {
                [0, 1, 2].map(|axis| sum[axis] + f64::from(field[axis]) * 0.125 / 100.0)
            })
        };
        let (without, with) = (mean(0.0), mean(10.0));
        let moved = (0..3).map(|axis| (with[axis] - without[axis]).abs());
        assert!(moved.fold(0.0, f64::max) > 2.0, "{with:?} {without:?}");
    }
}
