//! The first power-up of a board: twelve steps, each with what to connect, what is measured and its limits. The table [`STEPS`] is
//! what `magpie board bringup` does and what `firmware/BRING-UP.md` states.
//!
//! A step measures by messages, parameters and services of the firmware. What only a person can do or read is asked of an
//! [`Operator`]. Every value is kept in a [`Record`], in which passed steps are not repeated.

mod gripper;
mod steps;

use std::fmt::{self, Write as _};
use std::time::Duration;

use anyhow::{Result, bail};
use firmware::board::selected::table::{self, Range};
use firmware::motor::settings::MotorParameters;
use serde::{Deserialize, Serialize};

use crate::session::Credentials;
use crate::source::Source;
use gripper::Gripper;
pub use steps::STEPS;

/// A step.
pub struct Step {
    /// Name.
    pub name: &'static str,
    /// What to connect before.
    pub connect: &'static str,
    /// What is measured; `{}` stands for the next of the ranges.
    expect: &'static str,
    /// Limits that the board's table states.
    ranges: &'static [Range],
    /// What to do otherwise.
    pub otherwise: &'static str,
    run: fn(&mut BringUp<'_>) -> Result<()>,
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
    /// Before a step: its [`Step::connect`].
    Connect(usize),
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
            Self::Connect(step) => f.write_str(STEPS[*step].connect),
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

/// A step that was done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Number from 1.
    pub step: usize,
    /// Name.
    pub name: String,
    /// Whether all values were within their limits.
    pub passed: bool,
    /// All values.
    #[serde(default)]
    pub values: Vec<Value>,
}

/// Everything that was measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Who signed, once all steps were passed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub signed_by: Option<String>,
    /// Steps, the latest last.
    #[serde(default, rename = "steps")]
    pub steps: Vec<StepRecord>,
}

impl Record {
    /// Whether the step with this number from 1 was passed the last time.
    pub fn has_passed(&self, step: usize) -> bool {
        self.steps.iter().rev().find(|done| done.step == step).is_some_and(|done| done.passed)
    }

    /// Number of the first step that was not passed.
    pub fn next(&self) -> Option<usize> {
        (1..=STEPS.len()).find(|step| !self.has_passed(*step))
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
    gripper: Gripper<'b>,
    operator: &'b mut dyn Operator,
    expected: Expected,
    values: Vec<Value>,
}

impl BringUp<'_> {
    /// A person does something. What the gripper has sent until then is forgotten.
    fn act(&mut self, action: Action) -> Result<()> {
        self.operator.act(action)?;
        self.gripper.observe(OLD).map(|_| ())
    }

    /// Keeps a value.
    fn note(&mut self, name: &str, value: f64) {
        self.values.push(Value { name: name.to_owned(), value, limits: None });
    }

    /// Keeps a value that must be within limits.
    fn check(&mut self, name: &str, value: f64, [min, max]: [f64; 2]) -> Result<()> {
        let checked = Value { name: name.to_owned(), value, limits: Some([min, max]) };
        let is_within = checked.is_within();
        self.values.push(checked);
        if !is_within {
            bail!("{name} is {value:.4}, expected is {min:.4} to {max:.4}");
        }
        Ok(())
    }
}

/// A step has failed.
#[derive(Debug)]
pub struct StepFailure {
    /// Number from 1.
    pub step: usize,
    /// What was found.
    pub finding: String,
}

impl fmt::Display for StepFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Step { name, otherwise, .. } = &STEPS[self.step - 1];
        write!(f, "step {} ({name}): {}. {otherwise}", self.step, self.finding)
    }
}

impl std::error::Error for StepFailure {}

/// Does the steps that are missing from a record; `save` is called after each with the record. The limits of the bench stay until
/// [`sign_off`].
///
/// # Errors
/// [`StepFailure`], or the record cannot be saved.
pub fn run(
    source: &mut dyn Source,
    credentials: Credentials,
    operator: &mut dyn Operator,
    expected: Expected,
    record: &mut Record,
    mut save: impl FnMut(&Record) -> Result<()>,
) -> Result<()> {
    while let Some(step) = record.next() {
        let Step { name, run, .. } = &STEPS[step - 1];
        let gripper = Gripper { source, credentials };
        let mut doing = BringUp { gripper, operator, expected, values: Vec::new() };
        let done = doing.act(Action::Connect(step - 1)).and_then(|()| run(&mut doing));
        let values = doing.values;
        let name = (*name).to_owned();
        record.steps.push(StepRecord { step, name, passed: done.is_ok(), values });
        save(record)?;
        if let Err(error) = done {
            return Err(StepFailure { step, finding: format!("{error:#}") }.into());
        }
    }
    Ok(())
}

/// Removes the limits of the bench, from the next boot on.
///
/// # Errors
/// Steps are missing, or the connection is lost.
pub fn sign_off(
    source: &mut dyn Source,
    credentials: Credentials,
    record: &mut Record,
    name: &str,
) -> Result<()> {
    if let Some(step) = record.next() {
        bail!("step {step} is not passed");
    }
    Gripper { source, credentials }.set_bench(false)?;
    record.signed_by = Some(name.to_owned());
    Ok(())
}

/// The table of `firmware/BRING-UP.md`.
pub fn document() -> String {
    let mut text =
        "| step | connect | expected | otherwise |\n| --- | --- | --- | --- |\n".to_owned();
    for (number, step) in (1..).zip(&STEPS) {
        let (Step { name, connect, otherwise, .. }, expected) = (step, step.expectation());
        let _ = writeln!(text, "| {number} {name} | {connect} | {expected} | {otherwise} |");
    }
    text
}
