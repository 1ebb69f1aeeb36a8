//! Calibration of the predicted standard deviations: observed versus Gaussian
//! coverage.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::Section;
use crate::html::palette::{self, Role};
use crate::html::plot::{Along, AxisScale, Failure, Paper, Swatch, axes, figure, key, px, stroke};
use analysis::benchmark::Benchmark;
use analysis::benchmark::variants::EstimatorVariant;
use analysis::calibration::Coverage;

/// Size of the plot in pixels, nearly a square within the axes.
const SIZE: (u32, u32) = (440, 400);
/// Radius of a dot in pixels.
const DOT: f64 = 3.5;
/// Networks in the plot.
const DRAWN: [(EstimatorVariant, Role); 3] = [
    (EstimatorVariant::PhysicsGru, palette::FIRST),
    (EstimatorVariant::Gru3AxisIdeal, palette::SECOND),
    (EstimatorVariant::Gru3Axis, palette::THIRD),
];

/// Calibration curves.
pub fn section(table: &Benchmark) -> Section {
    let found = |(variant, role): (EstimatorVariant, Role)| {
        let coverage = table.of(variant)?.coverage.as_ref()?;
        Some((variant, role, coverage))
    };
    let curves: Vec<_> = DRAWN.into_iter().filter_map(found).collect();
    let line = |(variant, role, _): &(EstimatorVariant, Role, &Coverage)| {
        (Swatch::Line, *role, variant.words().to_owned())
    };
    let entries: Vec<_> = curves.iter().map(line).collect();
    let body = html! {
        @if curves.is_empty() {
            p.empty { "No network predicted a standard deviation." }
        } @else {
            figure {
                figcaption { "Errors of the device after the tare, both forces: observed coverage of multiples of the "
                    "predicted standard deviation versus a Gaussian" }
                (plot(&curves))
                (key(&entries))
            }
            p.note { "Above the diagonal the predicted standard deviations are too large, below it too small." }
        }
    };
    Section { id: "calibration", heading: "Calibration of sigma".to_owned(), body }
}

fn plot(curves: &[(EstimatorVariant, Role, &Coverage)]) -> Markup {
    let says = "A line for each network; on the diagonal it is calibrated.";
    figure(SIZE, says, |paper| draw(paper, curves))
}

fn draw(paper: &Paper, curves: &[(EstimatorVariant, Role, &Coverage)]) -> Result<(), Failure> {
    let share = |words: &str| Along {
        words: words.to_owned(),
        range: 0.0..100.0,
        labels: 6,
        scale: AxisScale::Linear,
    };
    let (across, upwards) = (share("share of a Gaussian, %"), share("share found, %"));
    let mut chart = axes(paper, &across, &upwards)?;
    let diagonal = vec![(0.0, 0.0), (100.0, 100.0)];
    chart.draw_series([PathElement::new(diagonal, stroke(palette::MUTED, 1.0))])?;
    for (_, role, coverage) in curves {
        let points = coverage.curve.iter().map(|point| point.map(|share| 100.0 * share));
        let points: Vec<(f64, f64)> = points.map(|[expected, found]| (expected, found)).collect();
        let dots = points.iter().map(|point| Circle::new(*point, px(DOT), role.light.filled()));
        chart.draw_series(dots)?;
        chart.draw_series([PathElement::new(points.clone(), stroke(*role, 2.0))])?;
    }
    Ok(())
}
