//! Text and JSON of a diagnosis.
//!
//! - [`verdicts`]: the table of the effects, and the accepted ones; [`reasons`]: why.
//! - [`steps`]: the error after each step. [`formulas`]: beyond the catalogue.
//! - [`open_questions`]: what these recordings cannot decide, and what is unexplained.
//! - [`conclusion`]: the verdict in one paragraph, and the suggested commands.

pub mod conclusion;
pub mod formulas;
pub mod open_questions;
pub mod reasons;
pub mod steps;
pub mod verdicts;

#[cfg(test)]
mod tests;

use analysis::diagnose::Diagnosis;
use serde_json::{Value, json};

use crate::text::findings;
use crate::text::recording_plan::{self, format_proposal};
use crate::text::terminal::{GOOD, WARNING, narrow, narrow_styled};
use conclusion::{next_commands, verdict};
use formulas::{accepted_of_catalogue, discovered_formulas, formula_json};
use open_questions::{
    equivalent_effects, inconclusive_effects, missing_columns, unexplained_json,
    unexplained_residual,
};
use steps::{force_headline, force_origins, format_steps};
use verdicts::{accepted_effects, verdict_json, verdict_table};

pub fn format_report(diagnosis: &Diagnosis) -> String {
    let mut page = findings::format_list(&diagnosis.findings);
    if diagnosis.staircase.is_empty() {
        return page + &narrow(&verdict(diagnosis));
    }
    let missing = missing_columns(diagnosis);
    if !missing.is_empty() {
        page += &(narrow(&missing) + "\n");
    }
    page += &verdict_table(diagnosis);
    page += &format_steps(diagnosis);
    page += &(narrow(&diagnosis.noise.sentence()) + "\n");
    page += &accepted_effects(diagnosis);
    page += &discovered_formulas(diagnosis);
    page += &equivalent_effects(diagnosis);
    page += &inconclusive_effects(diagnosis);
    page += &unexplained_residual(diagnosis);
    if diagnosis.is_interrupted {
        page += &narrow_styled(WARNING, INTERRUPTED_NOTE);
    }
    page += &narrow(&force_headline(diagnosis));
    page += &force_origins(diagnosis).iter().map(|origin| narrow(origin)).collect::<String>();
    let style = if diagnosis.at_floor { GOOD } else { WARNING };
    page += &narrow_styled(style, &verdict(diagnosis));
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
    let mut page = format_steps(diagnosis);
    page += &accepted_effects(diagnosis);
    page += &discovered_formulas(diagnosis);
    page += &equivalent_effects(diagnosis);
    page += &unexplained_residual(diagnosis);
    page + "\n"
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
