//! Result of a session, as JSON and as text.

use anyhow::Error;
use serde_json::{Value, json};

use super::log::{CommandLog, Measured, event_line};
use super::result_code::ResultCode;

/// How a session ended.
pub struct Outcome {
    pub code: ResultCode,
    /// Why it is not [`ResultCode::Reached`].
    pub error: Option<Error>,
    /// Measurements when the result was determined.
    pub measured: Measured,
    /// The set-point was reached at any time.
    pub is_reached: bool,
    /// The drive is disabled.
    pub is_disabled: bool,
    /// What is gripped is left gripped.
    pub is_left_gripped: bool,
    pub(super) gripper: String,
    pub(super) log: CommandLog,
}

impl Outcome {
    /// Last JSON object of the events of a session.
    pub fn result_line(&self) -> String {
        event_line("result", &self.result_json()) + "\n"
    }

    /// The session as JSON.
    pub fn json(&self) -> Value {
        json!({
            "simulated": false,
            "gripper": self.gripper,
            "result": self.result_json(),
            "reached": self.is_reached,
            "error": self.error_text(),
            "disabled": self.is_disabled,
            "left_gripped": self.is_left_gripped,
            "states": self.log.states,
            "points": self.log.points,
            "faults": self.log.faults,
        })
    }

    pub fn result_json(&self) -> Value {
        let mut result = json!(self.measured);
        result["code"] = self.code.name().into();
        result["status"] = self.code.status().into();
        result["error"] = self.error_text().into();
        result
    }

    fn error_text(&self) -> Option<String> {
        self.error.as_ref().map(|error| format!("{error:#}"))
    }

    /// The session as text, if it has no error.
    pub fn text(&self) -> String {
        let Measured { force_n, opening_mm, .. } = &self.measured;
        let values = force_n.zip(*opening_mm).map_or_else(String::new, |(force_n, opening_mm)| {
            format!(" with {force_n:.1} N at {opening_mm:.2} mm")
        });
        format!("Done{values}. The gripper is in state {}.\n", self.log.state_text())
    }
}
