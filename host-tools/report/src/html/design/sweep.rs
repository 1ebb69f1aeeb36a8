//! Many designs, and those that no other beats.

use maud::html;
use model_export::design::sampling::SamplingMethod;
use model_export::design::sweep::Candidate;

use crate::html::design::clouds;
use crate::html::tables::table;
use crate::html::{Section, palette};
use crate::text::design::{CANDIDATE_HEADS, candidate_row, causes};

/// Rows of the table at most.
const ROWS: usize = 200;

/// Range against sensitivity and interference; the front; what ends the ranges.
pub fn sections(candidates: &[Candidate], front: &[usize], sample: SamplingMethod) -> Vec<Section> {
    vec![overview(candidates, front, sample), unbeaten(candidates, front)]
}

fn overview(candidates: &[Candidate], front: &[usize], sample: SamplingMethod) -> Section {
    let how = match sample {
        SamplingMethod::Sobol => "spread evenly",
        SamplingMethod::Grid => "every combination of a few values of each size",
    };
    let best = || front.iter().map(|place| &candidates[*place]);
    let all = |of: fn(&Candidate) -> f64| points(candidates.iter(), of);
    let cloud = |of: fn(&Candidate) -> f64| {
        [
            (palette::GRID, "a design".to_owned(), all(of)),
            (palette::FIRST, "beaten by none".to_owned(), points(best(), of)),
        ]
    };
    let ended = causes(candidates).into_iter();
    let ended = ended.map(|(cause, count)| [cause.name().to_owned(), count.to_string()]);
    let axis = "force range, N";
    let body = html! {
        p { (candidates.len()) " designs, " (how) "; " (front.len())
            " are beaten by none in force range, sensitivity and interference together." }
        (clouds("Sensitivity over the force range of every design.", (axis, "sensitivity, G/N"), &cloud(|one| one.g_per_n)))
        (clouds("Interference over the force range of every design.", (axis, "interference, N"), &cloud(|one| one.interference_n)))
        (table("What ends the range, and of how many designs", &["by", "designs"], ended))
    };
    Section { id: "designs", heading: "All designs".to_owned(), body }
}

fn unbeaten(candidates: &[Candidate], front: &[usize]) -> Section {
    let rows = front.iter().take(ROWS).map(|place| candidate_row(&candidates[*place]));
    let body = html! {
        @if front.len() > ROWS { p { "The first " (ROWS) " of " (front.len()) ", the greatest range first." } }
        (table("Designs that no other beats", &CANDIDATE_HEADS, rows))
    };
    Section { id: "front", heading: "The best of them".to_owned(), body }
}

/// Range and something else of those that work.
pub(super) fn points<'a>(
    candidates: impl Iterator<Item = &'a Candidate>,
    of: fn(&Candidate) -> f64,
) -> Vec<(f64, f64)> {
    let working = candidates.filter(|one| one.works());
    working.map(|one| (one.range_n, of(one))).collect()
}
