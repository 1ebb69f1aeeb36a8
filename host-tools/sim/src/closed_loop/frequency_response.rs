//! Step and frequency response of the current loop with a locked rotor.

use crate::closed_loop::motor_rig::{DriveCase, MotorRig, periods};
use crate::drivetrain::PERIOD_S;
use firmware::motor::{MotorCommand, Setpoint};
use serde::Serialize;
use std::f64::consts::TAU;

/// Inertia of the locked rotor, in kg m^2.
const LOCKED_KG_M2: f64 = 1e3;
/// Number of averaged steps, each with its own noise.
const AVERAGED: u64 = 16;
/// Step from and to, in A; large compared with the ripple.
const STEP_A: [f64; 2] = [1.0, 4.0];
/// Duration of the step response.
const STEP_S: f64 = 4e-3;
/// Settling time before a measurement.
const SETTLE_S: f64 = 10e-3;
/// Mean and amplitude of the sine in A.
const SINE_A: [f64; 2] = [2.5, 1.0];
/// Measurement time of a sine; all frequencies are multiples of its inverse.
const WINDOW_S: f64 = 20e-3;

/// Frequencies in Hz, without half the rate of the outer loops, at which set-points arrive.
const FREQUENCIES_HZ: [f64; 20] = [
    50.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0, 1100.0, 1200.0,
    1300.0, 1400.0, 1600.0, 1800.0, 2200.0, 2600.0, 3000.0,
];

/// Mean step response.
#[derive(Clone, Debug, PartialEq)]
pub struct StepResponse {
    /// Time since the set-point in s, and quadrature current as a share of the step.
    pub points: Vec<[f64; 2]>,
}

/// Response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrequencyPoint {
    /// In Hz.
    pub frequency_hz: f64,
    /// Current over set-point.
    pub gain: f64,
    /// Phase lag of the current, in degrees.
    pub lag_deg: f64,
}

/// A rig with a locked rotor.
fn locked_rig(case: &DriveCase, seed: u64) -> MotorRig {
    let mut parameters = case.parameters;
    parameters.rotor.inertia_kg_m2 = LOCKED_KG_M2;
    MotorRig::armed(case.lead, parameters, 40.0, seed)
}

fn set_current(rig: &mut MotorRig, closing_a: f64) {
    let closing_a = closing_a as f32;
    rig.motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a }));
}

/// Measures the step response.
pub fn step_response(case: &DriveCase) -> StepResponse {
    let mut points: Vec<[f64; 2]> = Vec::new();
    for seed in 0..AVERAGED {
        let mut rig = locked_rig(case, case.seed.wrapping_add(seed << 32));
        let [from_a, to_a] = STEP_A;
        set_current(&mut rig, from_a);
        rig.run(SETTLE_S);
        set_current(&mut rig, to_a);
        rig.run_while(SETTLE_S, |telling| f64::from(telling.current_setpoint.q) < to_a - 1e-3);
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
    StepResponse { points }
}

impl StepResponse {
    /// Final value, the mean of the last quarter; one but for the gain of the current sensors.
    pub fn end(&self) -> f64 {
        let tail = &self.points[3 * self.points.len() / 4..];
        tail.iter().map(|[_, share]| share).sum::<f64>() / tail.len() as f64
    }

    /// Overshoot over the final value.
    pub fn overshoot(&self) -> f64 {
        let values = self.points.iter().map(|[_, share]| *share);
        values.fold(f64::NEG_INFINITY, f64::max) / self.end() - 1.0
    }

    /// From 10 % to 90 % of the step, in s.
    pub fn rise_s(&self) -> f64 {
        let when = |level: f64| {
            let mut points = self.points.iter();
            points.find(|[_, share]| *share >= level * self.end())
        };
        match (when(0.1), when(0.9)) {
            (Some([start_s, _]), Some([end_s, _])) => end_s - start_s,
            _ => f64::NAN,
        }
    }
}

/// Measures the frequency response.
pub fn frequency_response(case: &DriveCase) -> Vec<FrequencyPoint> {
    FREQUENCIES_HZ.map(|hz| tone(case, hz)).to_vec()
}

/// Measures one frequency by correlating set-point and current with the sine.
fn tone(case: &DriveCase, frequency_hz: f64) -> FrequencyPoint {
    let mut rig = locked_rig(case, case.seed);
    let [mean_a, amplitude_a] = SINE_A;
    set_current(&mut rig, mean_a);
    rig.run(SETTLE_S);
    let start_s = rig.plant.time_s();
    let (mut setpoint, mut measured) = ([0.0; 2], [0.0; 2]);
    let settled = periods(SETTLE_S);
    for index in 0..settled + periods(WINDOW_S) {
        let time_s = rig.plant.time_s() - start_s;
        let phase_rad = TAU * frequency_hz * time_s;
        set_current(&mut rig, mean_a + amplitude_a * phase_rad.sin());
        // The set-point of the next period, and the current in its middle.
        let setpoint_a = f64::from(rig.motor.status().current_setpoint.q) - mean_a;
        let measured_a = rig.plant.direct_quadrature_a()[1] - mean_a;
        if index >= settled {
            let (sin, cos) = phase_rad.sin_cos();
            for (sums, value) in [(&mut setpoint, setpoint_a), (&mut measured, measured_a)] {
                sums[0] += value * sin;
                sums[1] += value * cos;
            }
        }
        rig.period();
    }
    let size = |[sin, cos]: [f64; 2]| f64::hypot(sin, cos);
    let angle = |[sin, cos]: [f64; 2]| f64::atan2(cos, sin);
    let lag = (angle(setpoint) - angle(measured)).to_degrees();
    FrequencyPoint {
        frequency_hz,
        gain: size(measured) / size(setpoint),
        lag_deg: (lag + 90.0).rem_euclid(360.0) - 90.0,
    }
}

/// -3 dB frequency in Hz by interpolation; none where the gain does not fall that far.
pub fn bandwidth_hz(tones: &[FrequencyPoint]) -> Option<f64> {
    let threshold = std::f64::consts::FRAC_1_SQRT_2;
    let pair = tones.windows(2).find(|pair| pair[1].gain < threshold)?;
    let (above, below) = (pair[0], pair[1]);
    let share = (above.gain - threshold) / (above.gain - below.gain);
    Some(above.frequency_hz + share * (below.frequency_hz - above.frequency_hz))
}
