//! Text and JSON of the effects on which a recording can decide.

use analysis::diagnose::Reason;
use analysis::diagnose::recording_check::RecordingCheck;
use serde_json::{Value, json};

use crate::text::diagnosis::reasons::{reason, reason_sentence, short_reason};
use crate::text::terminal::{self, NARROW_WIDTH};

/// A table of all effects, then reason and recommended recording of each inconclusive one.
pub fn format_check(check: &RecordingCheck) -> String {
    let mut table = terminal::table(["effect", "decidable", "typical magnitude or reason"]);
    table.set_width(NARROW_WIDTH);
    for (effect, z_typical) in &check.decidable {
        table.add_row([effect.as_str(), "yes", &format!("{z_typical:.0} standard errors")]);
    }
    for verdict in &check.inconclusive {
        table.add_row([verdict.effect.as_str(), "no", &short_reason(verdict)]);
    }
    let mut text = format!(
        "{table}\n{}",
        terminal::wrap(
            "Decidable: a diagnosis of this recording alone would detect a typical magnitude of the effect.",
            NARROW_WIDTH
        )
    );
    let is_unfitted = |reason: &Reason| matches!(reason, Reason::Unfitted(_));
    if let Some(verdict) = check.inconclusive.iter().find(|v| is_unfitted(&v.reason)) {
        text += &terminal::wrap(&reason_sentence(verdict), NARROW_WIDTH);
    }
    if !check.inconclusive.is_empty() {
        text += "To record for the other effects:\n";
    }
    for verdict in &check.inconclusive {
        let reason = match &verdict.reason {
            Reason::Unfitted(_) => String::new(),
            _ => reason(verdict) + ". ",
        };
        let line = format!("  {}: {reason}{}", verdict.effect, verdict.record);
        text += &terminal::wrap(&line, NARROW_WIDTH);
    }
    text
}

/// The same as one list.
pub fn check_json(check: &RecordingCheck) -> Value {
    let decidable = check.decidable.iter().map(|(effect, z_typical)| {
        json!({ "effect": effect, "decidable": true, "z_typical": z_typical })
    });
    let inconclusive = check.inconclusive.iter().map(|verdict| {
        json!({
            "effect": verdict.effect,
            "decidable": false,
            "z_typical": verdict.z_typical,
            "reason": reason(verdict),
            "record": verdict.record,
        })
    });
    decidable.chain(inconclusive).collect()
}
