//! From a selection to verdicts.

use model_export::effects::Addition;
use model_export::fit::evidence::Evidence;
use model_export::fit::size::{EffectSize, sizes};

use super::candidates::Unjudged;
use super::kin::are_kin;
use super::screening::Screened;
use super::select::{Selection, Step};
use super::stage::Stage;
use super::words::{self, SEE_BELOW};
use super::{Diagnosis, Kind, Stair, Unexplained, Verdict};
use crate::compare::words::{AT_FLOOR, field};

/// A typical size fewer error bars than this from nothing cannot be judged.
const JUDGEABLE: f64 = 4.0;

/// A reason of more letters than this is no cell of a table.
const LONGEST: usize = 22;

/// Verdicts on every candidate, and what they come to.
pub fn assemble(selection: &Selection, unjudged: &[Unjudged], recordings: usize) -> Diagnosis {
    let Some(last) = selection.stages.last() else {
        return Diagnosis::default();
    };
    let complete = selection.is_complete();
    let mut diagnosis = Diagnosis {
        at_floor: last.floors() <= AT_FLOOR,
        accepted: match complete {
            true => selection.steps.iter().map(names).collect(),
            false => Vec::new(),
        },
        unexplained: selection
            .located
            .iter()
            .filter(|(covariate, _)| covariate.name != "constant")
            .map(|(covariate, share)| Unexplained {
                covariate: covariate.name.to_string(),
                words: covariate.words.to_string(),
                share: *share,
            })
            .collect(),
        staircase: stairs(selection),
        block_s: selection.block_s,
        blocks: selection.blocks,
        ..Diagnosis::default()
    };
    if last.floors() <= AT_FLOOR {
        diagnosis.unexplained.clear();
    }
    for step in &selection.steps {
        diagnosis
            .verdicts
            .extend(of_step(step, last, recordings, complete));
    }
    let named = |name: &str, verdicts: &[Verdict]| verdicts.iter().any(|v| v.effect == name);
    for screened in &selection.last {
        if !named(screened.candidate.name(), &diagnosis.verdicts) {
            diagnosis.verdicts.push(of_rest(
                screened,
                complete,
                selection,
                &diagnosis.unexplained,
            ));
        }
    }
    diagnosis.verdicts.extend(unjudged.iter().map(of_unjudged));
    diagnosis.verdicts.sort_by(|a, b| {
        (a.kind, b.gain)
            .partial_cmp(&(b.kind, a.gain))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    diagnosis.verdict = sentence(&diagnosis, selection, last, complete);
    diagnosis
}

fn names(step: &Step) -> Vec<String> {
    let all = std::iter::once(&step.chosen).chain(&step.tied);
    all.map(|effect| effect.name().to_owned()).collect()
}

fn stairs(selection: &Selection) -> Vec<Stair> {
    let added = std::iter::once(Vec::new()).chain(selection.steps.iter().map(names));
    let stair = |(stage, added): (&Stage, Vec<String>)| Stair {
        added,
        held_out_rms_g: stage.mean_square().sqrt(),
        held_out_rmse_n: stage.fit.tally().rmse_n(),
        floor_g: stage.fit.tally().floor_g(),
    };
    selection.stages.iter().zip(added).map(stair).collect()
}

fn of_step(step: &Step, last: &Stage, recordings: usize, complete: bool) -> Vec<Verdict> {
    let found = sizes(&last.fit, &last.effects, recordings);
    let size = last
        .effects
        .iter()
        .position(|effect| *effect == step.chosen)
        .map(|i| &found[i]);
    let all = names(step);
    let record = |effect: &Addition| {
        effect
            .effect()
            .map_or_else(String::new, |effect| effect.record.to_owned())
    };
    let base = |effect: &Addition, kind: Kind| Verdict {
        effect: effect.name().to_owned(),
        kind,
        provisional: !complete,
        tied_with: all
            .iter()
            .filter(|name| *name != effect.name())
            .cloned()
            .collect(),
        gain: step.gain,
        p_adjusted: step.p_adjusted,
        value: f64::NAN,
        std_error: f64::NAN,
        unit: effect.size().unit.to_owned(),
        z_typical: step.z_typical,
        reason: String::new(),
        short: String::new(),
        record: String::new(),
    };
    let mut verdicts = Vec::new();
    for effect in std::iter::once(&step.chosen).chain(&step.tied) {
        let mut verdict = base(
            effect,
            if step.tied.is_empty() {
                Kind::Found
            } else {
                Kind::Tied
            },
        );
        verdict.reason = match step.tied.is_empty() {
            true => format!(
                "it takes away {:.1} % of the squared error that was left out",
                100.0 * step.gain
            ),
            false => {
                verdict.record = record(effect);
                "each of them explains the same: these recordings do not tell which".to_owned()
            }
        };
        if !step.tied.is_empty() {
            verdict.short = format!("or {}", verdict.tied_with.join(", "));
        }
        if *effect == step.chosen
            && let Some(size) = size
        {
            (verdict.value, verdict.std_error) = (size.value, size.std_error);
            verdict.reason += &unusual(size);
            if step.tied.is_empty() {
                verdict.short = words::value(size.value, size.std_error, &verdict.unit);
            }
        }
        verdicts.push(verdict);
    }
    for effect in &step.shadows {
        let mut verdict = base(effect, Kind::Shadow);
        verdict.tied_with.clear();
        (verdict.gain, verdict.p_adjusted, verdict.z_typical) = (f64::NAN, f64::NAN, f64::NAN);
        verdict.reason = format!(
            "it explains part of what {} explains better",
            all.join(" or ")
        );
        verdict.short = format!("part of {}", step.chosen.name());
        verdicts.push(verdict);
    }
    verdicts
}

fn unusual(size: &EffectSize) -> String {
    match size.is_plausible() {
        true => String::new(),
        false => format!(
            "; an unusual size: usual are {} to {} {}",
            size.size.plausible.0, size.size.plausible.1, size.size.unit
        ),
    }
}

fn of_rest(
    screened: &Screened,
    complete: bool,
    selection: &Selection,
    unexplained: &[Unexplained],
) -> Verdict {
    let effect = &screened.candidate;
    let evidence = &screened.evidence;
    let record = effect
        .effect()
        .map_or_else(String::new, |effect| effect.record.to_owned());
    let (kind, reason, short, record) = if !complete {
        let what = match unexplained.first() {
            Some(first) => format!(
                "{:.0} % of what is left follows the {}",
                100.0 * first.share,
                first.words
            ),
            None => "far more than noise is left".to_owned(),
        };
        (
            Kind::NotJudgeable,
            format!("{what}, and no effect explains that: it stands in the way"),
            "too much is unexplained".to_owned(),
            record,
        )
    } else if screened.is_significant() {
        let (kind, reason, short) = remainder(effect, selection);
        (kind, reason, short, record)
    } else if evidence.z_typical < JUDGEABLE {
        let (why, short) = inadequate(evidence);
        (Kind::NotJudgeable, why, short.to_owned(), record)
    } else {
        // Rounded up: a bound of nothing would be a claim.
        let bound = (100.0 * evidence.bound).ceil() / 100.0;
        (
            Kind::Absent,
            format!("at most {bound:.2} times its typical size (95 %)"),
            format!("< {bound:.2} of typical"),
            String::new(),
        )
    };
    Verdict {
        effect: effect.name().to_owned(),
        kind,
        provisional: !complete,
        tied_with: Vec::new(),
        gain: evidence.gain(),
        p_adjusted: screened.p_adjusted,
        value: f64::NAN,
        std_error: f64::NAN,
        unit: effect.size().unit.to_owned(),
        z_typical: evidence.z_typical,
        reason,
        short,
        record,
    }
}

/// A reason as a cell of a table.
fn short_of(why: &str) -> String {
    match why.strip_suffix(" was not recorded") {
        Some(column) => format!("no {column}"),
        None if why.len() <= LONGEST => why.to_owned(),
        None => SEE_BELOW.to_owned(),
    }
}

/// Why recordings cannot tell a typical size from nothing, and the same in few words.
fn inadequate(evidence: &Evidence) -> (String, &'static str) {
    let z = evidence.z_typical;
    let (why, short) = if evidence.z_alone < JUDGEABLE {
        (
            "a typical size would hardly move the field here",
            "hardly moves the field",
        )
    } else if evidence.z_in_noise < JUDGEABLE {
        (
            "the model's own numbers can stand in for it",
            "others stand in for it",
        )
    } else {
        (
            "what is left of other causes hides a typical size",
            "other causes hide it",
        )
    };
    (format!("{why} ({z:.1} error bars)"), short)
}

/// What is said of an effect that explains something of what is left, and still gets no name.
fn remainder(effect: &Addition, selection: &Selection) -> (Kind, String, String) {
    let kin = selection
        .steps
        .iter()
        .find(|step| are_kin(&step.chosen, effect));
    match kin {
        Some(step) => (
            Kind::Shadow,
            format!(
                "it explains a remainder that may as well be the form of {}",
                step.chosen.name()
            ),
            format!("part of {}", step.chosen.name()),
        ),
        None if effect.lives_in_one_recording() => (
            Kind::NotJudgeable,
            "what is left wanders with time, more freely than it could".to_owned(),
            "wanders with time".to_owned(),
        ),
        None => (
            Kind::NotJudgeable,
            "it fits some of what is left, which has another cause".to_owned(),
            "has another cause".to_owned(),
        ),
    }
}

fn of_unjudged(unjudged: &Unjudged) -> Verdict {
    Verdict {
        effect: unjudged.effect.clone(),
        kind: Kind::NotJudgeable,
        provisional: false,
        tied_with: Vec::new(),
        gain: 0.0,
        p_adjusted: f64::NAN,
        value: f64::NAN,
        std_error: f64::NAN,
        unit: String::new(),
        z_typical: 0.0,
        reason: unjudged.why.clone(),
        short: short_of(&unjudged.why),
        record: unjudged.record.clone(),
    }
}

fn sentence(diagnosis: &Diagnosis, selection: &Selection, last: &Stage, complete: bool) -> String {
    let rms = field(last.mean_square().sqrt());
    let floors = last.floors();
    let steps: Vec<String> = selection
        .steps
        .iter()
        .map(|step| match step.tied.is_empty() {
            true => step.chosen.name().to_owned(),
            false => format!("one of {}", names(step).join(", ")),
        })
        .collect();
    let missing = match (steps.is_empty(), complete) {
        (true, _) => "No effect is found missing".to_owned(),
        (false, true) => format!("Missing: {}", steps.join("; ")),
        (false, false) => format!("Provisionally missing: {}", steps.join("; ")),
    };
    let unexplained = diagnosis.unexplained.first().map(|first| {
        format!(
            "{:.0} % of what is left follows the {}",
            100.0 * first.share,
            first.words
        )
    });
    match (complete, unexplained) {
        (true, _) if floors <= AT_FLOOR => {
            format!(
                "{missing}. With that {rms} is left, {floors:.2} times the floor: the noise floor, stop."
            )
        }
        (_, Some(unexplained)) => format!(
            "Structure remains: {unexplained}, and no effect explains it ({rms}, {floors:.1} times the floor). {}",
            match steps.is_empty() {
                true => "A formula of your own over it is a candidate like any other (--expr)."
                    .to_owned(),
                false => format!("{missing}."),
            }
        ),
        _ => format!(
            "{missing}. Structure remains: {rms} is left, {floors:.1} times the floor, and follows no covariate."
        ),
    }
}
