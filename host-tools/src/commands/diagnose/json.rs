//! What `magpie diagnose --json` prints.

use serde_json::{Value, json};

use crate::diagnose::{Diagnosis, Stair, Unexplained, Verdict};

/// The object.
pub fn json(diagnosis: &Diagnosis) -> Value {
    let findings = diagnosis.findings.iter().map(|finding| {
        json!({
            "id": finding.id,
            "column": finding.place.column,
            "message": finding.message,
            "stops": finding.stops,
        })
    });
    json!({
        "model": diagnosis.model,
        "campaign": diagnosis.campaign,
        "findings": findings.collect::<Vec<_>>(),
        "verdicts": diagnosis.verdicts.iter().map(verdict).collect::<Vec<_>>(),
        "accepted": diagnosis.accepted,
        "unexplained": diagnosis.unexplained.iter().map(unexplained).collect::<Vec<_>>(),
        "at_floor": diagnosis.at_floor,
        "staircase": diagnosis.staircase.iter().map(stair).collect::<Vec<_>>(),
        "blocks": diagnosis.blocks,
        "block_s": diagnosis.block_s,
        "seed": diagnosis.seed,
        "next": diagnosis.next.commands,
        "verdict": diagnosis.verdict,
    })
}

fn verdict(verdict: &Verdict) -> Value {
    json!({
        "effect": verdict.effect,
        "verdict": verdict.kind.id(),
        "provisional": verdict.provisional,
        "tied_with": verdict.tied_with,
        "gain": verdict.gain,
        "p_adjusted": verdict.p_adjusted,
        "value": verdict.value,
        "std_error": verdict.std_error,
        "unit": verdict.unit,
        "z_typical": verdict.z_typical,
        "reason": verdict.reason,
        "record": verdict.record,
    })
}

fn unexplained(unexplained: &Unexplained) -> Value {
    json!({ "covariate": unexplained.covariate, "share": unexplained.share })
}

fn stair(stair: &Stair) -> Value {
    json!({
        "added": stair.added,
        "held_out_rms_g": stair.held_out_rms_g,
        "held_out_rmse_n": stair.held_out_rmse_n,
        "floor_g": stair.floor_g,
    })
}
