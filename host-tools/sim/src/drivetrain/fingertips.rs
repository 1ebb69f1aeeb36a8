//! The fingertips: from contact forces to Hall counts, for the same simulated gripper as in `magpie simulate`.

use std::f64::consts::PI;

use anyhow::Result;
use device_run::channel_map::temperature_counts;
use firmware::config::constants;
use firmware::sensors::hall::{HallReading, SENSORS};
use model_export::effects::REFERENCE_C;
use model_export::recordings::description::NominalDesign;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use crate::effects::{Effect, Effects};
use crate::external_fields::motor_currents;
use crate::hall_sensor::{FieldConditions, HallScale, NOISE_G, SensorUnit};
use crate::motion::{LEAD_MM, MotionState};
use crate::mountings::Mountings;
use crate::random::{Purpose, normal_vector, stream};
use crate::uncatalogued::Covariates;

/// Mass that lands with the gripper on the ground, in kg (assumed).
pub const FOOT_KG: f64 = 2.0;

/// Lateral and longitudinal force at each sensor, in newtons.
pub type SensorForces = [[f64; 2]; SENSORS];

/// Distributes grip and ground force to the sensors. Two sensors carry a finger; the object touches at
/// `towards_first` times half their distance, towards the first of each finger. The grip pushes the fingers apart.
pub fn distribute_forces(grip_n: f64, towards_first: f64, ground_n: f64) -> SensorForces {
    let first_n = 0.5 * grip_n * (1.0 + towards_first);
    let second_n = grip_n - first_n;
    let ground_n = ground_n / SENSORS as f64;
    [first_n, second_n, -first_n, -second_n].map(|lateral_n| [lateral_n, ground_n])
}

/// Temperatures, ambient field and roll of the fingertips at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmbientConditions {
    /// Temperature of each sensor in degrees Celsius.
    pub temperature_c: [f64; SENSORS],
    /// Field of sources outside the gripper in gauss, gripper axes, the same at all sensors.
    pub field_g: Vector3<f64>,
    /// Roll of the gripper in rad.
    pub roll_rad: f64,
}

impl Default for AmbientConditions {
    /// The reference temperature, without a field, upright.
    fn default() -> Self {
        Self { temperature_c: [REFERENCE_C; SENSORS], field_g: Vector3::zeros(), roll_rad: 0.0 }
    }
}

/// All sensors of the gripper, with measurement noise.
#[derive(Clone)]
pub struct Fingertips {
    sensors: Vec<SensorUnit>,
    /// Loads and specific force of the last step.
    loads_n: SensorForces,
    specific_force: Vector3<f64>,
    /// Forces of effects outside the catalogue, from the last sample.
    added_n: SensorForces,
    rng: ChaCha8Rng,
}

impl Fingertips {
    /// Draws a gripper; `scatter` scales its manufacturing tolerances.
    ///
    /// # Errors
    /// An effect is given twice.
    pub fn new(seed: u64, scatter: f64, effects: &[Effect]) -> Result<Self> {
        let effects = Effects::new(effects, seed, SENSORS as u32, scatter)?;
        let max_n = |_| [constants::FORCE_RANGE.value; 2];
        Ok(Self::with_effects(seed, scatter, &Mountings::default(), &effects, max_n))
    }

    /// Draws a gripper with the mountings and the effects of its sensors; `max_n` are the largest loads of each axis of a sensor, at which a
    /// stop engages.
    pub fn with_effects(
        seed: u64,
        scatter: f64,
        mountings: &Mountings,
        effects: &Effects,
        max_n: impl Fn(u32) -> [f64; 2],
    ) -> Self {
        let design = NominalDesign::magpie();
        let sensor = |number| {
            let mounting = mountings.of(number);
            SensorUnit::new(&design, number, (seed, scatter), mounting, effects, max_n(number))
        };
        Self {
            sensors: (0..SENSORS as u32).map(sensor).collect(),
            loads_n: SensorForces::default(),
            specific_force: Vector3::zeros(),
            added_n: SensorForces::default(),
            rng: stream(seed, Purpose::Fingertips, 0),
        }
    }

    /// Pause without load, in seconds.
    pub fn pause(&mut self, seconds: f64) {
        for sensor in &mut self.sensors {
            sensor.finger.pause(seconds);
        }
    }

    /// Advances the flexures by `dt_s` under these forces and this specific force in m/s^2.
    pub fn step(&mut self, forces_n: &SensorForces, specific_force: Vector3<f64>, dt_s: f64) {
        (self.loads_n, self.specific_force) = (*forces_n, specific_force);
        for ((sensor, load_n), added_n) in self.sensors.iter_mut().zip(forces_n).zip(self.added_n) {
            let force_n = [load_n[0] + added_n[0], load_n[1] + added_n[1]];
            sensor.finger.step(force_n, specific_force, dt_s);
        }
    }

    /// Samples all sensors; opening, rotor and current contribute their fields.
    pub fn sample(
        &mut self,
        motion: &MotionState,
        ambient: &AmbientConditions,
        time_s: f64,
    ) -> [Option<HallReading>; SENSORS] {
        let mut readings = [None; SENSORS];
        let conditions = FieldConditions {
            screw_turns: motion.opening_mm / LEAD_MM,
            opening_mm: motion.opening_mm,
            currents_a: motor_currents(motion),
            ..FieldConditions::default()
        };
        let states = self.loads_n.into_iter().zip(&mut self.added_n).zip(ambient.temperature_c);
        for ((reading, sensor), ((load_n, added_n), temperature_c)) in
            readings.iter_mut().zip(&mut self.sensors).zip(states)
        {
            let warm_k = temperature_c - REFERENCE_C;
            let uncatalogued = sensor.uncatalogued.advance(Covariates {
                recording: 1,
                session_s: time_s,
                load_n,
                opening_mm: motion.opening_mm,
                current_a: motion.current_a,
                warm_k,
                specific_force: self.specific_force,
                roll_rad: ambient.roll_rad,
            });
            *added_n = uncatalogued.force_n;
            let conditions = FieldConditions { warm_k, uncatalogued, ..conditions };
            let field_g = sensor.field(&conditions) + ambient.field_g;
            let measured_g = sensor.element.reading(field_g, &conditions, time_s);
            let noisy_g = measured_g + normal_vector(&mut self.rng) * NOISE_G;
            *reading = Some(HallReading {
                // The range fits into the sensor's word.
                field: HallScale::a31301().counts(noisy_g).map(|count| count as i16),
                temperature: temperature_counts(warm_k),
            });
        }
        readings
    }
}

/// A landing: ground force as a half sine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Touchdown on the plant's clock, in s.
    pub start_s: f64,
    /// Duration of the contact in s, commonly 2 to 50 ms.
    pub lasts_s: f64,
    /// Peak force in N.
    pub peak_n: f64,
}

impl Impact {
    /// Force at a time, in N.
    pub fn force_n(&self, time_s: f64) -> f64 {
        let share = (time_s - self.start_s) / self.lasts_s;
        if (0.0..1.0).contains(&share) { self.peak_n * libm::sin(PI * share) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::physics::ForwardModel;

    const OPEN: MotionState = MotionState { opening_mm: 40.0, angle_rad: 0.0, current_a: 0.0 };

    #[test]
    fn nominal_fingertips_read_the_field_of_the_forward_model() {
        let mut tips = Fingertips::new(1, 0.0, &[]).unwrap();
        let forces = distribute_forces(100.0, 0.2, 40.0);
        tips.step(&forces, Vector3::zeros(), 1e-3);
        let model = ForwardModel::nominal(&NominalDesign::magpie());
        let readings = tips.sample(&OPEN, &AmbientConditions::default(), 0.0);
        for (reading, force_n) in readings.iter().zip(forces) {
            let field_g = model.field(force_n);
            for (axis, count) in reading.unwrap().field.iter().enumerate() {
                // Five standard deviations of the noise.
                let off_g = f64::from(*count) * constants::SENSOR_SCALE.value - field_g[axis];
                assert!(off_g.abs() < 5.0 * NOISE_G + 0.07, "{force_n:?} {axis}: {off_g}");
            }
        }
    }

    #[test]
    fn grip_force_is_distributed_and_pushes_the_fingers_apart() {
        assert_eq!(
            distribute_forces(100.0, 0.2, 40.0),
            [[60.0, 10.0], [40.0, 10.0], [-60.0, 10.0], [-40.0, 10.0]]
        );
    }

    #[test]
    fn motor_leakage_shifts_the_readings_with_the_current() {
        let effects = ["motor_leakage=20".parse().unwrap()];
        let mut tips = Fingertips::new(1, 0.0, &effects).unwrap();
        let mut mean = |current_a: f64| {
            let motion = MotionState { current_a, ..OPEN };
            let ambient = AmbientConditions::default();
            let samples = (0..100).map(|_| tips.sample(&motion, &ambient, 0.0)[0].unwrap().field);
            samples.fold([0.0; 3], |sum, field| {
                [0, 1, 2].map(|axis| sum[axis] + f64::from(field[axis]) * 0.125 / 100.0)
            })
        };
        let (without, with) = (mean(0.0), mean(10.0));
        let shift = (0..3).map(|axis| (with[axis] - without[axis]).abs());
        assert!(shift.fold(0.0, f64::max) > 2.0, "{with:?} {without:?}");
    }

    #[test]
    fn effects_outside_the_catalogue_act_on_the_board_s_gripper() {
        let mean = |effects: &[&str], opening_mm: f64| {
            let effects: Vec<Effect> = effects.iter().map(|one| one.parse().unwrap()).collect();
            let mut tips = Fingertips::new(1, 0.0, &effects).unwrap();
            let motion = MotionState { opening_mm, ..OPEN };
            let samples = (0..400).map(|tick| {
                let time_s = 1e-3 * f64::from(tick);
                tips.sample(&motion, &AmbientConditions::default(), time_s)[0].unwrap().field
            });
            samples.fold([0.0; 3], |sum, field| {
                [0, 1, 2].map(|axis| sum[axis] + f64::from(field[axis]) * 0.125 / 400.0)
            })
        };
        // A ripple of 40 um over the opening, at openings a fraction of its period apart.
        let openings = [10.0, 11.0, 12.0, 13.0];
        let moved = openings.map(|mm| {
            let (with, without) = (mean(&["guide_ripple=40"], mm), mean(&[], mm));
            (0..3).map(|axis| (with[axis] - without[axis]).abs()).fold(0.0, f64::max)
        });
        assert!(moved.into_iter().fold(0.0, f64::max) > 1.0, "{moved:?}");
    }

    #[test]
    fn impact_force_is_a_half_sine() {
        let impact = Impact { start_s: 1.0, lasts_s: 0.004, peak_n: 300.0 };
        assert!((impact.force_n(1.002) - 300.0).abs() < 1e-9);
        // sin(pi/4).
        assert!((impact.force_n(1.001) - 212.132).abs() < 1e-3);
        assert_eq!((impact.force_n(0.999), impact.force_n(1.0041)), (0.0, 0.0));
    }
}
