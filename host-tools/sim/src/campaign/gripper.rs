//! The simulated gripper of a campaign, with the state that carries over between recordings.

use model_export::effects::REFERENCE_C;
use model_export::effects::catalogue::{EXTERNAL_MAGNET, SCREW_BACKLASH};
use nalgebra::Vector3;

use crate::campaign::excitation::Excitation;
use crate::campaign::settings::{CampaignSettings, start_s};
use crate::effects::Effects;
use crate::external_fields::{PassingMagnet, earth_field, in_body, motor_currents};
use crate::hall_sensor::{FieldConditions, SensorUnit};
use crate::motion::{Backlash, LEAD_MM};
use crate::uncatalogued::Covariates;

/// Integration steps of the mechanics per sample.
const SUBSTEPS: u32 = 4;

/// All sensors and the fields around them.
pub struct CampaignGripper {
    /// One per finger and place.
    pub sensors: Vec<SensorUnit>,
    /// Earth's field in world axes, in gauss.
    pub earth_g: Vector3<f64>,
    /// Magnet that passes once; without field where the effect is absent.
    pub foreign: PassingMagnet,
    /// Loss of remanence in each recording, as a share of the effect's magnitude.
    pub losses: Vec<f64>,
    backlash: Backlash,
}

/// A sample time within a recording.
#[derive(Clone, Copy, Debug)]
pub struct CampaignTime {
    /// Number of the recording, from 1.
    pub recording: u32,
    /// Seconds since its start.
    pub time_s: f64,
    /// Seconds since the previous sample.
    pub since_s: f64,
}

impl CampaignGripper {
    /// State before the first recording; `excitations` are those of all recordings.
    pub fn new(settings: &CampaignSettings, effects: &Effects, excitations: &[Excitation]) -> Self {
        let (seed, scatter) = (settings.seed, settings.scatter);
        let sensor = |number: u32| {
            let max_n = excitations.iter().fold([0.0_f64; 2], |[x, z], excitation| {
                let [other_x, other_z] = excitation.max_load(number as usize);
                [x.max(other_x), z.max(other_z)]
            });
            SensorUnit::new(
                &settings.design,
                number,
                (seed, scatter),
                settings.mountings.of(number),
                effects,
                max_n,
            )
        };
        Self {
            sensors: (0..settings.sensors).map(sensor).collect(),
            earth_g: earth_field(effects, seed),
            foreign: PassingMagnet::draw(
                seed,
                effects.size(EXTERNAL_MAGNET.id),
                settings.sensors,
                settings.recordings,
                settings.seconds,
            ),
            // None in the first recording, all of it in the others.
            losses: settings
                .numbers()
                .map(|recording| f64::from(u8::from(recording > 1)))
                .collect(),
            backlash: Backlash::new(effects.size(SCREW_BACKLASH.id)),
        }
    }

    /// Advances to a sample time; returns the noise-free readings of all sensors in gauss.
    pub fn advance(
        &mut self,
        settings: &CampaignSettings,
        excitation: &Excitation,
        time: CampaignTime,
    ) -> Vec<Vector3<f64>> {
        let motion = excitation.motion(time.time_s);
        let orientation = excitation.orientation(time.time_s);
        let earth = in_body(self.earth_g, &orientation);
        let conditions = FieldConditions {
            screw_turns: motion.opening_mm / LEAD_MM,
            opening_mm: self.backlash.follow(motion.opening_mm),
            currents_a: motor_currents(&motion),
            lost: self.losses[time.recording as usize - 1],
            ..FieldConditions::default()
        };
        let session_s = start_s(settings.seconds, time.recording) + time.time_s;
        let foreign = &self.foreign;
        let read = |sensor: &mut SensorUnit| {
            let number = sensor.specimen.number;
            let warm_k = excitation.temperature_c(number as usize, time.time_s) - REFERENCE_C;
            let uncatalogued = sensor.uncatalogued.advance(Covariates {
                recording: time.recording,
                session_s,
                load_n: excitation.load(number as usize, time.time_s),
                opening_mm: motion.opening_mm,
                current_a: motion.current_a,
                warm_k,
                specific_force: orientation.specific_force,
                roll_rad: orientation.angles_rad[0],
            });
            apply_load(sensor, excitation, time, uncatalogued.force_n);
            let conditions = FieldConditions { warm_k, uncatalogued, ..conditions };
            let field = sensor.field(&conditions)
                + earth
                + foreign.field(time.recording, number, time.time_s);
            sensor.element.reading(field, &conditions, session_s)
        };
        self.sensors.iter_mut().map(read).collect()
    }

    /// Pause without load, in seconds.
    pub fn pause(&mut self, seconds: f64) {
        for sensor in &mut self.sensors {
            sensor.finger.pause(seconds);
        }
    }
}

/// Integrates a finger up to a sample time. `added_n` acts on the flexures in addition to the load; it changes little
/// between two samples.
fn apply_load(
    sensor: &mut SensorUnit,
    excitation: &Excitation,
    time: CampaignTime,
    added_n: [f64; 2],
) {
    let step_s = time.since_s / f64::from(SUBSTEPS);
    for remaining in (0..SUBSTEPS).rev() {
        let time_s = time.time_s - f64::from(remaining) * step_s;
        let load = excitation.load(sensor.specimen.number as usize, time_s);
        let specific_force = if sensor.finger.has_mass() {
            excitation.specific_force(time_s)
        } else {
            Vector3::zeros()
        };
        let load = [load[0] + added_n[0], load[1] + added_n[1]];
        sensor.finger.step(load, specific_force, step_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hall_sensor::HallScale;
    use crate::hall_sensor::NoiseKind;
    use crate::motion::Programme;
    use crate::mountings::Mountings;
    use model_export::recordings::description::NominalDesign;

    fn settings(effects: &[&str]) -> CampaignSettings {
        CampaignSettings {
            seed: 1,
            programme: Programme::Bench,
            recordings: 3,
            seconds: 5.0,
            design: NominalDesign::magpie(),
            part: HallScale::a31301(),
            sensors: 1,
            mountings: Mountings::default(),
            scatter: 0.0,
            noise: NoiseKind::White,
            harder: 1.0,
            warmer_k: 0.0,
            field_noise_g: 0.0,
            reference_noise_n: 0.0,
            effects: effects.iter().map(|id| id.parse().unwrap()).collect(),
            hidden: false,
            plan: None,
        }
    }

    fn gripper(effects: &[&str]) -> CampaignGripper {
        let settings = settings(effects);
        let effects = Effects::new(&settings.effects, 1, 1, 0.0).unwrap();
        CampaignGripper::new(&settings, &effects, &[])
    }

    #[test]
    fn ten_kelvin_reduce_remanence_by_1_1_percent() {
        let gripper = gripper(&["magnet_temperature"]);
        let at = |warm_k| {
            let conditions = FieldConditions { warm_k, ..FieldConditions::default() };
            gripper.sensors[0].own_field(&conditions).y
        };
        assert!((at(10.0) / at(0.0) - 0.989).abs() < 1e-12);
    }

    #[test]
    fn demagnetisation_acts_once_before_the_second_recording() {
        let gripper = gripper(&["demagnetisation=0.5"]);
        let at = |lost| {
            let conditions = FieldConditions { lost, ..FieldConditions::default() };
            gripper.sensors[0].own_field(&conditions).y
        };
        assert!((at(gripper.losses[1]) / at(gripper.losses[0]) - 0.995).abs() < 1e-12);
        assert_eq!(gripper.losses[2], gripper.losses[1]);
    }

    /// Position of the magnet and reading after four seconds of the first recording, with the excitation at that time.
    fn after_four_seconds(effects: &[&str]) -> (Vector3<f64>, Vector3<f64>, Excitation) {
        let settings = settings(effects);
        let excitation = settings.excitation(1);
        let mut gripper = gripper(effects);
        let mut reading = Vector3::zeros();
        for step in 0..=4000 {
            let time = CampaignTime { recording: 1, time_s: 1e-3 * f64::from(step), since_s: 1e-3 };
            reading = gripper.advance(&settings, &excitation, time)[0];
        }
        let centre_mm = gripper.sensors[0].finger.magnet(0.0, 0.0).centre_mm;
        (centre_mm, reading, excitation)
    }

    #[test]
    fn force_outside_the_catalogue_deflects_its_flexure() {
        let (centre_mm, _, excitation) = after_four_seconds(&["overhang=5"]);
        let [fx_n, fz_n] = excitation.load(0, 4.0);
        let compliance = 1.0 + 0.05 * (excitation.motion(4.0).opening_mm - 25.0) / 20.0;
        assert!((centre_mm.x * 500.0 - fx_n).abs() < 1e-6, "{centre_mm}");
        assert!((centre_mm.z * 800.0 - fz_n * compliance).abs() < 1e-6, "{centre_mm}");
        assert!((compliance - 1.0).abs() > 0.005 && fz_n.abs() > 5.0, "{compliance} {fz_n}");
    }

    #[test]
    fn field_outside_the_catalogue_is_added_to_the_reading() {
        let (clean_mm, clean, excitation) = after_four_seconds(&[]);
        let (centre_mm, reading, _) = after_four_seconds(&["warm_leakage=6"]);
        let current_a = excitation.motion(4.0).current_a;
        let warm_k = excitation.temperature_c(0, 4.0) - REFERENCE_C;
        let expected_g = (6.0 * current_a / 10.0 * warm_k / 10.0).abs();
        assert!(((reading - clean).norm() - expected_g).abs() < 1e-9);
        assert!(centre_mm == clean_mm && expected_g > 0.01, "{expected_g}");
    }
}
