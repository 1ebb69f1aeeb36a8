//! Residual over each covariate as small multiples with one scale per sensor, and the worst stretches.

use crate::html::plot::{
    Along, AxisScale, Failure, Paper, Swatch, axes, bounds, figure, key, lines, stroke,
};
use crate::html::tables::table;
use crate::html::{palette, sensor_that_errs_most};
use crate::text::comparison::{conditions, not_recorded};
use analysis::compare::{Attribution, Comparison};
use analysis::numbers::{number, whole_percent};
use maud::{Markup, html};
use plotters::prelude::*;
use std::ops::Range;

/// Size of a plot in pixels.
const SIZE: (u32, u32) = (340, 210);
/// Confidence bands beyond this multiple of the largest mean are clipped: bins of few rows would
/// flatten all others.
const FURTHEST_BAND: f64 = 1.6;

/// Selected covariates; the others are folded.
pub fn section(comparison: &Comparison) -> Markup {
    let (chosen, rest): (Vec<_>, Vec<_>) = comparison.located.iter().partition(|l| l.chosen);
    let mut sensors: Vec<u32> =
        comparison.located.iter().flat_map(|located| located.sensors.iter().copied()).collect();
    sensors.sort_unstable();
    sensors.dedup();
    let worst = sensor_that_errs_most(comparison).filter(|worst| sensors.contains(worst));
    let shown = worst.or(sensors.first().copied());
    html! {
        section #located {
            h2 { "Dependence on covariates" }
            @if comparison.located.is_empty() { p.empty { "No suitable covariate was recorded." } }
            @else {
                p.note {
                    "Mean residual (measured minus modelled) in gauss over each covariate, with its 95 % band. "
                    "A flat line at zero: this covariate explains no residual."
                }
                @if let Some(text) = not_recorded(comparison) { p.note { (text) } }
                p.controls.live hidden {
                    label for="located-sensor" { "Sensor " }
                    select #located-sensor {
                        @for sensor in &sensors {
                            option value=(sensor) selected[Some(*sensor) == shown] {
                                "s" (sensor) @if Some(*sensor) == worst { ", largest error" }
                            }
                        }
                    }
                }
                (key(&[
                    (Swatch::Line, palette::FIRST, "x".to_owned()),
                    (Swatch::Line, palette::SECOND, "y".to_owned()),
                    (Swatch::Line, palette::THIRD, "z".to_owned()),
                ]))
                @if chosen.is_empty() { p.empty { "No covariate explains a significant share." } }
                div.small { @for located in &chosen { (plots(comparison, located, shown)) } }
                @if !rest.is_empty() {
                    details {
                        summary { "The other " (rest.len()) " covariates" }
                        div.small { @for located in &rest { (plots(comparison, located, shown)) } }
                    }
                }
            }
        }
    }
}

/// One covariate: a plot for each sensor, one visible.
fn plots(comparison: &Comparison, located: &Attribution, shown: Option<u32>) -> Markup {
    let share = whole_percent(located.share);
    html! {
        figure.covariate {
            figcaption {
                strong { (located.words) } ": " (share)
                @if located.chosen { " of the residual" } @else {
                    " beyond the selected ones, " (whole_percent(located.alone)) " alone"
                }
            }
            @for (i, sensor) in located.sensors.iter().enumerate() {
                div.of-sensor data-sensor=(sensor) hidden[Some(*sensor) != shown] {
                    span.static-only { "s" (sensor) }
                    (plot(located, i, *sensor, &scale(comparison, *sensor)))
                }
            }
        }
    }
}

/// The same scale for all covariates of a sensor, in gauss.
fn scale(comparison: &Comparison, sensor: u32) -> Range<f64> {
    let of_sensor = |located: &Attribution| located.sensors.iter().position(|s| *s == sensor);
    let bins = comparison.located.iter().flat_map(|located| {
        let i = of_sensor(located);
        located.bins.iter().filter_map(move |bin| {
            let i = i?;
            Some((*bin.mean_g.get(i)?, bin.band_g.get(i).copied()))
        })
    });
    let (mut means, mut bands) = (Vec::new(), Vec::new());
    for (mean, band) in bins {
        means.extend(mean);
        bands.extend(band.into_iter().flatten().flat_map(|(low, high)| [low, high]));
    }
    let (least, greatest) = bounds(means).unwrap_or((-1.0, 1.0));
    let size = least.abs().max(greatest.abs()).max(f64::MIN_POSITIVE);
    let (low, high) = bounds(bands).unwrap_or((least, greatest));
    let furthest = FURTHEST_BAND * size;
    let low = low.min(least).min(0.0).max(-furthest);
    let high = high.max(greatest).max(0.0).min(furthest);
    low - 0.04 * (high - low)..high + 0.04 * (high - low)
}

fn plot(located: &Attribution, sensor_at: usize, sensor: u32, scale: &Range<f64>) -> Markup {
    let unit = match located.unit {
        "" => String::new(),
        unit => format!(" in {unit}"),
    };
    let words = format!("{}{unit}", located.words);
    let across =
        Along { labels: 4, ..Along::holding(&words, located.bins.iter().map(|bin| bin.centre)) };
    let upwards =
        Along { words: "G".to_owned(), range: scale.clone(), labels: 4, scale: AxisScale::Linear };
    let says = format!(
        "Mean residual of sensor {sensor} in gauss over {words}: x, y and z with 95 % bands."
    );
    figure(SIZE, &says, |paper| draw(paper, located, sensor_at, &across, &upwards))
}

fn draw(
    paper: &Paper,
    located: &Attribution,
    sensor_at: usize,
    across: &Along,
    upwards: &Along,
) -> Result<(), Failure> {
    let mut chart = axes(paper, across, upwards)?;
    let zero = [(across.range.start, 0.0), (across.range.end, 0.0)];
    chart.draw_series([PathElement::new(zero, stroke(palette::MUTED, 1.0))])?;
    let inside = |value: f64| value.clamp(upwards.range.start, upwards.range.end);
    for (axis, role) in palette::AXES.into_iter().enumerate() {
        let band = located.bins.iter().filter_map(|bin| {
            let (low, high) = bin.band_g.get(sensor_at)?.get(axis).copied()?;
            let numbers = [bin.centre, low, high].iter().all(|value| value.is_finite());
            numbers.then_some((bin.centre, inside(low), inside(high)))
        });
        let band: Vec<_> = band.collect();
        let outline = band.iter().map(|(x, low, _)| (*x, *low));
        let outline = outline.chain(band.iter().rev().map(|(x, _, high)| (*x, *high)));
        let area = Polygon::new(outline.collect::<Vec<_>>(), role.light.mix(0.18).filled());
        chart.draw_series([area])?;
    }
    for (axis, role) in palette::AXES.into_iter().enumerate() {
        let mean = located.bins.iter().map(|bin| {
            let mean = bin.mean_g.get(sensor_at).and_then(|mean| mean.get(axis));
            (bin.centre, inside(mean.copied().unwrap_or(f64::NAN)))
        });
        let runs = lines(&mean.collect::<Vec<_>>());
        let paths = runs.iter().cloned();
        chart.draw_series(paths.map(|run| PathElement::new(run, stroke(role, 1.8))))?;
        // A bin between two gaps has no line.
        let alone = runs.iter().filter(|run| run.len() == 1).flatten();
        chart.draw_series(alone.map(|at| Circle::new(*at, 8, role.light.filled())))?;
    }
    Ok(())
}

/// The table of the worst stretches.
pub fn worst_section(comparison: &Comparison) -> Markup {
    let rows = comparison.worst.iter().map(|worst| {
        let shown = comparison
            .traces
            .iter()
            .any(|trace| trace.recording == worst.recording && trace.sensor == worst.sensor);
        vec![
            html! { (number(worst.rms_g)) " G" },
            html! { (worst.recording) },
            html! { (format!("{:.2} to {:.2}", worst.from_s, worst.to_s)) },
            html! { "s" (worst.sensor) },
            html! { span.doing { (conditions(worst)) } },
            html! {
                @if shown {
                    button.live hidden type="button" data-recording=(worst.recording) data-sensor=(worst.sensor)
                        data-from=(worst.from_s) data-to=(worst.to_s) {
                        "Show"
                    }
                }
            },
        ]
    });
    html! {
        section #worst {
            h2 { "Worst stretches" }
            @if comparison.worst.is_empty() { p.empty { "None is significant." } }
            @else {
                (table(
                    "RMS over all sensors and axes",
                    &["RMS", "recording", "from, to (s)", "sensor", "conditions", ""],
                    rows,
                ))
            }
            @if comparison.correlation_s > 0.0 {
                p.note {
                    "Integrated autocorrelation time of the residual: " (number(comparison.correlation_s))
                    " s; confidence bands and shares take it into account."
                }
            }
        }
    }
}
