//! The sections of designs.
//!
//! - [`one`]: a design judged.
//! - [`sweep`]: many designs, and those that no other beats.
//! - [`paper`]: the paper's figures and statements.

pub mod one;
pub mod paper;
pub mod sweep;

pub use one::sections as of_one;
pub use paper::sections as of_paper;
pub use sweep::sections as of_sweep;

use maud::{Markup, html};
use plotters::prelude::*;

use super::palette::{self, Role};
use super::plot::{Along, HALF, Swatch, axes, figure, key, px, stroke};

/// Colours of up to four things in one plot.
const ROLES: [Role; 4] = [
    palette::FIRST,
    palette::SECOND,
    palette::THIRD,
    palette::INK,
];

/// Points of a plot at most: more would only cover each other. A prime, so that leaving points out takes no
/// step that is one of a grid's, and with it all of one value.
const POINTS: usize = 2503;

/// Named curves over one axis, with their key.
fn curves(
    says: &str,
    (across, upwards): (Along, Along),
    curves: &[(String, Vec<(f64, f64)>)],
) -> Markup {
    let drawn = figure(HALF, says, |paper| {
        let mut chart = axes(paper, &across, &upwards)?;
        for ((_, points), role) in curves.iter().zip(ROLES) {
            chart.draw_series([PathElement::new(points.clone(), stroke(role, 1.8))])?;
        }
        Ok(())
    });
    let entries = curves.iter().zip(ROLES);
    let entries: Vec<_> = entries
        .map(|((name, _), role)| (Swatch::Line, role, name.clone()))
        .collect();
    html! { figure { (drawn) } (key(&entries)) }
}

/// A cloud of points and its colour.
type Cloud = (Role, String, Vec<(f64, f64)>);

/// Clouds of points on logarithmic axes, with their key.
fn clouds(says: &str, (across, upwards): (&str, &str), clouds: &[Cloud]) -> Markup {
    let positive = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let shown = points.len().min(POINTS);
        let points = (0..shown).map(|i| &points[i * points.len() / shown]);
        points
            .filter(|(x, y)| *x > 0.0 && *y > 0.0 && (x * y).is_finite())
            .map(|(x, y)| (x.log10(), y.log10()))
            .collect()
    };
    let kept: Vec<(Role, Vec<(f64, f64)>)> = clouds
        .iter()
        .map(|(role, _, points)| (*role, positive(points)))
        .collect();
    let all = || kept.iter().flat_map(|(_, points)| points);
    let across = Along::powers(across, all().map(|point| point.0));
    let upwards = Along::powers(upwards, all().map(|point| point.1));
    let drawn = figure(HALF, says, |paper| {
        let mut chart = axes(paper, &across, &upwards)?;
        for (role, points) in &kept {
            let dots = points
                .iter()
                .map(|point| Circle::new(*point, px(1.4), role.light.filled()));
            chart.draw_series(dots)?;
        }
        Ok(())
    });
    let entries: Vec<_> = clouds
        .iter()
        .map(|(role, name, _)| (Swatch::Full, *role, name.clone()))
        .collect();
    html! { figure { (drawn) } (key(&entries)) }
}

#[cfg(test)]
mod tests;
