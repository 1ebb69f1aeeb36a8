//! The sections of a run of the drive.
//!
//! - [`over_time`]: place, speed, current and voltage.
//! - [`answers`]: the current loop's step and frequency response, and a step of the place.
//! - [`assumed`]: the constants that all of it rests on.

pub mod answers;
pub mod assumed;
pub mod over_time;

use maud::{Markup, html};
use plotters::prelude::*;

use super::Section;
use super::palette::Role;
use super::plot::{Along, HALF, axes, figure, stroke};
use crate::drive::told::Told;

/// The page's heading.
pub fn title(told: &Told) -> String {
    format!("magpie: the drive with screw {:?}", told.case.lead)
}

/// All of them.
pub fn sections(told: &Told) -> Vec<Section> {
    vec![
        over_time::section(told),
        answers::current(told),
        answers::place(told),
        assumed::section(&told.assumed()),
    ]
}

/// A curve: its colour, and its points.
pub(super) type Curve = (Role, Vec<(f64, f64)>);

/// Points of a curve at most; about two for each pixel.
const POINTS: usize = 900;

/// Curves over one axis.
pub(super) fn curves(says: &str, (across, upwards): (&str, &str), curves: &[Curve]) -> Markup {
    let all = || curves.iter().flat_map(|(_, points)| points);
    let across = Along {
        labels: 5,
        ..Along::holding(across, all().map(|point| point.0))
    };
    let upwards = Along::holding(upwards, all().map(|point| point.1));
    let drawn = figure(HALF, says, |paper| {
        let mut chart = axes(paper, &across, &upwards)?;
        for (role, points) in curves {
            let every = points.len().div_ceil(POINTS).max(1);
            let thinned: Vec<_> = points.iter().copied().step_by(every).collect();
            chart.draw_series([PathElement::new(thinned, stroke(*role, 1.5))])?;
        }
        Ok(())
    });
    html! { figure { (drawn) } }
}
