//! Result of a drive run: trace, responses of the loops, figures, assumed constants.

use crate::closed_loop::frequency_response::{self, FrequencyPoint, StepResponse};
use crate::closed_loop::motor_rig::{self, DriveCase, MotorTrace, POSITION_STEP_MM};
use crate::drivetrain::parameters::Lead;
use firmware::config::constants::{self, Constant};

/// Constants of a run in addition to its screw's: of the plant, then of the control.
const DRIVE_CONSTANTS: [Constant; 38] = [
    constants::BUS_VOLTAGE,
    constants::BUS_CAPACITANCE,
    constants::SUPPLY_RESISTANCE,
    constants::DEAD_TIME,
    constants::DIODE_DROP,
    constants::POLE_PAIRS,
    constants::TORQUE_CONSTANT,
    constants::PHASE_RESISTANCE,
    constants::PHASE_INDUCTANCE,
    constants::ROTOR_INERTIA,
    constants::VISCOUS_FRICTION,
    constants::DRY_FRICTION,
    constants::BREAKAWAY_FRICTION,
    constants::STRIBECK_SPEED,
    constants::COGGING,
    constants::COGGING_PERIODS,
    constants::BACKLASH,
    constants::SCREW_STIFFNESS,
    constants::FINGER_MASS,
    constants::GUIDE_FRICTION,
    constants::STIFFNESS_X,
    constants::STROKE,
    constants::CURRENT_SCALE,
    constants::CURRENT_NOISE,
    constants::CURRENT_OFFSET,
    constants::BUS_SCALE,
    constants::ENCODER_BITS,
    constants::ENCODER_NOISE,
    constants::ENCODER_ECCENTRICITY,
    constants::PWM_RATE,
    constants::MODULATION,
    constants::CURRENT_BANDWIDTH,
    constants::SPEED_BANDWIDTH,
    constants::SPEED_SETPOINT_WEIGHT,
    constants::POSITION_BANDWIDTH,
    constants::ENCODER_BANDWIDTH,
    constants::MOTION_ACCELERATION,
    constants::MOTION_JERK,
];

/// Target of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DriveTarget {
    /// An opening, with a speed limit.
    Position {
        /// Opening in mm.
        opening_mm: f64,
        /// In mm/s.
        speed_mm_s: f64,
    },
    /// A closing speed for a time, then the brake.
    Speed {
        /// In mm/s, closing positive.
        closing_mm_s: f64,
        /// In s.
        seconds: f64,
    },
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveResult {
    /// Drivetrain.
    pub case: DriveCase,
    /// Initial opening in mm.
    pub from_mm: f64,
    /// Target.
    pub target: DriveTarget,
    /// Trace of the run.
    pub run: MotorTrace,
    /// Braking distance in mm, where it braked.
    pub braked_mm: Option<f64>,
    /// Step response of the current loop.
    pub step: StepResponse,
    /// Frequency response of the current loop.
    pub sweep: Vec<FrequencyPoint>,
    /// Trace of a position step.
    pub position_step: MotorTrace,
}

impl DriveResult {
    /// Simulates the run and the responses of the loops; `done` is called after each part.
    pub fn of(case: DriveCase, from_mm: f64, target: DriveTarget, done: impl Fn()) -> Self {
        let (run, braked_mm) = match target {
            DriveTarget::Position { opening_mm, speed_mm_s } => {
                let run = motor_rig::run_to_position(&case, [from_mm, opening_mm], speed_mm_s);
                (run, None)
            }
            DriveTarget::Speed { closing_mm_s, seconds } => {
                let run = motor_rig::run_at_speed(&case, from_mm, closing_mm_s, seconds);
                (run.trace, Some(run.braking_mm))
            }
        };
        done();
        let step = frequency_response::step_response(&case);
        done();
        let sweep = frequency_response::frequency_response(&case);
        done();
        let position_step =
            motor_rig::run_to_position(&case, POSITION_STEP_MM, case.lead.closing_mm_s());
        done();
        Self { case, from_mm, target, run, braked_mm, step, sweep, position_step }
    }

    /// Number of calls of `done`.
    pub const PARTS: usize = 4;

    /// -3 dB frequency of the current loop in Hz.
    pub fn bandwidth_hz(&self) -> Option<f64> {
        frequency_response::bandwidth_hz(&self.sweep)
    }

    /// Summary of the simulated case.
    pub fn sentence(&self) -> String {
        let (lead, from_mm) = (self.case.lead, self.from_mm);
        let target = match self.target {
            DriveTarget::Position { opening_mm, speed_mm_s } => {
                format!("to {opening_mm} mm at {speed_mm_s} mm/s at the most")
            }
            DriveTarget::Speed { closing_mm_s, seconds } => {
                format!("closing at {closing_mm_s} mm/s for {seconds} s, then the brake")
            }
        };
        format!(
            "Screw {lead:?}, from an opening of {from_mm} mm {target}; seed {}. The firmware's own control on a \
             simulated motor.",
            self.case.seed
        )
    }

    /// Figures of the run: name, value, unit.
    pub fn figures(&self) -> Vec<(&'static str, f64, &'static str)> {
        let run = &self.run;
        let end_mm = run.mean_of_last(0.02, |point| point.opening_mm);
        let mut figures =
            vec![("duration", run.max(|point| point.time_s), "s"), ("final opening", end_mm, "mm")];
        if let DriveTarget::Position { opening_mm, .. } = self.target {
            let towards = (opening_mm - self.from_mm).signum();
            let beyond = run.max(|point| towards * (point.opening_mm - opening_mm));
            figures.push(("position error", end_mm - opening_mm, "mm"));
            figures.push(("overshoot", beyond.max(0.0), "mm"));
        }
        figures.extend(self.braked_mm.map(|mm| ("braking distance", mm, "mm")));
        figures.extend([
            ("max. speed", run.max(|p| p.closing_mm_s.abs()), "mm/s"),
            ("max. current", run.max(|p| p.current_a[1].abs()), "A"),
            ("max. bus voltage", run.max(|p| p.bus_v), "V"),
            ("min. bus voltage", -run.max(|p| -p.bus_v), "V"),
            ("current loop bandwidth (-3 dB)", self.bandwidth_hz().unwrap_or(f64::NAN), "Hz"),
            ("current loop overshoot", 100.0 * self.step.overshoot(), "%"),
        ]);
        figures
    }

    /// Assumed constants of the simulation.
    pub fn assumed(&self) -> Vec<Constant> {
        assumed_constants(self.case.lead, &[])
    }
}

/// Assumed constants of every run with this screw, and `more`.
pub fn assumed_constants(lead: Lead, more: &[Constant]) -> Vec<Constant> {
    let screw = lead.constants();
    let all = screw.into_iter().chain(DRIVE_CONSTANTS).chain(more.iter().copied());
    all.filter(Constant::is_assumed).collect()
}
