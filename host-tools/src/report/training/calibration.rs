//! Whether the standard deviations that networks tell mean what they say: shares of errors against those of
//! a Gaussian.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::coverage::Coverage;
use crate::report::Section;
use crate::report::palette::{self, Role};
use crate::report::plot::{Along, Failure, Paper, Swatch, axes, figure, key, px, stroke};
use crate::table::Table;
use crate::table::variant::Variant;

/// Size of the plot, in pixels: a square within the axes, nearly.
const SIZE: (u32, u32) = (440, 400);
/// Radius of a dot, in pixels.
const DOT: f64 = 3.5;
/// The networks that are drawn.
const DRAWN: [(Variant, Role); 3] = [
    (Variant::PhysicsGru, palette::FIRST),
    (Variant::Gru3AxisIdeal, palette::SECOND),
    (Variant::Gru3Axis, palette::THIRD),
];

/// The curves of the networks that there are.
pub fn section(table: &Table) -> Section {
    let found = |(variant, role): (Variant, Role)| {
        let coverage = table.of(variant)?.coverage.as_ref()?;
        Some((variant, role, coverage))
    };
    let curves: Vec<_> = DRAWN.into_iter().filter_map(found).collect();
    let line = |(variant, role, _): &(Variant, Role, &Coverage)| {
        (Swatch::Line, *role, variant.words().to_owned())
    };
    let entries: Vec<_> = curves.iter().map(line).collect();
    let body = html! {
        @if curves.is_empty() {
            p.empty { "No network told a standard deviation." }
        } @else {
            figure {
                figcaption { "Errors of the device after the tare, both forces: the share within a multiple of the standard "
                    "deviation that is told, against the share of a Gaussian" }
                (plot(&curves))
                (key(&entries))
            }
            p.note { "Above the straight line the standard deviations are too wide, below it too narrow." }
        }
    };
    Section {
        id: "calibration",
        heading: "What sigma means".to_owned(),
        body,
    }
}

fn plot(curves: &[(Variant, Role, &Coverage)]) -> Markup {
    let says =
        "A line for each network; on the diagonal its standard deviations mean what they say.";
    figure(SIZE, says, |paper| draw(paper, curves))
}

fn draw(paper: &Paper, curves: &[(Variant, Role, &Coverage)]) -> Result<(), Failure> {
    let share = |words: &str| Along {
        words: words.to_owned(),
        range: 0.0..100.0,
        labels: 6,
        powers: false,
    };
    let (across, upwards) = (share("share of a Gaussian, %"), share("share found, %"));
    let mut chart = axes(paper, &across, &upwards)?;
    let diagonal = vec![(0.0, 0.0), (100.0, 100.0)];
    chart.draw_series([PathElement::new(diagonal, stroke(palette::MUTED, 1.0))])?;
    for (_, role, coverage) in curves {
        let points = coverage
            .curve
            .iter()
            .map(|point| point.map(|share| 100.0 * share));
        let points: Vec<(f64, f64)> = points.map(|[expected, found]| (expected, found)).collect();
        let dots = points
            .iter()
            .map(|point| Circle::new(*point, px(DOT), role.light.filled()));
        chart.draw_series(dots)?;
        chart.draw_series([PathElement::new(points.clone(), stroke(*role, 2.0))])?;
    }
    Ok(())
}
