//! Runs of the drive: to a place, at a speed, to rest, against something.

use std::f64::consts::FRAC_PI_2;

use firmware::motor::{Order, Setpoint};
use firmware::params;

use super::Rig;
use super::trace::Trace;
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};

/// Greatest current of a way, in A: that of the peak torque.
pub const MOST_A: f64 = params::PEAK_TORQUE.value / params::TORQUE_CONSTANT.value;
/// Time to settle at the end of a way.
const SETTLE_S: f64 = 0.2;
/// No way takes longer.
const LONGEST_S: f64 = 20.0;
/// Own stiffness of something rigid in N/mm: a third of it with the flexures.
pub const RIGID_N_PER_MM: f64 = 1000.0;
/// Time in which a squeeze comes up, and in which it rests.
const SQUEEZE_S: [f64; 2] = [1.0, 0.2];

/// A drive that is to be run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Which screw.
    pub lead: Lead,
    /// What the plant is made of.
    pub parameters: Parameters,
    /// Seed of its noise.
    pub seed: u64,
}

impl Case {
    /// As the card says.
    pub fn nominal(lead: Lead, seed: u64) -> Self {
        Self {
            lead,
            parameters: Parameters::nominal(lead),
            seed,
        }
    }

    /// Scattered by a share about it.
    pub fn scattered(lead: Lead, share: f64, seed: u64) -> Self {
        Self {
            lead,
            parameters: Parameters::scattered(lead, share, seed),
            seed,
        }
    }

    fn rig(&self, opening_mm: f64) -> Rig {
        Rig::armed(self.lead, self.parameters, opening_mm, self.seed)
    }
}

/// A way from one opening to another.
pub fn to_place(case: &Case, [from_mm, to_mm]: [f64; 2], speed_mm_s: f64) -> Trace {
    let mut rig = case.rig(from_mm);
    rig.motor.obey(Order::Do(Setpoint::Position {
        opening_mm: to_mm as f32,
        speed_mm_s: speed_mm_s as f32,
        most_a: MOST_A as f32,
    }));
    let start_s = rig.plant.time_s();
    let mut trace = Trace::default();
    // The way's own end: what is asked is the place.
    let arrived = |trace: &Trace| {
        let asked = trace.points.last().and_then(|point| point.asked_mm);
        asked.is_some_and(|mm| (mm - to_mm).abs() < 1e-3)
    };
    while !arrived(&trace) && rig.plant.time_s() - start_s < LONGEST_S {
        trace.record(&mut rig, start_s, 1e-3);
    }
    trace.record(&mut rig, start_s, SETTLE_S);
    trace
}

/// A speed of closing for a time, and the brake.
pub fn at_speed(case: &Case, from_mm: f64, closing_mm_s: f64, seconds: f64) -> Braked {
    let mut rig = case.rig(from_mm);
    rig.motor.obey(Order::Do(Setpoint::Speed {
        closing_mm_s: closing_mm_s as f32,
        most_a: MOST_A as f32,
    }));
    let start_s = rig.plant.time_s();
    let mut trace = Trace::default();
    trace.record(&mut rig, start_s, seconds);
    let (mean_mm_s, braked_at) = (trace.last(0.02, |p| p.closing_mm_s), trace.points.len());
    rig.motor.obey(Order::Do(Setpoint::Brake));
    trace.record(&mut rig, start_s, 0.05);
    let distance = |index: usize| trace.points.get(index).map_or(0.0, |p| p.opening_mm);
    let way_mm = (distance(braked_at.saturating_sub(1)) - distance(trace.points.len() - 1)).abs();
    Braked {
        mean_mm_s,
        way_mm,
        trace,
    }
}

/// A run at a speed and to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Braked {
    /// Mean speed of closing before the brake, in mm/s.
    pub mean_mm_s: f64,
    /// Way of the fingers after it, in mm.
    pub way_mm: f64,
    /// All of it.
    pub trace: Trace,
}

/// Force in N that a current, brought up slowly, leaves between the fingers on something rigid.
pub fn squeeze_n(case: &Case, current_a: f64) -> f64 {
    let opening_mm = 40.0;
    let mut rig = case.rig(opening_mm);
    let object = Object::new(1e-3 * opening_mm, RIGID_N_PER_MM);
    rig.plant.hold(Some(&object));
    let [rise_s, rest_s] = SQUEEZE_S;
    let start_s = rig.plant.time_s();
    while rig.plant.time_s() - start_s < rise_s + rest_s {
        let share = ((rig.plant.time_s() - start_s) / rise_s).min(1.0);
        let closing_a = (current_a * (share * FRAC_PI_2).sin()) as f32;
        rig.under(Setpoint::Current { closing_a }, 1e-3);
    }
    rig.plant.grip_n()
}
