//! The first power-up of a board: twelve steps, each with what to connect, what is measured and its limits. The table [`STEPS`] is
//! what `magpie board bringup` does and what `firmware/BRING-UP.md` states.
//!
//! A step measures by messages, parameters and services of the firmware. What only a person can do or read is asked of an
//! [`Operator`]. Every value is kept in a [`Record`], in which passed steps are not repeated.

mod gripper;
mod step;
mod steps;

use std::fmt::{self, Write as _};

use anyhow::{Result, bail};
use serde::{Deserialize, Serialize};

use crate::session::Credentials;
use crate::source::Source;
use gripper::Gripper;
use step::BringUp;
pub use step::{Action, Expected, Operator, Reading, Step, Value};
pub use steps::STEPS;

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
        let Step { name, connect, run, .. } = &STEPS[step - 1];
        let gripper = Gripper { source, credentials };
        let mut doing = BringUp { gripper, operator, expected, values: Vec::new() };
        let done =
            doing.act(Action::Connect { step, what: connect }).and_then(|()| run(&mut doing));
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
