//! Formulas beyond the catalogue.

use analysis::diagnose::{Diagnosis, DiscoveredFormula};
use analysis::numbers;
use model_export::effects::EffectTerm;
use serde_json::{Value, json};

use super::reasons::reduction;
use super::verdicts::{device_line, of_device, runs_on_device};
use crate::text::causes::causes_sentence;
use crate::text::terminal::{HEADING, NARROW_WIDTH, TextTable, narrow, narrow_styled};

/// Formulas beyond the catalogue: text, evidence, values of each sensor.
pub(super) fn discovered_formulas(diagnosis: &Diagnosis) -> String {
    let mut page = String::new();
    for formula in &diagnosis.formulas {
        page += &narrow_styled(HEADING, &formula_heading(diagnosis, formula));
        // Not wrapped, so that they can be copied.
        for model in &formula.models {
            page += &format!("  {}\n", model.expression.as_deref().unwrap_or_default());
        }
        page += &narrow(&format!("  {}", formula_evidence(diagnosis, formula)));
        page += &narrow(&format!("  {}", formula_alternatives(formula)));
        page += &device_line(&formula_on_device(diagnosis, formula));
        page += &format!("{}\n\n", formula_table(formula));
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

/// Values of the parameters of a formula at each sensor, with standard errors.
pub fn formula_table(formula: &DiscoveredFormula) -> TextTable {
    let numbers = formula.models.iter().flat_map(|model| &model.sensors);
    let mut numbers: Vec<u32> = numbers.map(|sensor| sensor.number).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let sensors = numbers.iter().map(|number| format!("sensor {number}"));
    let heads: Vec<String> = std::iter::once("parameter".to_owned()).chain(sensors).collect();
    // A value with its standard error is a text.
    let text_columns = heads.len();
    TextTable { heads, rows: formula_values(formula), text_columns, width: NARROW_WIDTH }
}

/// Name and unit of each parameter of a formula, and its value at each sensor, in units of a power of ten where it is small or
/// large.
fn formula_values(formula: &DiscoveredFormula) -> Vec<Vec<String>> {
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

/// Accepted steps without those of the formulas, which are listed by themselves.
pub(super) fn accepted_of_catalogue(diagnosis: &Diagnosis) -> Vec<&Vec<String>> {
    let formulas = || diagnosis.formulas.iter().flat_map(|formula| &formula.effects);
    let is_formula = |name: &String| formulas().any(|formula| formula.name() == name);
    diagnosis.accepted.iter().filter(|step| !step.iter().any(is_formula)).collect()
}

/// Expressions and ranges are those of `magpie add --expr` and `--range`.
pub(super) fn formula_json(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> Value {
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
