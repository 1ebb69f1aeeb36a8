//! Measured and modelled values over time: interactive plots by the page's script, static ones without it.

use maud::{Markup, PreEscaped, html};
use plotters::prelude::*;

use crate::html::pack::{Channel, channels, pack, same};
use crate::html::palette::{self, Role};
use crate::html::plot::{
    Along, Chart, Failure, HALF, Swatch, axes, bounds, figure, key, lines, stroke,
};
use analysis::compare::{Comparison, Envelope, Trace};

/// Height of the residual in pixels.
const STRIP: f64 = 96.0;
/// Number of static traces; all of them would make the page too large.
const STILL: usize = 12;
/// Stretches of a static curve: about one per four pixels.
const STRETCHES: usize = 120;

/// Interactive plots with controls, and static ones.
pub fn section(comparison: &Comparison) -> Markup {
    if comparison.traces.is_empty() {
        return html! {
            section #overlay { h2 { "Measured and modelled over time" } p.empty { "No traces." } }
        };
    }
    html! {
        section #overlay {
            h2 { "Measured and modelled over time" }
            (legend(comparison))
            div.live hidden {
                (controls())
                div #plots tabindex="0" role="group"
                    aria-label="Measured and modelled over time. Plus and minus zoom, the arrows move, 0 shows all." {}
            }
            noscript { (still(comparison)) }
            script #traces type="application/json" { (PreEscaped(data(comparison))) }
        }
    }
}

/// JSON that cannot close the script element.
fn data(comparison: &Comparison) -> String {
    serde_json::to_string(&pack(comparison))
        .unwrap_or_else(|_| "null".to_owned())
        .replace('<', "\\u003c")
}

fn legend(comparison: &Comparison) -> Markup {
    let model = |letter: &str, model: &str| match comparison.other {
        Some(_) => format!("{letter}: {model}"),
        None => format!("modelled by {model}"),
    };
    let mut entries = vec![
        (Swatch::Broad, palette::INK, "measured".to_owned()),
        (Swatch::Line, palette::FIRST, model("A", &comparison.model)),
    ];
    if let Some(other) = &comparison.other {
        entries.push((Swatch::Line, palette::SECOND, model("B", &other.model)));
    }
    html! {
        (key(&entries))
        p.note { "Below each plot: the error, on its own scale. Long stretches are drawn as envelopes "
            "from minimum to maximum, so that peaks are preserved." }
    }
}

fn controls() -> Markup {
    html! {
        div.controls {
            label { "Recording " select #recording {} }
            label { "Sensor " select #sensor {} }
            label { "Show " select #kind {
                option value="" { "forces and field" }
                option value="force" { "forces" }
                option value="field" { "field" }
            } }
            span.buttons {
                @for (step, sign, says) in [
                    ("in", "+", "Zoom in"), ("out", "\u{2212}", "Zoom out"), ("back", "\u{25c0}\u{fe0e}", "Earlier"),
                    ("on", "\u{25b6}\u{fe0e}", "Later"),
                ] {
                    button type="button" data-zoom=(step) aria-label=(says) title=(says) { (sign) }
                }
                button type="button" data-zoom="all" { "Show all" }
            }
            output #window aria-live="polite" {}
        }
        p.note.mouse #value { "Point at a curve to read values." }
        p.note { "Drag across a stretch to zoom in; once zoomed, drag to move. "
            span.finger { "Pinch to zoom." }
            span.mouse { "Or click a plot, then turn the wheel or press + \u{2212} \u{2190} \u{2192}, and 0 to see all." } }
    }
}

fn still(comparison: &Comparison) -> Markup {
    let traces = &comparison.traces;
    html! {
        @for trace in traces.iter().take(STILL) {
            h3 { (trace.recording) ", s" (trace.sensor) }
            div.pair.still {
                @for channel in channels(trace) {
                    (plot(channel, same(comparison.other.as_deref(), trace)))
                }
            }
        }
        @if traces.len() > STILL {
            p.empty { "With JavaScript, this page shows " (traces.len() - STILL) " more." }
        }
    }
}

fn plot(channel: Channel, other: Option<&Trace>) -> Markup {
    let second = other.and_then(|other| channels(other).find(|c| c.name == channel.name));
    let models: Vec<(Role, Channel)> = [(palette::FIRST, Some(channel)), (palette::SECOND, second)]
        .into_iter()
        .filter_map(|(role, channel)| Some((role, channel?)))
        .collect();
    let few = |curve: &Envelope| curve.coarser(STRETCHES);
    let measured = few(channel.measured);
    let modelled: Vec<_> = models.iter().map(|(role, c)| (*role, few(c.modelled))).collect();
    let residual: Vec<_> = models.iter().map(|(role, c)| (*role, few(&c.error()))).collect();
    let time = Along { labels: 6, ..Along::holding("time in s", measured.time_s.iter().copied()) };
    let bare = Along { words: String::new(), ..time.clone() };
    let (name, unit) = (channel.name, channel.unit);
    let says =
        format!("{name} in {unit} over time, measured and modelled, and their difference below.");
    let drawn = figure(HALF, &says, |paper| {
        let height = f64::from(HALF.1) - STRIP;
        let (above, below) = paper.split_vertically(super::plot::px(height));
        let curves = || modelled.iter().map(|(_, curve)| curve).chain([&measured]);
        let mut chart = axes(&above, &bare, &Along::holding(unit, numbers(curves())))?;
        envelope(&mut chart, palette::INK, 4.0, 0.4, &measured)?;
        for (role, curve) in &modelled {
            envelope(&mut chart, *role, 1.5, 1.0, curve)?;
        }
        let left = residual.iter().map(|(_, curve)| curve);
        let upwards =
            Along { labels: 3, ..Along::holding(format!("error, {unit}"), numbers(left)) };
        let mut chart = axes(&below, &time, &upwards)?;
        for (role, curve) in &residual {
            // The first model remains visible through the second.
            envelope(&mut chart, *role, 1.0, 0.6, curve)?;
        }
        Ok(())
    });
    html! { figure { figcaption { (name) ", in " (unit) "; below: " (channel.sign()) } (drawn) } }
}

fn numbers<'a>(curves: impl Iterator<Item = &'a Envelope>) -> Vec<f64> {
    let ends = curves.flat_map(|curve| {
        let all = curve.low.iter().chain(&curve.high);
        bounds(all.copied())
    });
    ends.flat_map(|(least, greatest)| [least, greatest]).collect()
}

/// Band from minimum to maximum, with an outline for thin bands.
fn envelope(
    chart: &mut Chart,
    role: Role,
    width: f64,
    opacity: f64,
    curve: &Envelope,
) -> Result<(), Failure> {
    let along = |values: &[f64]| -> Vec<(f64, f64)> {
        curve.time_s.iter().copied().zip(values.iter().copied()).collect()
    };
    let style = ShapeStyle { color: role.light.mix(opacity), ..stroke(role, width) };
    let runs = lines(&along(&curve.low)).into_iter().zip(lines(&along(&curve.high)));
    for (low, high) in runs {
        let single = low == high;
        if single {
            chart.draw_series([PathElement::new(low, style)])?;
        } else {
            // The outline comes from CSS: the backend would write all points twice.
            let outline: Vec<_> = low.iter().chain(high.iter().rev()).copied().collect();
            let area = Polygon::new(outline, role.light.mix(opacity).filled());
            chart.draw_series([area])?;
        }
    }
    Ok(())
}
