//! The whole gripper with everything that it remembers from one recording to the next.

use nalgebra::{Matrix3, Vector3};

use super::effects::Effects;
use super::element::Element;
use super::finger::Finger;
use super::foreign::ForeignMagnet;
use super::programme::Excitation;
use super::scatter::Made;
use super::stroke::{Backlash, LEAD_MM};
use super::surroundings::{Neighbour, currents, earth, in_body, leakage};
use super::uncatalogued::Uncatalogued;
use super::warmth::REFERENCE_C;
use super::{Settings, start_s};

/// Steps of the mechanics in one period of the board.
const SUBSTEPS: u32 = 4;

/// A gripper on the bench.
pub struct Gripper {
    /// Its sensors.
    pub sensors: Vec<Sensor>,
    /// The Earth's field in the world's axes, in gauss.
    pub earth_g: Vector3<f64>,
    /// The magnet that passes.
    pub foreign: ForeignMagnet,
    uncatalogued: Uncatalogued,
    /// Loss of remanence in each recording, in shares of the effect's size.
    pub losses: Vec<f64>,
    backlash: Backlash,
}

/// One sensor and what acts on it.
pub struct Sensor {
    /// As it was made.
    pub made: Made,
    /// Its finger, in time.
    pub finger: Finger,
    /// Its Hall element.
    pub element: Element,
    /// The opposite finger's magnet.
    pub neighbour: Neighbour,
    /// Motor's leakage in G/A.
    pub leakage: Matrix3<f64>,
    /// Change of remanence with temperature, in 1/K.
    per_kelvin: f64,
    /// Loss of remanence in the second recording.
    loss: f64,
}

/// One time of one recording.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Number of the recording.
    pub recording: u32,
    /// Seconds since its start.
    pub time_s: f64,
    /// Seconds since the moment before.
    pub since_s: f64,
}

impl Gripper {
    /// A new gripper, before its first recording.
    pub fn new(settings: &Settings, effects: &Effects, excitations: &[Excitation]) -> Self {
        let (seed, scatter) = (settings.seed, settings.scatter);
        let sensor = |number: u32| {
            let made = Made::draw(&settings.design, number, seed, scatter);
            let greatest = excitations.iter().fold([0.0_f64; 2], |[x, z], excitation| {
                let [other_x, other_z] = excitation.greatest_load(number as usize);
                [x.max(other_x), z.max(other_z)]
            });
            let neighbour_g = effects.each("neighbour_magnet", number);
            Sensor {
                finger: Finger::new(&made, effects, greatest),
                element: Element::draw(&made, effects, seed),
                neighbour: Neighbour::draw(&made, seed, scatter, neighbour_g),
                leakage: leakage(&made, effects, seed),
                per_kelvin: 0.01 * effects.size("magnet_temperature"),
                loss: 0.01 * effects.each("demagnetisation", number),
                made,
            }
        };
        Self {
            sensors: (0..settings.sensors).map(sensor).collect(),
            earth_g: earth(effects, seed),
            foreign: ForeignMagnet::draw(
                seed,
                effects.size("external_magnet"),
                settings.sensors,
                settings.recordings,
                settings.seconds,
            ),
            uncatalogued: Uncatalogued::draw(effects, seed),
            losses: losses(settings.recordings),
            backlash: Backlash::new(effects.size("screw_backlash")),
        }
    }

    /// Goes on to a moment; what each element reads there in gauss, noise apart.
    pub fn go_on(
        &mut self,
        settings: &Settings,
        excitation: &Excitation,
        moment: Moment,
    ) -> Vec<Vector3<f64>> {
        let drive = excitation.drive(moment.time_s);
        let standing = excitation.standing(moment.time_s);
        let opening_mm = self.backlash.follow(drive.opening_mm);
        let earth = in_body(self.earth_g, &standing);
        let currents = currents(&drive);
        let session_s = start_s(settings.seconds, moment.recording) + moment.time_s;
        let lost = self.losses[moment.recording as usize - 1];
        let (turns, foreign) = (drive.opening_mm / LEAD_MM, &self.foreign);
        let unknown = self.uncatalogued.field(&drive, session_s);
        let read = |sensor: &mut Sensor| {
            let number = sensor.made.number;
            sensor.load(excitation, moment);
            let warm_k = excitation.temperature_c(number as usize, moment.time_s) - REFERENCE_C;
            let field = sensor.own_field(warm_k, turns, lost)
                + sensor.neighbour.field(opening_mm)
                + sensor.leakage * currents
                + earth
                + unknown
                + foreign.field(moment.recording, number, moment.time_s);
            sensor.element.reading(field, warm_k, session_s)
        };
        self.sensors.iter_mut().map(read).collect()
    }

    /// A pause without load, in seconds.
    pub fn pause(&mut self, seconds: f64) {
        for sensor in &mut self.sensors {
            sensor.finger.pause(seconds);
        }
    }
}

impl Sensor {
    /// Moves the finger on to a moment, in several steps.
    fn load(&mut self, excitation: &Excitation, moment: Moment) {
        let step_s = moment.since_s / f64::from(SUBSTEPS);
        for left in (0..SUBSTEPS).rev() {
            let time_s = moment.time_s - f64::from(left) * step_s;
            let load = excitation.load(self.made.number as usize, time_s);
            let felt = match self.finger.has_mass() {
                true => excitation.specific_force(time_s),
                false => Vector3::zeros(),
            };
            self.finger.step(load, felt, step_s);
        }
    }

    /// Field of the finger's own magnet in gauss, gripper's axes.
    fn own_field(&self, warm_k: f64, turns: f64, lost: f64) -> Vector3<f64> {
        let remanence =
            self.made.remanence_t * (1.0 + self.per_kelvin * warm_k) * (1.0 - self.loss * lost);
        let pose = self.finger.magnet(warm_k, turns);
        pose.unit_field(&self.made.magnet) * remanence
    }
}

/// None in the first recording, all of it in the others.
fn losses(recordings: u32) -> Vec<f64> {
    (1..=recordings)
        .map(|recording| f64::from(u8::from(recording > 1)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::element::{NoiseKind, Part};
    use crate::bench::programme::Programme;
    use model_export::recordings::description::Design;

    fn gripper(wanted: &[&str]) -> Gripper {
        let settings = Settings {
            seed: 1,
            programme: Programme::Bench,
            recordings: 3,
            seconds: 5.0,
            design: Design::magpie(),
            part: Part::a31301(),
            sensors: 1,
            scatter: 0.0,
            noise: NoiseKind::White,
            harder: 1.0,
            warmer_k: 0.0,
            field_noise_g: 0.0,
            reference_noise_n: 0.0,
            effects: wanted.iter().map(|id| id.parse().unwrap()).collect(),
            hidden: false,
        };
        let effects = Effects::new(&settings.effects, 1, 1, 0.0).unwrap();
        Gripper::new(&settings, &effects, &[])
    }

    #[test]
    fn ten_kelvin_take_a_little_more_than_a_percent_of_the_magnet() {
        let gripper = gripper(&["magnet_temperature"]);
        let at = |warm_k| gripper.sensors[0].own_field(warm_k, 0.0, 0.0).y;
        assert!((at(10.0) / at(0.0) - 0.989).abs() < 1e-12);
    }

    #[test]
    fn the_magnet_loses_its_share_before_the_second_recording_and_no_more_later() {
        let gripper = gripper(&["demagnetisation=0.5"]);
        let at = |lost| gripper.sensors[0].own_field(0.0, 0.0, lost).y;
        assert!((at(gripper.losses[1]) / at(gripper.losses[0]) - 0.995).abs() < 1e-12);
        assert_eq!(gripper.losses[2], gripper.losses[1]);
    }
}
