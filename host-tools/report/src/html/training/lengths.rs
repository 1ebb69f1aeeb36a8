//! Held-out error versus training duration.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::Section;
use crate::html::palette::{self, Role};
use crate::html::plot::{Along, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke};
use crate::html::tables::table as drawn;
use analysis::benchmark::Benchmark;
use analysis::benchmark::evaluate::LEARNING_VARIANTS;
use analysis::benchmark::variants::EstimatorVariant;
use analysis::numbers::number;

/// Size of the plot in pixels.
const SIZE: (u32, u32) = (660, 340);
/// Radius of a dot in pixels.
const DOT: f64 = 4.0;

/// Tick labels in newtons on the logarithmic axis; networks trained on few
/// seconds have errors tens of times those of physics.
const LABELLED_N: [f64; 9] = [0.03, 0.1, 0.2, 0.5, 1.0, 3.0, 10.0, 30.0, 100.0];

/// Style of an estimator: networks of the field, with the ideal model, after effects; broad lines
/// for physics only.
fn role(variant: EstimatorVariant) -> (Swatch, Role) {
    match variant {
        EstimatorVariant::IdealFitted => (Swatch::Broad, palette::MUTED),
        EstimatorVariant::Physics => (Swatch::Broad, palette::FIRST),
        EstimatorVariant::Gru3Axis => (Swatch::Line, palette::SECOND),
        EstimatorVariant::Gru3AxisIdeal => (Swatch::Line, palette::THIRD),
        _ => (Swatch::Line, palette::FIRST),
    }
}

/// Plot and table; `None` for a single duration.
pub fn section(table: &Benchmark) -> Option<Section> {
    let mut seconds: Vec<f64> = table.learning_curve.iter().map(|point| point.seconds).collect();
    seconds.dedup();
    if seconds.len() < 2 {
        return None;
    }
    let ways: Vec<EstimatorVariant> = LEARNING_VARIANTS
        .into_iter()
        .filter(|way| table.learning_curve.iter().any(|point| point.variant == *way))
        .collect();
    let entries: Vec<_> = ways
        .iter()
        .map(|way| {
            let (swatch, role) = role(*way);
            (swatch, role, way.words().to_owned())
        })
        .collect();
    let heads: Vec<String> = std::iter::once("estimator".to_owned())
        .chain(seconds.iter().map(|seconds| format!("{seconds:.0} s")))
        .collect();
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let rows = ways.iter().map(|way| {
        let cells = seconds.iter().map(|seconds| {
            let rmse = at(table, *way, *seconds).map_or(f64::NAN, |rmse_n| rmse_n);
            html! { (number(rmse)) }
        });
        std::iter::once(html! { (way.words()) }).chain(cells).collect()
    });
    let body = html! {
        figure {
            figcaption { "RMSE of the device over both forces in newtons, recording " (table.recordings.1)
                ", versus training duration" }
            (plot(table, &seconds, &ways))
            (key(&entries))
        }
        (drawn("RMSE in newtons", &heads, rows))
        p.note { "Physics is fitted to the full duration; networks use the last fifth as validation set and "
            "follow the physics fitted to the same data. Shorter trainings take up to three times as many epochs." }
    };
    Some(Section { id: "lengths", heading: "Error versus training duration".to_owned(), body })
}

fn at(table: &Benchmark, variant: EstimatorVariant, seconds: f64) -> Option<f64> {
    let mut points = table.learning_curve.iter();
    let point = points.find(|p| p.variant == variant && p.seconds == seconds)?;
    Some(point.rmse_n)
}

fn plot(table: &Benchmark, seconds: &[f64], ways: &[EstimatorVariant]) -> Markup {
    let curves: Vec<(EstimatorVariant, Vec<(f64, f64)>)> = ways
        .iter()
        .map(|way| {
            let points = seconds.iter().enumerate();
            let points = points.filter_map(|(i, s)| Some((i as f64 + 0.5, at(table, *way, *s)?)));
            (*way, points.collect())
        })
        .collect();
    let says = "Lines: held-out error of each estimator versus training duration.";
    figure(SIZE, says, |paper| draw(paper, seconds, &curves))
}

fn draw(
    paper: &Paper,
    seconds: &[f64],
    curves: &[(EstimatorVariant, Vec<(f64, f64)>)],
) -> Result<(), Failure> {
    let heights = curves.iter().flat_map(|(_, points)| points.iter().map(|p| p.1.log10()));
    let upwards = Along { labels: 0, ..Along::holding("RMSE in N", heights) };
    let range = upwards.range.clone();
    let mut chart = axes(paper, &Along::things(seconds.len()), &upwards)?;
    for newtons in LABELLED_N.into_iter().filter(|n| range.contains(&n.log10())) {
        let ends = [0.0, seconds.len() as f64].map(|x| (x, newtons.log10()));
        chart.draw_series([PathElement::new(ends.to_vec(), stroke(palette::GRID, 1.0))])?;
        let (x, y) = chart.backend_coord(&ends[0]);
        let words = format!("{newtons}");
        paper.draw(&Text::new(words, (x - px(16.0), y), centred(palette::INK, 1.0)))?;
    }
    for (variant, points) in curves {
        let (swatch, role) = role(*variant);
        let width = if matches!(swatch, Swatch::Broad) { 5.0 } else { 2.0 };
        let opacity = if matches!(swatch, Swatch::Broad) { 0.4 } else { 1.0 };
        let style = ShapeStyle { color: role.light.mix(opacity), ..stroke(role, width) };
        let points: Vec<(f64, f64)> = points.iter().map(|(x, y)| (*x, y.log10())).collect();
        chart.draw_series([PathElement::new(points.clone(), style)])?;
        let dots = points.iter().map(|p| Circle::new(*p, px(DOT), role.light.filled()));
        chart.draw_series(dots)?;
    }
    for (i, seconds) in seconds.iter().enumerate() {
        let (x, y) = chart.backend_coord(&(i as f64 + 0.5, range.start));
        let words = format!("{seconds:.0} s");
        paper.draw(&Text::new(words, (x, y + px(12.0)), centred(palette::INK, 1.0)))?;
    }
    Ok(())
}
