//! Error tables of both forces.

use maud::{Markup, html};

use crate::html::Section;
use crate::html::tables::table as drawn;
use crate::html::training::FORCES;
use crate::text::notes;
use analysis::benchmark::evaluate::VariantResult;
use analysis::benchmark::variants::{self, EstimatorVariant};
use analysis::benchmark::{Benchmark, NetworkBenefit, network_benefit};
use analysis::numbers::{maybe, number, percent};

/// First section of the page.
pub fn section(table: &Benchmark) -> Section {
    let body = html! {
        p.verdict { (verdict(table)) }
        p { "Held-out recording " (table.recordings.1) ". Everything was fitted and trained on recording "
            (table.recordings.0.join(", ")) " (" (number(table.training_s)) " s; the last " (number(table.validation_s))
            " s were the validation set for early stopping)." }
        @if table.simulated {
            p { "These recordings are simulated. The paper's were measured and are not public: its results are listed for reference only." }
        } @else {
            p { "The paper's recordings are not public: its results are from another gripper under other loads." }
        }
        @for note in &table.notes { p.note { "Note: " (notes::text(note)) "." } }
        @for (axis, name) in FORCES { (of_force(table, axis, name)) }
        p.note { "Estimate minus reference in newtons, at every row of the board. Fixed: with the device's fixed-point code. "
            "Tared: minus the mean of the estimate over the first unloaded stretch of at most one second, except what friction "
            "may hold at rest for physics with effects. "
            "Noise: contribution of the white noise of sensor and reference. "
            "Paper: RMSE, mean, and the column called variance in Table I, which is a standard deviation in N." }
        @if let Some(found) = table.of(EstimatorVariant::Gru3Axis).and_then(|evaluation| evaluation.coverage.as_ref()) {
            p { "Coverage of 1, 2, 3 predicted standard deviations of the network of 3 axes: "
                (found.within.map(percent).join(", ")) " of its errors after the tare; Gaussian: 68.3, 95.4, 99.7 %." }
        }
    };
    Section { id: "table", heading: "Errors, as in Table I".to_owned(), body }
}

fn of_force(table: &Benchmark, axis: usize, name: &str) -> Markup {
    let row = |evaluation: &VariantResult| {
        let figures = &evaluation.axes[axis];
        let stated = variants::published(evaluation.variant, axis);
        let tared =
            |sums: Option<analysis::statistics::Moments>| maybe(sums.map(|sums| sums.rms()));
        [
            evaluation.variant.words().to_owned(),
            number(figures.float.rms()),
            number(figures.float.mean()),
            number(figures.float.std()),
            tared(figures.float_tared),
            number(figures.fixed.rms()),
            tared(figures.fixed_tared),
            number(figures.noise_n),
            stated.map_or_else(String::new, |paper| {
                [paper.rmse_n, paper.mean_n, paper.std_n].map(number).join(" / ")
            }),
        ]
        .map(|text| html! { (text) })
        .to_vec()
    };
    let heads =
        ["by", "RMSE", "mean", "std", "RMSE tared", "fixed RMSE", "fixed tared", "noise", "paper"];
    drawn(&format!("{name}, in newtons"), &heads, table.results.iter().map(row))
}

fn verdict(table: &Benchmark) -> String {
    match network_benefit(table) {
        None => "Physics with effects is not in the table: the model has no effects.".to_owned(),
        Some(NetworkBenefit::Floor) => {
            "Physics with effects reaches the noise floor: a network brings no improvement here."
                .to_owned()
        }
        Some(NetworkBenefit::Nothing) => {
            "After physics with effects a network brings no improvement here.".to_owned()
        }
        Some(NetworkBenefit::Share(share)) => {
            format!("After physics with effects a network removes {} of the error.", percent(share))
        }
        Some(NetworkBenefit::Harm(share)) => format!(
            "After physics with effects a network increases the error by {}.",
            percent(share)
        ),
    }
}
