//! A grasp over time, and another way of controlling it beside.

use maud::{Markup, html};

use crate::drive::course::{Course, Point};
use crate::drive::gripped::Gripped;
use crate::report::Section;
use crate::report::drive::{Curve, curves};
use crate::report::numbers::number;
use crate::report::palette::{self, Role};
use crate::report::plot::{Swatch, key};
use crate::report::tables::table;

/// What is shown before the contact, and after it, in s.
const SHOWN_S: [f64; 2] = [-0.1, 0.7];

/// Points of a course that are shown, in milliseconds.
fn curve(course: &Course, role: Role, of: impl Fn(&Point) -> Option<f64>) -> Curve {
    let [from_s, to_s] = SHOWN_S;
    let last_s = course.hold_s().unwrap_or_default() + to_s;
    let shown = course.points.iter();
    let shown = shown.filter(|point| (from_s..last_s).contains(&point.time_s));
    let points = shown.filter_map(|point| Some((1e3 * point.time_s, of(point)?)));
    (role, points.collect())
}

/// Force, width, current and state, and the figures.
pub fn section(gripped: &Gripped) -> Section {
    let own = &gripped.own;
    let entry = |role: Role, words: &str| (Swatch::Line, role, words.to_owned());
    let mut forces = vec![
        curve(own, palette::MUTED, |point| Some(point.set_n)),
        curve(own, palette::SECOND, |point| point.told_n),
        curve(own, palette::FIRST, |point| Some(point.true_n)),
    ];
    let mut names = vec![
        entry(palette::FIRST, "between the fingers"),
        entry(palette::SECOND, "as the firmware is told"),
        entry(palette::MUTED, "asked for"),
    ];
    let mut widths = vec![curve(own, palette::FIRST, |point| Some(point.opening_mm))];
    let mut currents = vec![curve(own, palette::FIRST, |point| Some(point.current_a))];
    if let Some(other) = &gripped.other {
        forces.push(curve(other, palette::THIRD, |point| Some(point.true_n)));
        widths.push(curve(other, palette::THIRD, |point| Some(point.opening_mm)));
        currents.push(curve(other, palette::THIRD, |point| Some(point.current_a)));
        names.push(entry(
            palette::THIRD,
            "with nothing but a bound of the current",
        ));
    }
    let across = "time since the contact in ms";
    let body = html! {
        p { (gripped.sentence()) }
        (key(&names))
        div.pair {
            (curves("The force over time.", (across, "force, N"), &forces))
            (curves("The opening over time.", (across, "opening, mm"), &widths))
            (curves("The motor's current over time.", (across, "current, A"), &currents))
            (curves("The state over time, as a number.", (across, "state"), &[state(own)]))
        }
        (table("States of the firmware", &["number", "state", "from, ms"], states(gripped)))
        (figures(gripped))
        @if gripped.other.is_some() {
            p.note { "A bound of the current bounds the torque at rest. What presses at the contact is the rotor's \
                kinetic energy, of which the current knows nothing: on a screw that locks itself all of it stays." }
        }
    };
    Section {
        id: "grasp",
        heading: "The grasp".to_owned(),
        body,
    }
}

fn state(course: &Course) -> Curve {
    curve(course, palette::FIRST, |point| {
        let (power, task) = point.state?;
        Some(f64::from(firmware::grip::states::code(power, task)))
    })
}

fn states(gripped: &Gripped) -> Vec<Vec<Markup>> {
    let row = |(time_s, power, task): (f64, _, _)| {
        vec![
            html! { (firmware::grip::states::code(power, task)) },
            html! { (Gripped::state_name((power, task))) },
            html! { (number(1e3 * time_s)) },
        ]
    };
    gripped.own.states().into_iter().map(row).collect()
}

fn figures(gripped: &Gripped) -> Markup {
    let other = gripped.other.as_ref().map(Gripped::figures);
    let mut heads = vec!["figure", "this grasp", "unit"];
    heads.extend(other.as_ref().map(|_| "current limit"));
    let rows = Gripped::figures(&gripped.own).into_iter().enumerate();
    let rows = rows.map(|(index, (name, value, unit))| {
        let mut row = vec![
            html! { (name) },
            html! { (number(value)) },
            html! { (unit) },
        ];
        let beside = other.as_ref().and_then(|other| other.get(index));
        row.extend(beside.map(|(_, value, _)| html! { (number(*value)) }));
        row
    });
    table("This grasp", &heads, rows)
}
