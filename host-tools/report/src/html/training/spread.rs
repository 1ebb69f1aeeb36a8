//! Error histograms.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::Section;
use crate::html::palette::Role;
use crate::html::plot::{Along, Failure, HALF, Paper, Swatch, axes, figure, key, stroke};
use crate::html::training::{DRAWN, FORCES};
use analysis::benchmark::Benchmark;

/// Number of bins.
const BINS: usize = 60;
/// The range excludes at most this share on each side.
const BEYOND: f64 = 0.002;

/// A histogram for each force.
pub fn section(table: &Benchmark) -> Section {
    let entries = DRAWN.map(|(way, role)| (Swatch::Line, role, way.words().to_owned()));
    let body = html! {
        div.pair { @for (axis, name) in FORCES { figure { figcaption { (name) } (plot(table, axis, name)) } } }
        (key(&entries))
        p.note { "Device, before the tare. Errors beyond the range are in the first and the last bin." }
    };
    Section { id: "spread", heading: "Error histograms, as in Fig. 8".to_owned(), body }
}

/// Range that excludes at most [`BEYOND`] of each series on both sides.
fn ends<'a>(all: impl Iterator<Item = &'a Vec<f64>>) -> (f64, f64) {
    all.fold((0.0, 0.0), |(low, high), errors| {
        let mut sorted = errors.clone();
        sorted.sort_by(f64::total_cmp);
        let beyond = (BEYOND * sorted.len() as f64) as usize;
        let (first, last) = (sorted.get(beyond), sorted.iter().nth_back(beyond));
        (first.map_or(low, |n| n.min(low)), last.map_or(high, |n| n.max(high)))
    })
}

/// Density in percent per newton, as corners of a step function.
fn steps(errors: &[f64], (low, high): (f64, f64)) -> Vec<(f64, f64)> {
    let width = (high - low) / BINS as f64;
    let mut counts = [0_u32; BINS];
    for error in errors {
        let bin = ((error - low) / width).clamp(0.0, (BINS - 1) as f64) as usize;
        counts[bin] += 1;
    }
    let percent = |count: u32| 100.0 * f64::from(count) / errors.len().max(1) as f64 / width;
    let corners = counts.into_iter().enumerate().flat_map(|(bin, count)| {
        [bin, bin + 1].map(|edge| (low + edge as f64 * width, percent(count)))
    });
    corners.collect()
}

fn plot(table: &Benchmark, axis: usize, name: &str) -> Markup {
    let ways = || DRAWN.into_iter().filter_map(|(way, role)| Some((role, table.of(way)?)));
    let ends = ends(ways().map(|(_, way)| &way.errors_n[axis]));
    if ends.0 >= ends.1 {
        return html! { p.empty { "No errors." } };
    }
    let all: Vec<(Role, Vec<(f64, f64)>)> =
        ways().map(|(role, way)| (role, steps(&way.errors_n[axis], ends))).collect();
    let across = Along::holding("error in N", [ends.0, ends.1]);
    let heights = all.iter().flat_map(|(_, steps)| steps.iter().map(|s| s.1));
    let upwards = Along::bars("% of the rows per N", heights);
    let says = format!("Histograms of the errors of {name}, in percent of the rows per newton.");
    figure(HALF, &says, |paper| draw(paper, &across, &upwards, &all))
}

fn draw(
    paper: &Paper,
    across: &Along,
    upwards: &Along,
    all: &[(Role, Vec<(f64, f64)>)],
) -> Result<(), Failure> {
    let mut chart = axes(paper, across, upwards)?;
    for (role, steps) in all {
        chart.draw_series([PathElement::new(steps.clone(), stroke(*role, 1.8))])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn histogram_contains_every_error_once() {
        let errors = [-5.0, 0.1, 0.2, 0.9, 7.0];
        let steps = steps(&errors, (0.0, 1.0));
        let area: f64 = steps.chunks(2).map(|s| s[0].1 * (s[1].0 - s[0].0)).sum();
        assert!((area - 100.0).abs() < 1e-9, "{area}");
        // Outliers are in the outer bins: two of five below 1/60, in percent per N.
        assert!((steps[0].1 - 20.0 * BINS as f64).abs() < 1e-9);
    }
}
