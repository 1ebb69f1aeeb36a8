//! The current loop's answers, with the rotor held: to a step, and to sines of many frequencies.

use std::f64::consts::TAU;

use firmware::motor::{Order, Setpoint};

use super::runs::Case;
use super::{Rig, periods};
use crate::plant::PERIOD_S;

/// Inertia that nothing turns, in kg m^2.
const HELD_KG_M2: f64 = 1e3;
/// Steps that are averaged, each with noise of its own.
const AVERAGED: u64 = 16;
/// The step, from and to, in A: beyond what the ripple hides.
const STEP_A: [f64; 2] = [1.0, 4.0];
/// Time that a step is looked at.
const STEP_S: f64 = 4e-3;
/// Settling before anything is measured.
const SETTLE_S: f64 = 10e-3;
/// Mean and amplitude of the sines in A.
const SINE_A: [f64; 2] = [2.5, 1.0];
/// Time over which a sine is measured: every frequency is a multiple of 1/20 ms.
const WINDOW_S: f64 = 20e-3;

/// Frequencies in Hz: beside half the outer loops' rate, at which their set-points come.
const FREQUENCIES_HZ: [f64; 20] = [
    50.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0, 1100.0, 1200.0,
    1300.0, 1400.0, 1600.0, 1800.0, 2200.0, 2600.0, 3000.0,
];

/// The mean of many steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Time since it was asked in s, and quadrature current as a share of the step.
    pub points: Vec<[f64; 2]>,
}

/// One sine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// In Hz.
    pub frequency_hz: f64,
    /// Current over what was asked.
    pub gain: f64,
    /// Of the current behind what was asked, in degrees.
    pub lag_deg: f64,
}

/// A rig whose rotor is held.
fn held(case: &Case, seed: u64) -> Rig {
    let mut parameters = case.parameters;
    parameters.rotor.inertia_kg_m2 = HELD_KG_M2;
    Rig::armed(case.lead, parameters, 40.0, seed)
}

fn current(rig: &mut Rig, closing_a: f64) {
    let closing_a = closing_a as f32;
    rig.motor.obey(Order::Do(Setpoint::Current { closing_a }));
}

/// The answer to a step.
pub fn step(case: &Case) -> Step {
    let mut points: Vec<[f64; 2]> = Vec::new();
    for seed in 0..AVERAGED {
        let mut rig = held(case, case.seed.wrapping_add(seed << 32));
        let [from_a, to_a] = STEP_A;
        current(&mut rig, from_a);
        rig.run(SETTLE_S);
        current(&mut rig, to_a);
        rig.run_while(SETTLE_S, |telling| f64::from(telling.asked.q) < to_a - 1e-3);
        for index in 0..periods(STEP_S) as usize {
            let [_, quadrature] = rig.plant.direct_quadrature_a();
            let share = (quadrature - from_a) / (to_a - from_a) / AVERAGED as f64;
            match points.get_mut(index) {
                Some([_, sum]) => *sum += share,
                None => points.push([index as f64 * PERIOD_S, share]),
            }
            rig.period();
        }
    }
    Step { points }
}

impl Step {
    /// Mean of the last quarter: one, but for the gain of the current sensors.
    pub fn end(&self) -> f64 {
        let tail = &self.points[3 * self.points.len() / 4..];
        tail.iter().map(|[_, share]| share).sum::<f64>() / tail.len() as f64
    }

    /// Beyond its end, as a share of the step.
    pub fn overshoot(&self) -> f64 {
        let most = self.points.iter().map(|[_, share]| *share);
        most.fold(f64::NEG_INFINITY, f64::max) / self.end() - 1.0
    }

    /// From 10 % to 90 % of the step, in s.
    pub fn rise_s(&self) -> f64 {
        let when = |wanted: f64| {
            let mut points = self.points.iter();
            points.find(|[_, share]| *share >= wanted * self.end())
        };
        match (when(0.1), when(0.9)) {
            (Some([start_s, _]), Some([end_s, _])) => end_s - start_s,
            _ => f64::NAN,
        }
    }
}

/// The answer to sines, each measured by itself.
pub fn sweep(case: &Case) -> Vec<Tone> {
    FREQUENCIES_HZ.map(|hz| tone(case, hz)).to_vec()
}

/// The answer to one sine: what the control asks and what flows, correlated with it.
fn tone(case: &Case, frequency_hz: f64) -> Tone {
    let mut rig = held(case, case.seed);
    let [mean_a, amplitude_a] = SINE_A;
    current(&mut rig, mean_a);
    rig.run(SETTLE_S);
    let start_s = rig.plant.time_s();
    let (mut asked, mut flowed) = ([0.0; 2], [0.0; 2]);
    let settled = periods(SETTLE_S);
    for index in 0..settled + periods(WINDOW_S) {
        let time_s = rig.plant.time_s() - start_s;
        let phase_rad = TAU * frequency_hz * time_s;
        current(&mut rig, mean_a + amplitude_a * phase_rad.sin());
        // What the next answer follows, and the current in the middle of the next period.
        let asked_a = f64::from(rig.motor.telling().asked.q) - mean_a;
        let flowed_a = rig.plant.direct_quadrature_a()[1] - mean_a;
        if index >= settled {
            let (sin, cos) = phase_rad.sin_cos();
            for (sums, value) in [(&mut asked, asked_a), (&mut flowed, flowed_a)] {
                sums[0] += value * sin;
                sums[1] += value * cos;
            }
        }
        rig.period();
    }
    let size = |[sin, cos]: [f64; 2]| f64::hypot(sin, cos);
    let angle = |[sin, cos]: [f64; 2]| f64::atan2(cos, sin);
    let lag = (angle(asked) - angle(flowed)).to_degrees();
    Tone {
        frequency_hz,
        gain: size(flowed) / size(asked),
        lag_deg: (lag + 90.0).rem_euclid(360.0) - 90.0,
    }
}

/// Frequency in Hz at which the gain has fallen by 3 dB, by interpolation; nothing where it has not.
pub fn bandwidth_hz(tones: &[Tone]) -> Option<f64> {
    let falls = std::f64::consts::FRAC_1_SQRT_2;
    let pair = tones.windows(2).find(|pair| pair[1].gain < falls)?;
    let (above, below) = (pair[0], pair[1]);
    let share = (above.gain - falls) / (above.gain - below.gain);
    Some(above.frequency_hz + share * (below.frequency_hz - above.frequency_hz))
}
