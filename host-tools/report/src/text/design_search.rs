//! Text and JSON of searches of the design space.

use std::path::Path;

use analysis::numbers::number;
use model_export::design::interference::FieldShift;
use model_export::design::optimise::OptimisedDesign;
use model_export::design::sampling::SamplingMethod;
use model_export::design::sweep::Candidate;
use serde_json::{Value, json};

use crate::text::{design, terminal};

/// Printed rows of the Pareto front.
const FRONT_ROWS: usize = 12;

/// `count` evenly spaced elements, including both ends.
fn evenly_spaced(front: &[usize], count: usize) -> Vec<usize> {
    let last = front.len().saturating_sub(1);
    let rows = count.min(front.len());
    let place = |i: usize| i * last / rows.saturating_sub(1).max(1);
    (0..rows).map(|i| front[place(i)]).collect()
}

/// A sweep as text; `report` is the path of the HTML report.
pub fn format_sweep(
    sample: SamplingMethod,
    seed: u64,
    candidates: &[Candidate],
    front: &[usize],
    seconds: f64,
    report: Option<&Path>,
) -> String {
    let mut table = terminal::table(design::CANDIDATE_HEADS);
    for place in evenly_spaced(front, FRONT_ROWS) {
        table.add_row(design::candidate_row(&candidates[place]));
    }
    let limits: Vec<String> = design::causes(candidates)
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(cause, count)| format!("{} {count}", cause.name()))
        .collect();
    let mut page = terminal::paragraph(&format!(
        "{} designs ({}) in {seconds:.1} s, {} of them feasible; Pareto front of range, sensitivity and interference: \
         {} (misalignment seed {}). Range limited by: {}.",
        candidates.len(),
        sample.name(),
        candidates.iter().filter(|one| one.works()).count(),
        front.len(),
        seed,
        limits.join(", ")
    ));
    page += &format!("{table}\n");
    if front.len() > FRONT_ROWS {
        page += &terminal::paragraph(&format!(
            "{FRONT_ROWS} evenly spaced designs of the front; all are in the report (-o) and in --json."
        ));
    }
    page += "Next: cargo magpie design optimize --range N -o design.toml\n";
    page += &terminal::report_line(report);
    page
}

/// The object of `--json` of a sweep.
pub fn sweep_json(
    sample: SamplingMethod,
    seed: u64,
    candidates: &[Candidate],
    front: &[usize],
    report: Option<&Path>,
) -> Value {
    let one = |candidate: &Candidate| {
        json!({
            "design": candidate.design,
            "range_n": candidate.range_n,
            "ended_by": candidate.cause.name(),
            "g_per_n": candidate.g_per_n,
            "noise_n": candidate.noise_n,
            "interference_n": candidate.interference_n,
        })
    };
    let causes = design::causes(candidates)
        .into_iter()
        .map(|(cause, count)| (cause.name().replace(' ', "_"), count.into()));
    json!({
        "designs": candidates.len(),
        "working": candidates.iter().filter(|one| one.works()).count(),
        "seed": seed,
        "sample": sample.name(),
        "ended_by": causes.collect::<serde_json::Map<_, _>>(),
        "front": front.iter().map(|place| one(&candidates[*place])).collect::<Vec<_>>(),
        "report": report,
    })
}

/// An optimised design as text; `output` is the path of its design file.
pub fn format_optimum(
    optimum: &OptimisedDesign,
    shifts: &[FieldShift],
    output: Option<&Path>,
) -> String {
    let mut page = design::format_report(&optimum.design, &optimum.evaluation, shifts);
    page += &error_sentence(optimum);
    page += &design::assumptions(&optimum.design);
    if let Some(path) = output {
        page += &format!(
            "Written to {0}.\nNext: cargo magpie simulate --design {0} -o CAMPAIGN\n",
            path.display()
        );
    }
    page
}

/// The object of `--json` of an optimised design.
pub fn optimum_json(optimum: &OptimisedDesign, shifts: &[FieldShift], seed: u64) -> Value {
    let mut object = design::to_json(&optimum.design, &optimum.evaluation, shifts);
    object["error_n"] = optimum.error_n.into();
    object["bearing"] = optimum.feasible.0.into();
    object["designs"] = optimum.feasible.1.into();
    object["seed"] = seed.into();
    object
}

/// Error of the optimum, and the size bounds that limit it.
fn error_sentence(optimum: &OptimisedDesign) -> String {
    let (bearing, all) = optimum.feasible;
    let mut text = terminal::paragraph(&format!(
        "{bearing} of {all} designs withstand the force. The optimum, refined from the best of them in manufacturable \
         steps, has an error of {} N (noise and interference).",
        number(optimum.error_n)
    ));
    if !optimum.edges.is_empty() {
        let edges: Vec<String> = optimum
            .edges
            .iter()
            .map(|(name, at_minimum)| {
                if *at_minimum {
                    format!("{name} at its minimum")
                } else {
                    format!("{name} at its maximum")
                }
            })
            .collect();
        text += &terminal::paragraph(&format!("Active size bounds: {}.", edges.join(", ")));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_rows_include_both_ends_of_the_front() {
        let front: Vec<usize> = (100..200).collect();
        let rows = evenly_spaced(&front, 12);
        assert_eq!((rows.len(), rows[0], rows[11]), (12, 100, 199));
        assert_eq!(evenly_spaced(&[7], 12), [7]);
        assert!(evenly_spaced(&[], 12).is_empty());
    }
}
