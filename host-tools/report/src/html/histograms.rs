//! Distribution of the force errors.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::both;
use crate::html::palette::{self, Role};
use crate::html::plot::{Along, Failure, HALF, Paper, Swatch, axes, figure, key, stroke};
use analysis::compare::{Comparison, Histogram};
use model_export::recordings::columns::Axis;

pub fn section(comparison: &Comparison) -> Markup {
    html! {
        section #histograms {
            h2 { "Distribution of the errors" }
            @if comparison.histograms.is_empty() { p.empty { "No force errors." } }
            div.pair {
                @for histogram in &comparison.histograms { (plot(comparison, histogram)) }
            }
        }
    }
}

/// Density in percent of the rows per newton: the bins of two models differ in width.
fn percents(histogram: &Histogram) -> Vec<f64> {
    let all: u64 = histogram.counts.iter().sum();
    let widths = histogram.edges.windows(2).map(|edges| edges[1] - edges[0]);
    let percent = |(count, width): (&u64, f64)| 100.0 * *count as f64 / (all.max(1)) as f64 / width;
    histogram.counts.iter().zip(widths).map(percent).collect()
}

fn plot(comparison: &Comparison, histogram: &Histogram) -> Markup {
    let models: Vec<(Role, &Histogram)> = both(comparison)
        .into_iter()
        .filter_map(|(role, _, model)| {
            let same = model.histograms.iter().find(|h| h.axis == histogram.axis)?;
            Some((role, same))
        })
        .collect();
    let label = format!("error of the {} force / N", force_name(histogram.axis));
    if histogram.counts.is_empty() || histogram.edges.len() != histogram.counts.len() + 1 {
        return html! { p.empty { (label) ": no rows." } };
    }
    let across =
        Along::holding(label.clone(), models.iter().flat_map(|(_, h)| h.edges.iter().copied()));
    let upwards =
        Along::bars("% of the rows for each N", models.iter().flat_map(|(_, h)| percents(h)));
    let says = format!("Histogram: {label}, in percent of the rows per newton.");
    let drawn = figure(HALF, &says, |paper| draw(paper, &across, &upwards, &models));
    let entries = models.iter().enumerate().map(|(m, (role, _))| match m {
        0 => (Swatch::Full, *role, format!("A: {}", comparison.model)),
        _ => {
            let name = comparison.other.as_ref().map_or("", |other| &other.model);
            (Swatch::Line, *role, format!("B: {name}"))
        }
    });
    html! {
        figure {
            (drawn)
            @if models.len() > 1 { (key(&entries.collect::<Vec<_>>())) }
            p.note { "Errors beyond the range are in the first and the last bin." }
        }
    }
}

fn force_name(axis: Axis) -> &'static str {
    if axis == Axis::X { "lateral" } else { "longitudinal" }
}

fn draw(
    paper: &Paper,
    across: &Along,
    upwards: &Along,
    models: &[(Role, &Histogram)],
) -> Result<(), Failure> {
    let mut chart = axes(paper, across, upwards)?;
    for (m, (role, histogram)) in models.iter().enumerate() {
        let bins = histogram.edges.windows(2).zip(percents(histogram));
        if m == 0 {
            let bars = bins.filter_map(|(edges, percent)| {
                let corners = [(*edges.first()?, 0.0), (*edges.last()?, percent)];
                Some(Rectangle::new(corners, role.light.mix(0.8).filled()))
            });
            chart.draw_series(bars)?;
        } else {
            let steps = bins.flat_map(|(edges, percent)| edges.iter().map(move |x| (*x, percent)));
            let steps: Vec<_> = steps.collect();
            chart.draw_series([PathElement::new(steps, stroke(*role, 2.0))])?;
        }
    }
    if across.range.contains(&0.0) {
        let zero = [(0.0, upwards.range.start), (0.0, upwards.range.end)];
        chart.draw_series([PathElement::new(zero, stroke(palette::MUTED, 1.0))])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn density_is_independent_of_the_bin_width() {
        let of = |edges: Vec<f64>, counts: Vec<u64>| {
            percents(&Histogram { axis: Axis::X, edges, counts })
        };
        assert_eq!(of(vec![-1.0, 0.0, 1.0], vec![50, 50]), [50.0, 50.0]);
        assert_eq!(of(vec![-1.0, 1.0], vec![100]), [50.0]);
    }
}
