//! The page of the workbench: effects and formulas to choose from on the left, the force error on top, and the sections of the
//! comparison, which the page replaces with each model.

pub mod import;

use analysis::compare::Comparison;
use analysis::diagnose::{Diagnosis, Verdict};
use analysis::numbers;
use analysis::workbench::{ResidualScatter, Workbench, WorkbenchModel};
use maud::{DOCTYPE, PreEscaped, html};
use model_export::effects::excitation::BUILT_IN_COVARIATES;
use model_export::effects::{EffectTerm, Expression, find};
use model_export::inverse::device_support::device_support;
use plotters::prelude::*;
use serde_json::{Value, json};

use crate::html::diagnosis::verdicts::planned;
use crate::html::plot::{Along, axes, figure, px, stroke};
use crate::html::{
    attribution, errors, head, histograms, map, palette, parameters, summary, traces,
};
use crate::text::comparison::conclusion::{validation, verdict};
use crate::text::comparison::{force_headline, force_origins};
use crate::text::diagnosis::formulas::formula_on_device;
use crate::text::diagnosis::open_questions::missing_columns;
use crate::text::diagnosis::reasons::reason;
use crate::text::diagnosis::steps;
use crate::text::diagnosis::verdicts::{is_present, magnitude, runs_on_device};
use crate::text::notes;

/// The page, without a model; its script asks for one. With `live` it shows a gripper. Its scripts are those with the `nonce`.
pub fn page(campaign: &str, live: bool, nonce: &str) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("magpie workbench: {campaign}"), html! { style { (PreEscaped(include_str!("page.css"))) } }))
            body {
                header #top {
                    h1 { "Workbench " span #campaign { (campaign) } }
                    div #bar role="img" aria-label="Force error" {}
                    p.note #legend { span.key.error {} " force error " span.key.predicted {} " predicted with the effect under the pointer " span #predicted {} span.key.noise {} " noise alone" }
                    p #headline role="status" { "Fitting the base model." }
                    button #cancel type="button" { "Cancel" }
                    pre #error role="alert" {}
                    p.note #verdict {}
                    ul.note #notes {}
                }
                div #sides {
                    div #choices {
                        div.buttons {
                            button #undo type="button" title="Ctrl+Z" { "Undo" }
                            button #redo type="button" title="Ctrl+Shift+Z" { "Redo" }
                        }
                        h2 { "In the model" }
                        ul #present {}
                        h2 { "Could be missing" }
                        div.buttons {
                            button #diagnose type="button" { "Diagnose" }
                            button #plan type="button" { "Plan the next recording" }
                        }
                        div #diagnosis-result role="status" {}
                        p.note { "Predicted excess of the force error with the effect (without forces: fall of the squared field error), held out, by the linearised model." }
                        ul #candidates {}
                        details { summary { "Not significant" } ul #others {} }
                        details { summary { "Cannot be tested here" } ul #untestable {} }
                        h2 { "Formula" }
                        form #formula-form {
                            label for="formula" { "NAME: TARGET = FORMULA" }
                            input #formula type="text" spellcheck="false" autocomplete="off" list="words" placeholder="own: dz_um = a*opening_mm";
                            datalist #words {}
                            button type="submit" { "Add" }
                        }
                        details { summary { "Names for formulas" } div #names {} }
                        h2 { "Compared with" }
                        select #baseline aria-label="Model to compare with" {}
                    }
                    div #results {
                        @if live {
                            section #live {
                                h2 { "Gripper " span #live-name {} }
                                p.note #live-state role="status" { "Waiting for the gripper." }
                                p.note #reference-state {}
                                div.pair {
                                    figure { figcaption { "Lateral force, N" } canvas #live-x role="img" aria-label="Lateral forces of the last 20 seconds" {} }
                                    figure { figcaption { "Longitudinal force, N" } canvas #live-z role="img" aria-label="Longitudinal forces of the last 20 seconds" {} }
                                }
                                div.wide tabindex="0" role="region" aria-label="Sensors" { table { thead { tr { th { "sensor" } th { "Fx, N" } th { "Fz, N" } th { "validity" } th { "temperature, °C" } th.reference { "reference Fx, N" } th.reference { "reference Fz, N" } } } tbody #live-sensors {} } }
                                form #record-form {
                                    label { "Record to " input #record-output type="text" value=(format!("{campaign}/planned-1")); }
                                    label { "Plan " input #record-plan type="text" placeholder="plan.toml, or empty"; }
                                    label { "Seconds " input #record-seconds type="number" min="1" max="36000" value="30"; }
                                    button type="submit" { "Record" }
                                    button #record-end type="button" { "End" }
                                }
                                pre #record-lines role="status" {}
                            }
                        }
                        main #view aria-busy="true" {}
                        section #scatter {
                            h2 { "Residual over a covariate" }
                            p.note { "Of the fit to all rows. Connected points: the time interval that the plots over time show; zoom there to see a loop here." }
                            div.controls {
                                label { "Over " select #covariate {} }
                                label { "Axis " select #scatter-axis { option value="0" { "x" } option value="1" { "y" } option value="2" selected { "z" } } }
                            }
                            div #scatter-plot {}
                        }
                    }
                }
                footer #bottom {
                    form #write-form {
                        select #write-kind aria-label="What to write" {
                            option value="model" { "Model" }
                            option value="tables" { "Tables for the board" }
                            option value="report" { "This page as a report" }
                            option value="plan" { "Plan of the next recording" }
                            @if live { option value="board" { "To the gripper" } }
                        }
                        input #write-path type="text" value="model.toml" aria-label="File";
                        button type="submit" { "Write" }
                        button #reload type="button" title="After recordings were added to the campaign" { "Read the campaign again" }
                        output #written {}
                    }
                    details { summary { "The same on the command line" } pre #commands {} }
                }
                script type="text/plain" id="view-script" { (PreEscaped(include_str!("../page.js"))) }
                script nonce=(nonce) { (PreEscaped(include_str!("page.js"))) }
            }
        }
    };
    page.into_string()
}

/// A model as the page shows it, compared with `baseline`; `commands` do the same.
pub fn state(
    bench: &Workbench,
    model: &WorkbenchModel,
    baseline: Option<&WorkbenchModel>,
    commands: &[String],
) -> Value {
    let device = device_support(&model.model.file, &model.model.effects);
    let present = model.model.effects.iter().zip(&model.model.file.effects).zip(device);
    let present = present.map(|((term, effect), device)| {
        let formula = match term {
            EffectTerm::Expression(expression) => Some(&expression.text),
            _ => None,
        };
        json!({
            "name": effect.name, "formula": formula, "value": effect.value, "std_error": effect.std_error, "unit": effect.unit,
            "device": format!("on the device: {device}"),
        })
    });
    let candidates = model.candidates.iter().map(|one| {
        json!({
            "name": one.effect, "excess_n": one.excess_n, "gain": one.gain, "p": one.p_adjusted, "is_significant": one.is_significant,
            "title": find(&one.effect).map_or("", |effect| effect.size.description),
            "physics": find(&one.effect).map_or("", |effect| effect.physics),
        })
    });
    let untestable = bench.untestable.iter().map(
        |one| json!({ "name": one.effect, "reason": reason(&one.verdict()), "record": one.record }),
    );
    let compared = with_baseline(model, baseline);
    let headline = std::iter::once(force_headline(&compared)).chain(force_origins(&compared));
    json!({
        "name": model.comparison.model,
        "headline": headline.collect::<Vec<_>>().join(" "),
        "verdict": verdict(&model.comparison),
        "validation": validation(&model.comparison),
        "force": model.force(),
        "baseline_force": baseline.and_then(WorkbenchModel::force),
        "present": present.collect::<Vec<_>>(),
        "candidates": candidates.collect::<Vec<_>>(),
        "untestable": untestable.collect::<Vec<_>>(),
        "notes": notes::texts(&model.comparison.notes),
        "commands": commands,
        "view": view(&compared),
    })
}

/// Names that formulas can use.
pub fn formula_names(bench: &Workbench) -> Value {
    let recorded = bench.covariates();
    let covariates = BUILT_IN_COVARIATES.into_iter().map(str::to_owned).chain(recorded);
    json!({
        "targets": Expression::target_names(),
        "covariates": covariates.collect::<Vec<_>>(),
        "functions": Expression::function_names(),
        "residual_covariates": bench.residual_covariates().iter().map(|one| json!({ "name": one.name, "words": one.words })).collect::<Vec<_>>(),
    })
}

/// A diagnosis: its sentences, and what can be added.
pub fn diagnosis(diagnosis: &Diagnosis) -> Value {
    let evidence = |verdict: &Verdict| {
        let p = numbers::decimal(verdict.p_adjusted, 3);
        let device = runs_on_device(diagnosis, &[&verdict.effect]);
        let text =
            format!("{}; gain {:.1} %, p {p}. {device}", magnitude(verdict), 100.0 * verdict.gain);
        (verdict.effect.clone(), Value::from(text.trim_start_matches("; ").trim_end()))
    };
    let formula = |effect: &EffectTerm| match effect {
        EffectTerm::Expression(expression) => {
            let ranges = expression.ranges.iter();
            let ranges =
                ranges.map(|range| format!("; {}={}..{}", range.name, range.from, range.to));
            Some(format!("{}{}", expression.text, ranges.collect::<String>()))
        }
        _ => None,
    };
    let formulas = || diagnosis.formulas.iter().chain(&diagnosis.equivalent_formulas);
    let is_formula = |name: &String| {
        formulas().any(|one| one.effects.iter().any(|effect| effect.name() == name.as_str()))
    };
    let steps = diagnosis
        .accepted
        .iter()
        .map(|step| step.iter().filter(|name| !is_formula(name)).cloned().collect::<Vec<_>>());
    let formulas = formulas().map(|one| {
        json!({ "name": one.name, "formulas": one.effects.iter().filter_map(formula).collect::<Vec<_>>(), "gain": one.gain, "p": one.p_value, "device": formula_on_device(diagnosis, one) })
    });
    json!({
        "headline": steps::force_headline(diagnosis),
        "missing": missing_columns(diagnosis),
        "steps": steps.filter(|step| !step.is_empty()).collect::<Vec<_>>(),
        "evidence": diagnosis.verdicts.iter().filter(|verdict| is_present(verdict)).map(evidence).collect::<serde_json::Map<_, _>>(),
        "formulas": formulas.collect::<Vec<_>>(),
        "at_floor": diagnosis.at_floor,
        "plan": diagnosis.proposal.as_ref().map(|proposal| planned(proposal).into_string()),
    })
}

/// Drawn points of each kind.
const POINTS: usize = 1500;

pub fn scatter(scatter: &ResidualScatter) -> String {
    let name = &scatter.covariate.words;
    let words = match scatter.covariate.unit {
        "" => name.to_string(),
        unit => format!("{name}, {unit}"),
    };
    let across = Along::holding(words, scatter.all.iter().map(|point| point[0]));
    let upwards = Along::holding("residual, G", scatter.all.iter().map(|point| point[1]));
    let some = |points: &[[f64; 2]]| -> Vec<(f64, f64)> {
        points.iter().step_by(points.len().div_ceil(POINTS).max(1)).map(|&[x, y]| (x, y)).collect()
    };
    let says = format!(
        "Residual over {name}: {} rows, of which {} are in the shown time interval.",
        scatter.all.len(),
        scatter.interval.len()
    );
    let plot = figure(SCATTER_SIZE, &says, |paper| {
        let mut chart = axes(paper, &across, &upwards)?;
        let dot = |role, size| {
            move |(x, y): (f64, f64)| Circle::new((x, y), px(size), stroke(role, 1.0).filled())
        };
        chart.draw_series(some(&scatter.all).into_iter().map(dot(palette::MUTED, 1.0)))?;
        let interval = some(&scatter.interval);
        chart.draw_series([PathElement::new(interval.clone(), stroke(palette::FIRST, 0.7))])?;
        chart.draw_series(interval.into_iter().map(dot(palette::FIRST, 1.6)))?;
        Ok(())
    });
    plot.into_string()
}

/// Size of the plot in pixels.
const SCATTER_SIZE: (u32, u32) = (760, 380);

/// The comparison of a model with a baseline, as `magpie compare --baseline` makes it.
pub fn with_baseline(model: &WorkbenchModel, baseline: Option<&WorkbenchModel>) -> Comparison {
    let other = baseline.map(|baseline| Box::new(baseline.comparison.clone()));
    Comparison { other, ..model.comparison.clone() }
}

/// Sections of a comparison that change with the model.
fn view(comparison: &Comparison) -> String {
    let sections = html! {
        (summary::findings_section(comparison))
        (summary::section(comparison))
        (traces::section(comparison))
        (errors::section(comparison))
        (attribution::section(comparison))
        (map::section(comparison))
        (histograms::section(comparison))
        (attribution::worst_section(comparison))
        (parameters::section(comparison))
    };
    sections.into_string()
}
