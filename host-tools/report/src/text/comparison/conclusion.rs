//! The conclusion of a comparison.

use analysis::compare::attribution::MIN_SHARE;
use analysis::compare::{
    AT_FLOOR, Attribution, BELOW_FLOOR, Comparison, Validation, floor_g, is_at_floor, rms_g,
};
use analysis::data_quality::Finding;
use analysis::notes::MissingForces;
use analysis::numbers;
use analysis::statistics::pooled_rms;
use model_export::fit::cross_validation::{CvSplit, MAX_RECORDING_FOLDS};
use model_export::recordings::columns::SignalUnit;

use crate::text::comparison::attribution::{dependence, follows};
use crate::text::force_error;

pub fn verdict(comparison: &Comparison) -> String {
    let findings = &comparison.findings;
    if findings.iter().any(|finding| finding.stops) {
        return stopped_verdict(findings);
    }
    let conclusion = conclusion(comparison);
    match caveat(findings) {
        Some(caveat) => format!("{caveat} {conclusion}"),
        None => conclusion,
    }
}

fn conclusion(comparison: &Comparison) -> String {
    let (rms, floor) = (rms_g(&comparison.axes), floor_g(&comparison.axes));
    let span = pooled_rms(comparison.axes.iter().map(|axis| axis.error.span));
    let field = |value| numbers::signal(value, comparison.noise.unit);
    let error = format!("field {} held out ({:.2} % of the range)", field(rms), 100.0 * rms / span);
    if floor <= 0.0 || floor.is_nan() {
        return format!(
            "Inconclusive: the noise of these recordings is unknown, so there is no floor to compare {error} with."
        );
    }
    let worst =
        comparison.axes.iter().map(|axis| axis.error.rms / axis.floor.total).fold(0.0, f64::max);
    if rms < BELOW_FLOOR * floor {
        return below_floor(rms, floor, comparison.noise.unit);
    }
    let chosen: Vec<&Attribution> = comparison.located.iter().filter(|l| l.chosen).collect();
    if comparison.noise.disagreement.is_some() && rms <= AT_FLOOR * floor {
        return format!(
            "Inconclusive: {error}, the floor of {} is uncertain: see the findings.",
            field(floor)
        );
    }
    if is_at_floor(rms / floor, Some(worst)) {
        if let Some(lead) = chosen.first() {
            return format!(
                "Within {:.0} % of the noise floor: {error}, the floor is {}; {:.0} % of the remaining residual {}.",
                100.0 * (rms / floor - 1.0),
                field(floor),
                100.0 * lead.share,
                dependence(&lead.covariate, &lead.words)
            );
        }
        let excess = comparison.force().as_ref().and_then(force_error::larger_excess);
        return match excess {
            None => format!(
                "At the noise floor: {error}, the floor is {}. The field shows no missing effect.",
                field(floor)
            ),
            Some(excess) => {
                format!(
                    "Field at its noise floor: {error}, the floor is {}. {excess}",
                    field(floor)
                )
            }
        };
    }
    let located: f64 = chosen.iter().map(|l| l.share).sum();
    let unexplained = 1.0 - located;
    let lead = match chosen.first() {
        None => "no covariate explains the residual".to_owned(),
        Some(lead) => format!(
            "{}{}",
            follows(lead),
            match chosen.len() {
                1 => String::new(),
                _ => format!(
                    "; with {} it is {:.0} %",
                    chosen[1].words,
                    100.0 * (lead.share + chosen[1].share)
                ),
            }
        ),
    };
    let open = if unexplained >= MIN_SHARE && !chosen.is_empty() {
        format!("; {:.0} % follow no covariate", 100.0 * unexplained)
    } else {
        String::new()
    };
    // At most two lines: the tables have the rest.
    format!(
        "Structure remains: field {} held out, {:.1} times the floor; {lead}{open}.",
        field(rms),
        rms / floor
    )
}

/// That the residual is below the floor, with both numbers.
pub fn below_floor(rms: f64, floor: f64, unit: SignalUnit) -> String {
    format!(
        "The residual, {}, is below the noise floor, {}: the floor is too high, and it is not known what of the residual is noise. Record a rest of ten seconds, or repeat some loads.",
        numbers::signal(rms, unit),
        numbers::signal(floor, unit)
    )
}

/// Verdict where a setup error stops the comparison.
pub fn stopped_verdict(findings: &[Finding]) -> String {
    let mut stop: Vec<&str> = findings.iter().filter(|f| f.stops).map(|f| f.id).collect();
    stop.dedup();
    let fix = if findings.iter().any(|finding| finding.fix.is_some()) {
        " (--fix NEW writes a copy of the recordings with all unambiguous repairs)"
    } else {
        ""
    };
    format!(
        "Not compared: fix {} first{fix}; until then the errors do not describe the model.",
        stop.join(", ")
    )
}

/// Caveat to the verdict where the data contain setup errors.
fn caveat(findings: &[Finding]) -> Option<String> {
    let mut ids: Vec<&str> = findings.iter().map(|finding| finding.id).collect();
    ids.retain(|id| *id != "constant_covariate");
    ids.dedup();
    (!ids.is_empty()).then(|| {
        format!(
            "The data contain {}; results below include it. Fix the data before evaluating the model.",
            ids.join(", ")
        )
    })
}

/// How the errors were separated from the fit, as a clause; empty without an evaluation.
pub fn validation(comparison: &Comparison) -> String {
    match &comparison.validation {
        None => String::new(),
        Some(Validation::UnseenRecordings) => {
            "the model was not fitted to any of these recordings; its parameters are used unchanged"
                .to_owned()
        }
        Some(Validation::NotHeldOut(why)) => format!(
            "NOT held out: the model was fitted to these recordings and could not be fitted again ({why})"
        ),
        Some(Validation::Edited(worse)) => format!(
            "the file's parameters have {worse:.2} times the error of a fit to the same recordings; they are used unchanged"
        ),
        Some(Validation::CrossValidated { split, seen, refitted, all }) => {
            cross_validation(*split, *seen, *refitted, *all)
        }
    }
}

fn cross_validation(split: CvSplit, seen: usize, refitted: usize, all: usize) -> String {
    let how = match split {
        CvSplit::Recordings(count) if count > MAX_RECORDING_FOLDS => {
            "each tenth of the recordings is predicted by a fit to the others"
        }
        CvSplit::Recordings(_) => "each recording is predicted by a fit to the others",
        CvSplit::KFold => {
            "one recording: each sixth is predicted by a fit to the rest; no claim about other recordings"
        }
        CvSplit::Interleaved { block_ms } => &format!(
            "an effect is transient: every sixth block of {} s is predicted by a fit to the rest",
            numbers::decimal(1e-3 * f64::from(block_ms), 3)
        ),
        CvSplit::Blocks { block_ms, .. } => &dependent_blocks(block_ms),
    };
    let some = if refitted < seen {
        format!(
            "; fitted to {refitted} of {seen} recordings, uniformly chosen; the others are predicted by that fit"
        )
    } else {
        String::new()
    };
    let unseen = match all - seen {
        0 => String::new(),
        1 => "; 1 recording outside the fit is predicted by the model's own parameters".to_owned(),
        n => {
            format!("; {n} recordings outside the fit are predicted by the model's own parameters")
        }
    };
    format!("{how}{some}{unseen}")
}

/// What held out means where the recordings are not independent.
pub fn dependent_blocks(block_ms: u32) -> String {
    format!(
        "the recordings are not independent (see the findings): every sixth block of {} s, at the same time in all of them, is predicted by a fit to the rest without a third of a block on both sides; held out are other times of one run, so no claim about other recordings",
        numbers::decimal(1e-3 * f64::from(block_ms), 3)
    )
}

pub fn missing_forces(why: &MissingForces) -> String {
    match why {
        MissingForces::NotInvertible(why) => why.to_string(),
        MissingForces::NotCompensable(why) => why.to_string(),
        MissingForces::NotRepresentable(why) => {
            format!("the device's tables cannot hold them: {why}")
        }
        MissingForces::NoValidRow => {
            "no row has both a valid estimate and the reference forces".to_owned()
        }
    }
}
