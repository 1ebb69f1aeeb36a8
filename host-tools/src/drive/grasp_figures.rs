//! What is asked of the grasp, beside what it reaches in simulation.

use std::f64::consts::TAU;

use firmware::force::{Estimate, Validity};
use firmware::frame::SENSORS;
use firmware::grip::contact::Contact;
use firmware::grip::foot::Feeling;
use firmware::grip::states::Task;
use firmware::limits::Grasp;
use firmware::params;
use firmware::units::Force;
use rand::RngExt;
use rayon::prelude::*;

use super::course::{Asked, Course, current_limited, grasp};
use super::figures::SCATTER;
use super::grasp::{Bench, NOISE_N, grip_command, object};
use super::landing::{Landed, Landing};
use super::runs::Case;
use crate::bench::draw::{Purpose, between, normal, stream};
use crate::plant::parameters::{Lead, Parameters};

/// Newtons to the millimetre of the hardest contact.
const RIGID: f64 = params::CONTACT_STIFFNESS.value;
/// Forces of the grasps, in N.
pub const FORCES_N: [f64; 6] = [10.0, 20.0, 50.0, 100.0, 200.0, 350.0];
/// How far before the object a grasp begins, in mm: at the speed of its approach long before.
const FROM_MM: f64 = 0.5;
/// Seconds for which a hold is looked at: an overshoot lies before.
const HOLD_S: f64 = 0.1;
/// Asked of a force: newtons beyond it, or this share.
const OVER: [f64; 2] = [2.0, 0.02];
/// The sweep of the force: mean and amplitude in N, and the time over which a sine is measured, in s.
const SINE_N: [f64; 2] = [100.0, 20.0];
const WINDOW_S: f64 = 1.0;
/// Frequencies in Hz.
const FREQUENCIES_HZ: [f64; 10] = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0];
/// Acceleration of a gripper that is swung about, in mm/s^2, at so many hertz, which its sensor tells a
/// millisecond late (assumed).
const SWING: (f64, f64) = (30_000.0, 3.0);

/// The share of values, sorted, at which one lies.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = (share * sorted.len() as f64).ceil() as usize;
    let place = place.clamp(1, sorted.len().max(1)) - 1;
    sorted.get(place).copied().unwrap_or(f64::NAN)
}

fn sorted(values: impl ParallelIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

/// What is asked of the overshoot of a force, in N.
pub fn most_over_n(set_n: f64) -> f64 {
    let [newtons, share] = OVER;
    newtons.max(share * set_n)
}

/// Grasps of one force by scattered grippers.
#[derive(Clone, Debug, PartialEq)]
pub struct Grasps {
    /// Newtons beyond the force that was asked for, sorted.
    pub over_n: Vec<f64>,
    /// Milliseconds from the contact to 95 % of it, sorted.
    pub rise_ms: Vec<f64>,
    /// Root mean square of the error at the end in newtons, sorted.
    pub error_n: Vec<f64>,
    /// How many held.
    pub held: usize,
}

/// Grips something rigid with a force, once for each seed; calls `done` after each.
pub fn grasps(
    lead: Lead,
    set_n: f64,
    seeds: std::ops::Range<u64>,
    done: impl Fn() + Sync,
) -> Grasps {
    let one = |seed: u64| -> Course {
        let parameters = Parameters::scattered(lead, SCATTER, seed);
        let asked = Asked {
            from_mm: FROM_MM,
            ..Asked::new(RIGID, set_n, HOLD_S)
        };
        let mut course = grasp(lead, parameters, asked, seed);
        done();
        // Its figures are enough.
        course.points.shrink_to_fit();
        course
    };
    let courses: Vec<[f64; 4]> = seeds
        .into_par_iter()
        .map(|seed| {
            let course = one(seed);
            let rise_ms = 1e3 * course.rise_s().unwrap_or(f64::INFINITY);
            let held = f64::from(u8::from(course.hold_s().is_some()));
            [course.peak_n() - set_n, rise_ms, course.error_n(), held]
        })
        .collect();
    let column = |index: usize| sorted(courses.par_iter().map(move |course| course[index]));
    Grasps {
        over_n: column(0),
        rise_ms: column(1),
        error_n: column(2),
        held: courses.iter().filter(|[.., held]| *held > 0.0).count(),
    }
}

/// The greatest force in N of a grasp at full speed with nothing but a bound of the current; the gripper of the
/// card.
pub fn by_current_n(lead: Lead, set_n: f64, seed: u64) -> f64 {
    let asked = Asked {
        from_mm: 15.0,
        ..Asked::new(RIGID, set_n, HOLD_S)
    };
    current_limited(lead, Parameters::nominal(lead), asked, seed).peak_n()
}

/// Gain of the force at each frequency, in Hz: a sine of orders about a force that is held.
pub fn sweep(case: &Case) -> Vec<[f64; 2]> {
    let tones = FREQUENCIES_HZ.into_par_iter();
    tones.map(|hz| [hz, tone(case, hz)]).collect()
}

fn tone(case: &Case, frequency_hz: f64) -> f64 {
    let [mean_n, amplitude_n] = SINE_N;
    let mut bench = Bench::new(case.lead, case.parameters, 41.0, case.seed);
    let thing = object(&case.parameters, 40.0, RIGID);
    bench.rig.plant.hold(Some(&thing));
    bench.order(grip_command(mean_n));
    bench.until(2.0, |bench| bench.grip.task() == Task::HoldActive);
    let start_s = bench.rig.plant.time_s();
    let (mut sums, settles_s) = ([0.0; 2], 2.0 / frequency_hz);
    loop {
        let time_s = bench.rig.plant.time_s() - start_s;
        if time_s >= settles_s + WINDOW_S {
            break;
        }
        let (sin, cos) = (TAU * frequency_hz * time_s).sin_cos();
        // Beyond 100 N only with the profile for tools.
        let mut command = grip_command(mean_n + 20.0);
        command.force = ((mean_n + amplitude_n * sin) * 10.0).round() as u16;
        bench.order(command);
        if time_s >= settles_s {
            let off_n = bench.rig.plant.grip_n() - mean_n;
            sums = [sums[0] + off_n * sin, sums[1] + off_n * cos];
        }
        bench.tick();
    }
    f64::hypot(sums[0], sums[1]) / (0.5 * amplitude_n * WINDOW_S * 1e3)
}

/// Where the gain falls below 0.707, between two frequencies on a line; none where it does not.
pub fn bandwidth_hz(sweep: &[[f64; 2]]) -> Option<f64> {
    let least = 0.5_f64.sqrt();
    sweep.windows(2).find_map(|pair| match pair {
        [[low_hz, above], [high_hz, below]] if *above >= least && *below < least => {
            Some(low_hz + (high_hz - low_hz) * (above - least) / (above - below))
        }
        _ => None,
    })
}

/// Milliseconds from the touch to the sample in which it is told, sorted: landings whose first fingertip loads
/// at `rates_n_s` or more, on either screw.
pub fn landings(rates_n_s: [f64; 2], seeds: std::ops::Range<u64>) -> Vec<f64> {
    let one = |seed: u64| {
        let mut rng = stream(seed, Purpose::Mischance, 0);
        let [least, most] = rates_n_s;
        let lasts_s = between(&mut rng, 2e-3, 50e-3);
        let mut landing = Landing {
            peak_n: 1.0,
            lasts_s,
            along_mm: between(&mut rng, -20.0, 20.0),
            phase: rng.random(),
        };
        landing.peak_n = between(&mut rng, least, most) / landing.rises_n_s();
        let lead = Lead::BOTH[(seed % 2) as usize];
        let landed: Landed = landing.run(&Case::scattered(lead, SCATTER, seed));
        1e3 * landed.contact_s().unwrap_or(f64::INFINITY)
    };
    sorted(seeds.into_par_iter().map(one))
}

/// Contacts that are believed in so many virtual hours without any, of the fingers and of the foot: the detectors
/// themselves, under the noise of `noise` times the forces' and the inertia of a gripper that is swung about.
pub fn false_contacts(hours: f64, noise: f64, seed: u64) -> usize {
    const MINUTE: usize = 60_000;
    let minutes = (60.0 * hours).ceil() as u32;
    let each = (0..minutes).into_par_iter().map(|minute| {
        let mut rng = stream(seed, Purpose::Mischance, minute);
        let (mut contact, mut feeling) = (Contact::default(), Feeling::default());
        let limits = Grasp::GRIPPER;
        let (mut false_ones, mut was) = (0, false);
        let (swings, hertz) = SWING;
        let mut told = 0.0;
        for tick in 0..MINUTE {
            let along = swings * (TAU * hertz * 1e-3 * tick as f64).sin();
            let own_n = 1e-3 * params::FINGERTIP_MASS.value * along;
            let mut estimates = [Estimate::MISSING; SENSORS];
            for estimate in &mut estimates {
                let newtons = [0.0, own_n].map(|force_n| {
                    let white_n = noise * NOISE_N / 2_f64.sqrt() * normal(&mut rng);
                    Force(((force_n + white_n) * Force::PER_NEWTON) as i32)
                });
                (estimate.force, estimate.validity) = (newtons, Validity::Valid);
            }
            let fingers = firmware::grip::fingers::Fingers::of(&estimates);
            contact.note(fingers.greatest_n().unwrap_or_default(), &limits);
            let acceleration = [0, 0, told as i32];
            let standing = feeling.note(&estimates, Some(acceleration), None, &limits);
            told = along;
            let is = contact.is_believed() || standing.contacts != 0;
            false_ones += usize::from(is && !was);
            was = is;
        }
        false_ones
    });
    each.sum()
}
