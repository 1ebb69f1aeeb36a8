//! Tables of a page: [`table`], [`text_table`], and those of the errors of a comparison.

use maud::{Markup, Render, html};

use crate::html::both;
use crate::text::comparison::{field_table, force_table};
use crate::text::terminal::TextTable;
use analysis::compare::Comparison;
use analysis::numbers::{maybe, number};

/// Table in a horizontally scrolling box with a fixed first column.
pub fn table<C: Render>(
    caption: &str,
    heads: &[impl Render],
    rows: impl IntoIterator<Item = impl IntoIterator<Item = C>>,
) -> Markup {
    html! {
        div.wide tabindex="0" role="region" aria-label=(caption) {
            table {
                caption { (caption) }
                thead { tr { @for head in heads { th scope="col" { (head) } } } }
                tbody {
                    @for row in rows {
                        tr {
                            @for (i, cell) in row.into_iter().enumerate() {
                                @if i == 0 { th scope="row" { (cell) } } @else { td { (cell) } }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The same table as on the terminal.
pub fn text_table(caption: &str, shown: &TextTable) -> Markup {
    table(caption, &shown.heads, &shown.rows)
}

/// Rows of both models under the same heads; the first cell names sensor and axis. Empty where neither model has a row.
fn of_both(
    comparison: &Comparison,
    caption: &str,
    rows_of: fn(&Comparison) -> TextTable,
) -> Markup {
    let mut rows: Vec<(&str, Vec<String>)> = both(comparison)
        .into_iter()
        .flat_map(|(_, letter, of)| rows_of(of).rows.into_iter().map(move |row| (letter, row)))
        .collect();
    if rows.is_empty() {
        return html! {};
    }
    // Stable: the sensors and axes keep their order, and A comes before B.
    let names: Vec<String> = rows.iter().map(|(_, row)| row[0].clone()).collect();
    rows.sort_by_key(|(_, row)| names.iter().position(|name| *name == row[0]));
    let rows = rows.into_iter().map(|(letter, row)| {
        row.into_iter().enumerate().map(move |(column, cell)| {
            html! {
                (cell)
                @if column == 0 && !letter.is_empty() { " " span.model { (letter) } }
            }
        })
    });
    table(caption, &rows_of(comparison).heads, rows)
}

/// Field errors and the composition of the floor.
pub fn of_field(comparison: &Comparison) -> Markup {
    if comparison.axes.is_empty() {
        return html! {};
    }
    let floors = comparison.axes.iter().map(|axis| {
        let floor = axis.floor;
        [
            format!("s{} {}", axis.sensor, axis.axis.letter()),
            number(floor.total),
            number(floor.white),
            number(floor.quantisation),
            number(floor.reference),
            maybe(floor.slow),
            maybe(floor.replicates),
        ]
    });
    html! {
        (of_both(comparison, "Field: measured minus modelled", field_table))
        details {
            summary { "Composition of the noise floor" }
            (table(
                "Floor of the field and its parts, in gauss",
                &["sensor", "floor", "white noise", "quantisation", "reference", "slow (10 s)", "replicates"],
                floors,
            ))
            p.note {
                "The floor is the noise of sensor and reference. Slow drift and the scatter between "
                "visits of the same condition are listed for comparison; a dash: not identifiable from these recordings."
            }
        }
        p.note { "P95: 95th percentile. Explainable: what a better model could remove, "
            "the root of RMS² minus floor²." }
    }
}

pub fn of_forces(comparison: &Comparison) -> Markup {
    let caption = "Forces: device minus reference (x lateral, z longitudinal)";
    of_both(comparison, caption, force_table)
}
