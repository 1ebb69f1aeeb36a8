//! Text and JSON of a diagnosis.

use analysis::compare::{AT_FLOOR, BELOW_FLOOR, ForceError};
use analysis::diagnose::candidates::{LEVEL, RESAMPLES};
use analysis::diagnose::fitted_model::MIN_GAIN;
use analysis::diagnose::recording_differences;
use analysis::diagnose::remaining_structure::RemainingStructure;
use analysis::diagnose::{
    ConfoundedOffsets, Diagnosis, DiscoveredFormula, DropReason, DroppedStep, Reason,
    StaircaseStep, Suggestion, SuggestionKind, Unexplained, Verdict, VerdictKind,
};
use analysis::numbers::{self, signal};
use anstyle::Style;
use model_export::effects::{EffectTerm, find};
use model_export::fit::polynomial::HigherDegree;
use model_export::inverse::device_support::DeviceSupport;
use model_export::recordings::columns::SignalUnit;
use serde_json::{Value, json};

use crate::text::causes::causes_sentence;
use crate::text::comparison::{data_findings, dependence, stopped_verdict};
use crate::text::recording_plan::{self, format_proposal};
use crate::text::terminal::{self, GOOD, HEADING, NARROW_WIDTH, WARNING};
use crate::text::{findings, force_error};

/// Result as tables and text.
pub fn format_report(diagnosis: &Diagnosis) -> String {
    let mut page = data_findings(&diagnosis.findings);
    if diagnosis.staircase.is_empty() {
        return page + &paragraph(&verdict(diagnosis));
    }
    let missing = missing_columns(diagnosis);
    if !missing.is_empty() {
        page += &(paragraph(&missing) + "\n");
    }
    page += &verdict_table(diagnosis);
    page += &step_table(diagnosis);
    page += &(paragraph(&diagnosis.noise.sentence()) + "\n");
    page += &accepted_effects(diagnosis);
    page += &discovered_formulas(diagnosis);
    page += &equivalent_effects(diagnosis);
    page += &inconclusive_effects(diagnosis);
    page += &unexplained_residual(diagnosis);
    if diagnosis.is_interrupted {
        page += &styled(WARNING, INTERRUPTED_NOTE);
    }
    page += &paragraph(&force_headline(diagnosis));
    page += &force_origins(diagnosis).iter().map(|origin| paragraph(origin)).collect::<String>();
    let style = if diagnosis.at_floor { GOOD } else { WARNING };
    page += &styled(style, &verdict(diagnosis));
    if let Some(proposal) = &diagnosis.proposal {
        page += &format!("\n{}", format_proposal(proposal));
    }
    page + &next_commands(&diagnosis.next)
}

/// Of a diagnosis that was ended early.
pub const INTERRUPTED_NOTE: &str =
    "INTERRUPTED: what was not tried until then is missing, and all names are provisional.";

/// The accepted effects, without the table of all candidates.
pub fn format_summary(diagnosis: &Diagnosis) -> String {
    let mut page = step_table(diagnosis);
    page += &accepted_effects(diagnosis);
    page += &discovered_formulas(diagnosis);
    page += &equivalent_effects(diagnosis);
    page += &unexplained_residual(diagnosis);
    page + "\n"
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

fn paragraph(text: &str) -> String {
    terminal::wrap(text, NARROW_WIDTH)
}

fn styled(style: Style, text: &str) -> String {
    terminal::styled(style, text, NARROW_WIDTH)
}

/// Minimum gain that is shown where a large unexplained residual prevents the verdicts.
const MIN_SHOWN: f64 = 0.01;
/// Maximum number of effects in a list.
const MAX_LISTED: usize = 6;

/// The verdicts with something to say, and how many others a large unexplained residual prevents.
pub fn shown_verdicts(diagnosis: &Diagnosis) -> (Vec<&Verdict>, usize) {
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

fn verdict_table(diagnosis: &Diagnosis) -> String {
    // The page has both.
    let has_forces = diagnosis.verdicts.iter().any(|verdict| verdict.excess_n.is_some());
    let error = if has_forces { "excess / N" } else { "gain" };
    let mut table = terminal::table(["effect", "verdict", error, "p", "magnitude or reason"]);
    table.set_width(NARROW_WIDTH);
    let (shown, hidden) = shown_verdicts(diagnosis);
    let finite = |value: f64, text: String| if value.is_finite() { text } else { "-".to_owned() };
    for verdict in shown {
        table.add_row([
            verdict.effect.clone(),
            verdict_label(verdict),
            match (has_forces, verdict.excess_n) {
                (true, None) => "-".to_owned(),
                (true, Some(excess_n)) => format!("{excess_n:.3}"),
                (false, _) => {
                    finite(verdict.gain, format!("{:.1} %", 100.0 * verdict.gain.max(0.0)))
                }
            },
            finite(verdict.p_adjusted, format!("{:.3}", verdict.p_adjusted)),
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
        page += &paragraph(PROVISIONAL_NOTE);
    }
    if diagnosis.verdicts.iter().any(|v| v.kind == VerdictKind::Shadow) {
        page += &paragraph(SHADOW_NOTE);
    }
    page + &paragraph(&significance_note(diagnosis)) + "\n"
}

fn step_table(diagnosis: &Diagnosis) -> String {
    let heads = ["step", "params", "excess / N", "force / N", "noise / N", "field", "x floor"];
    let mut table = terminal::table(heads);
    table.set_width(NARROW_WIDTH);
    for stair in &diagnosis.staircase {
        let newtons = |figure: fn(&ForceError) -> f64| {
            stair.force.as_ref().map_or_else(|| "-".to_owned(), |of| format!("{:.3}", figure(of)))
        };
        table.add_row([
            added_effects(stair),
            stair.parameters.to_string(),
            newtons(ForceError::excess_n),
            newtons(|force| force.rms_n),
            newtons(|force| force.noise_n),
            signal(stair.held_out_rms_g, diagnosis.noise.unit),
            format!("{:.2}", stair.held_out_rms_g / stair.floor_g),
        ]);
    }
    terminal::right_align(&mut table, 1);
    let rise = rising_force(&diagnosis.staircase).map_or_else(String::new, |note| paragraph(&note));
    let dropped = match dropped_steps(diagnosis) {
        text if text.is_empty() => text,
        text => paragraph(&text),
    };
    format!("{table}\n{}{rise}{dropped}\n", paragraph(STEP_NOTE))
}

/// What was accepted and dropped again, with the reasons; empty without any.
pub fn dropped_steps(diagnosis: &Diagnosis) -> String {
    let of = |step: &DroppedStep| {
        let why = match step.reason {
            DropReason::Needless => "next to the other steps the error does not rise without it",
            DropReason::Replaced => "formulas leave less, or as much with fewer terms",
            DropReason::Undetermined => {
                "next to the others its magnitude is smaller than two of its standard errors"
            }
            DropReason::NotOnAllRows => {
                "it lowers the error of all rows by too little, or not in every fold"
            }
            DropReason::IrrelevantForces => {
                "the field is at the floor without it, and the squared error of the forces rises by less than 1 %"
            }
        };
        format!(
            "Dropped: {} (gain {:.1} % when it was accepted): {why}.",
            step.step,
            100.0 * step.gain
        )
    };
    diagnosis.dropped.iter().map(of).collect::<Vec<_>>().join(" ")
}

/// Steps that lower the error of the field and raise that of the forces; `None` without one.
pub fn rising_force(steps: &[StaircaseStep]) -> Option<String> {
    let raises = |pair: &&[StaircaseStep]| match (pair[0].force, pair[1].force) {
        (Some(before), Some(after)) => {
            let rises = after.excess_n() > before.excess_n() && !force_error::is_at_noise(&after);
            pair[1].held_out_rms_g < pair[0].held_out_rms_g && rises
        }
        _ => false,
    };
    let raising: Vec<String> =
        steps.windows(2).filter(raises).map(|pair| pair[1].added.join(" or ")).collect();
    (!raising.is_empty()).then(|| {
        format!(
            "With {} the excess of the forces rises although the error of the field falls.",
            raising.join(" and with ")
        )
    })
}

/// What the columns of the steps are.
const STEP_NOTE: &str = "Held out. Params: free parameters of the model at one sensor. Force: RMS over all forces through the device's code, of which noise alone, and the excess over it \
                         (root of the difference of squares). Field: RMS over all channels, and in multiples of the noise floor.";

/// The force error of the model as it is and with everything that was found; empty without forces.
pub fn force_headline(diagnosis: &Diagnosis) -> String {
    let force = |step: Option<&StaircaseStep>| step.and_then(|step| step.force);
    let steps = &diagnosis.staircase;
    let rows = |error: &ForceError| match diagnosis.is_without_places() {
        true => format!(
            "{}, fitted without the other places of the magnets",
            force_error::rows(error.rows)
        ),
        false => force_error::rows(error.rows).into_owned(),
    };
    match (force(steps.first()), force(steps.last())) {
        (Some(before), Some(after)) if steps.len() > 1 => {
            force_error::change_of(&before, &after, &rows(&after))
        }
        (Some(only), _) => force_error::headline_of(&only, &rows(&only)),
        (None, _) => String::new(),
    }
}

/// What of the force error is not of the device's model.
pub fn force_origins(diagnosis: &Diagnosis) -> Vec<String> {
    let last = diagnosis.staircase.last().and_then(|last| last.force);
    last.map_or_else(Vec::new, |last| force_error::origins(&last, &diagnosis.origins))
}

/// Accepted effects: estimated and typical magnitude, evidence, physics.
fn accepted_effects(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for verdict in diagnosis.verdicts.iter().filter(|v| is_present(v)) {
        page += &styled(HEADING, &heading(verdict));
        page += &paragraph(&format!("  {}", physics(verdict)));
        let evidence = [
            reason_sentence(verdict),
            similar_effects(verdict),
            beyond_polynomial(diagnosis, verdict),
        ];
        let said: Vec<String> = evidence.into_iter().filter(|said| !said.is_empty()).collect();
        page += &paragraph(&format!("  {}", said.join(" ")));
        page += &device_line(&runs_on_device(diagnosis, &[&verdict.effect]));
        page.push('\n');
    }
    page
}

/// A sentence on the device as a line; nothing without one.
fn device_line(sentence: &str) -> String {
    if sentence.is_empty() { String::new() } else { paragraph(&format!("  {sentence}")) }
}

/// Whether the device compensates these effects, which act together; `None` if it is unknown.
fn of_device<'d>(diagnosis: &'d Diagnosis, effects: &[&str]) -> Option<&'d DeviceSupport> {
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

/// Formulas beyond the catalogue: text, evidence, values of each sensor.
fn discovered_formulas(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for formula in &diagnosis.formulas {
        page += &styled(HEADING, &formula_heading(diagnosis, formula));
        // Not wrapped, so that they can be copied.
        for model in &formula.models {
            page += &format!("  {}\n", model.expression.as_deref().unwrap_or_default());
        }
        page += &paragraph(&format!("  {}", formula_evidence(diagnosis, formula)));
        page += &paragraph(&format!("  {}", formula_alternatives(formula)));
        page += &device_line(&formula_on_device(diagnosis, formula));
        let numbers = formula.models.iter().flat_map(|model| &model.sensors);
        let mut numbers: Vec<u32> = numbers.map(|sensor| sensor.number).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let heads = numbers.iter().map(|number| format!("sensor {number}"));
        let mut table = terminal::table(std::iter::once("parameter".to_owned()).chain(heads));
        table.set_width(NARROW_WIDTH);
        for row in formula_values(formula) {
            table.add_row(row);
        }
        page += &format!("{table}\n\n");
    }
    page
}

/// "formula_1, a function of fx_n and opening_mm (partial)".
pub fn formula_heading(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> String {
    let partial = if diagnosis.at_floor { "" } else { ", PARTIAL: structure remains" };
    format!("{}, a formula of {}{partial}", formula.name, formula.covariates.join(" and "))
}

/// What a formula explains.
pub fn formula_evidence(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> String {
    let floors = formula_floors(diagnosis, formula);
    let evidence = format!(
        "No effect of the catalogue explains as much with as few coefficients. It {} (family-wise p {:.3}), to {floors:.2} times the \
         noise floor. A formula is not a cause. {}",
        reduction(formula.gain),
        formula.p_value,
        causes_sentence(&formula.covariates)
    );
    evidence.trim_end().to_owned()
}

/// [`runs_on_device`] of a formula.
pub fn formula_on_device(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> String {
    runs_on_device(diagnosis, &effect_names(formula))
}

fn effect_names(formula: &DiscoveredFormula) -> Vec<&str> {
    formula.effects.iter().map(EffectTerm::name).collect()
}

/// Where else the same function can act.
pub fn formula_alternatives(formula: &DiscoveredFormula) -> String {
    let Some(other_targets) = &formula.other_targets else {
        return format!(
            "It acts on {}. Other quantities were not compared.",
            formula.targets.join(", ")
        );
    };
    if other_targets.is_empty() {
        return format!(
            "It acts on {}: on no other quantity it explains as much.",
            formula.targets.join(", ")
        );
    }
    let others: Vec<String> = other_targets.iter().map(|targets| targets.join(" and ")).collect();
    format!(
        "It acts on {}. On these recordings it explains the same, within 2 %, if it acts on {} instead.",
        formula.targets.join(", "),
        others.join(", or on ")
    )
}

/// Error after the step of a formula, in noise floors.
fn formula_floors(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> f64 {
    let mut steps = diagnosis.staircase.iter();
    let step = steps.find(|step| step.added.contains(&formula.name));
    step.map_or(f64::NAN, |step| step.held_out_rms_g / step.floor_g)
}

/// Name and unit of each parameter of a formula, and its value at each sensor, in units of a power of ten where it is small or
/// large.
pub fn formula_values(formula: &DiscoveredFormula) -> Vec<Vec<String>> {
    let mut rows = Vec::new();
    for model in &formula.models {
        let Some(first) = model.sensors.first() else { continue };
        for (name, parameter) in &first.parameters {
            let target = model.name.strip_prefix(&format!("{}_", formula.name));
            let of = target.map_or_else(String::new, |target| format!("{target}: "));
            let all = model.sensors.iter().map(|sensor| sensor.parameters.get(name));
            let largest =
                all.clone().flatten().fold(0.0, |most: f64, own| most.max(own.value.abs()));
            let exponent = if largest > 0.0 { largest.log10().floor() as i32 } else { 0 };
            let (factor, unit) = match exponent {
                -1..=3 => (1.0, parameter.unit.clone()),
                _ => (10_f64.powi(exponent), format!("1e{exponent} {}", parameter.unit)),
            };
            let mut row =
                vec![format!("{of}{name} / {unit}").trim_end_matches([' ', '/']).to_owned()];
            row.extend(all.map(|own| {
                own.map_or_else(String::new, |own| {
                    let (value, error) = (own.value / factor, own.std_error / factor);
                    numbers::with_error(value, error, value.abs())
                })
            }));
            rows.push(row);
        }
    }
    rows
}

fn heading(verdict: &Verdict) -> String {
    match magnitude(verdict).as_str() {
        "" => verdict.effect.clone(),
        size => format!("{}: {size}", verdict.effect),
    }
}

/// Effects with equal evidence, and the recordings that would separate them.
fn equivalent_effects(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for tie in equivalent_sets(diagnosis) {
        page += &styled(HEADING, &format!("Equivalent on these data: {}", tie.effects.join(", ")));
        for alike in &tie.alike {
            page += &paragraph(&format!("  {alike}."));
        }
        page += &suggested_recordings("To separate them, record", &tie.record);
        page.push('\n');
    }
    page
}

/// Inconclusive effects by reason.
fn inconclusive_effects(diagnosis: &Diagnosis) -> String {
    let groups = inconclusive_groups(diagnosis);
    if groups.is_empty() {
        return String::new();
    }
    let mut page = format!("{HEADING}Inconclusive from these recordings{HEADING:#}\n");
    for group in groups {
        page += &paragraph(&format!("  {}: {}.", listed(&group.effects), group.why));
        page += &suggested_recordings("Record", &group.record);
    }
    page + "\n"
}

fn suggested_recordings(head: &str, list: &[(String, String)]) -> String {
    let mut page = String::new();
    for (effects, record) in list {
        page += &match list.len() {
            1 => paragraph(&format!("    {head}: {record}")),
            _ => paragraph(&format!("    {head}, for {effects}: {record}")),
        };
    }
    page
}

/// The residual that no effect explains.
fn unexplained_residual(diagnosis: &Diagnosis) -> String {
    if diagnosis.at_floor {
        return styled(GOOD, &at_floor_note(diagnosis)) + "\n";
    }
    let mut page = String::new();
    for one in &diagnosis.unexplained {
        page += &styled(WARNING, &unexplained(one));
    }
    if let Some(structure) = &diagnosis.remaining {
        page += &styled(WARNING, &remaining(structure, diagnosis.noise.unit));
    }
    if diagnosis.unexplained.is_empty() {
        return page;
    }
    page + &paragraph(&format!("  {}", EXPR_HINT)) + "\n"
}

/// Commands are not wrapped, so that they can be copied.
fn next_commands(next: &Suggestion) -> String {
    let mut page = String::new();
    let heading = suggestion_heading(next.kind);
    if !heading.is_empty() {
        page += &format!("\n{}", paragraph(heading));
    }
    for command in &next.commands {
        page += &format!("  {command}\n");
    }
    page
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
            "Suggestion, align the clocks, which no device can compensate, and diagnose the new model with the same --delay-ms:"
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

pub fn to_json(diagnosis: &Diagnosis) -> Value {
    let findings = diagnosis.findings.iter().map(|finding| {
        json!({
            "id": finding.id,
            "column": finding.place.column,
            "message": findings::message(finding),
            "stops": finding.stops,
        })
    });
    json!({
        "model": diagnosis.model,
        "campaign": diagnosis.campaign,
        "findings": findings.collect::<Vec<_>>(),
        "verdicts": diagnosis.verdicts.iter().map(|one| verdict_json(diagnosis, one)).collect::<Vec<_>>(),
        "accepted": accepted_of_catalogue(diagnosis),
        "formulas": diagnosis.formulas.iter().map(|one| formula_json(diagnosis, one)).collect::<Vec<_>>(),
        "equivalent_formulas": diagnosis.equivalent_formulas.iter().map(|one| formula_json(diagnosis, one)).collect::<Vec<_>>(),
        "unexplained": unexplained_json(diagnosis),
        "higher_degree": diagnosis.higher_degree,
        "confounded_offsets": diagnosis.confounded_offsets,
        "at_floor": diagnosis.at_floor,
        "worst_axis": diagnosis.worst_axis,
        "signal_unit": diagnosis.noise.unit.symbol(),
        "noise": diagnosis.noise,
        "interrupted": diagnosis.is_interrupted,
        "staircase": diagnosis.staircase,
        "dropped": diagnosis.dropped,
        "rows": { "selected_by": diagnosis.rows[0], "all": diagnosis.rows[1] },
        "recordings": { "selected_by": diagnosis.recordings[0], "all": diagnosis.recordings[1] },
        "blocks": diagnosis.blocks,
        "block_s": diagnosis.block_s,
        "seed": diagnosis.seed,
        "proposal": diagnosis.proposal.as_ref().map(recording_plan::to_json),
        "next": diagnosis.next.commands,
        "verdict": verdict(diagnosis),
    })
}

/// Accepted steps without those of the formulas, which are listed by themselves.
fn accepted_of_catalogue(diagnosis: &Diagnosis) -> Vec<&Vec<String>> {
    let formulas = || diagnosis.formulas.iter().flat_map(|formula| &formula.effects);
    let is_formula = |name: &String| formulas().any(|formula| formula.name() == name);
    diagnosis.accepted.iter().filter(|step| !step.iter().any(is_formula)).collect()
}

/// Located shares, then what follows no covariate; empty at the noise floor only.
fn unexplained_json(diagnosis: &Diagnosis) -> Vec<Value> {
    let located = diagnosis.unexplained.iter().map(|one| json!(one));
    let remaining = diagnosis.remaining.iter().map(|structure| {
        let mut object = json!(structure);
        object["covariate"] = Value::Null;
        object
    });
    located.chain(remaining).collect()
}

/// Expressions and ranges are those of `magpie add --expr` and `--range`.
fn formula_json(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> Value {
    json!({
        "name": formula.name,
        "partial": !diagnosis.at_floor,
        "covariates": formula.covariates,
        "targets": formula.targets,
        "other_targets": formula.other_targets,
        "gain": formula.gain,
        "p_value": formula.p_value,
        "floors_after": formula_floors(diagnosis, formula),
        "effects": formula.models,
        "device": of_device(diagnosis, &effect_names(formula)),
    })
}

fn verdict_json(diagnosis: &Diagnosis, verdict: &Verdict) -> Value {
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
        "unit": verdict.unit,
        "z_typical": verdict.z_typical,
        "reason": reason(verdict),
        "record": verdict.record,
        "device": of_device(diagnosis, &[&verdict.effect]),
    })
}

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

/// Explanation of shadows.
pub const SHADOW_NOTE: &str = "Shadow: significant by itself, but it explains part of the same residual as the effect named in its row and, \
                               next to that, nothing significant: whether it is present is open.";

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
    let value = value(verdict.value, verdict.std_error, &verdict.unit);
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

/// "7.98±0.01 N", or that the magnitude is not identifiable.
pub fn value(value: f64, std_error: f64, unit: &str) -> String {
    if std_error > MAX_RELATIVE_ERROR * value.abs() {
        return "not identifiable".to_owned();
    }
    let value = numbers::with_error(value, std_error, value.abs());
    format!("{value} {unit}").trim_end().to_owned()
}

/// Physics of the effect, one paragraph.
pub fn physics(verdict: &Verdict) -> &'static str {
    find(&verdict.effect).map_or("A user-defined effect.", |effect| effect.physics)
}

/// That the residual is below the floor, with both numbers.
pub fn below_floor(rms: f64, floor: f64, unit: SignalUnit) -> String {
    format!(
        "The residual, {}, is below the noise floor, {}: the floor is too high, and it is not known what of the residual is noise. Record a rest of ten seconds, or repeat some loads.",
        signal(rms, unit),
        signal(floor, unit)
    )
}

/// Summary in one paragraph; empty without a result.
pub fn verdict(diagnosis: &Diagnosis) -> String {
    if diagnosis.findings.iter().any(|finding| finding.stops) {
        return stopped_verdict(&diagnosis.findings);
    }
    let sentences = [
        diagnosis.higher_degree.as_ref().map(|higher| higher_degree(higher, diagnosis.noise.unit)),
        Some(verdict_on_effects(diagnosis)),
        diagnosis.confounded_offsets.as_ref().map(confounded_offsets),
    ];
    sentences.into_iter().flatten().collect::<Vec<_>>().join(" ")
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

/// That another degree of the polynomial describes the forces better.
pub fn higher_degree(higher: &HigherDegree, unit: SignalUnit) -> String {
    format!(
        "The degree of the polynomial is too low: with degree {} the held-out error of the field falls from {} to {}.",
        higher.degree,
        signal(higher.now_g, unit),
        signal(higher.then_g, unit)
    )
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

/// What a step gains; an earlier step may raise the error that a later one lowers.
fn reduction(gain: f64) -> String {
    if gain > 0.0 {
        format!("reduces the held-out squared error by {:.1} %", 100.0 * gain)
    } else {
        "reduces the held-out squared error together with the later steps".to_owned()
    }
}

/// The reason of a verdict, as a clause.
pub fn reason(verdict: &Verdict) -> String {
    let z = verdict.z_typical;
    let mut text = match &verdict.reason {
        Reason::ReducesError => {
            let included = if verdict.inclusion.is_finite() {
                format!(
                    ", and is included in {:.0} of {RESAMPLES} resamples of the blocks of time",
                    verdict.inclusion * RESAMPLES as f64
                )
            } else {
                String::new()
            };
            format!("it {}{included}", reduction(verdict.gain))
        }
        Reason::Equivalent => {
            "each of them explains the same; these recordings cannot distinguish them".to_owned()
        }
        Reason::ExplainedBetter(effects) => {
            format!("it explains part of what {} explains better", effects.join(" or "))
        }
        Reason::FormOf(effect) => {
            format!("it explains a remainder that is consistent with another form of {effect}")
        }
        Reason::DriftsWithTime => {
            "the residual drifts with time more freely than this effect can".to_owned()
        }
        Reason::OtherCause => "it fits part of a residual with another cause".to_owned(),
        Reason::Implausible => format!(
            "it lowers the error by {:.1} %, but only with {}, {}",
            100.0 * verdict.gain,
            value(verdict.value, verdict.std_error, &verdict.unit),
            match verdict.implausible {
                Some(_) => "so the cause is another one",
                None => "which is negligible or not determined",
            }
        ),
        Reason::Unconfirmed => {
            "the score test is significant, but no fit with it lowers the held-out error in every fold, with a plausible magnitude"
                .to_owned()
        }
        Reason::UnexplainedResidual(first) => format!(
            "{} and is explained by no effect, which prevents a verdict",
            first
                .as_ref()
                .map_or_else(|| "much more than noise is unexplained".to_owned(), residual_follows)
        ),
        Reason::HardlyChangesField => {
            format!("a typical magnitude hardly changes the field here ({z:.1} standard errors)")
        }
        Reason::Confounded => {
            format!("it is confounded with the model's parameters ({z:.1} standard errors)")
        }
        Reason::Masked => format!(
            "the residual of other causes masks a typical magnitude ({z:.1} standard errors)"
        ),
        Reason::BelowBound(bound) if *bound >= 1.0 => {
            format!("no significant gain on held-out rows, where a typical magnitude would be {z:.0} standard errors")
        }
        Reason::BelowBound(bound) => {
            format!("at most {bound:.2} times its typical magnitude (95 %)")
        }
        Reason::NeedsGeometry => {
            "it acts on the magnet, which a polynomial does not model: give [design] and fit the cylinder base".to_owned()
        }
        Reason::InPolynomial => {
            "it depends on the forces alone, and the polynomial of the forces contains it".to_owned()
        }
        Reason::NeedsForce => "it acts through a force, and no force was recorded".to_owned(),
        Reason::DoesNotVary(column) => format!("{column} does not vary beyond its noise"),
        Reason::NoTimeOrder => "the order of the rows carries no time".to_owned(),
        missing @ (Reason::NotRecorded(..) | Reason::AssumedTimes(_) | Reason::NotAField(_)) => {
            missing.missing_data().unwrap_or_default()
        }
        Reason::Unfitted(error) => format!("the base model cannot be fitted: {error}"),
    };
    if let Some((low, high)) = verdict.implausible {
        text += &format!("; plausible are {low} to {high} {}", verdict.unit);
    }
    text
}

/// The magnitude or the reason in a few words, for a table; equal for equal reasons.
pub fn short_reason(verdict: &Verdict) -> String {
    match &verdict.reason {
        Reason::ReducesError if verdict.value.is_finite() => {
            value(verdict.value, verdict.std_error, &verdict.unit)
        }
        Reason::ReducesError => String::new(),
        Reason::Equivalent => format!("or {}", verdict.tied_with.join(", ")),
        Reason::ExplainedBetter(effects) => {
            effects.first().map_or_else(String::new, |first| format!("part of {first}"))
        }
        Reason::FormOf(effect) => format!("form of {effect}"),
        Reason::DriftsWithTime => "drifts with time".to_owned(),
        Reason::OtherCause => "has another cause".to_owned(),
        Reason::Implausible => {
            let word = if verdict.implausible.is_some() { "implausible" } else { "undetermined" };
            format!("{word}: {}", value(verdict.value, verdict.std_error, &verdict.unit))
        }
        Reason::Unconfirmed => "not confirmed by a fit".to_owned(),
        Reason::UnexplainedResidual(_) => "much is unexplained".to_owned(),
        Reason::HardlyChangesField => "not detectable here".to_owned(),
        Reason::Confounded => "confounded".to_owned(),
        Reason::Masked => "masked by other causes".to_owned(),
        Reason::BelowBound(bound) => {
            // Why a small p-value is not enough.
            match (verdict.p_adjusted < LEVEL, *bound < 1.0) {
                (true, true) => format!("not in every fold, < {bound:.2} of typical"),
                (true, false) => "not in every fold".to_owned(),
                (false, true) => format!("< {bound:.2} of typical"),
                (false, false) => "not significant".to_owned(),
            }
        }
        Reason::NoTimeOrder => "rows without time".to_owned(),
        Reason::NotRecorded(column, _) => format!("no {column}"),
        Reason::AssumedTimes(_) => "times are assumed".to_owned(),
        Reason::NotAField(_) => "no magnetic field".to_owned(),
        Reason::NeedsGeometry
        | Reason::InPolynomial
        | Reason::NeedsForce
        | Reason::DoesNotVary(_) => SEE_BELOW.to_owned(),
        Reason::Unfitted(_) => "base model not fitted".to_owned(),
    }
}

/// "84 % of the residual follows the rotor angle".
fn residual_follows(unexplained: &Unexplained) -> String {
    let dependence = dependence(&unexplained.covariate, &unexplained.words);
    format!("{:.0} % of the residual {dependence}", 100.0 * unexplained.share)
}

pub fn reason_sentence(verdict: &Verdict) -> String {
    let reason = reason(verdict);
    let mut letters = reason.chars();
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

/// Reason by which an effect is grouped.
fn group_reason(verdict: &Verdict) -> String {
    match short_reason(verdict) {
        short if short.is_empty() || short == SEE_BELOW => reason(verdict),
        short => short,
    }
}

/// Placeholder in a table for a long reason.
pub const SEE_BELOW: &str = "see below";

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

/// Hint where structure is unexplained.
pub const EXPR_HINT: &str =
    "No effect of the catalogue explains it. Test a formula of your own with --expr.";

pub fn added_effects(stair: &StaircaseStep) -> String {
    match stair.added.as_slice() {
        [] => "the model as it is".to_owned(),
        added => format!("+ {}", added.join(" or ")),
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::diagnosis_fixture::{formula, full, verdict_of};
    use analysis::compare::ErrorRows;
    use analysis::diagnose::fitted_model::WorstAxis;

    #[test]
    fn equivalent_set_lists_reasons_and_experiments() {
        let tied = |one: &str, other: &str| Verdict {
            tied_with: vec![other.to_owned()],
            ..verdict_of(one, VerdictKind::Tied, Reason::Equivalent)
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
        let masked = |effect, z_typical| Verdict {
            z_typical,
            ..verdict_of(effect, VerdictKind::Inconclusive, Reason::Masked)
        };
        let unrecorded = Reason::NotRecorded("temp_c".to_owned(), Vec::new());
        let diagnosis = Diagnosis {
            verdicts: vec![
                masked("tip_slope", 1.0),
                verdict_of("thermal_gap", VerdictKind::Inconclusive, unrecorded),
                masked("geometric_stiffening", 2.0),
            ],
            ..Diagnosis::default()
        };
        let groups = inconclusive_groups(&diagnosis);
        assert_eq!(groups.len(), 2);
        assert_eq!(groups[0].effects, ["tip_slope", "geometric_stiffening"]);
        assert_eq!(groups[0].why, "masked by other causes");
        // One recording decides on both.
        assert_eq!(groups[0].record.len(), 1);
        assert_eq!(groups[0].record[0].0, "tip_slope, geometric_stiffening");
        assert_eq!(groups[1].why, "temp_c was not recorded");
    }

    #[test]
    fn provisional_verdict_requests_no_recording() {
        let mut blocked =
            verdict_of("tip_slope", VerdictKind::Inconclusive, Reason::UnexplainedResidual(None));
        blocked.provisional = true;
        let diagnosis = Diagnosis { verdicts: vec![blocked], ..Diagnosis::default() };
        assert_eq!(inconclusive_groups(&diagnosis)[0].record, []);
    }

    #[test]
    fn one_large_unknown_is_one_row_and_missing_columns_come_first() {
        let blocked = |effect: &str, gain: f64| Verdict {
            gain,
            provisional: true,
            ..verdict_of(effect, VerdictKind::Inconclusive, Reason::UnexplainedResidual(None))
        };
        let names = [
            "creep",
            "hysteresis",
            "softening",
            "hard_stop",
            "tip_slope",
            "viscous_lag",
            "earth_field",
        ];
        let mut verdicts = vec![blocked("external_magnet", 0.13)];
        verdicts.extend(names.iter().map(|name| blocked(name, 0.001)));
        let missing = Reason::NotRecorded("opening_mm".to_owned(), Vec::new());
        verdicts.push(verdict_of("neighbour_magnet", VerdictKind::Inconclusive, missing));
        let step = StaircaseStep {
            added: Vec::new(),
            parameters: 14,
            held_out_rms_g: 0.7,
            force: None,
            floor_g: 0.16,
        };
        let diagnosis = Diagnosis { verdicts, staircase: vec![step], ..Diagnosis::default() };
        let page = uncolored(&diagnosis);
        let row = page.lines().find(|line| line.contains("7 others")).unwrap();
        assert!(row.contains("INCONCLUSIVE") && row.contains("much is unexplained"), "{row}");
        assert!(!page.contains("hard_stop") && page.contains("external_magnet"), "{page}");
        assert!(page.contains("8 effects: much more than noise"), "{page}");
        let first =
            page.find("opening_mm was not recorded: nothing can be said on neighbour_magnet.");
        assert!(first.unwrap() < page.find("verdict").unwrap(), "{page}");
    }

    #[test]
    fn rule_behind_absent_is_stated_where_the_p_value_is_small() {
        let absent = |p_adjusted: f64| {
            short_reason(&Verdict {
                p_adjusted,
                ..verdict_of("creep", VerdictKind::Absent, Reason::BelowBound(0.08))
            })
        };
        assert_eq!(absent(0.4), "< 0.08 of typical");
        assert_eq!(absent(0.002), "not in every fold, < 0.08 of typical");
    }

    #[test]
    fn rising_force_error_is_stated() {
        let step = |added: &str, rms_g: f64, rms_n: f64| StaircaseStep {
            added: vec![added.to_owned()],
            parameters: 14,
            held_out_rms_g: rms_g,
            force: Some(ForceError::of_device(rms_n, 0.4, ErrorRows::LeaveRecordingOut)),
            floor_g: 0.16,
        };
        let steps = [
            step("", 3.8, 2.4),
            step("magnet_temperature", 2.1, 2.6),
            step("hysteresis", 0.2, 0.5),
        ];
        let note = rising_force(&steps).unwrap();
        assert!(
            note.starts_with("With magnet_temperature the excess of the forces rises"),
            "{note}"
        );
        assert_eq!(rising_force(&steps[1..]), None);
    }

    #[test]
    fn magnitude_is_formatted_with_the_typical_one() {
        let mut found = verdict_of("hysteresis", VerdictKind::Found, Reason::ReducesError);
        (found.value, found.std_error) = (7.982, 0.010);
        found.unit = "N".to_owned();
        let text = magnitude(&found);
        assert!(text.starts_with("7.982±0.010 N, friction"), "{text}");
        assert!(text.ends_with("; typical is 2.5 N"), "{text}");
        assert_eq!(magnitude(&verdict_of("my_own", VerdictKind::Found, Reason::ReducesError)), "");
    }

    #[test]
    fn formula_is_listed_with_its_line_its_values_and_its_other_targets() {
        let step = |added: &[&str], rms: f64| StaircaseStep {
            added: added.iter().map(|&name| name.to_owned()).collect(),
            parameters: 14,
            held_out_rms_g: rms,
            force: None,
            floor_g: 0.16,
        };
        let diagnosis = Diagnosis {
            formulas: vec![formula()],
            staircase: vec![step(&[], 0.521), step(&["formula_1"], 0.1632)],
            at_floor: true,
            ..Diagnosis::default()
        };
        let page = uncolored(&diagnosis);
        assert!(page.contains("  formula_1: by_g = a*fx_n*opening_mm + b*fx_n\n"), "{page}");
        // In units of a power of ten; no finer than a thousandth of the value.
        for cells in
            [["a / 1e-3 G", "1.204±0.002", "1.199±0.002"], ["b / G", "-0.251±0.012", "0.020±0.012"]]
        {
            let has_all = |line: &&str| cells.iter().all(|cell| line.contains(cell));
            assert!(page.lines().any(|line| has_all(&line)), "{cells:?}: {page}");
        }
        let words = unwrapped(&page);
        assert!(words.contains("by 98.4 % (family-wise p 0.001), to 1.02 times"), "{words}");
        let others = "the same, within 2 %, if it acts on dy_um, or on gain_x_percent and gain_y_percent instead";
        assert!(words.contains(others), "{words}");
        assert!(!words.contains("PARTIAL"), "{words}");
        let unknown = DiscoveredFormula { other_targets: None, ..formula() };
        let expected = "It acts on by_g. Other quantities were not compared.";
        assert_eq!(formula_alternatives(&unknown), expected);
        let partial = Diagnosis { at_floor: false, ..diagnosis };
        assert!(uncolored(&partial).contains("PARTIAL: structure remains"));
        let json = to_json(&partial);
        assert_eq!(json["formulas"][0]["partial"], true);
        assert_eq!(json["formulas"][0]["covariates"], json!(["fx_n", "opening_mm"]));
        assert!((json["formulas"][0]["floors_after"].as_f64().unwrap() - 1.02).abs() < 1e-9);
        let effect = &json["formulas"][0]["effects"][0];
        assert_eq!(effect["expression"], "formula_1: by_g = a*fx_n*opening_mm + b*fx_n");
    }

    /// The report without colors.
    fn uncolored(diagnosis: &Diagnosis) -> String {
        anstream::adapter::strip_str(&format_report(diagnosis)).to_string()
    }

    fn unwrapped(page: &str) -> String {
        page.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn lines_other_than_commands_fit_in_80_columns() {
        let page = uncolored(&full());
        for line in page.lines().filter(|line| !line.contains("cargo magpie add")) {
            assert!(line.chars().count() <= 80, "{line}");
        }
    }

    #[test]
    fn each_effect_takes_one_table_row() {
        let page = uncolored(&full());
        let table: Vec<&str> = page
            .lines()
            .skip_while(|line| !line.starts_with('─'))
            .skip(1)
            .take_while(|line| !line.starts_with('─'))
            .collect();
        assert_eq!(table.len(), 9, "{table:#?}");
        assert!(table[8].contains("ABSENT") && table[8].contains("< 0.08 of typical"));
    }

    #[test]
    fn equivalent_effects_list_recordings_that_separate_them() {
        let page = unwrapped(&uncolored(&full()));
        assert!(page.contains("Equivalent on these data: magnet_temperature, sensor_temperature"));
        assert!(page.contains(
            "To separate them, record, for magnet_temperature: Warm the gripper by 10 K"
        ));
        assert!(page.contains(
            "To separate them, record, for sensor_temperature: Warm and cool the unloaded"
        ));
    }

    #[test]
    fn text_lists_inconclusive_effects_by_reason() {
        let page = unwrapped(&uncolored(&full()));
        assert!(page.contains(
            "tip_slope, geometric_stiffening: not detectable here. Record: Load each flexure"
        ));
        assert!(
            page.contains("earth_field: roll_rad was not recorded. Record: Rotate the unloaded")
        );
        assert!(page.contains("thermal_gap: it acts on the magnet, which a polynomial"));
    }

    #[test]
    fn sampling_similar_effects_and_equivalent_formulas_are_stated() {
        let mut diagnosis = full();
        diagnosis.rows = [900, 3600];
        let found = &mut diagnosis.verdicts[0];
        let share = |effect: &str, share| (effect.to_owned(), share);
        found.reproduces = vec![share("creep", 0.76), share("clock_skew", 0.3)];
        let equivalent = formula();
        let text = equivalent.models[0].expression.clone().unwrap();
        (found.kind, found.tied_with) = (VerdictKind::Tied, vec![equivalent.name.clone()]);
        diagnosis.equivalent_formulas = vec![equivalent];
        let page = unwrapped(&uncolored(&diagnosis));
        assert!(page.contains("Effects are selected on 25 % of the rows"));
        assert!(page.contains("standard errors are 2.0 times those of all rows then"));
        assert!(page.contains("On these recordings it reproduces the patterns of creep (76 %)."));
        assert!(page.contains("Equivalent on these data: hysteresis, formula_1"));
        assert!(page.contains(&format!("A formula leaves the same error: {text}.")));
        let json = to_json(&diagnosis);
        assert_eq!(json["equivalent_formulas"][0]["name"], "formula_1");
        assert_eq!(json["verdicts"][0]["reproduces"][0]["effect"], "creep");
        assert_eq!(json["rows"]["all"], 3600);
    }

    #[test]
    fn unexplained_residual_suggests_a_formula() {
        let mut diagnosis = full();
        let page = unwrapped(&uncolored(&diagnosis));
        assert!(page.contains(
            "UNEXPLAINED: 84 % of the residual follows the rotor angle (motor_angle_rad)"
        ));
        assert!(page.contains("--expr"));
        assert!(!page.contains("AT NOISE FLOOR"));
        diagnosis.at_floor = true;
        let page = unwrapped(&uncolored(&diagnosis));
        assert!(page.contains("AT NOISE FLOOR with what was found"));
        assert!(!page.contains("UNEXPLAINED"));
    }

    #[test]
    fn an_axis_above_its_floor_is_named_where_all_together_are_at_it() {
        let mut diagnosis = full();
        let last = diagnosis.staircase.last_mut().unwrap();
        last.held_out_rms_g = 1.1 * last.floor_g;
        diagnosis.is_complete = true;
        diagnosis.worst_axis = Some(WorstAxis { sensor: 2, axis: "y", floors: 1.72 });
        let expected =
            "Structure remains: sensor 2 y has 1.72 times its floor, all axes together 1.10 times";
        assert!(verdict(&diagnosis).contains(expected), "{}", verdict(&diagnosis));
        diagnosis.at_floor = true;
        assert!(verdict(&diagnosis).contains("at the noise floor"), "{}", verdict(&diagnosis));
    }

    #[test]
    fn dropped_steps_are_listed_with_their_reason() {
        let dropped =
            |step: &str, reason| DroppedStep { step: step.to_owned(), gain: 0.021, reason };
        let mut diagnosis = full();
        assert!(!uncolored(&diagnosis).contains("Dropped"));
        diagnosis.dropped = vec![
            dropped("creep", DropReason::NotOnAllRows),
            dropped("hysteresis", DropReason::Replaced),
        ];
        let page = unwrapped(&uncolored(&diagnosis));
        let expected = "Dropped: creep (gain 2.1 % when it was accepted): it lowers the error of all rows by too little, or not in \
                        every fold. Dropped: hysteresis (gain 2.1 % when it was accepted): formulas leave less, or as much with \
                        fewer terms.";
        assert!(page.contains(expected), "{page}");
        assert_eq!(to_json(&diagnosis)["dropped"][1]["reason"], "replaced");
    }

    #[test]
    fn accepted_effect_has_magnitude_and_physics() {
        let page = unwrapped(&uncolored(&full()));
        let at = page.find("hysteresis: 7.982±0.010 N, friction force").unwrap();
        assert!(page[at..].contains("typical is 2.5 N Where the finger rubs on a guide"));
        assert!(page.contains("It reduces the held-out squared error by 99.4 %."));
    }

    #[test]
    fn report_ends_with_the_next_command() {
        let page = uncolored(&full());
        assert!(
            page.ends_with("\n  cargo magpie add model.toml 'my <b>' hysteresis -o new.toml\n")
        );
    }

    #[test]
    fn provisional_verdict_is_marked_and_explained() {
        let mut diagnosis = full();
        diagnosis.verdicts[0].provisional = true;
        let page = uncolored(&diagnosis);
        assert!(page.contains(" FOUND? "));
        assert!(page.contains("A question mark: provisional"));
        assert!(!uncolored(&full()).contains("A question mark"));
    }
}
