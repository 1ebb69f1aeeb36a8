//! The verdicts of a diagnosis as a table, and the accepted effects.

use analysis::diagnose::candidates::LEVEL;
use analysis::diagnose::fitted_model::MIN_GAIN;
use analysis::diagnose::{Diagnosis, Reason, Verdict, VerdictKind};
use analysis::numbers;
use model_export::effects::find;
use model_export::inverse::device_support::DeviceSupport;
use serde_json::{Value, json};

use super::conclusion::one_recording;
use super::reasons::{reason, reason_sentence, short_reason, value};
use crate::text::terminal::{self, HEADING, NARROW_WIDTH, narrow, narrow_styled, or_dash};

/// Minimum gain that is shown where a large unexplained residual prevents the verdicts.
const MIN_SHOWN: f64 = 0.01;

/// Maximum number of effects in a list.
const MAX_LISTED: usize = 6;

/// The verdicts with something to say, and how many others a large unexplained residual prevents.
fn shown_verdicts(diagnosis: &Diagnosis) -> (Vec<&Verdict>, usize) {
    let says_nothing = |verdict: &&Verdict| {
        matches!(verdict.reason, Reason::UnexplainedResidual(_)) && verdict.gain < MIN_SHOWN
    };
    let (hidden, shown): (Vec<_>, Vec<_>) = diagnosis.verdicts.iter().partition(says_nothing);
    if hidden.len() > MAX_LISTED {
        (shown, hidden.len())
    } else {
        (diagnosis.verdicts.iter().collect(), 0)
    }
}

/// The names, or how many they are.
pub fn listed(effects: &[String]) -> String {
    match effects.len() {
        count if count > MAX_LISTED => format!("{count} effects"),
        _ => effects.join(", "),
    }
}

pub(super) fn verdict_table(diagnosis: &Diagnosis) -> String {
    // The page has both.
    let has_forces = diagnosis.verdicts.iter().any(|verdict| verdict.excess_n.is_some());
    let error = if has_forces { "excess / N" } else { "gain" };
    let mut table = terminal::table(["effect", "verdict", error, "p", "magnitude or reason"]);
    table.set_width(NARROW_WIDTH);
    let (shown, hidden) = shown_verdicts(diagnosis);
    for verdict in shown {
        table.add_row([
            verdict.effect.clone(),
            verdict_label(verdict),
            match (has_forces, verdict.excess_n) {
                (true, None) => "-".to_owned(),
                (true, Some(excess_n)) => format!("{excess_n:.3}"),
                (false, _) => {
                    or_dash(verdict.gain, format!("{:.1} %", 100.0 * verdict.gain.max(0.0)))
                }
            },
            or_dash(verdict.p_adjusted, format!("{:.3}", verdict.p_adjusted)),
            short_reason(verdict),
        ]);
    }
    if hidden > 0 {
        table.add_row([
            format!("{hidden} others"),
            "INCONCLUSIVE".to_owned(),
            if has_forces { "-".to_owned() } else { format!("< {:.0} %", 100.0 * MIN_SHOWN) },
            "-".to_owned(),
            "much is unexplained".to_owned(),
        ]);
    }
    let mut page = format!("{table}\n");
    if diagnosis.verdicts.iter().any(|v| is_present(v) && v.provisional) {
        page += &narrow(PROVISIONAL_NOTE);
    }
    if diagnosis.verdicts.iter().any(|v| v.kind == VerdictKind::Shadow) {
        page += &narrow(SHADOW_NOTE);
    }
    page + &narrow(&significance_note(diagnosis)) + "\n"
}

/// How gain and p-value were computed.
pub fn significance_note(diagnosis: &Diagnosis) -> String {
    let [selected, all] = diagnosis.rows;
    let sampled = if selected < all {
        let recordings = match diagnosis.recordings {
            [some, every] if some < every => format!(
                ", in {some} of the {every} recordings: what acts only in the others is not found"
            ),
            _ => String::new(),
        };
        format!(
            " Effects are selected on {:.0} % of the rows{recordings}. Where the residual is white noise, standard errors are \
             {:.1} times those of all rows then. Magnitudes and errors of the accepted models are from all rows.",
            100.0 * selected as f64 / all as f64,
            (all as f64 / selected.max(1) as f64).sqrt()
        )
    } else {
        String::new()
    };
    let excess = match diagnosis.verdicts.iter().any(|verdict| verdict.excess_n.is_some()) {
        true => {
            "Excess: of the held-out force error over its noise, after the step of an accepted effect (replay), and predicted for any \
             other one added to the last step. "
        }
        false => "",
    };
    format!(
        "{excess}Gain: reduction of the held-out squared error of the field, of an accepted step relative to the step before. p: p-value of \
         a reduction by at most {} %, by the errors of {} blocks of {:.1} s, adjusted for all candidates. Present: a lower error \
         in every fold by a full fit of all rows, of a transient effect with p below {LEVEL}; p is - where only that fit is significant. < b of \
         typical: 95 % upper bound of the magnitude.{sampled}",
        100.0 * MIN_GAIN,
        diagnosis.blocks,
        diagnosis.block_s,
    )
}

/// Explanation of the question mark.
pub const PROVISIONAL_NOTE: &str =
    "A question mark: provisional, because much more than noise is unexplained.";

pub const SHADOW_NOTE: &str = "Shadow: significant by itself, but it explains part of the same residual as the effect named in its row and, \
                               next to that, nothing significant: whether it is present is open.";

/// Accepted effects: estimated and typical magnitude, evidence, physics.
pub(super) fn accepted_effects(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for verdict in diagnosis.verdicts.iter().filter(|v| is_present(v)) {
        page += &narrow_styled(HEADING, &heading(verdict));
        page += &narrow(&format!("  {}", physics(verdict)));
        let evidence = [
            reason_sentence(verdict),
            similar_effects(verdict),
            beyond_polynomial(diagnosis, verdict),
            one_recording(diagnosis).unwrap_or_default(),
        ];
        let said: Vec<String> = evidence.into_iter().filter(|said| !said.is_empty()).collect();
        page += &narrow(&format!("  {}", said.join(" ")));
        page += &device_line(&runs_on_device(diagnosis, &[&verdict.effect]));
        page.push('\n');
    }
    page
}

/// A sentence on the device as a line; nothing without one.
pub(super) fn device_line(sentence: &str) -> String {
    if sentence.is_empty() { String::new() } else { narrow(&format!("  {sentence}")) }
}

/// Whether the device compensates these effects, which act together; `None` if it is unknown.
pub(super) fn of_device<'d>(
    diagnosis: &'d Diagnosis,
    effects: &[&str],
) -> Option<&'d DeviceSupport> {
    let known = || diagnosis.device.iter().filter(|of| effects.contains(&of.effect.as_str()));
    known().find(|of| of.runs == Some(false)).or_else(|| known().next())
}

/// "Runs on the device: yes, after homing." of these effects, which act together; empty if it is unknown.
pub fn runs_on_device(diagnosis: &Diagnosis, effects: &[&str]) -> String {
    let support = of_device(diagnosis, effects);
    support.map_or_else(String::new, |support| format!("Runs on the device: {support}."))
}

/// Minimum share of a pattern that is mentioned.
const MIN_SIMILAR: f64 = 0.5;

/// "On these recordings it reproduces the patterns of clock_skew (92 %), creep (54 %)." and "Outside the catalogue, a reference that is
/// not linear can leave nearly the same."; empty where neither is known.
pub fn similar_effects(verdict: &Verdict) -> String {
    let mut said = similar_in_catalogue(verdict);
    let outside = find(&verdict.effect).map_or("", |effect| effect.similar_outside);
    if !outside.is_empty() {
        let space = if said.is_empty() { "" } else { " " };
        said += &format!("{space}Outside the catalogue, {outside} can leave nearly the same.");
    }
    said
}

fn similar_in_catalogue(verdict: &Verdict) -> String {
    let similar = verdict.reproduces.iter().filter(|(_, share)| *share >= MIN_SIMILAR);
    let parts: Vec<String> =
        similar.map(|(effect, share)| format!("{effect} ({:.0} %)", 100.0 * share)).collect();
    if parts.is_empty() {
        return String::new();
    }
    format!("On these recordings it reproduces the patterns of {}.", parts.join(", "))
}

/// Effects on the magnet that look like an accepted one, where a polynomial cannot test them.
fn beyond_polynomial(diagnosis: &Diagnosis, verdict: &Verdict) -> String {
    let confused = find(&verdict.effect).map_or(&[][..], |effect| effect.confused_with);
    let untested = diagnosis.verdicts.iter().filter(|other| {
        other.reason == Reason::NeedsGeometry && confused.iter().any(|(id, _)| *id == other.effect)
    });
    let names: Vec<&str> = untested.map(|other| other.effect.as_str()).collect();
    if names.is_empty() {
        return String::new();
    }
    format!(
        "Or it is {}: similar, and not part of a polynomial; with [design] and the cylinder base they are compared.",
        names.join(" or ")
    )
}

fn heading(verdict: &Verdict) -> String {
    match magnitude(verdict).as_str() {
        "" => verdict.effect.clone(),
        size => format!("{}: {size}", verdict.effect),
    }
}

/// Label of a verdict; a question mark if provisional.
pub fn verdict_label(verdict: &Verdict) -> String {
    let word = match verdict.kind {
        VerdictKind::Found => "FOUND",
        VerdictKind::Tied => "TIED",
        VerdictKind::Shadow => "SHADOW",
        VerdictKind::Inconclusive => "INCONCLUSIVE",
        VerdictKind::Absent => "ABSENT",
    };
    if verdict.provisional && is_present(verdict) { format!("{word}?") } else { word.to_owned() }
}

/// True for found effects, alone or tied.
pub fn is_present(verdict: &Verdict) -> bool {
    matches!(verdict.kind, VerdictKind::Found | VerdictKind::Tied)
}

/// "7.98±0.01 N, friction force; typical is 2.5 N", without unknown parts.
pub fn magnitude(verdict: &Verdict) -> String {
    let typical = find(&verdict.effect).ok().map(|effect| {
        format!("typical is {} {}", numbers::decimal(effect.size.typical, 3), effect.size.unit)
    });
    if !verdict.value.is_finite() {
        return typical.unwrap_or_default();
    }
    let value = value(verdict);
    match (find(&verdict.effect).ok(), typical) {
        (Some(effect), _) if effect.size.unit != verdict.unit => {
            format!(
                "{value}, a coefficient other than its magnitude ({}), which is not determined",
                effect.size.description
            )
        }
        (Some(effect), Some(typical)) => format!("{value}, {}; {typical}", effect.size.description),
        _ => value,
    }
}

pub fn physics(verdict: &Verdict) -> &'static str {
    find(&verdict.effect).map_or("A user-defined effect.", |effect| effect.physics)
}

pub(super) fn verdict_json(diagnosis: &Diagnosis, verdict: &Verdict) -> Value {
    json!({
        "effect": verdict.effect,
        "verdict": verdict.kind.id(),
        "provisional": verdict.provisional,
        "tied_with": verdict.tied_with,
        "reproduces": verdict.reproduces.iter().map(|(effect, share)| json!({ "effect": effect, "share": share })).collect::<Vec<_>>(),
        "excess_n": verdict.excess_n,
        "gain": verdict.gain,
        "p_adjusted": verdict.p_adjusted,
        "inclusion": verdict.inclusion,
        "value": verdict.value,
        "std_error": verdict.std_error,
        "differs": verdict.differs,
        "unit": verdict.unit,
        "z_typical": verdict.z_typical,
        "reason": reason(verdict),
        "record": verdict.record,
        "device": of_device(diagnosis, &[&verdict.effect]),
    })
}
