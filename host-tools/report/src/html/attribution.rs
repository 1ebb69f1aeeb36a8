//! Residual over each covariate as small multiples with one scale per sensor, and the worst stretches.

use crate::html::palette::Role;
use crate::html::plot::{
    Along, Failure, Paper, Swatch, axes, figure, key, lines, range_of_bands, stroke, with_unit,
};
use crate::html::summary::initial;
use crate::html::tables::table;
use crate::html::{both, palette, sensor_that_errs_most};
use crate::text::comparison::attribution::{conditions, not_recorded, residual_words};
use analysis::compare::{Attribution, Comparison};
use analysis::numbers::{number, whole_percent};
use maud::{Markup, html};
use plotters::prelude::*;
use std::ops::Range;

/// Size of a plot in pixels.
const SIZE: (u32, u32) = (340, 210);

/// Selected covariates of the model, and of the baseline if any; the others are folded.
pub fn section(comparison: &Comparison) -> Markup {
    let models = both(comparison);
    let mut sensors: Vec<u32> =
        comparison.located.iter().flat_map(|located| located.sensors.iter().copied()).collect();
    sensors.sort_unstable();
    sensors.dedup();
    let worst = sensor_that_errs_most(comparison).filter(|worst| sensors.contains(worst));
    let shown = worst.or(sensors.first().copied());
    let unit = comparison.located.first().map_or_else(Default::default, |one| one.error_unit);
    let [x, y, z] = unit.axis_names();
    let axes = [(palette::FIRST, x), (palette::SECOND, y), (palette::THIRD, z)];
    let axes = axes.into_iter().filter(|(_, name)| !name.is_empty());
    html! {
        section #located {
            h2 { "Dependence on covariates" }
            @if comparison.located.is_empty() { p.empty { "No suitable covariate was recorded." } }
            @else {
                p.note {
                    "Mean residual over each covariate, with its 95 % band. Residual: " (residual_words(unit)) ". "
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
                (key(&axes.map(|(role, name)| (Swatch::Line, role, name.to_owned())).collect::<Vec<_>>()))
                // The baseline first: what was added follows from it.
                @for (role, letter, model) in models.iter().rev() {
                    @if models.len() > 1 { h3 { (initial(*role, letter)) " " (model.model) } }
                    (of_model(&models, model, shown))
                }
            }
        }
    }
}

fn of_model(
    models: &[(Role, &str, &Comparison)],
    model: &Comparison,
    shown: Option<u32>,
) -> Markup {
    let (chosen, rest): (Vec<_>, Vec<_>) = model.located.iter().partition(|l| l.chosen);
    html! {
        @if chosen.is_empty() { p.empty { "No covariate explains a significant share." } }
        div.small { @for located in &chosen { (plots(models, located, shown)) } }
        @if !rest.is_empty() {
            details {
                summary { "The other " (rest.len()) " covariates" }
                div.small { @for located in &rest { (plots(models, located, shown)) } }
            }
        }
    }
}

/// One covariate: a plot for each sensor, one visible.
fn plots(
    models: &[(Role, &str, &Comparison)],
    located: &Attribution,
    shown: Option<u32>,
) -> Markup {
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
                    (plot(located, i, *sensor, &scale(models, *sensor)))
                }
            }
        }
    }
}

/// The same scale for all covariates of a sensor, in the unit of the residual.
fn scale(models: &[(Role, &str, &Comparison)], sensor: u32) -> Range<f64> {
    let of_sensor = |located: &Attribution| located.sensors.iter().position(|s| *s == sensor);
    let located = models.iter().flat_map(|(_, _, model)| &model.located);
    let bins = located.flat_map(|located| {
        let i = of_sensor(located);
        located.bins.iter().filter_map(move |bin| {
            let i = i?;
            Some((*bin.mean.get(i)?, bin.band.get(i).copied()))
        })
    });
    let (mut means, mut bands) = (Vec::new(), Vec::new());
    for (mean, band) in bins {
        means.extend(mean);
        bands.extend(band.into_iter().flatten().flat_map(|(low, high)| [low, high]));
    }
    range_of_bands(means, bands, 0.04)
}

fn plot(located: &Attribution, sensor_at: usize, sensor: u32, scale: &Range<f64>) -> Markup {
    let words = with_unit(&located.words, located.unit);
    let across =
        Along { labels: 4, ..Along::holding(&words, located.bins.iter().map(|bin| bin.centre)) };
    let symbol = located.error_unit.symbol();
    let upwards = Along::linear(symbol, scale.clone(), 4);
    let says =
        format!("Mean residual of sensor {sensor} in {symbol} over {words}, with 95 % bands.");
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
    let names = located.error_unit.axis_names();
    let shown =
        || palette::AXES.into_iter().enumerate().filter(|(axis, _)| !names[*axis].is_empty());
    for (axis, role) in shown() {
        let band = located.bins.iter().filter_map(|bin| {
            let (low, high) = bin.band.get(sensor_at)?.get(axis).copied()?;
            let numbers = [bin.centre, low, high].iter().all(|value| value.is_finite());
            numbers.then_some((bin.centre, inside(low), inside(high)))
        });
        let band: Vec<_> = band.collect();
        let outline = band.iter().map(|(x, low, _)| (*x, *low));
        let outline = outline.chain(band.iter().rev().map(|(x, _, high)| (*x, *high)));
        let area = Polygon::new(outline.collect::<Vec<_>>(), role.light.mix(0.18).filled());
        chart.draw_series([area])?;
    }
    for (axis, role) in shown() {
        let mean = located.bins.iter().map(|bin| {
            let mean = bin.mean.get(sensor_at).and_then(|mean| mean.get(axis));
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

/// The table of the worst stretches, of the model and of the baseline if any.
pub fn worst_section(comparison: &Comparison) -> Markup {
    let models = both(comparison);
    html! {
        section #worst {
            h2 { "Worst stretches" }
            @for (role, letter, model) in models.iter().rev() {
                @if models.len() > 1 { h3 { (initial(*role, letter)) " " (model.model) } }
                (worst_stretches(model, comparison))
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

fn worst_stretches(model: &Comparison, comparison: &Comparison) -> Markup {
    let rows = model.worst.iter().map(|worst| {
        let shown = comparison
            .traces
            .iter()
            .any(|trace| trace.recording == worst.recording && trace.sensor == worst.sensor);
        vec![
            html! { (number(worst.rms)) " " (worst.error_unit.symbol()) },
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
        @if model.worst.is_empty() { p.empty { "None is significant." } }
        @else {
            (table(
                "RMS over all sensors and axes",
                &["RMS", "recording", "from, to (s)", "sensor", "conditions", ""],
                rows,
            ))
        }
    }
}
