//! Held-out error after each added effect, relative to the floor.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::plot::{Along, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke};
use crate::html::tables::table;
use crate::html::{Section, palette};
use crate::text::diagnosis as text;
use analysis::diagnose::{Diagnosis, StaircaseStep};
use analysis::numbers::{maybe, number};

/// Size of the plot in pixels.
const SIZE: (u32, u32) = (440, 280);
/// Relative width of a bar.
const FILLED: f64 = 0.6;

/// Bars, and a table with the names of the effects.
pub fn section(diagnosis: &Diagnosis) -> Section {
    let stairs = &diagnosis.staircase;
    let rows = stairs.iter().enumerate().map(|(i, stair)| {
        vec![
            html! { (i) ". " (text::added_effects(stair)) },
            html! { (number(stair.held_out_rms_g)) },
            html! { (number(floors(stair))) },
            html! { (maybe(stair.held_out_rmse_n)) },
        ]
    });
    let body = html! {
        figure {
                figcaption { "Held-out error over all sensors, in gauss; above each bar in floors" }
                (plot(stairs))
                (key(&[
                    (Swatch::Full, palette::FIRST, "RMS, held out".to_owned()),
                    (Swatch::Mark, palette::INK, "floor: residual of a perfect model".to_owned()),
                ]))
            }
            (table(
                "Step by step",
                &["added", "RMS in G", "RMS / floor", "as force in N"],
                rows,
            ))
    };
    Section { id: "staircase", heading: "Error reduction".to_owned(), body }
}

fn floors(stair: &StaircaseStep) -> f64 {
    stair.held_out_rms_g / stair.floor_g
}

fn plot(stairs: &[StaircaseStep]) -> Markup {
    let says =
        stairs.iter().fold("Bars: held-out error after each step.".to_owned(), |says, stair| {
            format!(
                "{says} {}: {} G, {} floors.",
                text::added_effects(stair),
                number(stair.held_out_rms_g),
                number(floors(stair))
            )
        });
    figure(SIZE, &says, |paper| draw(paper, stairs))
}

fn draw(paper: &Paper, stairs: &[StaircaseStep]) -> Result<(), Failure> {
    let sizes = stairs.iter().flat_map(|s| [s.held_out_rms_g, s.floor_g]);
    let mut upwards = Along::bars("RMS in gauss", sizes);
    // Space for the labels above the highest bar.
    upwards.range.end *= 1.08;
    let mut chart = axes(paper, &Along::things(stairs.len()), &upwards)?;
    let (foot, top) = (upwards.range.start, upwards.range.end);
    for (i, stair) in stairs.iter().enumerate() {
        let (from, to) = (i as f64, i as f64 + 1.0);
        let middle = from + 0.5;
        if stair.held_out_rms_g.is_finite() {
            let corners =
                [(middle - 0.5 * FILLED, 0.0), (middle + 0.5 * FILLED, stair.held_out_rms_g)];
            let fill = palette::FIRST.light.filled();
            chart.draw_series([Rectangle::new(corners, fill)])?;
        }
        if stair.floor_g.is_finite() {
            let line = [(from, stair.floor_g), (to, stair.floor_g)];
            chart.draw_series([PathElement::new(line, stroke(palette::INK, 2.5))])?;
        }
        let height = if stair.held_out_rms_g.is_finite() {
            stair.held_out_rms_g.max(stair.floor_g)
        } else {
            top
        };
        let (x, y) = chart.backend_coord(&(middle, height));
        let words = format!("{} x", number(floors(stair)));
        paper.draw(&Text::new(words, (x, y - px(10.0)), centred(palette::INK, 1.0)))?;
        let (x, y) = chart.backend_coord(&(middle, foot));
        let words = match i {
            0 => "initial".to_owned(),
            _ => format!("{i}."),
        };
        paper.draw(&Text::new(words, (x, y + px(12.0)), centred(palette::INK, 1.0)))?;
    }
    Ok(())
}
