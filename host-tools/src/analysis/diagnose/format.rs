//! Texts of a diagnosis, shared by terminal and report.

use crate::analysis::diagnose::{Diagnosis, StaircaseStep, Unexplained, Verdict, VerdictKind};
use crate::terminal;
use model_export::effects::find;

/// A magnitude with a larger relative standard error is not identifiable.
const MAX_RELATIVE_ERROR: f64 = 10.0;

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

/// Explanation of the question mark.
pub const PROVISIONAL_NOTE: &str =
    "A question mark: provisional, because much more than noise is unexplained.";

/// Note where the residual is at the noise floor.
pub fn at_floor_note(diagnosis: &Diagnosis) -> String {
    let with = if diagnosis.accepted.is_empty() { "" } else { " with what was found" };
    format!(
        "AT NOISE FLOOR{with}: what is left is indistinguishable from noise. A further effect would fit noise."
    )
}

/// True for found effects, alone or tied.
pub fn is_present(verdict: &Verdict) -> bool {
    matches!(verdict.kind, VerdictKind::Found | VerdictKind::Tied)
}

/// "7.98±0.01 N, friction force; typical is 2.5 N", without unknown parts.
pub fn magnitude(verdict: &Verdict) -> String {
    let typical = find(&verdict.effect).ok().map(|effect| {
        format!("typical is {} {}", terminal::decimal(effect.size.typical, 3), effect.size.unit)
    });
    if !verdict.value.is_finite() {
        return typical.unwrap_or_default();
    }
    let value = value(verdict.value, verdict.std_error, &verdict.unit);
    match (find(&verdict.effect).ok(), typical) {
        (Some(effect), Some(typical)) => format!("{value}, {}; {typical}", effect.size.description),
        _ => value,
    }
}

/// "7.98±0.01 N", or that the magnitude is not identifiable.
pub fn value(value: f64, std_error: f64, unit: &str) -> String {
    if std_error > MAX_RELATIVE_ERROR * value.abs() {
        return "not identifiable".to_owned();
    }
    let value = terminal::with_error(value, std_error, value.abs());
    format!("{value} {unit}").trim_end().to_owned()
}

/// Physics of the effect, one paragraph.
pub fn physics(verdict: &Verdict) -> &'static str {
    find(&verdict.effect).map_or("A user-defined effect.", |effect| effect.physics)
}

/// The reason as a sentence.
pub fn reason_sentence(verdict: &Verdict) -> String {
    let mut letters = verdict.reason.chars();
    let first = letters.next().map(|letter| letter.to_uppercase());
    format!("{}{}.", first.into_iter().flatten().collect::<String>(), letters.as_str())
}

/// Equivalent effects, and the experiments that would distinguish them.
#[derive(Clone, Debug, PartialEq)]
pub struct EquivalentSet {
    /// Names of the effects.
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
        ties.push(EquivalentSet { alike: alike(&effects), record: records(members), effects });
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
    /// Names of the effects.
    pub effects: Vec<String>,
    /// Common reason.
    pub why: String,
    /// Effects, and the recording that would decide on them; empty while unexplained structure prevents it.
    pub record: Vec<(String, String)>,
}

/// Inconclusive effects, grouped by reason.
pub fn inconclusive_groups(diagnosis: &Diagnosis) -> Vec<InconclusiveGroup> {
    let verdicts = diagnosis.verdicts.iter();
    let open: Vec<&Verdict> = verdicts.filter(|v| v.kind == VerdictKind::Inconclusive).collect();
    let mut reasons: Vec<&str> = Vec::new();
    for verdict in &open {
        if !reasons.contains(&reason(verdict)) {
            reasons.push(reason(verdict));
        }
    }
    let of_reason = |why: &str| {
        let members: Vec<&Verdict> = open.iter().copied().filter(|v| reason(v) == why).collect();
        let first = members.first().map_or("", |verdict| verdict.reason.as_str());
        let alike = members.iter().all(|verdict| verdict.reason == first);
        let helps = members.iter().copied().filter(|v| !v.provisional);
        InconclusiveGroup {
            effects: members.iter().map(|verdict| verdict.effect.clone()).collect(),
            why: if alike { first } else { why }.to_owned(),
            record: records(helps),
        }
    };
    reasons.into_iter().map(of_reason).collect()
}

/// Reason by which an effect is grouped.
fn reason(verdict: &Verdict) -> &str {
    match verdict.short.as_str() {
        "" | SEE_BELOW => &verdict.reason,
        short => short,
    }
}

/// Placeholder in a table for a long reason.
pub const SEE_BELOW: &str = "see below";

/// "UNEXPLAINED: 84 % of the residual follows the rotor angle (motor_angle_rad)".
pub fn unexplained(of: &Unexplained) -> String {
    format!(
        "UNEXPLAINED: {:.0} % of the residual follows the {} ({})",
        100.0 * of.share,
        of.words,
        of.covariate
    )
}

/// Hint where structure is unexplained.
pub const EXPR_HINT: &str =
    "No effect of the catalogue explains it. Test a formula of your own with --expr.";

/// Effects added in a step.
pub fn added_effects(stair: &StaircaseStep) -> String {
    match stair.added.as_slice() {
        [] => "the model as it is".to_owned(),
        added => format!("+ {}", added.join(" or ")),
    }
}

/// How gain and p-value were computed.
pub fn significance_note(diagnosis: &Diagnosis) -> String {
    format!(
        "Gain: reduction of the cross-validated squared error. p: p-value adjusted for all candidates \
         (wild bootstrap over {} blocks of {:.1} s, seed {}).",
        diagnosis.blocks, diagnosis.block_s, diagnosis.seed
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::diagnose::fixture::verdict;

    #[test]
    fn equivalent_set_lists_reasons_and_experiments() {
        let tied = |one: &str, other: &str| Verdict {
            tied_with: vec![other.to_owned()],
            ..verdict(one, VerdictKind::Tied, "", "")
        };
        let diagnosis = Diagnosis {
            verdicts: vec![
                tied("neighbour_magnet", "motor_leakage"),
                tied("motor_leakage", "neighbour_magnet"),
            ],
            ..Diagnosis::default()
        };
        let ties = equivalent_sets(&diagnosis);
        assert_eq!(ties.len(), 1);
        assert_eq!(ties[0].effects, ["neighbour_magnet", "motor_leakage"]);
        assert_eq!(ties[0].alike, ["neighbour_magnet and motor_leakage: closing requires current"]);
        assert_eq!(ties[0].record.len(), 2);
        assert!(ties[0].record[0].1.starts_with("Open and close over the whole stroke"));
    }

    #[test]
    fn inconclusive_effects_are_grouped_by_reason() {
        let small = |effect, z| {
            let reason = format!("a typical size would be {z} standard errors");
            verdict(effect, VerdictKind::Inconclusive, "too small", &reason)
        };
        let unrecorded = "temp_c was not recorded";
        let diagnosis = Diagnosis {
            verdicts: vec![
                small("tip_slope", 1.0),
                verdict("thermal_gap", VerdictKind::Inconclusive, unrecorded, unrecorded),
                small("geometric_stiffening", 2.0),
            ],
            ..Diagnosis::default()
        };
        let groups = inconclusive_groups(&diagnosis);
        assert_eq!(groups.len(), 2);
        assert_eq!(groups[0].effects, ["tip_slope", "geometric_stiffening"]);
        assert_eq!(groups[0].why, "too small");
        // Both want the same recording.
        assert_eq!(groups[0].record.len(), 1);
        assert_eq!(groups[0].record[0].0, "tip_slope, geometric_stiffening");
        assert_eq!(groups[1].why, unrecorded);
    }

    #[test]
    fn provisional_verdict_requests_no_recording() {
        let mut blocked =
            verdict("tip_slope", VerdictKind::Inconclusive, "in the way", "in the way");
        blocked.provisional = true;
        let diagnosis = Diagnosis { verdicts: vec![blocked], ..Diagnosis::default() };
        assert_eq!(inconclusive_groups(&diagnosis)[0].record, []);
    }

    #[test]
    fn magnitude_is_formatted_with_the_typical_one() {
        let mut found = verdict("hysteresis", VerdictKind::Found, "", "");
        (found.value, found.std_error) = (7.982, 0.010);
        found.unit = "N".to_owned();
        let said = magnitude(&found);
        assert!(said.starts_with("7.982±0.010 N, friction"), "{said}");
        assert!(said.ends_with("; typical is 2.5 N"), "{said}");
        assert_eq!(magnitude(&verdict("my_own", VerdictKind::Found, "", "")), "");
    }
}
