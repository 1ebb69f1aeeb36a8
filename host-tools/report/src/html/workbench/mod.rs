//! The page of the workbench: effects and formulas to choose from on the left, the force error on top, and the sections of the
//! comparison, which the page replaces with each model.

use analysis::compare::Comparison;
use analysis::diagnose::Reason;
use analysis::workbench::{Workbench, WorkbenchModel};
use maud::{DOCTYPE, PreEscaped, html};
use model_export::effects::excitation::BUILT_IN_COVARIATES;
use model_export::effects::{EffectTerm, Expression, find};
use serde_json::{Value, json};

use crate::html::{attribution, errors, histograms, map, palette, summary, traces};
use crate::text::comparison::{validation, verdict};
use crate::text::notes;

/// The page, without a model; its script asks for one.
pub fn page(campaign: &str) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                link rel="icon" href="data:,";
                title { "magpie workbench: " (campaign) }
                style { (PreEscaped(palette::style())) (PreEscaped(include_str!("../page.css"))) (PreEscaped(include_str!("page.css"))) }
            }
            body {
                header #top {
                    h1 { "Workbench " span #campaign { (campaign) } }
                    div #bar role="img" aria-label="Force error" {}
                    p #headline role="status" { "Fitting the base model." }
                    p.note #verdict {}
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
                        p.note { "Predicted fall of the squared field error on held-out rows, by the linearised model." }
                        ul #candidates {}
                        details { summary { "Not significant" } ul #others {} }
                        details { summary { "Cannot be tested here" } ul #untestable {} }
                        h2 { "Formula" }
                        form #formula-form {
                            label for="formula" { "NAME: TARGET = FORMULA" }
                            input #formula type="text" spellcheck="false" autocomplete="off" list="words" placeholder="own: dz_um = a*opening_mm";
                            datalist #words {}
                            button type="submit" { "Add" }
                            pre #formula-error role="alert" {}
                        }
                        details { summary { "Names for formulas" } div #names {} }
                        h2 { "Compared with" }
                        select #baseline aria-label="Model to compare with" {}
                    }
                    main #view aria-busy="true" {}
                }
                footer #bottom {
                    form #write-form {
                        select #write-kind aria-label="What to write" {
                            option value="model" { "Model" }
                            option value="tables" { "Tables for the board" }
                            option value="report" { "This page as a report" }
                        }
                        input #write-path type="text" value="model.toml" aria-label="File";
                        button type="submit" { "Write" }
                        output #written {}
                    }
                    details { summary { "The same on the command line" } pre #commands {} }
                }
                script type="text/plain" id="view-script" { (PreEscaped(include_str!("../page.js"))) }
                script { (PreEscaped(include_str!("page.js"))) }
            }
        }
    };
    page.into_string()
}

/// A model as the page shows it, compared with `baseline`.
pub fn state(
    bench: &Workbench,
    model: &WorkbenchModel,
    baseline: Option<&WorkbenchModel>,
) -> Value {
    let present = model.effects.iter().zip(&model.model.effects).map(|(term, effect)| {
        let formula = match term {
            EffectTerm::Expression(expression) => Some(&expression.text),
            _ => None,
        };
        json!({
            "name": effect.name, "formula": formula, "value": effect.value, "std_error": effect.std_error, "unit": effect.unit,
        })
    });
    let candidates = model.candidates.iter().map(|one| {
        json!({
            "name": one.effect, "gain": one.gain, "p": one.p_adjusted, "is_significant": one.is_significant,
            "title": find(&one.effect).map_or("", |effect| effect.size.description),
            "physics": find(&one.effect).map_or("", |effect| effect.physics),
        })
    });
    let untestable = bench.untestable.iter().map(|one| {
        let reason = match &one.reason {
            Reason::NotRecorded(column) => format!("{column} was not recorded"),
            Reason::DoesNotVary(column) => format!("{column} does not vary"),
            Reason::NeedsGeometry => "it needs the design of the sensor".to_owned(),
            _ => "it needs a force".to_owned(),
        };
        json!({ "name": one.effect, "reason": reason, "record": one.record })
    });
    json!({
        "name": model.comparison.model,
        "verdict": verdict(&model.comparison),
        "validation": validation(&model.comparison),
        "force": model.force(),
        "baseline_force": baseline.and_then(WorkbenchModel::force),
        "present": present.collect::<Vec<_>>(),
        "candidates": candidates.collect::<Vec<_>>(),
        "untestable": untestable.collect::<Vec<_>>(),
        "notes": notes::texts(&model.comparison.notes),
        "view": view(&with_baseline(model, baseline)),
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
    })
}

/// The comparison of a model with a baseline: the baseline is the first of the two.
pub fn with_baseline(model: &WorkbenchModel, baseline: Option<&WorkbenchModel>) -> Comparison {
    match baseline {
        None => model.comparison.clone(),
        Some(baseline) => Comparison {
            other: Some(Box::new(model.comparison.clone())),
            ..baseline.comparison.clone()
        },
    }
}

/// Sections of a comparison that change with the model.
fn view(comparison: &Comparison) -> String {
    let sections = html! {
        (summary::section(comparison))
        (traces::section(comparison))
        (errors::section(comparison))
        (attribution::section(comparison))
        (map::section(comparison))
        (histograms::section(comparison))
        (attribution::worst_section(comparison))
    };
    sections.into_string()
}
