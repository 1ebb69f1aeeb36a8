//! A proposed recording as text and JSON: what it decides, and its steps.

use analysis::diagnose::recording_plan::{MAX_S, PlannedDecision, RecordingProposal};
use serde_json::{Value, json};
use sim::campaign::plan::RecordingPlan;

use super::terminal;

/// Columns of the table of decisions.
pub const COLUMNS: [&str; 3] = ["effects", "now", "with it"];

/// Number and duration of the proposed recordings.
pub fn heading(proposal: &RecordingProposal) -> String {
    let plan = &proposal.plan;
    match (plan.steps.is_empty(), plan.recordings) {
        (true, _) if proposal.decisions.is_empty() => {
            "Nothing is open that another recording could decide".to_owned()
        }
        (true, _) => format!(
            "No recordings of up to {MAX_S:.0} s together would decide more; those described for each effect need more time, or \
             what a plan cannot do"
        ),
        (false, 1) => format!("Plan: a recording of {:.0} s", plan.seconds()),
        (false, count) => format!("Plan: {count} recordings of {:.0} s each", plan.seconds()),
    }
}

/// Cells of a row of the table.
pub fn decision_cells(decision: &PlannedDecision) -> [String; 3] {
    [decision.effects.join(" or "), percent(decision.power_now), percent(decision.power_planned)]
}

/// What proposed recordings decide, with predicted probabilities, and their steps.
pub fn format_proposal(proposal: &RecordingProposal) -> String {
    let RecordingProposal { plan, decisions, left } = proposal;
    let mut text = format!("{}\n", heading(proposal));
    if !decisions.is_empty() {
        text += "Predicted probability of the right decision:\n";
        let mut table = terminal::table(COLUMNS);
        decisions.iter().for_each(|one| {
            table.add_row(decision_cells(one));
        });
        terminal::right_align(&mut table, 1);
        text += &format!("{table}\n");
    }
    text += &format_steps(plan);
    if let Some(note) = several(plan) {
        text += &terminal::paragraph(&note);
    }
    if !left.is_empty() {
        text += &terminal::paragraph(&format!(
            "Not planned for: {} (see the reasons above).",
            left.join(", ")
        ));
    }
    text
}

/// Why the plan has several recordings, if it has.
pub fn several(plan: &RecordingPlan) -> Option<String> {
    let is_warmed = plan.steps.iter().any(|step| step.temperature_k != 0.0);
    let other =
        if is_warmed { " In the second one the temperature changes the other way." } else { "" };
    (plan.recordings > 1 && !plan.steps.is_empty()).then(|| {
        format!(
            "{} recordings: what a model learns from one is validated on another.{other}",
            plan.recordings
        )
    })
}

/// The steps as instructions, with their start.
pub fn format_steps(plan: &RecordingPlan) -> String {
    let mut start_s = 0.0;
    let mut text = String::new();
    for (number, step) in (1..).zip(&plan.steps) {
        let end_s = start_s + step.seconds;
        text += &terminal::paragraph(&format!(
            "{number}. {start_s:.0} to {end_s:.0} s: {}.",
            step.instruction()
        ));
        start_s = end_s;
    }
    text
}

pub fn to_json(proposal: &RecordingProposal) -> Value {
    json!({
        "plan": proposal.plan,
        "seconds": f64::from(proposal.plan.recordings) * proposal.plan.seconds(),
        "decisions": proposal.decisions,
        "not_planned_for": proposal.left,
    })
}

/// A probability; close to 0 and 1 as a bound, because it is predicted from a linearised model.
fn percent(probability: f64) -> String {
    match 100.0 * probability {
        low if low < 1.0 => "< 1 %".to_owned(),
        high if high > 99.0 => "> 99 %".to_owned(),
        percent => format!("{percent:.0} %"),
    }
}

#[cfg(test)]
mod tests {
    use sim::campaign::plan::{AttitudePattern, LoadPattern, PlanStep};

    use super::*;

    #[test]
    fn proposal_states_decisions_steps_and_what_is_left() {
        let step = PlanStep {
            seconds: 25.0,
            load: LoadPattern::Hold,
            load_n: [150.0, 140.0],
            opening_mm: [10.0, 10.0],
            temperature_k: 8.0,
            attitude: AttitudePattern::Level,
        };
        let mut plan = RecordingPlan::new(vec![step]);
        plan.recordings = 2;
        let decision = |effects: &[&str], power_planned| PlannedDecision {
            effects: effects.iter().map(|name| (*name).to_owned()).collect(),
            power_now: 0.0,
            power_planned,
        };
        let decisions =
            vec![decision(&["creep", "viscous_lag"], 0.997), decision(&["tip_slope"], 0.42)];
        let proposal =
            RecordingProposal { plan, decisions, left: vec!["external_magnet".to_owned()] };
        let text = format_proposal(&proposal);
        for part in [
            "Plan: 2 recordings of 25 s each",
            "creep or viscous_lag   < 1 %   > 99 %",
            "tip_slope              < 1 %     42 %",
            "2 recordings: what a model learns from one is validated on another. In the second one the",
            "temperature changes the other way.",
            "1. 0 to 25 s: hold 150 N lateral and 140 N longitudinal for 15 s, then release;",
            "keep the opening at\n10 mm; warm by 8 K.",
            "Not planned for: external_magnet",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let json = to_json(&proposal);
        assert_eq!(json["seconds"], 50.0);
        assert_eq!(json["plan"]["step"][0]["load"], "hold");
        let nothing = RecordingProposal {
            plan: RecordingPlan::new(Vec::new()),
            decisions: Vec::new(),
            left: Vec::new(),
        };
        let text = format_proposal(&nothing);
        assert_eq!(text, "Nothing is open that another recording could decide\n");
        let hopeless =
            RecordingProposal { decisions: vec![decision(&["tip_slope"], 0.0)], ..nothing };
        let text = format_proposal(&hopeless);
        assert!(
            text.starts_with("No recordings of up to 60 s together would decide more; "),
            "{text}"
        );
    }
}
