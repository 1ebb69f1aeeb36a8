//! The held-out error against the seconds that are learned from.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::report::Section;
use crate::report::numbers::number;
use crate::report::palette::{self, Role};
use crate::report::plot::{Along, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke};
use crate::report::tables::table as drawn;
use crate::table::Table;
use crate::table::length::FOLLOWED;
use crate::table::variant::Variant;

/// Size of the plot, in pixels.
const SIZE: (u32, u32) = (660, 340);
/// Radius of a dot, in pixels.
const DOT: f64 = 4.0;

/// Errors that are written at the side, in newtons, as far as they are on the plot: it is a logarithm,
/// since a network of few seconds errs by tens of times as much as physics.
const LABELLED_N: [f64; 9] = [0.03, 0.1, 0.2, 0.5, 1.0, 3.0, 10.0, 30.0, 100.0];

/// How a way is drawn: networks of the field alone, with the ideal model, behind effects; broad lines
/// are physics alone.
fn role(variant: Variant) -> (Swatch, Role) {
    match variant {
        Variant::IdealFitted => (Swatch::Broad, palette::MUTED),
        Variant::Physics => (Swatch::Broad, palette::FIRST),
        Variant::Gru3Axis => (Swatch::Line, palette::SECOND),
        Variant::Gru3AxisIdeal => (Swatch::Line, palette::THIRD),
        _ => (Swatch::Line, palette::FIRST),
    }
}

/// Plot and table; `None` where there is one length only.
pub fn section(table: &Table) -> Option<Section> {
    let mut seconds: Vec<f64> = table.lengths.iter().map(|point| point.seconds).collect();
    seconds.dedup();
    if seconds.len() < 2 {
        return None;
    }
    let ways: Vec<Variant> = FOLLOWED
        .into_iter()
        .filter(|way| table.lengths.iter().any(|point| point.variant == *way))
        .collect();
    let entries: Vec<_> = ways
        .iter()
        .map(|way| {
            let (swatch, role) = role(*way);
            (swatch, role, way.words().to_owned())
        })
        .collect();
    let heads: Vec<String> = std::iter::once("by".to_owned())
        .chain(seconds.iter().map(|seconds| format!("{seconds:.0} s")))
        .collect();
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let rows = ways.iter().map(|way| {
        let cells = seconds.iter().map(|seconds| {
            let rmse = at(table, *way, *seconds).map_or(f64::NAN, |rmse_n| rmse_n);
            html! { (number(rmse)) }
        });
        std::iter::once(html! { (way.words()) })
            .chain(cells)
            .collect()
    });
    let body = html! {
        figure {
            figcaption { "RMSE of the device over both forces in newtons, recording " (table.recordings.1)
                ", against the seconds that were learned from" }
            (plot(table, &seconds, &ways))
            (key(&entries))
        }
        (drawn("RMSE in newtons", &heads, rows))
        p.note { "Physics is fitted to all of these seconds; networks keep the last fifth to tell when to stop, and "
            "stand behind the physics fitted to the same seconds. Shorter trainings take up to three times as many epochs." }
    };
    Some(Section {
        id: "lengths",
        heading: "What physics buys".to_owned(),
        body,
    })
}

fn at(table: &Table, variant: Variant, seconds: f64) -> Option<f64> {
    let mut points = table.lengths.iter();
    let point = points.find(|p| p.variant == variant && p.seconds == seconds)?;
    Some(point.rmse_n)
}

fn plot(table: &Table, seconds: &[f64], ways: &[Variant]) -> Markup {
    let curves: Vec<(Variant, Vec<(f64, f64)>)> = ways
        .iter()
        .map(|way| {
            let points = seconds.iter().enumerate();
            let points = points.filter_map(|(i, s)| Some((i as f64 + 0.5, at(table, *way, *s)?)));
            (*way, points.collect())
        })
        .collect();
    let says = "Lines: the held-out error of each way against the seconds that were learned from.";
    figure(SIZE, says, |paper| draw(paper, seconds, &curves))
}

fn draw(
    paper: &Paper,
    seconds: &[f64],
    curves: &[(Variant, Vec<(f64, f64)>)],
) -> Result<(), Failure> {
    let heights = curves
        .iter()
        .flat_map(|(_, points)| points.iter().map(|p| p.1.log10()));
    let upwards = Along {
        labels: 0,
        ..Along::holding("RMSE in N", heights)
    };
    let range = upwards.range.clone();
    let mut chart = axes(paper, &Along::things(seconds.len()), &upwards)?;
    for newtons in LABELLED_N
        .into_iter()
        .filter(|n| range.contains(&n.log10()))
    {
        let ends = [0.0, seconds.len() as f64].map(|x| (x, newtons.log10()));
        chart.draw_series([PathElement::new(ends.to_vec(), stroke(palette::GRID, 1.0))])?;
        let (x, y) = chart.backend_coord(&ends[0]);
        let words = format!("{newtons}");
        paper.draw(&Text::new(
            words,
            (x - px(16.0), y),
            centred(palette::INK, 1.0),
        ))?;
    }
    for (variant, points) in curves {
        let (swatch, role) = role(*variant);
        let width = if matches!(swatch, Swatch::Broad) {
            5.0
        } else {
            2.0
        };
        let opacity = if matches!(swatch, Swatch::Broad) {
            0.4
        } else {
            1.0
        };
        let style = ShapeStyle {
            color: role.light.mix(opacity),
            ..stroke(role, width)
        };
        let points: Vec<(f64, f64)> = points.iter().map(|(x, y)| (*x, y.log10())).collect();
        chart.draw_series([PathElement::new(points.clone(), style)])?;
        let dots = points
            .iter()
            .map(|p| Circle::new(*p, px(DOT), role.light.filled()));
        chart.draw_series(dots)?;
    }
    for (i, seconds) in seconds.iter().enumerate() {
        let (x, y) = chart.backend_coord(&(i as f64 + 0.5, range.start));
        let words = format!("{seconds:.0} s");
        paper.draw(&Text::new(
            words,
            (x, y + px(12.0)),
            centred(palette::INK, 1.0),
        ))?;
    }
    Ok(())
}
