//! What a diagnosis leaves open: equivalent effects, inconclusive ones, and the residual that no effect explains.

use analysis::diagnose::remaining_structure::RemainingStructure;
use analysis::diagnose::{Diagnosis, Unexplained, Verdict, VerdictKind};
use analysis::numbers::{self, signal};
use model_export::effects::find;
use model_export::recordings::columns::SignalUnit;
use serde_json::{Value, json};

use super::conclusion::at_floor_note;
use super::reasons::{group_reason, reason, residual_follows};
use super::verdicts::listed;
use crate::text::terminal::{GOOD, HEADING, WARNING, narrow, narrow_styled};

/// Equivalent effects, and the experiments that would distinguish them.
#[derive(Clone, Debug, PartialEq)]
pub struct EquivalentSet {
    pub effects: Vec<String>,
    /// Why they are confusable, by pair, where the catalogue has a reason.
    pub alike: Vec<String>,
    /// Effects, and the experiment that would decide on them.
    pub record: Vec<(String, String)>,
}

/// All sets of equivalent effects, in the order of the verdicts.
pub fn equivalent_sets(diagnosis: &Diagnosis) -> Vec<EquivalentSet> {
    let mut ties: Vec<EquivalentSet> = Vec::new();
    for verdict in diagnosis.verdicts.iter().filter(|v| v.kind == VerdictKind::Tied) {
        if ties.iter().any(|tie| tie.effects.contains(&verdict.effect)) {
            continue;
        }
        let effects: Vec<String> =
            std::iter::once(&verdict.effect).chain(&verdict.tied_with).cloned().collect();
        let members = diagnosis.verdicts.iter().filter(|v| effects.contains(&v.effect));
        let equivalent_formulas =
            diagnosis.equivalent_formulas.iter().filter(|formula| effects.contains(&formula.name));
        let texts = equivalent_formulas.flat_map(|formula| &formula.models).filter_map(|model| {
            let text = model.expression.as_deref()?;
            Some(format!("A formula leaves the same error: {text}"))
        });
        let alike = alike(&effects).into_iter().chain(texts).collect();
        ties.push(EquivalentSet { alike, record: records(members), effects });
    }
    ties
}

/// Why effects are confusable: "neighbour_magnet and motor_leakage: closing requires current".
fn alike(effects: &[String]) -> Vec<String> {
    let mut said = Vec::new();
    for (i, one) in effects.iter().enumerate() {
        for other in &effects[i + 1..] {
            let why = |one: &str, other: &str| {
                let confused = find(one).ok()?.confused_with.iter();
                confused.clone().find(|(id, _)| *id == other).map(|c| c.1)
            };
            if let Some(why) = why(one, other).or_else(|| why(other, one)) {
                said.push(format!("{one} and {other}: {why}"));
            }
        }
    }
    said
}

/// Recordings to make, each with the effects it would decide on.
fn records<'a>(verdicts: impl Iterator<Item = &'a Verdict>) -> Vec<(String, String)> {
    let mut list: Vec<(String, String)> = Vec::new();
    for verdict in verdicts.filter(|verdict| !verdict.record.is_empty()) {
        match list.iter_mut().find(|(_, record)| *record == verdict.record) {
            Some((effects, _)) => *effects += &format!(", {}", verdict.effect),
            None => list.push((verdict.effect.clone(), verdict.record.clone())),
        }
    }
    list
}

/// Inconclusive effects with the same reason.
#[derive(Clone, Debug, PartialEq)]
pub struct InconclusiveGroup {
    pub effects: Vec<String>,
    pub why: String,
    /// Effects, and the recording that would decide on them; empty while unexplained structure prevents it.
    pub record: Vec<(String, String)>,
}

/// Inconclusive effects, grouped by reason.
pub fn inconclusive_groups(diagnosis: &Diagnosis) -> Vec<InconclusiveGroup> {
    let verdicts = diagnosis.verdicts.iter();
    let open: Vec<&Verdict> = verdicts.filter(|v| v.kind == VerdictKind::Inconclusive).collect();
    let mut reasons: Vec<String> = Vec::new();
    for verdict in &open {
        let reason = group_reason(verdict);
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    let of_reason = |why: String| {
        let members: Vec<&Verdict> =
            open.iter().copied().filter(|v| group_reason(v) == why).collect();
        let first = members.first().map_or_else(String::new, |verdict| reason(verdict));
        let alike = members.iter().all(|verdict| reason(verdict) == first);
        let helps = members.iter().copied().filter(|v| !v.provisional);
        InconclusiveGroup {
            effects: members.iter().map(|verdict| verdict.effect.clone()).collect(),
            why: if alike { first } else { why },
            record: records(helps),
        }
    };
    reasons.into_iter().map(of_reason).collect()
}

/// Effects with equal evidence, and the recordings that would separate them.
pub(super) fn equivalent_effects(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for tie in equivalent_sets(diagnosis) {
        page += &narrow_styled(
            HEADING,
            &format!("Equivalent on these data: {}", tie.effects.join(", ")),
        );
        for alike in &tie.alike {
            page += &narrow(&format!("  {alike}."));
        }
        page += &suggested_recordings("To separate them, record", &tie.record);
        page.push('\n');
    }
    page
}

/// Inconclusive effects by reason.
pub(super) fn inconclusive_effects(diagnosis: &Diagnosis) -> String {
    let groups = inconclusive_groups(diagnosis);
    if groups.is_empty() {
        return String::new();
    }
    let mut page = format!("{HEADING}Inconclusive from these recordings{HEADING:#}\n");
    for group in groups {
        page += &narrow(&format!("  {}: {}.", listed(&group.effects), group.why));
        page += &suggested_recordings("Record", &group.record);
    }
    page + "\n"
}

fn suggested_recordings(head: &str, list: &[(String, String)]) -> String {
    let mut page = String::new();
    for (effects, record) in list {
        page += &match list.len() {
            1 => narrow(&format!("    {head}: {record}")),
            _ => narrow(&format!("    {head}, for {effects}: {record}")),
        };
    }
    page
}

/// The residual that no effect explains.
pub(super) fn unexplained_residual(diagnosis: &Diagnosis) -> String {
    if diagnosis.at_floor {
        return narrow_styled(GOOD, &at_floor_note(diagnosis)) + "\n";
    }
    let mut page = String::new();
    for one in &diagnosis.unexplained {
        page += &narrow_styled(WARNING, &unexplained(one));
    }
    if let Some(structure) = &diagnosis.remaining {
        page += &narrow_styled(WARNING, &remaining(structure, diagnosis.noise.unit));
    }
    if diagnosis.unexplained.is_empty() {
        return page;
    }
    page + &narrow(&format!("  {EXPR_HINT}")) + "\n"
}

/// "UNEXPLAINED: 84 % of the residual follows the rotor angle (motor_angle_rad)".
pub fn unexplained(of: &Unexplained) -> String {
    format!("UNEXPLAINED: {} ({})", residual_follows(of), of.covariate)
}

/// "NOT LOCATED: 40 % of the excess of 0.31 G over the noise follows no covariate. The residual stays alike for 1.2 s, oscillates
/// at 0.4 Hz, and is on sensor 0 z (60 %), sensor 2 z (30 %)".
pub fn remaining(structure: &RemainingStructure, unit: SignalUnit) -> String {
    let oscillates = match structure.peak_hz {
        Some(hz) => format!("oscillates at {} Hz", numbers::decimal(hz, 2)),
        None => "has no dominant frequency".to_owned(),
    };
    let channels = structure.channels.iter().map(|channel| {
        format!("sensor {} {} ({:.0} %)", channel.sensor, channel.axis, 100.0 * channel.share)
    });
    let recordings = structure
        .recordings
        .iter()
        .map(|one| format!(", in recording {} ({:.0} %)", one.recording, 100.0 * one.share));
    format!(
        "NOT LOCATED: {:.0} % of the excess of {} over the noise follows no covariate. The residual stays alike for {} s, \
         {oscillates}, and is on {}{}",
        100.0 * structure.share,
        signal(structure.excess_g, unit),
        numbers::decimal(structure.correlation_s, 2),
        channels.collect::<Vec<_>>().join(", "),
        recordings.collect::<String>()
    )
}

pub const EXPR_HINT: &str =
    "No effect of the catalogue explains it. Test a formula of your own with --expr.";

/// Located shares, then what follows no covariate; empty at the noise floor only.
pub(super) fn unexplained_json(diagnosis: &Diagnosis) -> Vec<Value> {
    let located = diagnosis.unexplained.iter().map(|one| json!(one));
    let remaining = diagnosis.remaining.iter().map(|structure| {
        let mut object = json!(structure);
        object["covariate"] = Value::Null;
        object
    });
    located.chain(remaining).collect()
}

/// What was not recorded or does not vary, and the effects on which it would decide; empty if nothing is missing.
pub fn missing_columns(diagnosis: &Diagnosis) -> String {
    let mut columns: Vec<(String, Vec<&str>)> = Vec::new();
    for verdict in &diagnosis.verdicts {
        let Some(what) = verdict.reason.missing_data() else { continue };
        match columns.iter_mut().find(|(own, _)| *own == what) {
            Some((_, effects)) => effects.push(&verdict.effect),
            None => columns.push((what, vec![&verdict.effect])),
        }
    }
    let missing: Vec<String> = columns
        .iter()
        .map(|(what, effects)| format!("{what}: nothing can be said on {}", effects.join(", ")))
        .collect();
    if missing.is_empty() { String::new() } else { format!("{}.", missing.join("; ")) }
}
