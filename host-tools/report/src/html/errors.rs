//! Errors by sensor as bars with the noise floor.

use crate::text::comparison::conclusion::missing_forces;
use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::palette::{self, Role};
use crate::html::plot::{Along, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke};
use crate::html::{both, tables};
use analysis::compare::Comparison;
use analysis::numbers::number;

/// Size of a plot in pixels.
const SIZE: (u32, u32) = (440, 270);
/// Relative width of a bar.
const FILLED: f64 = 0.76;

/// One bar: sensor, axis, height and floor.
struct Bar {
    sensor: u32,
    axis: &'static str,
    rms: f64,
    floor: f64,
}

/// Bars and tables of the field and force errors.
pub fn section(comparison: &Comparison) -> Markup {
    html! {
        section #errors {
            h2 { "Error by sensor" }
            @if comparison.axes.is_empty() {
                p.empty { "No field errors: see the setup errors." }
            }
            div.pair {
                (bars(comparison, "Field", "gauss", field))
                (bars(comparison, "Forces", "newtons", forces))
            }
            @if let Some(why) = &comparison.no_forces { p.empty { "No forces: " (missing_forces(why)) } }
            (tables::of_field(comparison))
            (tables::of_forces(comparison))
        }
    }
}

fn field(comparison: &Comparison) -> Vec<Bar> {
    let bar = |axis: &analysis::compare::FieldAxisErrors| Bar {
        sensor: axis.sensor,
        axis: axis.axis.letter(),
        rms: axis.error.rms,
        floor: axis.floor.total,
    };
    comparison.axes.iter().map(bar).collect()
}

fn forces(comparison: &Comparison) -> Vec<Bar> {
    let bar = |force: &analysis::compare::ForceAxisErrors| Bar {
        sensor: force.sensor,
        axis: force.axis.letter(),
        rms: force.error.rms,
        floor: force.floor,
    };
    comparison.forces.iter().map(bar).collect()
}

fn bars(
    comparison: &Comparison,
    of: &str,
    unit: &str,
    bars_of: fn(&Comparison) -> Vec<Bar>,
) -> Markup {
    let models: Vec<(Role, Vec<Bar>)> =
        both(comparison).into_iter().map(|(role, _, model)| (role, bars_of(model))).collect();
    let Some((_, first)) = models.first().filter(|(_, bars)| !bars.is_empty()) else {
        return html! {};
    };
    let says = first.iter().fold(
        format!("Bars: root mean square of the error in {unit}, with the floor."),
        |says, bar| {
            format!(
                "{says} Sensor {} {}: {} over {}.",
                bar.sensor,
                bar.axis,
                number(bar.rms),
                number(bar.floor)
            )
        },
    );
    let all = models.iter().flat_map(|(_, bars)| bars);
    let upwards = Along::bars(format!("RMS in {unit}"), all.flat_map(|bar| [bar.rms, bar.floor]));
    let drawn = figure(SIZE, &says, |paper| draw(paper, &upwards, &models));
    let mut entries = vec![(Swatch::Full, palette::FIRST, "RMS".to_owned())];
    if let Some(other) = &comparison.other {
        entries = vec![
            (Swatch::Full, palette::FIRST, format!("RMS of A: {}", comparison.model)),
            (Swatch::Framed, palette::SECOND, format!("RMS of B: {}", other.model)),
        ];
    }
    entries.push((Swatch::Mark, palette::INK, "floor: residual of a perfect model".to_owned()));
    html! {
        figure {
            figcaption { (of) ", in " (unit) }
            (drawn)
            (key(&entries))
        }
    }
}

fn draw(paper: &Paper, upwards: &Along, models: &[(Role, Vec<Bar>)]) -> Result<(), Failure> {
    let Some((_, first)) = models.first() else {
        return Ok(());
    };
    let mut chart = axes(paper, &Along::things(first.len()), upwards)?;
    let wide = FILLED / models.len() as f64;
    for (m, (role, bars)) in models.iter().enumerate() {
        for bar in bars {
            // The baseline may have other axes or another order.
            let place = |other: &Bar| (other.sensor, other.axis) == (bar.sensor, bar.axis);
            let Some(i) = first.iter().position(place) else {
                continue;
            };
            let left = i as f64 + (1.0 - FILLED) / 2.0 + wide * m as f64;
            if bar.rms.is_finite() {
                let corners = [(left, 0.0), (left + wide, bar.rms)];
                let fill = if m == 0 { 1.0 } else { 0.35 };
                let area = Rectangle::new(corners, role.light.mix(fill).filled());
                chart.draw_series([area])?;
                if m > 0 {
                    chart.draw_series([Rectangle::new(corners, stroke(*role, 1.5))])?;
                }
            }
            if bar.floor.is_finite() {
                let mark = [(left, bar.floor), (left + wide, bar.floor)];
                chart.draw_series([PathElement::new(mark, stroke(palette::INK, 2.5))])?;
            }
        }
    }
    names(paper, first, |x| chart.backend_coord(&(x, upwards.range.start)))
}

/// Labels of the axes and the sensors.
fn names(paper: &Paper, bars: &[Bar], foot: impl Fn(f64) -> (i32, i32)) -> Result<(), Failure> {
    for (i, bar) in bars.iter().enumerate() {
        let (x, y) = foot(i as f64 + 0.5);
        let at = (x, y + px(9.0));
        paper.draw(&Text::new(bar.axis, at, centred(palette::INK, 0.95)))?;
    }
    let mut from = 0;
    for group in bars.chunk_by(|one, next| one.sensor == next.sensor) {
        let (left, y) = foot(from as f64 + 0.12);
        from += group.len();
        let (right, _) = foot(from as f64 - 0.12);
        let line = [(left, y + px(18.0)), (right, y + px(18.0))];
        paper.draw(&PathElement::new(line, stroke(palette::GRID, 1.0)))?;
        let words = format!("s{}", group.first().map_or(0, |bar| bar.sensor));
        let at = ((left + right) / 2, y + px(26.0));
        paper.draw(&Text::new(words, at, centred(palette::MUTED, 1.0)))?;
    }
    Ok(())
}
