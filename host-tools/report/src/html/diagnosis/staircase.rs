//! Held-out error after each added effect, with its noise.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::plot::{Along, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke};
use crate::html::tables::text_table;
use crate::html::{Section, palette};
use crate::text::diagnosis::steps;
use analysis::diagnose::{Diagnosis, StaircaseStep};
use analysis::numbers::number;

/// Size of the plot in pixels.
const SIZE: (u32, u32) = (440, 280);
/// Relative width of a bar.
const FILLED: f64 = 0.6;

/// Bars, and a table with the names of the effects.
pub fn section(diagnosis: &Diagnosis) -> Section {
    let stairs = &diagnosis.staircase;
    let unit = diagnosis.noise.unit.symbol();
    let bars = Bars::of(stairs, unit);
    let body = html! {
        figure {
                figcaption { (bars.caption) }
                (plot(stairs, &bars))
                (key(&[
                    (Swatch::Full, palette::FIRST, "held out".to_owned()),
                    (Swatch::Mark, palette::INK, bars.floor.to_owned()),
                ]))
            }
            @if let Some(note) = steps::rising_force(stairs) { p.note { (note) } }
            @if !diagnosis.dropped.is_empty() { p.note { (steps::dropped_steps(diagnosis)) } }
            (text_table("Step by step", &steps::step_table(diagnosis)))
            p.note { (steps::STEP_NOTE) }
    };
    Section { id: "staircase", heading: "Error reduction".to_owned(), body }
}

/// What the bars show: forces in newtons, or the signal where the device computes no forces.
struct Bars {
    caption: &'static str,
    axis: String,
    floor: &'static str,
    /// Error, noise and label of each bar.
    list: Vec<(f64, f64, String)>,
}

impl Bars {
    fn of(stairs: &[StaircaseStep], unit: &str) -> Self {
        let forces: Option<Vec<_>> = stairs.iter().map(|stair| stair.force).collect();
        match forces {
            Some(forces) => Self {
                caption: "Held-out force error through the device's code: excess over the noise, over all forces",
                axis: "excess in newtons".to_owned(),
                floor: "noise alone",
                list: forces
                    .iter()
                    .map(|of| (of.excess_n(), of.noise_n, format!("{} N", number(of.excess_n()))))
                    .collect(),
            },
            None => Self {
                caption: "Held-out error of the field over all sensors",
                axis: format!("RMS in {unit}"),
                floor: "floor: residual of a perfect model",
                list: stairs
                    .iter()
                    .map(|s| {
                        let label = format!("{} {unit}", number(s.held_out_rms_g));
                        (s.held_out_rms_g, s.floor_g, label)
                    })
                    .collect(),
            },
        }
    }
}

fn plot(stairs: &[StaircaseStep], bars: &Bars) -> Markup {
    let steps = stairs.iter().zip(&bars.list);
    let says = steps.fold(format!("Bars: {}.", bars.caption), |says, (stair, (rms, _, label))| {
        format!("{says} {}: {}, {label}.", steps::added_effects(stair), number(*rms))
    });
    figure(SIZE, &says, |paper| draw(paper, bars))
}

fn draw(paper: &Paper, bars: &Bars) -> Result<(), Failure> {
    let sizes = bars.list.iter().flat_map(|(rms, noise, _)| [*rms, *noise]);
    let mut upwards = Along::bars(&bars.axis, sizes);
    // Space for the labels above the highest bar.
    upwards.range.end *= 1.08;
    let mut chart = axes(paper, &Along::things(bars.list.len()), &upwards)?;
    let (foot, top) = (upwards.range.start, upwards.range.end);
    for (i, (rms, noise, label)) in bars.list.iter().enumerate() {
        let (from, to) = (i as f64, i as f64 + 1.0);
        let middle = from + 0.5;
        if rms.is_finite() {
            let corners = [(middle - 0.5 * FILLED, 0.0), (middle + 0.5 * FILLED, *rms)];
            let fill = palette::FIRST.light.filled();
            chart.draw_series([Rectangle::new(corners, fill)])?;
        }
        if noise.is_finite() {
            let line = [(from, *noise), (to, *noise)];
            chart.draw_series([PathElement::new(line, stroke(palette::INK, 2.5))])?;
        }
        let height = if rms.is_finite() { rms.max(*noise) } else { top };
        let (x, y) = chart.backend_coord(&(middle, height));
        paper.draw(&Text::new(label.as_str(), (x, y - px(10.0)), centred(palette::INK, 1.0)))?;
        let (x, y) = chart.backend_coord(&(middle, foot));
        let words = match i {
            0 => "initial".to_owned(),
            _ => format!("{i}."),
        };
        paper.draw(&Text::new(words, (x, y + px(12.0)), centred(palette::INK, 1.0)))?;
    }
    Ok(())
}
