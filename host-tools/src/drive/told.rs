//! What is told of a run: the run, the loops' answers, and what it rests on.

use firmware::params::{self, Constant};

use super::figures::STEP_MM;
use super::response::{self, Step, Tone};
use super::runs::{self, Case};
use super::trace::Trace;
use crate::plant::parameters::Lead;

/// What a run rests on beside its screw's lead and efficiency: of the plant, then of the control.
const RESTS_ON: [Constant; 37] = [
    params::BUS_VOLTAGE,
    params::BUS_CAPACITANCE,
    params::SUPPLY_RESISTANCE,
    params::DEAD_TIME,
    params::DIODE_DROP,
    params::POLE_PAIRS,
    params::TORQUE_CONSTANT,
    params::PHASE_RESISTANCE,
    params::PHASE_INDUCTANCE,
    params::ROTOR_INERTIA,
    params::VISCOUS_FRICTION,
    params::DRY_FRICTION,
    params::BREAKAWAY_FRICTION,
    params::STRIBECK_SPEED,
    params::COGGING,
    params::COGGING_PERIODS,
    params::PLAY,
    params::SCREW_STIFFNESS,
    params::FINGER_MASS,
    params::GUIDE_FRICTION,
    params::STIFFNESS_X,
    params::STROKE,
    params::CURRENT_SCALE,
    params::CURRENT_NOISE,
    params::CURRENT_OFFSET,
    params::BUS_SCALE,
    params::ENCODER_BITS,
    params::ENCODER_NOISE,
    params::ENCODER_ECCENTRICITY,
    params::PWM_RATE,
    params::MODULATION,
    params::CURRENT_BANDWIDTH,
    params::SPEED_BANDWIDTH,
    params::POSITION_BANDWIDTH,
    params::ENCODER_BANDWIDTH,
    params::MOTION_ACCELERATION,
    params::MOTION_JERK,
];

/// What is asked of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Asked {
    /// A place, at a speed at the most.
    Place {
        /// Opening in mm.
        opening_mm: f64,
        /// In mm/s.
        speed_mm_s: f64,
    },
    /// A speed of closing for a time, then the brake.
    Speed {
        /// In mm/s, closing positive.
        closing_mm_s: f64,
        /// In s.
        seconds: f64,
    },
}

/// All that is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    /// The drive.
    pub case: Case,
    /// Where it began, in mm.
    pub from_mm: f64,
    /// What was asked.
    pub asked: Asked,
    /// What it did.
    pub run: Trace,
    /// Way of the fingers after the brake, in mm, where it braked.
    pub braked_mm: Option<f64>,
    /// The current loop's answer to a step.
    pub step: Step,
    /// Its answer to sines.
    pub sweep: Vec<Tone>,
    /// A step of the place.
    pub place: Trace,
}

impl Told {
    /// Runs the drive, and its loops.
    pub fn of(case: Case, from_mm: f64, asked: Asked, done: impl Fn()) -> Self {
        let (run, braked_mm) = match asked {
            Asked::Place {
                opening_mm,
                speed_mm_s,
            } => {
                let run = runs::to_place(&case, [from_mm, opening_mm], speed_mm_s);
                (run, None)
            }
            Asked::Speed {
                closing_mm_s,
                seconds,
            } => {
                let run = runs::at_speed(&case, from_mm, closing_mm_s, seconds);
                (run.trace, Some(run.way_mm))
            }
        };
        done();
        let step = response::step(&case);
        done();
        let sweep = response::sweep(&case);
        done();
        let place = runs::to_place(&case, STEP_MM, case.lead.closing_mm_s());
        done();
        Self {
            case,
            from_mm,
            asked,
            run,
            braked_mm,
            step,
            sweep,
            place,
        }
    }

    /// How often `done` is called.
    pub const PARTS: usize = 4;

    /// Where the current loop's gain has fallen by 3 dB, in Hz.
    pub fn bandwidth_hz(&self) -> Option<f64> {
        response::bandwidth_hz(&self.sweep)
    }

    /// The run in a sentence.
    pub fn sentence(&self) -> String {
        let (lead, from_mm) = (self.case.lead, self.from_mm);
        let asked = match self.asked {
            Asked::Place {
                opening_mm,
                speed_mm_s,
            } => format!("to {opening_mm} mm at {speed_mm_s} mm/s at the most"),
            Asked::Speed {
                closing_mm_s,
                seconds,
            } => format!("closing at {closing_mm_s} mm/s for {seconds} s, then the brake"),
        };
        format!(
            "Screw {lead:?}, from an opening of {from_mm} mm {asked}; seed {}. The firmware's own control on a \
             simulated motor.",
            self.case.seed
        )
    }

    /// Figures of the run: name, value, unit.
    pub fn figures(&self) -> Vec<(&'static str, f64, &'static str)> {
        let run = &self.run;
        let end_mm = run.last(0.02, |point| point.opening_mm);
        let mut figures = vec![
            ("time", run.most(|point| point.time_s), "s"),
            ("opening at the end", end_mm, "mm"),
        ];
        if let Asked::Place { opening_mm, .. } = self.asked {
            let towards = (opening_mm - self.from_mm).signum();
            let beyond = run.most(|point| towards * (point.opening_mm - opening_mm));
            figures.push(("off what is asked", end_mm - opening_mm, "mm"));
            figures.push(("overshoot", beyond.max(0.0), "mm"));
        }
        figures.extend(self.braked_mm.map(|mm| ("way after the brake", mm, "mm")));
        figures.extend([
            ("greatest speed", run.most(|p| p.closing_mm_s.abs()), "mm/s"),
            ("greatest current", run.most(|p| p.current_a[1].abs()), "A"),
            ("greatest bus voltage", run.most(|p| p.bus_v), "V"),
            ("least bus voltage", -run.most(|p| -p.bus_v), "V"),
            (
                "current loop, 3 dB",
                self.bandwidth_hz().unwrap_or(f64::NAN),
                "Hz",
            ),
            (
                "current loop, overshoot",
                100.0 * self.step.overshoot(),
                "%",
            ),
        ]);
        figures
    }

    /// The assumed constants that it rests on.
    pub fn assumed(&self) -> Vec<Constant> {
        assumed(self.case.lead, &[])
    }
}

/// The assumed constants that every run with a screw rests on, and more.
pub fn assumed(lead: Lead, more: &[Constant]) -> Vec<Constant> {
    let screw = lead.constants();
    let all = screw
        .into_iter()
        .chain(RESTS_ON)
        .chain(more.iter().copied());
    all.filter(|constant| constant.assumed).collect()
}
