//! What is said of a diagnosis, in the terminal and in the report alike.

use model_export::effects::find;

use super::{Diagnosis, Kind, Stair, Unexplained, Verdict};
use crate::show;

/// A size with an error bar of more than this many times itself is not known.
const NOT_TOLD: f64 = 10.0;

/// A verdict in a word or two; a question mark where it is provisional.
pub fn word(verdict: &Verdict) -> String {
    let word = match verdict.kind {
        Kind::Found => "FOUND",
        Kind::Tied => "TIED",
        Kind::Shadow => "SHADOW",
        Kind::NotJudgeable => "NOT JUDGEABLE",
        Kind::Absent => "ABSENT",
    };
    match verdict.provisional && is_there(verdict) {
        true => format!("{word}?"),
        false => word.to_owned(),
    }
}

/// What the question mark means.
pub const PROVISIONAL: &str =
    "A question mark: provisional, for far more than noise is unexplained.";

/// Said where nothing is left to find.
pub fn stop(diagnosis: &Diagnosis) -> String {
    let with = match diagnosis.accepted.is_empty() {
        true => "",
        false => " with what was found",
    };
    format!(
        "AT NOISE FLOOR{with}: what is left cannot be told from noise. A further effect would fit noise."
    )
}

/// True for what was found, alone or tied.
pub fn is_there(verdict: &Verdict) -> bool {
    matches!(verdict.kind, Kind::Found | Kind::Tied)
}

/// "7.98±0.01 N, friction force; typical is 2.5 N"; what is not known of it is left out.
pub fn size(verdict: &Verdict) -> String {
    let typical = find(&verdict.effect).ok().map(|effect| {
        format!(
            "typical is {} {}",
            show::plain(effect.size.typical, 3),
            effect.size.unit
        )
    });
    if !verdict.value.is_finite() {
        return typical.unwrap_or_default();
    }
    let value = value(verdict.value, verdict.std_error, &verdict.unit);
    match (find(&verdict.effect).ok(), typical) {
        (Some(effect), Some(typical)) => format!("{value}, {}; {typical}", effect.size.words),
        _ => value,
    }
}

/// "7.98±0.01 N"; where the error bar is far wider than the value, it says that.
pub fn value(value: f64, std_error: f64, unit: &str) -> String {
    if std_error > NOT_TOLD * value.abs() {
        return "size not told".to_owned();
    }
    let value = show::with_error(value, std_error, value.abs());
    format!("{value} {unit}").trim_end().to_owned()
}

/// A paragraph of the physics; of a formula of one's own there is none.
pub fn physics(verdict: &Verdict) -> &'static str {
    find(&verdict.effect).map_or("An effect of your own.", |effect| effect.physics)
}

/// Why, as a sentence of its own.
pub fn sentence(verdict: &Verdict) -> String {
    let mut letters = verdict.reason.chars();
    let first = letters.next().map(|letter| letter.to_uppercase());
    format!(
        "{}{}.",
        first.into_iter().flatten().collect::<String>(),
        letters.as_str()
    )
}

/// Effects that cannot be told apart, and what would tell.
#[derive(Clone, Debug, PartialEq)]
pub struct Tie {
    /// Their names.
    pub effects: Vec<String>,
    /// Why they look alike, pair by pair, where the catalogue knows.
    pub alike: Vec<String>,
    /// Whom an experiment tells of, and the experiment.
    pub record: Vec<(String, String)>,
}

/// Every tie, in the order of the verdicts.
pub fn ties(diagnosis: &Diagnosis) -> Vec<Tie> {
    let mut ties: Vec<Tie> = Vec::new();
    for verdict in diagnosis.verdicts.iter().filter(|v| v.kind == Kind::Tied) {
        if ties.iter().any(|tie| tie.effects.contains(&verdict.effect)) {
            continue;
        }
        let effects: Vec<String> = std::iter::once(&verdict.effect)
            .chain(&verdict.tied_with)
            .cloned()
            .collect();
        let members = diagnosis
            .verdicts
            .iter()
            .filter(|v| effects.contains(&v.effect));
        ties.push(Tie {
            alike: alike(&effects),
            record: records(members),
            effects,
        });
    }
    ties
}

/// Why effects look alike: "neighbour_magnet and motor_leakage: closing needs current".
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

/// What to record, the same recording said once: whom it tells of, and the recording.
fn records<'a>(verdicts: impl Iterator<Item = &'a Verdict>) -> Vec<(String, String)> {
    let mut list: Vec<(String, String)> = Vec::new();
    for verdict in verdicts.filter(|verdict| !verdict.record.is_empty()) {
        match list
            .iter_mut()
            .find(|(_, record)| *record == verdict.record)
        {
            Some((effects, _)) => *effects += &format!(", {}", verdict.effect),
            None => list.push((verdict.effect.clone(), verdict.record.clone())),
        }
    }
    list
}

/// Effects that cannot be judged for the same reason.
#[derive(Clone, Debug, PartialEq)]
pub struct Unjudged {
    /// Their names.
    pub effects: Vec<String>,
    /// Why.
    pub why: String,
    /// Whom a recording tells of, and the recording; nothing where no recording helps before what is
    /// unexplained is out of the way.
    pub record: Vec<(String, String)>,
}

/// What cannot be judged, reason by reason.
pub fn unjudged(diagnosis: &Diagnosis) -> Vec<Unjudged> {
    let verdicts = diagnosis.verdicts.iter();
    let open: Vec<&Verdict> = verdicts.filter(|v| v.kind == Kind::NotJudgeable).collect();
    let mut reasons: Vec<&str> = Vec::new();
    for verdict in &open {
        if !reasons.contains(&reason(verdict)) {
            reasons.push(reason(verdict));
        }
    }
    let of_reason = |why: &str| {
        let members: Vec<&Verdict> = open.iter().copied().filter(|v| reason(v) == why).collect();
        let first = members
            .first()
            .map_or("", |verdict| verdict.reason.as_str());
        let alike = members.iter().all(|verdict| verdict.reason == first);
        let helps = members.iter().copied().filter(|v| !v.provisional);
        Unjudged {
            effects: members
                .iter()
                .map(|verdict| verdict.effect.clone())
                .collect(),
            why: if alike { first } else { why }.to_owned(),
            record: records(helps),
        }
    };
    reasons.into_iter().map(of_reason).collect()
}

/// Under which an effect is said together with others.
fn reason(verdict: &Verdict) -> &str {
    match verdict.short.as_str() {
        "" | SEE_BELOW => &verdict.reason,
        short => short,
    }
}

/// Stands in a table for a reason that is too long for it.
pub const SEE_BELOW: &str = "see below";

/// "UNEXPLAINED: 84 % of what is left follows the rotor angle (motor_angle_rad)".
pub fn unexplained(of: &Unexplained) -> String {
    format!(
        "UNEXPLAINED: {:.0} % of what is left follows the {} ({})",
        100.0 * of.share,
        of.words,
        of.covariate
    )
}

/// What follows where something is unexplained.
pub const EXPR: &str = "No effect of the catalogue explains that. A formula of your own is a candidate \
                        like any other: give it with --expr.";

/// What was added on a step of the staircase.
pub fn added(stair: &Stair) -> String {
    match stair.added.as_slice() {
        [] => "the model as it is".to_owned(),
        added => format!("+ {}", added.join(" or ")),
    }
}

/// How chance was judged.
pub fn chance(diagnosis: &Diagnosis) -> String {
    format!(
        "Gain: share of the squared error left out that it takes away. p: probability of as much by chance \
         in the best of all candidates (wild bootstrap over {} blocks of {:.1} s, seed {}).",
        diagnosis.blocks, diagnosis.block_s, diagnosis.seed
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::fixture::verdict;

    #[test]
    fn a_tie_says_why_its_members_look_alike_and_what_would_tell() {
        let tied = |one: &str, other: &str| Verdict {
            tied_with: vec![other.to_owned()],
            ..verdict(one, Kind::Tied, "", "")
        };
        let diagnosis = Diagnosis {
            verdicts: vec![
                tied("neighbour_magnet", "motor_leakage"),
                tied("motor_leakage", "neighbour_magnet"),
            ],
            ..Diagnosis::default()
        };
        let ties = ties(&diagnosis);
        assert_eq!(ties.len(), 1);
        assert_eq!(ties[0].effects, ["neighbour_magnet", "motor_leakage"]);
        assert_eq!(
            ties[0].alike,
            ["neighbour_magnet and motor_leakage: closing needs current"]
        );
        assert_eq!(ties[0].record.len(), 2);
        assert!(
            ties[0].record[0]
                .1
                .starts_with("Open and close over the whole stroke")
        );
    }

    #[test]
    fn what_cannot_be_judged_for_the_same_reason_is_said_together() {
        let small = |effect, z| {
            let reason = format!("a typical size would stand {z} error bars out");
            verdict(effect, Kind::NotJudgeable, "too small", &reason)
        };
        let unrecorded = "temp_c was not recorded";
        let diagnosis = Diagnosis {
            verdicts: vec![
                small("tip_slope", 1.0),
                verdict("thermal_gap", Kind::NotJudgeable, unrecorded, unrecorded),
                small("geometric_stiffening", 2.0),
            ],
            ..Diagnosis::default()
        };
        let groups = unjudged(&diagnosis);
        assert_eq!(groups.len(), 2);
        assert_eq!(groups[0].effects, ["tip_slope", "geometric_stiffening"]);
        assert_eq!(groups[0].why, "too small");
        // Both want the same recording.
        assert_eq!(groups[0].record.len(), 1);
        assert_eq!(groups[0].record[0].0, "tip_slope, geometric_stiffening");
        assert_eq!(groups[1].why, unrecorded);
    }

    #[test]
    fn no_recording_is_asked_for_while_something_stands_in_the_way() {
        let mut blocked = verdict("tip_slope", Kind::NotJudgeable, "in the way", "in the way");
        blocked.provisional = true;
        let diagnosis = Diagnosis {
            verdicts: vec![blocked],
            ..Diagnosis::default()
        };
        assert_eq!(unjudged(&diagnosis)[0].record, []);
    }

    #[test]
    fn a_size_stands_beside_the_typical_one() {
        let mut found = verdict("hysteresis", Kind::Found, "", "");
        (found.value, found.std_error) = (7.982, 0.010);
        found.unit = "N".to_owned();
        let said = size(&found);
        assert!(said.starts_with("7.982±0.010 N, friction"), "{said}");
        assert!(said.ends_with("; typical is 2.5 N"), "{said}");
        assert_eq!(size(&verdict("my_own", Kind::Found, "", "")), "");
    }
}
