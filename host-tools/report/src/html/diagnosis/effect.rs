//! The residual before an effect was added, over its covariate, with what the effect took of it.

use std::ops::Range;

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::palette;
use crate::html::plot::{
    Along, Failure, Paper, Swatch, axes, figure, key, lines, range_of_bands, stroke, with_unit,
};
use analysis::diagnose::EffectShape;

/// Size of the plot of the strongest channel, in pixels.
const LARGE: (u32, u32) = (440, 280);
/// Size of those of the others.
const SMALL: (u32, u32) = (340, 200);
/// Radius of a dot in drawing units.
const DOT: i32 = 12;
/// Colours of rising and falling force.
const BRANCHES: [palette::Role; 2] = [palette::FIRST, palette::THIRD];
/// Letters of the axes of the field.
const AXES: [&str; 3] = ["x", "y", "z"];

/// The channel in which it shows most.
pub fn strongest(shape: &EffectShape) -> Markup {
    let Some(strongest) = shape.strongest() else {
        return html! {};
    };
    let name = shape.effects.join(" or ");
    html! {
        figure {
            figcaption {
                "Where it shows most: " (channel(shape, strongest)) " over the " (shape.words)
            }
            (plot(shape, strongest, LARGE, &scale(shape, &[strongest])))
            (key(&[
                (Swatch::Framed, palette::FIRST, "residual before it was added: mean and 95 % band".to_owned()),
                (Swatch::Line, palette::SECOND, format!("what {name} took away")),
            ]))
        }
    }
}

/// The hysteresis loop, where there is one: residual over the force, apart for rising and falling force.
pub fn load_loop(shape: &EffectShape) -> Markup {
    let Some((load_loop, (of, _))) = shape.load_loop.as_ref().and_then(|l| Some((l, l.widest()?)))
    else {
        return html! {};
    };
    let branch = |means: &[Vec<[f64; 3]>]| -> Vec<(f64, f64)> {
        let pairs = load_loop.force_n.iter().zip(means);
        pairs.filter_map(|(force, bin)| Some((*force, bin.get(of.0)?[of.1]))).collect()
    };
    let before = load_loop.before_g.each_ref().map(|means| branch(means));
    let taken = load_loop.taken_g.each_ref().map(|means| branch(means));
    let all = || before.iter().chain(&taken).flatten();
    let across =
        Along::holding(format!("{} in N", load_loop.words), load_loop.force_n.iter().copied());
    let upwards = Along { labels: 4, ..Along::holding("G", all().map(|(_, g)| *g)) };
    let says = format!(
        "Mean residual of {} in gauss over the {}, apart for rising and falling force, before {} was added, and what that took away.",
        channel(shape, of),
        load_loop.words,
        shape.effects.join(" or ")
    );
    let draw = |paper: &Paper| -> Result<(), Failure> {
        let mut chart = axes(paper, &across, &upwards)?;
        for (branch, role) in taken.iter().zip(BRANCHES) {
            for run in lines(branch) {
                chart.draw_series([PathElement::new(run, stroke(role, 2.2))])?;
            }
        }
        for (branch, role) in before.iter().zip(BRANCHES) {
            let finite = branch.iter().filter(|(force, g)| force.is_finite() && g.is_finite());
            let dots = finite.map(|point| Circle::new(*point, DOT, role.light.filled()));
            chart.draw_series(dots)?;
        }
        Ok(())
    };
    html! {
        figure {
            figcaption { "The loop: " (channel(shape, of)) " over the " (load_loop.words) }
            (figure(LARGE, &says, draw))
            (key(&[
                (Swatch::Framed, BRANCHES[0], "residual while the force rises, before it was added".to_owned()),
                (Swatch::Framed, BRANCHES[1], "while the force falls".to_owned()),
                (Swatch::Line, BRANCHES[0], "lines: what was taken away".to_owned()),
            ]))
        }
    }
}

/// Every channel on one scale, folded.
pub fn all(shape: &EffectShape) -> Markup {
    let sensors = 0..shape.sensors.len();
    let channels: Vec<(usize, usize)> =
        sensors.flat_map(|s| [0, 1, 2].map(|axis| (s, axis))).collect();
    let scale = scale(shape, &channels);
    html! {
        details {
            summary { "All sensors and axes" }
            div.small {
                @for one in &channels {
                    figure {
                        figcaption { (channel(shape, *one)) }
                        (plot(shape, *one, SMALL, &scale))
                    }
                }
            }
        }
    }
}

fn channel(shape: &EffectShape, (sensor, axis): (usize, usize)) -> String {
    format!("s{} {}", shape.sensors[sensor], AXES[axis])
}

/// Centre, mean, band and what was taken away of each bin of a channel.
fn points(shape: &EffectShape, (sensor, axis): (usize, usize)) -> Vec<[f64; 5]> {
    let bins = shape.bins.iter().zip(&shape.taken_g);
    let point = |(bin, taken): (&analysis::compare::Bin, &Vec<[f64; 3]>)| {
        let (low, high) = bin.band.get(sensor)?[axis];
        let mean = bin.mean.get(sensor)?[axis];
        Some([bin.centre, mean, low, high, taken.get(sensor)?[axis]])
    };
    bins.filter_map(point).collect()
}

/// A scale that holds these channels, with zero in it.
fn scale(shape: &EffectShape, channels: &[(usize, usize)]) -> Range<f64> {
    let all: Vec<[f64; 5]> = channels.iter().flat_map(|c| points(shape, *c)).collect();
    let means = all.iter().flat_map(|point| [point[1], point[4]]);
    let bands = all.iter().flat_map(|point| [point[2], point[3]]);
    range_of_bands(means, bands, 0.06)
}

fn plot(shape: &EffectShape, of: (usize, usize), size: (u32, u32), scale: &Range<f64>) -> Markup {
    let words = with_unit(&shape.words, shape.unit);
    let says = format!(
        "Mean residual of {} in gauss over {words} before {} was added, with its 95 % band, and what that took away.",
        channel(shape, of),
        shape.effects.join(" or ")
    );
    let few = shape.bins.len() <= 3;
    let across = Along {
        labels: if few { shape.bins.len() } else { 4 },
        ..Along::holding(&words, shape.bins.iter().map(|bin| bin.centre))
    };
    let upwards = Along::linear("G", scale.clone(), 4);
    let points = points(shape, of);
    figure(size, &says, |paper| draw(paper, &points, &across, &upwards))
}

fn draw(
    paper: &Paper,
    points: &[[f64; 5]],
    across: &Along,
    upwards: &Along,
) -> Result<(), Failure> {
    let mut chart = axes(paper, across, upwards)?;
    let zero = [(across.range.start, 0.0), (across.range.end, 0.0)];
    chart.draw_series([PathElement::new(zero, stroke(palette::MUTED, 1.0))])?;
    let inside = |value: f64| value.clamp(upwards.range.start, upwards.range.end);
    let before = palette::FIRST.light;
    let sound = || points.iter().filter(|p| p[..4].iter().all(|v| v.is_finite()));
    let lower = sound().map(|p| (p[0], inside(p[2])));
    let upper = sound().rev().map(|p| (p[0], inside(p[3])));
    let outline: Vec<(f64, f64)> = lower.chain(upper).collect();
    if !outline.is_empty() {
        chart.draw_series([Polygon::new(outline, before.mix(0.25).filled())])?;
    }
    let dots = sound().map(|p| Circle::new((p[0], inside(p[1])), DOT, before.filled()));
    chart.draw_series(dots)?;
    let taken: Vec<(f64, f64)> = points.iter().map(|p| (p[0], p[4])).collect();
    for run in lines(&taken) {
        let run: Vec<(f64, f64)> = run.into_iter().map(|(x, y)| (x, inside(y))).collect();
        chart.draw_series([PathElement::new(run, stroke(palette::SECOND, 2.2))])?;
    }
    Ok(())
}
