//! A proposed recording as text and JSON: what it decides, and its steps.

use analysis::diagnose::recording_plan::RecordingProposal;
use serde_json::{Value, json};
use sim::campaign::plan::RecordingPlan;

use super::terminal;

/// What a proposed recording decides, with predicted probabilities, and its steps; empty where nothing is open.
pub fn format_proposal(proposal: &RecordingProposal) -> String {
    let RecordingProposal { plan, decisions, left } = proposal;
    let mut text = String::new();
    if plan.steps.is_empty() {
        text += "Plan: no recording of up to 60 s would decide more.\n";
    } else {
        text += &format!(
            "Plan: {} of {:.0} s, with the predicted probability of the right decision:\n",
            if plan.recordings == 1 {
                "a recording".to_owned()
            } else {
                format!("{} recordings", plan.recordings)
            },
            plan.seconds()
        );
    }
    if !decisions.is_empty() {
        let mut table = terminal::table(["effects", "now", "with it"]);
        for one in decisions {
            table.add_row([
                one.effects.join(" or "),
                percent(one.power_now),
                percent(one.power_planned),
            ]);
        }
        terminal::right_align(&mut table, 1);
        text += &format!("{table}\n");
    }
    text += &format_steps(plan);
    if plan.recordings > 1 {
        text += &terminal::paragraph(
            "In the second recording the temperature changes the other way. Two are needed: what a model learns from one is validated on the other.",
        );
    }
    if !left.is_empty() {
        text += &terminal::paragraph(&format!(
            "Not planned for: {} (see the reasons above).",
            left.join(", ")
        ));
    }
    text
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

/// As one JSON object.
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
