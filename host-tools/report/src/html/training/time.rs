//! Reference and estimates over time with the network's confidence band.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::Section;
use crate::html::palette::{self, Role};
use crate::html::plot::{Along, Failure, Paper, Swatch, axes, figure, key, px, stroke};
use crate::html::training::{DRAWN, FORCES};
use analysis::benchmark::Benchmark;
use analysis::benchmark::variants::EstimatorVariant;
use analysis::replay::ForceSample;

/// Size of a force plot in pixels.
const SIZE: (u32, u32) = (880, 420);
/// Height of the error strip in pixels.
const STRIP: f64 = 180.0;
/// Half width of the band in standard deviations.
const BAND: f64 = 2.0;
/// Subsampling to about one point per pixel.
const THINNED: usize = 2;

/// A plot for each force.
pub fn section(table: &Benchmark) -> Section {
    let mut entries = vec![(Swatch::Broad, palette::INK, "reference".to_owned())];
    entries.extend(DRAWN.map(|(way, role)| (Swatch::Line, role, way.words().to_owned())));
    entries.push((
        Swatch::Framed,
        palette::THIRD,
        format!("\u{b1}{BAND} predicted standard deviations of the network of 3 axes"),
    ));
    let body = html! {
        @for (axis, name) in FORCES {
            figure {
                figcaption { (name) ", first sensor, in newtons; below: the device's error" }
                (plot(table, axis, name))
            }
        }
        (key(&entries))
    };
    Section { id: "time", heading: "Over time, as in Fig. 7".to_owned(), body }
}

/// Curve: colour and points.
type Curve = (Role, Vec<(f64, f64)>);

fn curve(seen: &[ForceSample], of: impl Fn(&ForceSample) -> f64) -> Vec<(f64, f64)> {
    let points = seen.iter().step_by(THINNED);
    points.map(|seen| (seen.time_s, of(seen))).collect()
}

fn plot(table: &Benchmark, axis: usize, name: &str) -> Markup {
    let Some(network) = table.of(EstimatorVariant::Gru3Axis).filter(|j| !j.samples.is_empty())
    else {
        return html! { p.empty { "The recording is too short." } };
    };
    let ways = || DRAWN.into_iter().filter_map(|(way, role)| Some((role, table.of(way)?)));
    let estimates: Vec<Curve> = ways()
        .map(|(role, way)| (role, curve(&way.samples, |seen| seen.estimate_n[axis])))
        .collect();
    let errors: Vec<Curve> = ways()
        .map(|(role, way)| {
            let error = |seen: &ForceSample| seen.estimate_n[axis] - seen.reference_n[axis];
            (role, curve(&way.samples, error))
        })
        .collect();
    let truth = curve(&network.samples, |seen| seen.reference_n[axis]);
    let side = |sign: f64| {
        curve(&network.samples, |seen| {
            let sigma = seen.sigma_n.map_or(f64::NAN, |sigma| sigma[axis]);
            seen.estimate_n[axis] - seen.reference_n[axis] + sign * BAND * sigma
        })
    };
    let (low, high) = (side(-1.0), side(1.0));
    let says = format!("{name} over time: reference and estimates, and their errors below.");
    figure(SIZE, &says, |paper| {
        let height = f64::from(SIZE.1) - STRIP;
        let (above, below) = paper.split_vertically(px(height));
        let all = estimates.iter().flat_map(|(_, points)| points);
        let time = Along { labels: 8, ..Along::holding("time in s", truth.iter().map(|p| p.0)) };
        let bare = Along { words: String::new(), ..time.clone() };
        let up = Along::holding("N", all.chain(&truth).map(|p| p.1));
        draw(&above, (&bare, &up), (&truth, &[], &[]), &estimates)?;
        let all = errors.iter().flat_map(|(_, points)| points);
        let up = Along::holding("error, N", all.chain(&low).chain(&high).map(|p| p.1));
        draw(&below, (&time, &up), (&[], &low, &high), &errors)
    })
}

/// Points of a line or of one side of a band.
type Points<'a> = &'a [(f64, f64)];

fn draw(
    paper: &Paper,
    (across, upwards): (&Along, &Along),
    (broad, low, high): (Points, Points, Points),
    curves: &[Curve],
) -> Result<(), Failure> {
    let mut chart = axes(paper, across, upwards)?;
    let sound = |points: Points| -> Vec<(f64, f64)> {
        points.iter().copied().filter(|p| p.1.is_finite()).collect()
    };
    let mut outline = sound(low);
    outline.extend(sound(high).into_iter().rev());
    if !outline.is_empty() {
        let fill = palette::THIRD.light.mix(0.25).filled();
        chart.draw_series([Polygon::new(outline, fill)])?;
    }
    if !broad.is_empty() {
        let style = ShapeStyle { color: palette::INK.light.mix(0.4), ..stroke(palette::INK, 4.0) };
        chart.draw_series([PathElement::new(broad.to_vec(), style)])?;
    }
    for (role, points) in curves {
        chart.draw_series([PathElement::new(points.clone(), stroke(*role, 1.5))])?;
    }
    Ok(())
}
