//! Specified figures of drive and grasp, and their simulated values over scattered grippers.

use crate::closed_loop::frequency_response::{bandwidth_hz, frequency_response, step_response};
use crate::closed_loop::grasp_result::{GraspTarget, run_current_limited, run_grasp};
use crate::closed_loop::grasp_rig::{GraspRig, NOISE_N, contact_object, grip_command};
use crate::closed_loop::landing::{FootContact, Landing, LandingResult};
use crate::closed_loop::motor_rig::{
    DriveCase, POSITION_STEP_MM, run_at_speed, run_to_position, static_force_n,
};
use crate::drivetrain::parameters::{Lead, PlantParameters, SCATTER};
use crate::random::{Purpose, normal, stream, uniform};
use firmware::config::constants;
use firmware::config::limits::GripLimits;
use firmware::estimator::{Estimate, Validity};
use firmware::fixed_point::Force;
use firmware::grip::contact::ContactDetector;
use firmware::grip::ground_contact::GroundContactDetector;
use firmware::grip::states::TaskState;
use firmware::sensors::hall::SENSORS;
use rand::RngExt;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Specified bandwidth of the current loop in Hz, and its relative overshoot.
const BANDWIDTH_HZ: f64 = 1000.0;
const CURRENT_OVERSHOOT: f64 = 0.1;
/// Specified overshoot and error of a position step in mm; backlash adds to the error.
const OVERSHOOT_MM: f64 = 0.05;
const ERROR_MM: f64 = 0.02 + constants::BACKLASH.value;
/// Specified relative overshoot of a speed step.
const SPEED_OVERSHOOT: f64 = 0.1;
/// Speed step in mm/s that the current limit does not slow down.
const SLOW_STEP_MM_S: f64 = 10.0;
/// Specified braking distance in mm.
const BRAKE_MM: f64 = 0.5;
/// Specified relative tolerance of speed and force.
const TOLERANCE: f64 = 0.03;

/// A specified figure and its simulated value.
#[derive(Clone, Debug, PartialEq)]
pub struct Requirement {
    /// Name of the figure.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Specified minimum and maximum; infinite without a limit.
    pub specified: [f64; 2],
    /// Worst simulated value.
    pub reached: f64,
}

impl Requirement {
    /// Whether the value is within its specification.
    pub fn is_met(&self) -> bool {
        let [min, max] = self.specified;
        (min..=max).contains(&self.reached)
    }
}

/// Figures of a screw, the worst over one nominal gripper and one scattered gripper per seed.
pub fn evaluate(lead: Lead, seeds: std::ops::RangeInclusive<u64>) -> Vec<Requirement> {
    let nominal = DriveCase::nominal(lead, *seeds.start());
    let scattered: Vec<DriveCase> =
        seeds.map(|seed| DriveCase::scattered(lead, SCATTER, seed)).collect();
    let mut figures = nominal_figures(&nominal);
    let all: Vec<DriveCase> = std::iter::once(nominal).chain(scattered).collect();
    figures.extend(worst_figures(&all));
    figures
}

/// Figures that depend on the motor constants, of the nominal gripper.
fn nominal_figures(case: &DriveCase) -> Vec<Requirement> {
    let full_mm_s = case.lead.closing_mm_s();
    let run = run_at_speed(case, 70.0, full_mm_s, 0.2);
    let stated_mm_s = constants::CLOSING_SPEED.value;
    let rated_a = constants::RATED_TORQUE.value / constants::TORQUE_CONSTANT.value;
    let about = |value: f64| [value * (1.0 - TOLERANCE), value * (1.0 + TOLERANCE)];
    vec![
        Requirement {
            name: "closing speed",
            unit: "mm/s",
            specified: about(stated_mm_s),
            reached: run.mean_mm_s * stated_mm_s / full_mm_s,
        },
        Requirement {
            name: "force at rated current",
            unit: "N",
            specified: about(constants::GRASP_FORCE.value),
            reached: static_force_n(case, rated_a),
        },
        Requirement {
            name: "braking distance at full speed",
            unit: "mm",
            specified: [0.0, BRAKE_MM],
            reached: run.braking_mm,
        },
        Requirement {
            name: "bus voltage while braking",
            unit: "V",
            specified: [0.0, constants::BUS_VOLTAGE_MAX.value],
            reached: run.trace.max(|point| point.bus_v),
        },
    ]
}

/// Figures that are specified for all grippers, the worst of all cases.
fn worst_figures(cases: &[DriveCase]) -> Vec<Requirement> {
    let each: Vec<[f64; 8]> = cases.par_iter().map(case_figures).collect();
    let worst = |index: usize, min: bool| {
        let values = each.iter().map(|figures| figures[index]);
        if min {
            values.fold(f64::INFINITY, f64::min)
        } else {
            values.fold(f64::NEG_INFINITY, f64::max)
        }
    };
    let at_most = |name, unit, index, max| Requirement {
        name,
        unit,
        specified: [f64::NEG_INFINITY, max],
        reached: worst(index, false),
    };
    vec![
        Requirement {
            name: "current loop bandwidth",
            unit: "Hz",
            specified: [BANDWIDTH_HZ, f64::INFINITY],
            reached: worst(0, true),
        },
        at_most("current loop overshoot", "%", 1, 100.0 * CURRENT_OVERSHOOT),
        at_most("full speed step, overshoot", "%", 6, 100.0 * SPEED_OVERSHOOT),
        at_most("speed step of 10 mm/s, overshoot", "%", 7, 100.0 * SPEED_OVERSHOOT),
        at_most("position step of 10 mm, overshoot", "mm", 2, OVERSHOOT_MM),
        at_most("position step of 10 mm, final error with backlash", "mm", 3, ERROR_MM),
        at_most("bus voltage of a position step", "V", 4, constants::BUS_VOLTAGE_MAX.value),
        // Shorted windings brake with the square of the flux, so that a weak motor has no limit.
        at_most("braking distance, all grippers", "mm", 5, f64::INFINITY),
    ]
}

/// Bandwidth, overshoot in percent; overshoot and error of a position step, bus voltage; braking distance; overshoot
/// of both speed steps in percent.
fn case_figures(case: &DriveCase) -> [f64; 8] {
    let bandwidth = bandwidth_hz(&frequency_response(case)).unwrap_or(f64::NAN);
    let overshoot = 100.0 * step_response(case).overshoot();
    let [from_mm, to_mm] = POSITION_STEP_MM;
    let mut worst = [f64::NEG_INFINITY; 3];
    for (from_mm, to_mm) in [(from_mm, to_mm), (to_mm, from_mm)] {
        let trace = run_to_position(case, [from_mm, to_mm], case.lead.closing_mm_s());
        let towards = (to_mm - from_mm).signum();
        let beyond = trace.max(|point| towards * (point.opening_mm - to_mm));
        let off_mm = (trace.mean_of_last(0.05, |point| point.opening_mm) - to_mm).abs();
        let bus_v = trace.max(|point| point.bus_v);
        let found = [beyond, off_mm, bus_v];
        worst = [0, 1, 2].map(|index| f64::max(worst[index], found[index]));
    }
    let [beyond, off, bus] = worst;
    let full = run_at_speed(case, 70.0, case.lead.closing_mm_s(), 0.2);
    let slow = run_at_speed(case, 70.0, SLOW_STEP_MM_S, 0.2);
    let [over_full, over_slow] = [&full, &slow].map(|run| 100.0 * run.overshoot());
    [bandwidth, overshoot, beyond, off, bus, full.braking_mm, over_full, over_slow]
}

/// Stiffness of the hardest contact in N/mm.
const RIGID: f64 = constants::CONTACT_STIFFNESS.value;
/// Force set-points in N.
pub const FORCES_N: [f64; 6] = [10.0, 20.0, 50.0, 100.0, 200.0, 350.0];
/// Initial distance to the object in mm, long enough to reach the approach speed.
const FROM_MM: f64 = 0.5;
/// Observed duration of the hold in seconds; an overshoot precedes it.
const HOLD_S: f64 = 0.1;
/// Specification of a force: newtons beyond it, or this share.
const OVER: [f64; 2] = [2.0, 0.02];
/// Force sine: mean and amplitude in N, and measurement time in s.
const SINE_N: [f64; 2] = [100.0, 20.0];
const WINDOW_S: f64 = 1.0;
/// Frequencies in Hz.
const FREQUENCIES_HZ: [f64; 10] = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0];
/// Acceleration in mm/s^2 and frequency in Hz of a swinging gripper, measured with a delay of
/// 1 ms (assumed).
const SWING: (f64, f64) = (30_000.0, 3.0);

/// Quantile of sorted values.
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

/// Specified overshoot of a force set-point, in N.
pub fn max_overshoot_n(set_n: f64) -> f64 {
    let [newtons, share] = OVER;
    newtons.max(share * set_n)
}

/// Statistics of grasps with one force by scattered grippers.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspStatistics {
    /// Overshoot in newtons, sorted.
    pub over_n: Vec<f64>,
    /// Rise time to 95 % in milliseconds, sorted.
    pub rise_ms: Vec<f64>,
    /// Final RMS error in newtons, sorted.
    pub error_n: Vec<f64>,
    /// Number of grasps that reached hold.
    pub held: usize,
}

/// Grips a rigid object, once per seed; `done` is called after each.
pub fn grasp_statistics(
    lead: Lead,
    set_n: f64,
    seeds: std::ops::Range<u64>,
    done: impl Fn() + Sync,
) -> GraspStatistics {
    let target = GraspTarget { from_mm: FROM_MM, ..GraspTarget::new(RIGID, set_n, HOLD_S) };
    let traces: Vec<[f64; 4]> = seeds
        .into_par_iter()
        .map(|seed| {
            let parameters = PlantParameters::scattered(lead, SCATTER, seed);
            let trace = run_grasp(lead, parameters, target, seed);
            done();
            let rise_ms = 1e3 * trace.rise_s().unwrap_or(f64::INFINITY);
            let held = f64::from(u8::from(trace.hold_s().is_some()));
            [trace.peak_n() - set_n, rise_ms, trace.error_n(), held]
        })
        .collect();
    let column = |index: usize| sorted(traces.par_iter().map(move |trace| trace[index]));
    GraspStatistics {
        over_n: column(0),
        rise_ms: column(1),
        error_n: column(2),
        held: traces.iter().filter(|[.., held]| *held > 0.0).count(),
    }
}

/// Peak force in N of a nominal grasp at full speed with only a current limit.
pub fn current_limited_peak_n(lead: Lead, set_n: f64, seed: u64) -> f64 {
    let target = GraspTarget { from_mm: 15.0, ..GraspTarget::new(RIGID, set_n, HOLD_S) };
    run_current_limited(lead, PlantParameters::nominal(lead), target, seed).peak_n()
}

/// Gain of the force at each frequency in Hz, for a sinusoidal set-point around a held force.
pub fn force_frequency_response(case: &DriveCase) -> Vec<[f64; 2]> {
    let tones = FREQUENCIES_HZ.into_par_iter();
    tones.map(|hz| [hz, tone(case, hz)]).collect()
}

fn tone(case: &DriveCase, frequency_hz: f64) -> f64 {
    let [mean_n, amplitude_n] = SINE_N;
    let mut bench = GraspRig::new(case.lead, case.parameters, 41.0, case.seed);
    let object = contact_object(&case.parameters, 40.0, RIGID);
    bench.rig.plant.set_object(Some(&object));
    bench.order(grip_command(mean_n));
    bench.until(2.0, |bench| bench.grip.task() == TaskState::HoldActive);
    let start_s = bench.rig.plant.time_s();
    let (mut sums, settles_s) = ([0.0; 2], 2.0 / frequency_hz);
    loop {
        let time_s = bench.rig.plant.time_s() - start_s;
        if time_s >= settles_s + WINDOW_S {
            break;
        }
        let (sin, cos) = (TAU * frequency_hz * time_s).sin_cos();
        // Forces above 100 N need the tool profile.
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

/// -3 dB frequency by interpolation; none where the gain does not fall that far.
pub fn force_bandwidth_hz(sweep: &[[f64; 2]]) -> Option<f64> {
    let threshold = 0.5_f64.sqrt();
    sweep.windows(2).find_map(|pair| match pair {
        [[low_hz, above], [high_hz, below]] if *above >= threshold && *below < threshold => {
            Some(low_hz + (high_hz - low_hz) * (above - threshold) / (above - below))
        }
        _ => None,
    })
}

/// Contact detection latencies of landings in milliseconds, sorted, for an initial force rate of the first
/// fingertip within `rates_n_s`, on either screw.
pub fn contact_latencies_ms(rates_n_s: [f64; 2], seeds: std::ops::Range<u64>) -> Vec<f64> {
    let one = |seed: u64| {
        let mut rng = stream(seed, Purpose::FaultInjection, 0);
        let [min, max] = rates_n_s;
        let lasts_s = uniform(&mut rng, 2e-3, 50e-3);
        let mut landing = Landing {
            peak_n: 1.0,
            lasts_s,
            contact: FootContact::Flat,
            along_mm: uniform(&mut rng, -20.0, 20.0),
            across_mm: 0.0,
            phase: rng.random(),
        };
        landing.peak_n = uniform(&mut rng, min, max) / landing.rises_n_s();
        let lead = Lead::BOTH[(seed % 2) as usize];
        let landed: LandingResult = landing.run(&DriveCase::scattered(lead, SCATTER, seed));
        1e3 * landed.contact_s().unwrap_or(f64::INFINITY)
    };
    sorted(seeds.into_par_iter().map(one))
}

/// Number of false contacts of the fingers and of the foot in a number of contact-free hours: the detectors alone,
/// with `noise` times the force noise and the inertia of a swinging gripper.
pub fn count_false_contacts(hours: f64, noise: f64, seed: u64) -> usize {
    const MINUTE: usize = 60_000;
    let minutes = (60.0 * hours).ceil() as u32;
    let each = (0..minutes).into_par_iter().map(|minute| {
        let mut rng = stream(seed, Purpose::FaultInjection, minute);
        let (mut contact, mut feeling) =
            (ContactDetector::default(), GroundContactDetector::default());
        let limits = GripLimits::GRIPPER;
        let (mut false_ones, mut was) = (0, false);
        let (swings, hertz) = SWING;
        let mut delayed = 0.0;
        for tick in 0..MINUTE {
            let along = swings * (TAU * hertz * 1e-3 * tick as f64).sin();
            let own_n = 1e-3 * constants::FINGERTIP_MASS.value * along;
            let mut estimates = [Estimate::MISSING; SENSORS];
            for estimate in &mut estimates {
                let newtons = [0.0, own_n].map(|force_n| {
                    let white_n = noise * NOISE_N / 2_f64.sqrt() * normal(&mut rng);
                    Force(((force_n + white_n) * Force::PER_NEWTON) as i32)
                });
                (estimate.force, estimate.validity) = (newtons, Validity::Valid);
            }
            let fingers = firmware::grip::finger_force::FingerForces::of(&estimates);
            contact.update(fingers.max_n().unwrap_or_default(), &limits);
            let acceleration = [0, 0, delayed as i32];
            let standing = feeling.update(&estimates, Some(acceleration), None, &limits);
            delayed = along;
            let is = contact.is_confirmed() || standing.contacts != 0;
            false_ones += usize::from(is && !was);
            was = is;
        }
        false_ones
    });
    each.sum()
}
