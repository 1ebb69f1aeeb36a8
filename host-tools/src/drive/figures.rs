//! What is asked of the drive, beside what it reaches in simulation.

use firmware::params;
use rayon::prelude::*;

use super::response::{bandwidth_hz, step, sweep};
use super::runs::{Case, at_speed, squeeze_n, to_place};
use crate::plant::parameters::Lead;
use crate::show;

/// Everything uncertain is off by up to this share.
pub const SCATTER: f64 = 0.2;
/// A step of the place, in mm.
pub const STEP_MM: [f64; 2] = [40.0, 30.0];
/// Asked: bandwidth in Hz, and overshoot as a share.
const BANDWIDTH_HZ: f64 = 1000.0;
const CURRENT_OVERSHOOT: f64 = 0.1;
/// Asked of a step of the place: beyond it, and off it, the play on top, in mm.
const OVERSHOOT_MM: f64 = 0.05;
const ERROR_MM: f64 = 0.02 + params::PLAY.value;
/// Asked of the brake, in mm.
const BRAKE_MM: f64 = 0.5;
/// Asked of speed and force, as a share.
const WITHIN: f64 = 0.03;

/// One figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What it is.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Least that is asked, and most.
    pub asked: [f64; 2],
    /// The worst that was reached.
    pub reached: f64,
}

impl Figure {
    /// Whether it is what is asked.
    pub fn is_met(&self) -> bool {
        let [least, most] = self.asked;
        (least..=most).contains(&self.reached)
    }

    /// What is asked, in words.
    fn asked_words(&self) -> String {
        let [least, most] = self.asked.map(|value| show::plain(value, 2));
        match self.asked.map(f64::is_finite) {
            [true, true] if self.asked[0] > 0.0 => format!("{least} to {most}"),
            [true, false] => format!("at least {least}"),
            [false, false] => "-".to_owned(),
            _ => format!("at most {most}"),
        }
    }
}

/// All figures of a screw, the worst over these seeds: the first is nominal, the others are scattered.
pub fn of(lead: Lead, seeds: std::ops::RangeInclusive<u64>) -> Vec<Figure> {
    let nominal = Case::nominal(lead, *seeds.start());
    let scattered: Vec<Case> = seeds
        .map(|seed| Case::scattered(lead, SCATTER, seed))
        .collect();
    let mut figures = alone(&nominal);
    let all: Vec<Case> = std::iter::once(nominal).chain(scattered).collect();
    figures.extend(loops(&all));
    figures
}

/// What rests on the motor's constants: nominal.
fn alone(case: &Case) -> Vec<Figure> {
    let full_mm_s = case.lead.closing_mm_s();
    let run = at_speed(case, 70.0, full_mm_s, 0.2);
    let stated_mm_s = params::CLOSING_SPEED.value;
    let rated_a = params::RATED_TORQUE.value / params::TORQUE_CONSTANT.value;
    let about = |value: f64| [value * (1.0 - WITHIN), value * (1.0 + WITHIN)];
    vec![
        Figure {
            name: "closing speed",
            unit: "mm/s",
            asked: about(stated_mm_s),
            reached: run.mean_mm_s * stated_mm_s / full_mm_s,
        },
        Figure {
            name: "force at rated current",
            unit: "N",
            asked: about(params::GRASP_FORCE.value),
            reached: squeeze_n(case, rated_a),
        },
        Figure {
            name: "full speed to rest by the brake",
            unit: "mm",
            asked: [0.0, BRAKE_MM],
            reached: run.way_mm,
        },
        Figure {
            name: "bus voltage meanwhile",
            unit: "V",
            asked: [0.0, params::BUS_GREATEST.value],
            reached: run.trace.most(|point| point.bus_v),
        },
    ]
}

/// What must hold whatever the constants are: the worst of all cases.
fn loops(cases: &[Case]) -> Vec<Figure> {
    let each: Vec<[f64; 6]> = cases.par_iter().map(one).collect();
    let worst = |index: usize, least: bool| {
        let values = each.iter().map(|one| one[index]);
        match least {
            true => values.fold(f64::INFINITY, f64::min),
            false => values.fold(f64::NEG_INFINITY, f64::max),
        }
    };
    let most = |name, unit, index, asked| Figure {
        name,
        unit,
        asked: [f64::NEG_INFINITY, asked],
        reached: worst(index, false),
    };
    vec![
        Figure {
            name: "current loop, bandwidth",
            unit: "Hz",
            asked: [BANDWIDTH_HZ, f64::INFINITY],
            reached: worst(0, true),
        },
        most("current loop, overshoot", "%", 1, 100.0 * CURRENT_OVERSHOOT),
        most("step of 10 mm, overshoot", "mm", 2, OVERSHOOT_MM),
        most(
            "step of 10 mm, error after it, play counted",
            "mm",
            3,
            ERROR_MM,
        ),
        most("bus voltage of a step", "V", 4, params::BUS_GREATEST.value),
        // Shorted windings brake by the square of the flux: nothing is asked of a weak motor.
        most("to rest by the brake, the worst", "mm", 5, f64::INFINITY),
    ]
}

/// Bandwidth, overshoot in percent; overshoot and error of a step of the place, the bus; the brake.
fn one(case: &Case) -> [f64; 6] {
    let bandwidth = bandwidth_hz(&sweep(case)).unwrap_or(f64::NAN);
    let overshoot = 100.0 * step(case).overshoot();
    let [from_mm, to_mm] = STEP_MM;
    let mut worst = [f64::NEG_INFINITY; 3];
    for (from_mm, to_mm) in [(from_mm, to_mm), (to_mm, from_mm)] {
        let trace = to_place(case, [from_mm, to_mm], case.lead.closing_mm_s());
        let towards = (to_mm - from_mm).signum();
        let beyond = trace.most(|point| towards * (point.opening_mm - to_mm));
        let off_mm = (trace.last(0.05, |point| point.opening_mm) - to_mm).abs();
        let bus_v = trace.most(|point| point.bus_v);
        let found = [beyond, off_mm, bus_v];
        worst = [0, 1, 2].map(|index| f64::max(worst[index], found[index]));
    }
    let [beyond, off, bus] = worst;
    let braked = at_speed(case, 70.0, case.lead.closing_mm_s(), 0.2);
    [bandwidth, overshoot, beyond, off, bus, braked.way_mm]
}

/// A table of both screws with so many scattered grippers.
pub fn text(seeds: u64) -> String {
    let [a, b] = Lead::BOTH.map(|lead| of(lead, 1..=seeds));
    let mut table = show::table(["figure", "unit", "asked", "screw A", "screw B"]);
    for (a, b) in a.iter().zip(&b) {
        let reached = |figure: &Figure| {
            let missed = if figure.is_met() { "" } else { " (missed)" };
            format!("{}{missed}", show::plain(figure.reached, 3))
        };
        table.add_row([
            a.name.to_owned(),
            a.unit.to_owned(),
            a.asked_words(),
            reached(a),
            reached(b),
        ]);
    }
    show::right_align(&mut table, 3);
    table.to_string()
}
