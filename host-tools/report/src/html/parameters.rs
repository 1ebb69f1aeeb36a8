//! The fitted parameters: values with errors, distances from the design, correlations, and what is not identified.

use analysis::compare::Comparison;
use analysis::numbers::{decimal, maybe};
use analysis::parameters::{ParameterEstimate, ParameterTable, SensorCorrelation};
use maud::{Markup, html};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::html::both;
use crate::html::palette;
use crate::html::plot::{Failure, LETTER_WIDTH, Paper, centred, figure, letters, px};
use crate::html::summary::initial;
use crate::html::tables::{table, text_table};
use crate::text::parameters::{TERMS, UNIDENTIFIED, by_remedy, overview, sentences, value};

/// Side of a cell of the correlations in pixels.
const CELL: f64 = 30.0;
/// Correlations of the scale, from negative to positive.
const SCALE: [f64; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
/// Opacity of a full correlation: text on it remains legible.
const FULL: f64 = 0.6;

pub fn section(comparison: &Comparison) -> Markup {
    let models = both(comparison);
    html! {
        section #parameters {
            h2 { "Fitted parameters" }
            p.note { (TERMS) " The errors are those of the fit that wrote the model file, not of the recordings compared here." }
            @for (role, letter, model) in &models {
                @if models.len() > 1 { h3 { (initial(*role, letter)) " " (model.model) } }
                (of_model(&model.parameters))
            }
        }
    }
}

fn of_model(table: &ParameterTable) -> Markup {
    html! {
        @if table.estimates.is_empty() {
            p.empty { "A polynomial without effects has no physical parameters; `fit --json` lists its coefficients with their errors." }
        } @else {
            (text_table("Value and standard error", &overview(table, &table.sensors())))
            @for sentence in sentences(table) { p { (sentence) } }
            (not_identified(table))
            @for sensor in table.sensors() {
                details {
                    summary { "Sensor " (sensor) ": distances from the design, correlations" }
                    (distances(table, sensor))
                    p.note {
                        "Distance: in standard deviations of tolerance and standard error together; of an effect from zero, in standard "
                        "errors. Error / prior width: near 1 the prior decides."
                    }
                    @for of in table.correlations.iter().filter(|of| of.sensor == sensor) { (correlations(of)) }
                }
            }
        }
    }
}

fn not_identified(table: &ParameterTable) -> Markup {
    let remedied = by_remedy(table);
    html! {
        @if remedied.is_empty() {
            @if table.estimates.iter().all(|one| one.identifiable) { p { "These recordings identify all parameters." } }
        } @else {
            p { (UNIDENTIFIED) }
            ul {
                @for (remedy, sensors) in remedied {
                    li {
                        "To identify them: " (remedy) "."
                        @for (sensor, combinations) in sensors {
                            br; "sensor " (sensor) ": " (combinations.join("; "))
                        }
                    }
                }
            }
        }
    }
}

fn distances(table_of: &ParameterTable, sensor: u32) -> Markup {
    let row = |one: &ParameterEstimate| {
        [
            format!("{} {}", one.full_name(), one.unit),
            value(one),
            maybe(one.nominal),
            maybe(one.prior_width),
            one.deviation.map_or_else(|| maybe(None), |sigmas| format!("{sigmas:+.2}")),
            maybe(one.of_prior()),
        ]
    };
    let rows = table_of.estimates.iter().filter(|one| one.sensor == sensor).map(row);
    table(
        "Distances from the design",
        &["parameter", "value", "design", "prior width", "distance", "error / prior width"],
        rows,
    )
}

/// The lower triangle with the name of each parameter on the diagonal: the end of its row, and the head of its column.
fn correlations(of: &SensorCorrelation) -> Markup {
    let names = &of.table.names;
    let right = |(i, name): (usize, &String)| {
        CELL * i as f64 + 12.0 + LETTER_WIDTH * name.chars().count() as f64
    };
    let width = names.iter().enumerate().map(right).fold(CELL * 9.0, f64::max);
    let size = (width.ceil() as u32, (CELL * (names.len() as f64 + 1.5)).ceil() as u32);
    let says = format!("Correlations of the {} parameters of sensor {}.", names.len(), of.sensor);
    let drawn = figure(size, &says, |paper| {
        let name_at = letters(palette::INK, 1.0).pos(Pos::new(HPos::Left, VPos::Center));
        for (i, name) in names.iter().enumerate() {
            for j in 0..i {
                cell(paper, (j as f64, i as f64), of.table.between(i, j))?;
            }
            let place = (px(CELL * i as f64 + 6.0), px(CELL * (i as f64 + 0.5)));
            paper.draw(&Text::new(name.clone(), place, name_at.clone()))?;
        }
        for (place, r) in SCALE.into_iter().enumerate() {
            cell(paper, (place as f64, names.len() as f64 + 0.4), r)?;
        }
        Ok(())
    });
    html! {
        figure {
            figcaption {
                "Correlation × 100 of row and column; a name ends its row and heads its column. Blue: positive, orange: negative, as in "
                "the scale below. Without parameters of single recordings and those that all sensors share."
            }
            div.wide tabindex="0" role="region" aria-label=(says) { div style=(format!("min-width:{}px", 4 * size.0 / 5)) { (drawn) } }
        }
    }
}

/// A correlation at a column and a row.
fn cell(paper: &Paper, (column, row): (f64, f64), r: f64) -> Result<(), Failure> {
    let (left, top) = (px(CELL * column), px(CELL * row));
    let corners = [(left, top), (left + px(CELL - 1.0), top + px(CELL - 1.0))];
    let role = if r < 0.0 { palette::SECOND } else { palette::FIRST };
    paper.draw(&Rectangle::new(corners, role.light.mix(FULL * r.abs()).filled()))?;
    let at = (left + px(0.5 * CELL), top + px(0.5 * CELL));
    // Not "-0".
    let percent = decimal((100.0 * r).round() + 0.0, 0).replace('-', "\u{2212}");
    paper.draw(&Text::new(percent, at, centred(palette::INK, 0.85)))
}
