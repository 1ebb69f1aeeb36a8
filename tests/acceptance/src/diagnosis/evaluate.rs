//! Comparison of a diagnosis with the simulated effects.

use std::collections::BTreeSet;

use model_export::effects::excitation::source_column;
use model_export::recordings::columns::STATOR_CURRENTS;
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
    /// Decisions that a proposed recording promised; none where no recording is planned.
    pub promised: Option<Promises>,
    /// Comparison of the discovered formulas with the simulated effect; none where no formula is expected.
    pub formulas: Option<FormulaEvaluation>,
}

/// Open questions of a diagnosis, and what became of them with the recording that it proposed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Promises {
    /// Open questions that a recording could decide by their kind.
    pub open: usize,
    /// Those of which the proposal promises a decision.
    pub promised: usize,
    /// Those that were decided rightly.
    pub kept: usize,
}

impl Promises {
    /// Compares the diagnosis `first`, with its proposal, with that of all recordings together.
    pub fn new(case: &Case, first: &Value, again: &Value) -> Self {
        let list = |value: &Value| -> Vec<String> {
            let all = value.as_array().into_iter().flatten();
            all.filter_map(Value::as_str).map(str::to_owned).collect()
        };
        let proposal = &first["proposal"];
        let mut promises =
            Self { open: proposal["decisions"].as_array().map_or(0, Vec::len), ..Self::default() };
        let accepted: Vec<Vec<String>> =
            again["accepted"].as_array().into_iter().flatten().map(list).collect();
        let verdict = |id: &str| {
            let mut verdicts = again["verdicts"].as_array().into_iter().flatten();
            verdicts
                .find(|verdict| verdict["effect"] == *id)
                .map_or("", |own| own["verdict"].as_str().unwrap_or(""))
        };
        for decision in list(&proposal["plan"]["decides"]) {
            promises.promised += 1;
            let effects: Vec<&str> = decision.split(" or ").collect();
            // A simulated effect is present, alone or among others that the question does not separate from it; the others are
            // not, except among such.
            let is_right = effects.iter().all(|effect| {
                let holds = |step: &&Vec<String>| step.iter().any(|name| name == effect);
                let step = accepted.iter().find(holds);
                let is_tied = |other: &&&str| {
                    *other != effect
                        && step.is_some_and(|step| step.iter().any(|name| name == **other))
                };
                let is_true = step.is_some_and(|step| step.iter().any(|name| case.hides(name)));
                let is_decided =
                    verdict(effect) != "not_judgeable" && effects.iter().find(is_tied).is_none();
                is_decided && if step.is_some() { is_true } else { !case.hides(effect) }
            });
            promises.kept += usize::from(is_right);
        }
        promises
    }
}

/// Maximum held-out error in noise floors of a campaign that the model explains.
pub const EXPLAINED_FLOORS: f64 = 1.15;

/// Comparison of all formulas of a diagnosis with the simulated effect. Without formulas the first two are false.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FormulaEvaluation {
    /// Together they depend on exactly the columns of the simulated effect.
    pub right_covariates: bool,
    /// With all of them the held-out error is at most [`EXPLAINED_FLOORS`].
    pub explains: bool,
    /// An effect of the catalogue is reported as found, and not provisionally: a wrong name, since none is simulated.
    pub false_name: bool,
}

impl FormulaEvaluation {
    fn new(expected: &[&str], output: &Value) -> Self {
        let formulas: &[Value] = output["formulas"].as_array().map_or(&[], Vec::as_slice);
        let columns = formulas.iter().flat_map(|formula| formula["covariates"].as_array());
        let names = columns.flatten().filter_map(Value::as_str);
        let found: BTreeSet<&str> = names.flat_map(recorded_columns).collect();
        // Every formula reports the error after all of them.
        let floors = formulas.last().and_then(|formula| formula["floors_after"].as_f64());
        let mut verdicts = output["verdicts"].as_array().into_iter().flatten();
        Self {
            false_name: verdicts.any(|verdict| {
                verdict["verdict"] == "found" && verdict["provisional"] != Value::Bool(true)
            }),
            right_covariates: !formulas.is_empty()
                && found.iter().eq(&BTreeSet::from_iter(expected.iter().copied())),
            explains: floors.is_some_and(|floors| floors <= EXPLAINED_FLOORS),
        }
    }
}

/// Recorded columns from which a covariate is derived, such as the rate of a force.
fn recorded_columns(covariate: &str) -> Vec<&str> {
    match covariate {
        "fx_rate_n_per_s" | "loading_x" => vec!["fx_n"],
        "fz_rate_n_per_s" | "loading_z" => vec!["fz_n"],
        name if STATOR_CURRENTS.contains(&name) => vec!["motor_iq_a", "motor_angle_rad"],
        name => vec![source_column(name)],
    }
}

impl Evaluation {
    /// Word in the log.
    pub fn word(&self) -> &'static str {
        match (self.right, self.wrong_alone) {
            _ if self.promised.is_some_and(|of| of.kept < of.promised) => "NOT DECIDED",
            _ if self.promised.is_some_and(|of| of.promised == 0) => "no plan",
            _ if self.formulas.is_some_and(|of| of.false_name) => "WRONG NAME",
            _ if self.formulas.is_some_and(|of| !of.right_covariates) => "NO FORMULA",
            _ if self.formulas.is_some_and(|of| !of.explains) => "UNEXPLAINED",
            _ if self.formulas.is_some() => "right",
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
            Expected::NoName(_) | Expected::Formula(_) => true,
            Expected::Verdict(id, output) => output.contains(&verdict(id)),
            Expected::PromisedDecisions => true,
        };
    let located = match &case.expected {
        Expected::NoName(Some(covariate)) => {
            let mut unexplained = output["unexplained"].as_array().into_iter().flatten();
            let is_unexplained = unexplained.any(|one| one["covariate"] == *covariate);
            let formulas = output["formulas"].as_array().into_iter().flatten();
            let names = formulas.filter_map(|formula| formula["covariates"].as_array()).flatten();
            let mut columns = names.filter_map(Value::as_str).flat_map(recorded_columns);
            Some(is_unexplained || columns.any(|column| column == *covariate))
        }
        _ => None,
    };
    Evaluation {
        right,
        wrong_alone: false_steps().any(|step| step.len() == 1),
        tied: case.hidden.first().and_then(|(id, _)| holds(id)).map(Vec::len),
        located,
        promised: None,
        formulas: match case.expected {
            Expected::Formula(covariates) => Some(FormulaEvaluation::new(covariates, output)),
            _ => None,
        },
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::cases::{Group, of};
    use super::*;

    fn formulas(output: &Value) -> FormulaEvaluation {
        let cases = of(Group::Outside, 1..2);
        let case = cases.iter().find(|case| case.hides("cable_pull")).unwrap();
        evaluate(case, output).formulas.unwrap()
    }

    fn formula(covariates: &[&str], floors_after: f64) -> Value {
        json!({ "expression": "f: fx_n = a*x", "covariates": covariates, "floors_after": floors_after })
    }

    #[test]
    fn formulas_together_need_exactly_the_true_covariates() {
        let [opening, acceleration, other] =
            ["opening_mm", "accel_y_mps2", "temp_c"].map(|name| formula(&[name], 1.1));
        let both = formula(&["accel_y_mps2", "opening_mm"], 1.1);
        for (found, right) in [
            (json!([both]), true),
            (json!([opening, acceleration]), true),
            (json!([both, opening]), true),
            (json!([opening]), false),
            (json!([both, other]), false),
            (json!([]), false),
            (Value::Null, false),
        ] {
            let found = formulas(&json!({ "formulas": found }));
            assert_eq!((found.right_covariates, found.false_name), (right, false));
        }
        assert!(!formulas(&json!({})).explains);
    }

    #[test]
    fn derived_covariates_count_as_their_recorded_columns() {
        let columns: BTreeSet<&str> = ["fz_rate_n_per_s", "motor_alpha_a", "temp_c"]
            .iter()
            .flat_map(|name| recorded_columns(name))
            .collect();
        assert_eq!(columns, BTreeSet::from(["fz_n", "motor_angle_rad", "motor_iq_a", "temp_c"]));
    }

    #[test]
    fn error_after_all_formulas_decides_whether_they_explain() {
        for (floors, explains) in [(1.15, true), (1.16, false)] {
            let found = json!({ "formulas": [formula(&["opening_mm"], 3.0), formula(&["temp_c"], floors)] });
            assert_eq!(formulas(&found).explains, explains);
        }
    }

    #[test]
    fn only_a_definite_catalogue_effect_is_a_false_name() {
        for (verdict, provisional, expected) in [
            ("found", false, true),
            ("found", true, false),
            ("tied", false, false),
            ("absent", false, false),
        ] {
            let verdicts =
                [json!({ "effect": "creep", "verdict": verdict, "provisional": provisional })];
            assert_eq!(
                formulas(&json!({ "verdicts": verdicts })).false_name,
                expected,
                "{verdict}"
            );
        }
    }

    #[test]
    fn outside_group_has_every_effect_outside_the_catalogue() {
        let cases = of(Group::Outside, 1..4);
        let outside = sim::effects::EFFECT_KINDS.iter().filter(|kind| !kind.is_in_catalogue);
        assert!(outside.clone().all(|kind| cases.iter().any(|case| case.hides(kind.id))));
        assert_eq!(cases.len(), 3 * outside.count());
        let with_formula =
            cases.iter().filter(|case| matches!(case.expected, Expected::Formula(_)));
        assert_eq!(with_formula.count(), 3 * 12);
    }
}
