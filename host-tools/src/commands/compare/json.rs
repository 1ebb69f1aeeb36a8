//! What `magpie compare --json` prints.

use serde_json::{Value, json};

use crate::compare::{AxisFigures, Bin, Comparison, ForceFigures, Located, Worst};

/// The object.
pub fn json(comparison: &Comparison) -> Value {
    let findings = comparison.findings.iter().map(|finding| {
        json!({
            "id": finding.id,
            "column": finding.place.column,
            "file": finding.place.file.display().to_string(),
            "line": finding.place.line,
            "message": finding.message,
            "stops": finding.stops,
            "fix": finding.fix.as_ref().map(ToString::to_string),
        })
    });
    let mut object = json!({
        "model": comparison.model,
        "campaign": comparison.campaign,
        "findings": findings.collect::<Vec<_>>(),
        "judged": comparison.judged,
        "axes": comparison.axes.iter().map(axis).collect::<Vec<_>>(),
        "forces": comparison.forces.iter().map(force).collect::<Vec<_>>(),
        "where": comparison.located.iter().map(located).collect::<Vec<_>>(),
        "worst": comparison.worst.iter().map(worst).collect::<Vec<_>>(),
        "correlation_s": comparison.correlation_s,
        "verdict": comparison.verdict,
    });
    if let (Some(other), Some(fields)) = (&comparison.other, object.as_object_mut()) {
        fields.insert("with".to_owned(), json(other));
    }
    object
}

fn axis(axis: &AxisFigures) -> Value {
    json!({
        "sensor": axis.sensor,
        "axis": axis.axis.letter(),
        "rms_g": axis.error.rms,
        "mean_g": axis.error.mean,
        "std_g": axis.error.std,
        "p95_g": axis.error.p95,
        "max_g": axis.error.greatest,
        "span_g": axis.error.span,
        "floor_g": axis.floor.total,
        "floor": {
            "white_g": axis.floor.white,
            "quantisation_g": axis.floor.quantisation,
            "reference_g": axis.floor.reference,
            "slow_g": axis.floor.slow,
            "replicates_g": axis.floor.replicates,
        },
        "explainable_g": axis.explainable,
    })
}

fn force(force: &ForceFigures) -> Value {
    json!({
        "sensor": force.sensor,
        "axis": force.axis.letter(),
        "rmse_n": force.error.rms,
        "mean_n": force.error.mean,
        "std_n": force.error.std,
        "p95_n": force.error.p95,
        "max_n": force.error.greatest,
        "span_n": force.error.span,
        "tared_rmse_n": force.tared_rms,
        "floor_n": force.floor,
        "explainable_n": force.explainable,
    })
}

fn located(located: &Located) -> Value {
    json!({
        "covariate": located.covariate,
        "unit": located.unit,
        "share": located.share,
        "alone": located.alone,
        "chosen": located.chosen,
        "sensors": located.sensors,
        "bins": located.bins.iter().map(bin).collect::<Vec<_>>(),
    })
}

fn bin(bin: &Bin) -> Value {
    json!({
        "from": bin.from,
        "to": bin.to,
        "centre": bin.centre,
        "rows": bin.rows,
        "rms_g": bin.rms_g,
        "share": bin.share,
        "mean_g": bin.mean_g,
        "band_g": bin.band_g,
    })
}

fn worst(worst: &Worst) -> Value {
    json!({
        "recording": worst.recording,
        "from_s": worst.from_s,
        "to_s": worst.to_s,
        "sensor": worst.sensor,
        "rms_g": worst.rms_g,
        "doing": worst.doing,
    })
}
