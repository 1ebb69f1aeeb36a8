//! Comparison of a diagnosis with the simulated effects.

use serde_json::Value;

use super::cases::{Case, Expected};

/// Correctness of a diagnosis.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// The diagnosis is as expected and contains nothing false.
    pub right: bool,
    /// An effect that was not simulated was named, without an equivalent alternative.
    pub wrong_alone: bool,
    /// Size of the set of equivalent effects that contains the first simulated effect.
    pub tied: Option<usize>,
    /// Whether the expected covariate was located; none without one.
    pub located: Option<bool>,
}

impl Evaluation {
    /// Word in the log.
    pub fn word(&self) -> &'static str {
        match (self.right, self.wrong_alone) {
            (_, true) => "WRONG NAME",
            (true, _) if self.located == Some(false) => "NOT LOCATED",
            (true, _) => "right",
            (false, false) => "missed",
        }
    }
}

/// Evaluates the JSON output of `magpie diagnose`.
pub fn evaluate(case: &Case, output: &Value) -> Evaluation {
    let accepted: Vec<Vec<&str>> = output["accepted"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|step| step.as_array().into_iter().flatten().filter_map(Value::as_str).collect())
        .collect();
    let is_true = |name: &str| case.hides(name);
    let false_steps = || accepted.iter().filter(|step| !step.iter().any(|name| is_true(name)));
    let holds = |id: &str| accepted.iter().find(|step| step.contains(&id));
    let verdict = |id: &str| {
        let mut verdicts = output["verdicts"].as_array().into_iter().flatten();
        let own = verdicts.find(|verdict| verdict["effect"] == *id);
        own.and_then(|own| own["verdict"].as_str()).unwrap_or("")
    };
    let right = false_steps().count() == 0
        && match &case.expected {
            Expected::Names => case.hidden.iter().all(|(id, _)| holds(id).is_some()),
            Expected::NoName(_) => true,
            Expected::Verdict(id, output) => output.contains(&verdict(id)),
        };
    let located = match &case.expected {
        Expected::NoName(Some(covariate)) => {
            let mut unexplained = output["unexplained"].as_array().into_iter().flatten();
            Some(unexplained.any(|one| one["covariate"] == *covariate))
        }
        _ => None,
    };
    Evaluation {
        right,
        wrong_alone: false_steps().any(|step| step.len() == 1),
        tied: case.hidden.first().and_then(|(id, _)| holds(id)).map(Vec::len),
        located,
    }
}
