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
    /// Decisions predicted for a proposed recording; none where no recording is planned.
    pub predicted: Option<PredictedCounts>,
    /// Comparison of the discovered formulas with the simulated effect; none where no formula is expected.
    pub formulas: Option<FormulaEvaluation>,
}

/// Open questions of a diagnosis, and what became of them with the recording that it proposed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PredictedCounts {
    /// Open questions that a recording could decide by their kind.
    pub open: usize,
    /// Those of which the proposal predicts a decision.
    pub predicted: usize,
    /// Those that were decided rightly.
    pub right: usize,
}

impl PredictedCounts {
    /// Compares the diagnosis `first`, with its proposal, with that of all recordings together.
    pub fn new(case: &Case, first: &Value, again: &Value) -> Self {
        let proposal = &first["proposal"];
        let accepted = accepted(again);
        let mut counts =
            Self { open: proposal["decisions"].as_array().map_or(0, Vec::len), ..Self::default() };
        for decision in names(&proposal["plan"]["decides"]) {
            counts.predicted += 1;
            let effects: Vec<&str> = decision.split(" or ").collect();
            // A simulated effect is present, alone or among others that the question does not separate from it; the others are
            // not, except among such.
            let is_right = |effect: &str| match accepted.iter().find(|step| step.contains(&effect))
            {
                Some(step) => {
                    let of_question = effects.iter().filter(|name| step.contains(name)).count();
                    of_question == 1 && step.iter().any(|name| case.hides(name))
                }
                None => verdict(again, effect) != "not_judgeable" && !case.hides(effect),
            };
            counts.right += usize::from(effects.iter().all(|effect| is_right(effect)));
        }
        counts
    }
}

/// Strings of an array.
fn names(value: &Value) -> Vec<&str> {
    value.as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

/// Accepted steps, each one effect or several equivalent ones.
fn accepted(output: &Value) -> Vec<Vec<&str>> {
    output["accepted"].as_array().into_iter().flatten().map(names).collect()
}

/// Verdict on an effect; empty where there is none.
fn verdict<'a>(output: &'a Value, id: &str) -> &'a str {
    let mut verdicts = output["verdicts"].as_array().into_iter().flatten();
    let own = verdicts.find(|verdict| verdict["effect"] == *id);
    own.and_then(|own| own["verdict"].as_str()).unwrap_or("")
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
            _ if self.predicted.is_some_and(|of| of.right < of.predicted) => "NOT DECIDED",
            _ if self.predicted.is_some_and(|of| of.predicted == 0) => "no plan",
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
    let accepted = accepted(output);
    let is_true = |name: &str| case.hides(name);
    let false_steps = || accepted.iter().filter(|step| !step.iter().any(|name| is_true(name)));
    let holds = |id: &str| accepted.iter().find(|step| step.contains(&id));
    let right = false_steps().count() == 0
        && match &case.expected {
            Expected::Names => case.hidden.iter().all(|(id, _)| holds(id).is_some()),
            Expected::NoName(_) | Expected::Formula(_) => true,
            Expected::Verdict(id, verdicts) => verdicts.contains(&verdict(output, id)),
            Expected::PredictedDecisions => true,
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
        predicted: None,
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
    fn predicted_decision_is_right_if_it_names_the_simulated_effect_alone() {
        let mut case = of(Group::Planned, 1..2).remove(0);
        case.hidden = vec![("viscous_lag", 1.0)];
        let first = |decides: &str| json!({ "proposal": { "decisions": [{}, {}], "plan": { "decides": [decides] } } });
        let both = "hysteresis or viscous_lag";
        for (decides, accepted, verdict, right) in [
            (both, json!([["viscous_lag"]]), "shadow", true),
            (both, json!([["viscous_lag", "hysteresis"]]), "tied", false),
            (both, json!([["hysteresis"]]), "found", false),
            (both, json!([]), "not_judgeable", false),
            // Not separated by the question.
            (both, json!([["viscous_lag", "clock_skew"]]), "shadow", true),
            ("hysteresis", json!([["viscous_lag"]]), "absent", true),
            ("hysteresis", json!([["viscous_lag"]]), "not_judgeable", false),
            ("viscous_lag", json!([]), "absent", false),
        ] {
            let verdicts = [json!({ "effect": "hysteresis", "verdict": verdict })];
            let again = json!({ "accepted": accepted, "verdicts": verdicts });
            let counts = PredictedCounts::new(&case, &first(decides), &again);
            let expected = PredictedCounts { open: 2, predicted: 1, right: usize::from(right) };
            assert_eq!(counts, expected, "{decides}: {again}");
        }
        let none = PredictedCounts::new(&case, &json!({ "proposal": null }), &json!({}));
        assert_eq!(none, PredictedCounts::default());
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
