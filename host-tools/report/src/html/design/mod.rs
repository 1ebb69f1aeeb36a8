//! Sections of sensor designs.
//!
//! - [`one`]: one design.
//! - [`sweep`]: many designs and their Pareto front.

pub mod one;
pub mod sweep;

pub use one::sections as of_one;
pub use sweep::sections as of_sweep;

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::palette::{self, Role};
use crate::html::plot::{Along, HALF, Swatch, axes, curve_figure, figure, key, px};

/// Colours of up to four series.
const ROLES: [Role; 4] = [palette::FIRST, palette::SECOND, palette::THIRD, palette::INK];

/// Maximum number of points in a plot. Prime, so that subsampling a grid does not
/// select one of its values only.
const POINTS: usize = 2503;

/// Labelled curves with a legend.
fn curves(
    says: &str,
    (across, upwards): (Along, Along),
    curves: &[(String, Vec<(f64, f64)>)],
) -> Markup {
    let entries: Vec<_> = curves
        .iter()
        .zip(ROLES)
        .map(|((name, _), role)| (Swatch::Line, role, name.clone()))
        .collect();
    let curves: Vec<_> =
        curves.iter().zip(ROLES).map(|((_, points), role)| (role, points.clone())).collect();
    html! { (curve_figure(says, &across, &upwards, &curves)) (key(&entries)) }
}

/// Point cloud and its colour.
type Cloud = (Role, String, Vec<(f64, f64)>);

/// Point clouds on logarithmic axes with a legend.
fn clouds(says: &str, (across, upwards): (&str, &str), clouds: &[Cloud]) -> Markup {
    let positive = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let shown = points.len().min(POINTS);
        let points = (0..shown).map(|i| &points[i * points.len() / shown]);
        points
            .filter(|(x, y)| *x > 0.0 && *y > 0.0 && (x * y).is_finite())
            .map(|(x, y)| (x.log10(), y.log10()))
            .collect()
    };
    let kept: Vec<(Role, Vec<(f64, f64)>)> =
        clouds.iter().map(|(role, _, points)| (*role, positive(points))).collect();
    let all = || kept.iter().flat_map(|(_, points)| points);
    let across = Along::powers(across, all().map(|point| point.0));
    let upwards = Along::powers(upwards, all().map(|point| point.1));
    let drawn = figure(HALF, says, |paper| {
        let mut chart = axes(paper, &across, &upwards)?;
        for (role, points) in &kept {
            let dots = points.iter().map(|point| Circle::new(*point, px(1.4), role.light.filled()));
            chart.draw_series(dots)?;
        }
        Ok(())
    });
    let entries: Vec<_> =
        clouds.iter().map(|(role, name, _)| (Swatch::Full, *role, name.clone())).collect();
    html! { figure { (drawn) } (key(&entries)) }
}

#[cfg(test)]
mod tests;
