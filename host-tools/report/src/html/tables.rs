//! Tables of the errors.

use maud::{Markup, html};

use crate::html::both;
use analysis::compare::Comparison;
use analysis::numbers::{maybe, number, percent};
use analysis::statistics::ErrorStatistics;
use model_export::recordings::columns::Axis;

/// Table in a horizontally scrolling box with a fixed first column.
pub fn table(caption: &str, heads: &[&str], rows: impl IntoIterator<Item = Vec<Markup>>) -> Markup {
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

fn text(words: impl AsRef<str>) -> Markup {
    html! { (words.as_ref()) }
}

/// Sensor and axis, and the model where there are two.
fn whose(comparison: &Comparison, sensor: u32, axis: Axis, model: usize) -> Markup {
    let letter = ["A", "B"].get(model).copied().unwrap_or("");
    html! {
        "s" (sensor) " " (axis.letter())
        @if comparison.other.is_some() { " " span.model { (letter) } }
    }
}

fn errors(error: &ErrorStatistics) -> Vec<Markup> {
    [error.rms, error.mean, error.std, error.p95, error.greatest]
        .map(|size| text(number(size)))
        .into_iter()
        .chain([text(percent(error.rms / error.span))])
        .collect()
}

/// Rows of both models interleaved: sorted by sensor and axis, first model first.
fn interleave<T: Copy>(
    comparison: &Comparison,
    of: fn(&Comparison) -> &[T],
    whose: fn(&T) -> (u32, Axis),
) -> Vec<(usize, T)> {
    let mut rows: Vec<(usize, T)> = both(comparison)
        .into_iter()
        .enumerate()
        .flat_map(|(model, (_, _, evaluation))| of(evaluation).iter().map(move |row| (model, *row)))
        .collect();
    rows.sort_by_key(|(model, row)| (whose(row), *model));
    rows
}

/// Field errors and the composition of the floor.
pub fn of_field(comparison: &Comparison) -> Markup {
    let rows = interleave(comparison, |c| &c.axes, |axis| (axis.sensor, axis.axis));
    if rows.is_empty() {
        return html! {};
    }
    let errors = rows.iter().map(|(model, axis)| {
        let mut row = vec![whose(comparison, axis.sensor, axis.axis, *model)];
        row.extend(errors(&axis.error));
        row.push(text(number(axis.floor.total)));
        row.push(text(number(axis.error.rms / axis.floor.total)));
        row.push(text(number(axis.explainable)));
        row
    });
    let floors = rows.iter().filter(|(model, _)| *model == 0);
    let floors = floors.map(|(_, axis)| {
        let floor = axis.floor;
        vec![
            html! { "s" (axis.sensor) " " (axis.axis.letter()) },
            text(number(floor.total)),
            text(number(floor.white)),
            text(number(floor.quantisation)),
            text(number(floor.reference)),
            text(maybe(floor.slow)),
            text(maybe(floor.replicates)),
        ]
    });
    html! {
        (table(
            "Field: measured minus modelled, in gauss",
            &["sensor", "RMS", "mean", "std", "P95", "max", "% of range", "floor", "RMS / floor", "explainable"],
            errors,
        ))
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

/// Force errors.
pub fn of_forces(comparison: &Comparison) -> Markup {
    let rows = interleave(comparison, |c| &c.forces, |force| (force.sensor, force.axis));
    if rows.is_empty() {
        return html! {};
    }
    let rows = rows.iter().map(|(model, force)| {
        let mut row = vec![whose(comparison, force.sensor, force.axis, *model)];
        row.extend(errors(&force.error));
        row.push(text(maybe(force.tared_rms)));
        row.push(text(number(force.floor)));
        row.push(text(number(force.error.rms / force.floor)));
        row.push(text(number(force.explainable)));
        row
    });
    table(
        "Forces: device minus reference, in newtons (x lateral, z longitudinal)",
        &[
            "sensor",
            "RMS",
            "mean",
            "std",
            "P95",
            "greatest",
            "% of range",
            "RMS after tare",
            "floor",
            "RMS / floor",
            "explainable",
        ],
        rows,
    )
}
