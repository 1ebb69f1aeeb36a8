//! A landing over time: the ground's force, the peak that is kept, where it pushes.

use maud::html;

use crate::drive::landing::{Landed, Point};
use crate::report::Section;
use crate::report::drive::{Curve, curves};
use crate::report::numbers::number;
use crate::report::palette::{self, Role};
use crate::report::plot::{Swatch, key};
use crate::report::tables::table;

/// Forces, contacts and the centre of pressure.
pub fn section(landed: &Landed) -> Section {
    let curve = |role: Role, of: &dyn Fn(&Point) -> Option<f64>| -> Curve {
        let points = landed.points.iter();
        let points = points.filter_map(|point| Some((1e3 * point.time_s, of(point)?)));
        (role, points.collect())
    };
    let entry = |role: Role, words: &str| (Swatch::Line, role, words.to_owned());
    let rows = landed
        .figures()
        .into_iter()
        .map(|(name, [told, is], unit)| {
            vec![
                html! { (name) },
                html! { (number(told)) },
                html! { (number(is)) },
                html! { (unit) },
            ]
        });
    let across = "time since the touch in ms";
    let body = html! {
        p { (landed.sentence()) }
        (key(&[
            entry(palette::FIRST, "of the ground"),
            entry(palette::SECOND, "as it is told"),
            entry(palette::THIRD, "on one fingertip, the peak of the last 10 ms"),
        ]))
        div.pair {
            (curves("The ground's force over time.", (across, "force, N"), &[
                curve(palette::THIRD, &|point| Some(point.held_n)),
                curve(palette::SECOND, &|point| Some(point.told_n)),
                curve(palette::FIRST, &|point| Some(point.true_n)),
            ]))
            (curves("Where the ground pushes, over time.", (across, "along the fingers, mm"),
                &[curve(palette::SECOND, &|point| (point.contacts != 0).then_some(point.along_mm))]))
            (curves("Fingertips that stand, over time.", (across, "fingertips that stand"),
                &[curve(palette::FIRST, &|point| Some(f64::from(point.contacts.count_ones())))]))
        }
        (table("This landing", &["figure", "told", "true", "unit"], rows))
        p.note { "Each point stands at the time of its sample: between two samples a short impact is higher than \
            either. Where the landing is harder than the acceleration's sensor tells, the fingertips' own inertia is \
            not taken off whole, and the force is told too high." }
    };
    Section {
        id: "landing",
        heading: "The landing".to_owned(),
        body,
    }
}
