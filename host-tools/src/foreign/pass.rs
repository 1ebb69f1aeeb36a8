//! One recording through the device's code, twice: as it is, and with magnets that pass.

use firmware::compensate::{Compensation, Memory};
use firmware::force::{Estimate, estimate_all};
use firmware::foreign::Detector;
use firmware::frame::{Frame, SENSORS};
use firmware::hall::Reading;
use firmware::model::table::Tables;
use firmware::params;
use firmware::surroundings::Surroundings;
use host_tools::bench::draw::{Purpose, normal, stream};
use host_tools::bench::element::{Noise, counts};
use host_tools::bench::gripper::{Gripper as Mechanics, Moment};
use host_tools::bench::programme::Excitation;
use host_tools::bench::warmth::REFERENCE_C;
use model_export::gru::pack::{self, Running};
use model_export::inverse::compensation::OwnedCompensation;
use nalgebra::Vector3;

use super::gripper::Gripper;
use super::passage::{Passage, Passages};
use super::tally::Tally;

/// Length of a recording.
pub const SECONDS: f64 = 100.0;
/// Noise of a temperature in K, as the bench's recorder has it.
const TEMPERATURE_K: f64 = 0.05;
/// Frames of a second.
const RATE: u32 = params::SENSE_RATE.value as u32;
/// A gripper stands so long before its first frame.
const SETTLING_S: f64 = 1.0;

/// The device with all that it remembers.
struct Board<'a> {
    tables: &'a Tables<'a>,
    memories: [Memory; SENSORS],
    running: Vec<Box<dyn Running + 'a>>,
    detector: Detector,
}

impl Board<'_> {
    fn frame(&mut self, readings: [Option<Reading>; SENSORS]) -> [Estimate; SENSORS] {
        let frame = Frame {
            time_us: 0,
            readings,
        };
        let around = Surroundings::default();
        let ideal = estimate_all(self.tables, &frame, &around, &mut self.memories);
        let mut told = ideal;
        pack::apply(&mut self.running, &mut told);
        self.detector.watch(&ideal, &mut told);
        told
    }

    /// Parity and common mode as squares, sigma and split in newtons.
    fn measures(&self) -> [f64; 4] {
        let measures = self.detector.measures;
        let square = |square: i32| f64::from(square) / f64::from(1_u32 << 16);
        [
            square(measures.parity),
            square(measures.common),
            measures.sigma.newtons(),
            measures.split.newtons(),
        ]
    }
}

/// Runs one fresh recording.
pub fn run(gripper: &Gripper, number: u32) -> Tally {
    let (settings, recording) = (&gripper.settings, Gripper::fresh(number));
    let excitation = Excitation::draw(settings.programme, settings.seed, recording, 4, SECONDS);
    let excitations = [excitation];
    let [excitation] = &excitations;
    let mut mechanics = Mechanics::new(settings, &gripper.effects, &excitations);
    let mut noises: [Noise; SENSORS] = std::array::from_fn(|sensor| {
        let place = (recording, sensor as u32);
        Noise::begin(settings.noise, settings.field_noise_g, settings.seed, place)
    });
    let mut rng = stream(settings.seed, Purpose::Covariates, recording);
    let owned = &gripper.built.compensations;
    let compensations: Vec<Compensation> = owned.iter().map(OwnedCompensation::view).collect();
    let tables = gripper.built.chosen.tables.tables(&compensations);
    let board = || Board {
        tables: &tables,
        memories: [Memory::default(); SENSORS],
        running: gripper.networks.as_ref().map_or_else(Vec::new, |networks| {
            networks.packed.iter().map(|packed| packed.run()).collect()
        }),
        detector: Detector::default(),
    };
    let (mut clean, mut passed) = (board(), board());
    let mut passages = Passages::new(settings.seed, recording);
    let mut passage: Option<Passage> = None;
    let mut tally = Tally::default();
    let mut was_up = false;
    for frame in 0..(SECONDS * f64::from(RATE)) as u32 {
        let time_s = f64::from(frame) / f64::from(RATE);
        let since_s = if frame == 0 {
            SETTLING_S
        } else {
            1.0 / f64::from(RATE)
        };
        let moment = Moment {
            recording,
            time_s,
            since_s,
        };
        let fields = mechanics.go_on(settings, excitation, moment);
        let noise: [Vector3<f64>; SENSORS] =
            std::array::from_fn(|sensor| noises[sensor].next(since_s));
        let temperature: [i16; SENSORS] = std::array::from_fn(|sensor| {
            let warm_k = excitation.temperature_c(sensor, time_s) - REFERENCE_C;
            let seen_k = warm_k + TEMPERATURE_K * normal(&mut rng);
            (seen_k * params::TEMPERATURE_SCALE.value).round() as i16
        });
        let read = |foreign: &dyn Fn(usize) -> Vector3<f64>| -> [Option<Reading>; SENSORS] {
            std::array::from_fn(|sensor| {
                let seen = counts(fields[sensor] + noise[sensor] + foreign(sensor));
                Some(Reading {
                    field: seen.map(|count| count as i16),
                    temperature: temperature[sensor],
                })
            })
        };
        let own = clean.frame(read(&|_| Vector3::zeros()));
        let up = clean.detector.flag();
        tally.frame(frame, clean.measures(), up && !was_up);
        was_up = up;
        if passages.at(time_s, passed.detector.flag()) {
            tally.passages.extend(passage.take());
            passage = Some(Passage::default());
        } else if passages.magnet.is_none() {
            tally.passages.extend(passage.take());
        }
        let magnet = passages.magnet.as_ref();
        let elements = &mechanics.sensors;
        let other = passed.frame(read(&|sensor| match magnet {
            None => Vector3::zeros(),
            Some(magnet) => {
                elements[sensor]
                    .element
                    .turned(magnet.field(recording, sensor as u32, time_s))
            }
        }));
        if let Some(passage) = &mut passage {
            let forces = own.iter().zip(&other);
            let off_n = forces.flat_map(|(own, other)| {
                [0, 1].map(|axis| (other.force[axis].newtons() - own.force[axis].newtons()).abs())
            });
            let off_n = off_n.fold(0.0, f64::max);
            passage.note(frame, off_n, passed.detector.flag(), passed.measures());
        }
    }
    tally.passages.extend(passage);
    tally.seconds = SECONDS;
    tally
}
