//! What a step consists of: what a person does and reads, the limits of its values, and a step in progress.

use std::fmt;
use std::time::Duration;

use anyhow::{Result, bail};
use firmware::board::selected::table::{self, Range};
use firmware::motor::settings::MotorParameters;
use serde::{Deserialize, Serialize};

use super::gripper::Gripper;

/// A step.
pub struct Step {
    /// Name.
    pub name: &'static str,
    /// What to connect before.
    pub connect: &'static str,
    /// What is measured; `{}` stands for the next of the ranges.
    pub(super) expect: &'static str,
    /// Limits that the board's table states.
    pub(super) ranges: &'static [Range],
    /// What to do otherwise.
    pub otherwise: &'static str,
    pub(super) run: fn(&mut BringUp<'_>) -> Result<()>,
}

impl Step {
    /// What is measured, with its limits.
    pub fn expectation(&self) -> String {
        self.ranges.iter().fold(self.expect.to_owned(), |text, range| {
            let ([min, max], unit) = (range.limits, range.unit);
            text.replacen("{}", format!("{min} to {max} {unit}").trim_end(), 1)
        })
    }
}

/// What a person does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Before a step.
    Connect {
        /// Its number from 1.
        step: usize,
        /// Its [`Step::connect`].
        what: &'static str,
    },
    /// Press this finger outwards, 0 or 1.
    Press(usize),
    /// Let go of it.
    LetGo,
    /// Turn the rotor by hand.
    Turn,
    /// Open the wire of the break input.
    OpenBreak,
    /// Connect it again.
    CloseBreak,
    /// Let a weight pull the first fingertip outwards with these newtons.
    Weight(f64),
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connect { what, .. } => f.write_str(what),
            Self::Press(finger) => write!(
                f,
                "Press the fingertip of finger {} outwards with about 20 N, and keep pressing.",
                finger + 1
            ),
            Self::LetGo => f.write_str("Let go of the finger."),
            Self::Turn => f.write_str(
                "Turn the rotor by hand by a quarter of a turn, so that the fingers close.",
            ),
            Self::OpenBreak => {
                write!(f, "Open the wire of the break input ({}).", table::BREAK.pins[0].1)
            }
            Self::CloseBreak => f.write_str("Connect the wire of the break input again."),
            Self::Weight(newtons) => write!(
                f,
                "Let a weight pull the fingertip of finger 1 outwards with {newtons} N ({:.2} kg).",
                newtons / 9.81
            ),
        }
    }
}

/// What a person reads off an instrument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Volts.
    GatesInReset,
    /// Volts.
    GatesAfterHalt,
    /// Volts.
    GatesAfterDip,
}

impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::GatesInReset => {
                "Hold the reset button. Highest voltage at the six gate inputs in volts:"
            }
            Self::GatesAfterHalt => {
                "Halt the core with the debugger. Highest voltage at the six gate inputs in volts:"
            }
            Self::GatesAfterDip => {
                "Lower the 3.3 V rail to 2.7 V and raise it again. Highest voltage at the six gate inputs meanwhile in volts:"
            }
        })
    }
}

/// A person, or a program in its place.
pub trait Operator {
    /// Does something; returns when it is done.
    ///
    /// # Errors
    /// It is given up.
    fn act(&mut self, action: Action) -> Result<()>;

    /// Reads a value.
    ///
    /// # Errors
    /// It is given up.
    fn read(&mut self, reading: Reading) -> Result<f64>;
}

/// A value with its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// What it is, with its unit.
    pub name: String,
    /// The value.
    pub value: f64,
    /// Limits; none for a value that is only recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limits: Option<[f64; 2]>,
}

impl Value {
    fn is_within(&self) -> bool {
        self.limits.is_none_or(|[min, max]| (min..=max).contains(&self.value))
    }
}

/// What the data sheet of the motor states; the assumed motor where it is not given.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Phase resistance in ohms.
    pub resistance_ohm: f64,
    /// Phase inductance in millihenries.
    pub inductance_mh: f64,
    /// Pole pairs.
    pub pole_pairs: f64,
    /// Torque constant in N m/A.
    pub torque_nm_a: f64,
    /// Inertia of rotor and coupling in kg m^2.
    pub inertia_kg_m2: f64,
    /// Weight of the last step in newtons.
    pub weight_n: f64,
    /// Observation of the rotor sensor.
    pub watch: Duration,
}

impl Default for Expected {
    fn default() -> Self {
        let motor = MotorParameters::ASSUMED;
        Self {
            resistance_ohm: motor.resistance_ohm.into(),
            inductance_mh: 1e3 * f64::from(motor.inductance_h),
            pole_pairs: motor.pole_pairs.into(),
            torque_nm_a: motor.torque_nm_a.into(),
            inertia_kg_m2: motor.inertia_kg_m2.into(),
            weight_n: 10.0,
            watch: Duration::from_secs(600),
        }
    }
}

/// Time in which everything arrives that was sent while a person did something.
const OLD: Duration = Duration::from_millis(100);

/// A step in progress.
pub struct BringUp<'b> {
    pub(super) gripper: Gripper<'b>,
    pub(super) operator: &'b mut dyn Operator,
    pub(super) expected: Expected,
    pub(super) values: Vec<Value>,
}

impl BringUp<'_> {
    /// A person does something. What the gripper has sent until then is forgotten.
    pub(super) fn act(&mut self, action: Action) -> Result<()> {
        self.operator.act(action)?;
        self.gripper.observe(OLD).map(|_| ())
    }

    /// Keeps a value.
    pub(super) fn note(&mut self, name: &str, value: f64) {
        self.values.push(Value { name: name.to_owned(), value, limits: None });
    }

    /// Keeps a value that must be within limits.
    pub(super) fn check(&mut self, name: &str, value: f64, [min, max]: [f64; 2]) -> Result<()> {
        let checked = Value { name: name.to_owned(), value, limits: Some([min, max]) };
        let is_within = checked.is_within();
        self.values.push(checked);
        if !is_within {
            bail!("{name} is {value:.4}, expected is {min:.4} to {max:.4}");
        }
        Ok(())
    }
}
