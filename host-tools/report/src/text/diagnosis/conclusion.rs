//! The conclusion of a diagnosis, and what to do next.

use analysis::compare::{AT_FLOOR, BELOW_FLOOR};
use analysis::diagnose::{
    ConfoundedOffsets, Diagnosis, Suggestion, SuggestionKind, recording_differences,
};
use analysis::numbers::signal;
use model_export::fit::polynomial::HigherDegree;
use model_export::recordings::columns::SignalUnit;

use super::reasons::residual_follows;
use crate::text::comparison::conclusion::{below_floor, stopped_verdict};
use crate::text::force_error;
use crate::text::terminal::narrow;

/// Summary in one paragraph; empty without a result.
pub fn verdict(diagnosis: &Diagnosis) -> String {
    if diagnosis.findings.iter().any(|finding| finding.stops) {
        return stopped_verdict(&diagnosis.findings);
    }
    let sentences = [
        diagnosis.higher_degree.as_ref().map(|higher| higher_degree(higher, diagnosis.noise.unit)),
        Some(verdict_on_effects(diagnosis)),
        one_recording(diagnosis),
        diagnosis.confounded_offsets.as_ref().map(confounded_offsets),
    ];
    sentences.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

/// What a single recording does not show; `None` where there are more.
pub(super) fn one_recording(diagnosis: &Diagnosis) -> Option<String> {
    let [_, all] = diagnosis.recordings;
    (all == 1).then(|| "One recording: no claim about others; record two more.".to_owned())
}

fn verdict_on_effects(diagnosis: &Diagnosis) -> String {
    let Some(last) = diagnosis.staircase.last() else { return String::new() };
    let (rms, floors) =
        (signal(last.held_out_rms_g, diagnosis.noise.unit), last.held_out_rms_g / last.floor_g);
    let steps: Vec<String> = diagnosis
        .staircase
        .iter()
        .filter_map(|step| match step.added.as_slice() {
            [] => None,
            [only] => Some(only.clone()),
            tied => Some(format!("one of {}", tied.join(", "))),
        })
        .collect();
    let is_named = |name: &String| diagnosis.staircase.iter().any(|step| step.added.contains(name));
    let others = diagnosis.equivalent_formulas.iter().map(|formula| &formula.name);
    let others: Vec<&str> = others.filter(|name| !is_named(name)).map(String::as_str).collect();
    let instead = match others.as_slice() {
        [] => String::new(),
        others => format!(", or {} instead", others.join(" with ")),
    };
    let missing = match (steps.is_empty(), diagnosis.is_complete) {
        (true, _) => "No missing effect was found".to_owned(),
        (false, true) => format!("Missing: {}{instead}", steps.join("; ")),
        (false, false) => format!("Provisionally missing: {}{instead}", steps.join("; ")),
    };
    if floors < BELOW_FLOOR {
        return format!(
            "{missing}. {}",
            below_floor(last.held_out_rms_g, last.floor_g, diagnosis.noise.unit)
        );
    }
    match (diagnosis.is_complete, diagnosis.unexplained.first()) {
        (true, _) if floors <= AT_FLOOR && diagnosis.noise.disagreement.is_some() => format!(
            "{missing}. The residual is then {rms}, {floors:.2} times a floor that is uncertain: see the findings."
        ),
        (true, _) if diagnosis.at_floor => {
            format!(
                "{missing}. The residual is then {rms}, {floors:.2} times the floor: at the noise floor."
            )
        }
        (_, Some(first)) if floors > AT_FLOOR => format!(
            "Structure remains: {}, {} ({rms}, {floors:.1} times the floor). {}",
            residual_follows(first),
            if first.covariate == "recording"
                && diagnosis.findings.iter().any(|finding| finding.id == recording_differences::ID)
            {
                "as the finding on the recordings says"
            } else {
                "and no effect explains it"
            },
            if steps.is_empty() {
                "Test a formula of your own over it with --expr.".to_owned()
            } else {
                format!("{missing}.")
            }
        ),
        _ if floors <= AT_FLOOR => {
            let of_axis = diagnosis.worst_axis.map_or_else(String::new, |worst| {
                format!(
                    ": sensor {} {} has {:.2} times its floor, all axes together {floors:.2} times ({rms})",
                    worst.sensor, worst.axis, worst.floors
                )
            });
            let follows = diagnosis.unexplained.first().map_or_else(String::new, |first| {
                format!("; {}, and no effect explains it", residual_follows(first))
            });
            format!("{missing}. Structure remains{of_axis}{follows}.")
        }
        _ => format!(
            "{missing}. Structure remains: {rms}, {floors:.1} times the floor, explained by no covariate."
        ),
    }
}

/// Note where the residual is at the noise floor.
pub fn at_floor_note(diagnosis: &Diagnosis) -> String {
    let with = if diagnosis.accepted.is_empty() { "" } else { " with what was found" };
    let force = diagnosis.staircase.last().and_then(|last| last.force);
    let field = format!(
        "the error of the field is within {:.0} % of its noise floor",
        100.0 * (AT_FLOOR - 1.0)
    );
    let excess = match diagnosis.is_without_places() {
        true => force_error::excess_of_places,
        false => force_error::larger_excess,
    };
    match force.as_ref().and_then(excess) {
        None => format!("AT NOISE FLOOR{with}: {field}, and a further effect would fit noise."),
        Some(excess) => format!("FIELD AT NOISE FLOOR{with}: {field}. {excess}"),
    }
}

/// That another degree of the polynomial describes the forces better.
fn higher_degree(higher: &HigherDegree, unit: SignalUnit) -> String {
    format!(
        "The degree of the polynomial is too low: with degree {} the held-out error of the field falls from {} to {}.",
        higher.degree,
        signal(higher.now_g, unit),
        signal(higher.then_g, unit)
    )
}

/// That the offsets of sensors are confounded with the Earth's field.
pub fn confounded_offsets(of: &ConfoundedOffsets) -> String {
    let sensors: Vec<String> = of.sensors.iter().map(u32::to_string).collect();
    let [roll, pitch, yaw] = of.range_deg;
    format!(
        "The offset of sensor {} is confounded with the Earth's field in these recordings (range of roll {roll:.0}, pitch {pitch:.0}, yaw {yaw:.0} degrees); it is regularised towards zero. Rotate the gripper by at least 90 degrees about two axes.",
        sensors.join(", ")
    )
}

/// Heading of the suggested commands; empty without a suggestion.
pub fn suggestion_heading(kind: SuggestionKind) -> &'static str {
    match kind {
        SuggestionKind::None => "",
        SuggestionKind::AddEffects => "Suggestion, add it and see the error fall:",
        SuggestionKind::ChooseEffect => {
            "Suggestion, choose one and add it, or make a recording that tells them apart (`--plan` proposes one where a short one can):"
        }
        SuggestionKind::AlignClocks => {
            "Suggestion, align the clocks, which no device can compensate, and diagnose the new model:"
        }
        SuggestionKind::CorrectRecordings => {
            "Suggestion, give the recordings one zero, fit the copy, and diagnose it with the new model:"
        }
        SuggestionKind::RaiseDegree => {
            "Suggestion, fit a polynomial of this degree, and diagnose the new model:"
        }
        SuggestionKind::Replay => {
            "No missing effect was found, with the model's parameters fitted again. Its file is of other recordings: see whether it \
             holds for this gripper before its tables are used, else fit these recordings:"
        }
        SuggestionKind::Export => {
            "No missing effect was found. Suggestion, the tables for the device:"
        }
        SuggestionKind::TestFormula => {
            "Suggestion, propose its shape and test it like any effect (put in yours):"
        }
        SuggestionKind::Compare => "Suggestion, look at the residual:",
    }
}

/// Commands are not wrapped, so that they can be copied.
pub(super) fn next_commands(next: &Suggestion) -> String {
    let mut page = String::new();
    let heading = suggestion_heading(next.kind);
    if !heading.is_empty() {
        page += &format!("\n{}", narrow(heading));
    }
    for command in &next.commands {
        page += &format!("  {command}\n");
    }
    page
}
