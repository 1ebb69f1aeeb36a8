//! The table, force by force.

use maud::{Markup, html};

use super::FORCES;
use crate::report::Section;
use crate::report::numbers::{maybe, number, percent};
use crate::report::tables::table as drawn;
use crate::table::judge::Judged;
use crate::table::variant::Variant;
use crate::table::{Table, Worth, paper, worth};

/// What the page begins with.
pub fn section(table: &Table) -> Section {
    let body = html! {
        p.verdict { (verdict(table)) }
        p { "Recording " (table.recordings.1) ", which chose nothing. Everything was fitted and trained on recording "
            (table.recordings.0.join(", ")) " (" (number(table.training_s)) " s; the last " (number(table.stopping_s))
            " s told the networks when to stop)." }
        @if table.simulated {
            p { "These recordings are simulated. The paper's were measured and are not public: its figures stand beside these, not against them." }
        } @else {
            p { "The paper's recordings are not public: its figures are of another gripper under other loads." }
        }
        @for note in &table.notes { p.note { "Note: " (note) "." } }
        @for (axis, name) in FORCES { (of_force(table, axis, name)) }
        p.note { "Estimate minus reference in newtons, at every row of the board. Fixed: by the device's own code. "
            "Tared: less the mean of the estimate over the first unloaded stretch, a second at the most, but not what friction "
            "may hold at rest by the physics with effects. "
            "Noise: what white noise of sensor and reference leaves of the estimates. "
            "Paper: RMSE, mean, and what Table I calls variance and is a standard deviation in N." }
        @if let Some(found) = table.of(Variant::Gru3Axis).and_then(|judged| judged.coverage.as_ref()) {
            p { "Within 1, 2, 3 of the standard deviations that the network of 3 axes tells lie "
                (found.within.map(percent).join(", ")) " of its errors after the tare; of a Gaussian's, 68.3, 95.4, 99.7 %." }
        }
    };
    Section {
        id: "table",
        heading: "Errors, as in Table I".to_owned(),
        body,
    }
}

fn of_force(table: &Table, axis: usize, name: &str) -> Markup {
    let row = |judged: &Judged| {
        let figures = &judged.axes[axis];
        let stated = paper::stated(judged.variant, axis);
        let tared = |sums: Option<crate::sums::Sums>| maybe(sums.map(|sums| sums.rms()));
        [
            judged.variant.words().to_owned(),
            number(figures.float.rms()),
            number(figures.float.mean()),
            number(figures.float.std()),
            tared(figures.float_tared),
            number(figures.fixed.rms()),
            tared(figures.fixed_tared),
            number(figures.noise_n),
            stated.map_or_else(String::new, |paper| {
                [paper.rmse_n, paper.mean_n, paper.std_n]
                    .map(number)
                    .join(" / ")
            }),
        ]
        .map(|text| html! { (text) })
        .to_vec()
    };
    let heads = [
        "by",
        "RMSE",
        "mean",
        "std",
        "RMSE tared",
        "fixed RMSE",
        "fixed tared",
        "noise",
        "paper",
    ];
    drawn(
        &format!("{name}, in newtons"),
        &heads,
        table.judged.iter().map(row),
    )
}

fn verdict(table: &Table) -> String {
    match worth(table) {
        None => "Physics with effects is not in the table: the model has none.".to_owned(),
        Some(Worth::Floor) => {
            "Physics with effects reaches the floor: a network adds nothing here.".to_owned()
        }
        Some(Worth::Nothing) => {
            "Behind physics with effects a network adds nothing here.".to_owned()
        }
        Some(Worth::Share(share)) => format!(
            "Behind physics with effects a network takes {} of the error.",
            percent(share)
        ),
        Some(Worth::Harm(share)) => format!(
            "Behind physics with effects a network makes the error {} larger.",
            percent(share)
        ),
    }
}
