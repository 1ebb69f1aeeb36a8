//! Sections of a grasp and of a ground contact.

use crate::html::Section;
use crate::html::drive::{self, curves};
use crate::html::palette::{self, Role};
use crate::html::plot::{Along, Curve, Swatch, curve_figure, key};
use crate::html::tables::text_table;
use crate::text::grasp::{grasp_tables, landing_table};
use maud::{Markup, html};
use sim::closed_loop::grasp_result::{GraspResult, GraspSample, GraspTrace};
use sim::closed_loop::landing::{self, LandingResult};

pub fn title(gripped: &GraspResult) -> String {
    format!("magpie: a grasp of {} N with screw {:?}", gripped.own.target.set_n, gripped.case.lead)
}

pub fn sections(gripped: &GraspResult) -> Vec<Section> {
    vec![grasp_section(gripped), drive::assumptions_section(&gripped.assumed())]
}

pub fn landing_title(landed: &LandingResult) -> String {
    format!("magpie: ground contact with {} N", landed.landing.peak_n)
}

pub fn landing(landed: &LandingResult) -> Vec<Section> {
    vec![contact_section(landed), drive::assumptions_section(&landed.assumed())]
}

/// Time range relative to the contact in seconds.
const SHOWN_S: [f64; 2] = [-0.1, 0.7];

/// Samples within that range.
fn shown(course: &GraspTrace) -> impl Iterator<Item = &GraspSample> {
    let [from_s, to_s] = SHOWN_S;
    let last_s = course.hold_s().unwrap_or_default() + to_s;
    course.points.iter().filter(move |point| (from_s..last_s).contains(&point.time_s))
}

/// Curve over the time range in milliseconds.
fn curve(course: &GraspTrace, role: Role, of: impl Fn(&GraspSample) -> Option<f64>) -> Curve {
    let points = shown(course).filter_map(|point| Some((1e3 * point.time_s, of(point)?)));
    (role, points.collect())
}

/// Force, opening, current and state over time, and the results.
pub fn grasp_section(gripped: &GraspResult) -> Section {
    let own = &gripped.own;
    let entry = |role: Role, words: &str| (Swatch::Line, role, words.to_owned());
    let mut forces = vec![
        curve(own, palette::MUTED, |point| Some(point.set_n)),
        curve(own, palette::SECOND, |point| point.estimated_n),
        curve(own, palette::FIRST, |point| Some(point.true_n)),
    ];
    let mut names = vec![
        entry(palette::FIRST, "true force"),
        entry(palette::SECOND, "estimate of the firmware"),
        entry(palette::MUTED, "set-point"),
    ];
    let mut widths = vec![curve(own, palette::FIRST, |point| Some(point.opening_mm))];
    let mut currents = vec![curve(own, palette::FIRST, |point| Some(point.current_a))];
    if let Some(other) = &gripped.other {
        forces.push(curve(other, palette::THIRD, |point| Some(point.true_n)));
        widths.push(curve(other, palette::THIRD, |point| Some(point.opening_mm)));
        currents.push(curve(other, palette::THIRD, |point| Some(point.current_a)));
        names.push(entry(palette::THIRD, "with a current limit only"));
    }
    let across = "time since the contact in ms";
    let [figures, states] = grasp_tables(gripped);
    let body = html! {
        p { (gripped.sentence()) }
        (key(&names))
        div.pair {
            (curves("Force over time.", (across, "force, N"), &forces))
            (curves("Opening over time.", (across, "opening, mm"), &widths))
            (curves("Motor current over time.", (across, "current, A"), &currents))
            (state_plot(own, across))
        }
        (text_table("States of the firmware", &states))
        (text_table("This grasp", &figures))
        @if gripped.other.is_some() {
            p.note { "A current limit bounds the static torque. The impact force at the contact results from the rotor's \
                kinetic energy, which a current limit does not bound: a self-locking screw retains all of it." }
        }
    };
    Section { id: "grasp", heading: "Grasp".to_owned(), body }
}

/// The states by name, in the order in which they first occur.
fn state_plot(course: &GraspTrace, across: &str) -> Markup {
    let mut names: Vec<String> = Vec::new();
    for state in shown(course).filter_map(|point| point.state) {
        let name = GraspResult::state_name(state);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let place = |point: &GraspSample| {
        let name = GraspResult::state_name(point.state?);
        Some(names.iter().position(|own| *own == name)? as f64)
    };
    let states = curve(course, palette::FIRST, place);
    let across = Along::holding(across, states.1.iter().map(|point| point.0));
    curve_figure("State over time.", &across, &Along::names(names), &[states])
}

/// Forces, contacts and centre of pressure.
pub fn contact_section(landed: &LandingResult) -> Section {
    let curve = |role: Role, of: &dyn Fn(&landing::LandingSample) -> Option<f64>| -> Curve {
        let points = landed.points.iter();
        let points = points.filter_map(|point| Some((1e3 * point.time_s, of(point)?)));
        (role, points.collect())
    };
    let entry = |role: Role, words: &str| (Swatch::Line, role, words.to_owned());
    let across = "time since the contact in ms";
    let body = html! {
        p { (landed.sentence()) }
        (key(&[
            entry(palette::FIRST, "true force"),
            entry(palette::SECOND, "estimate"),
            entry(palette::THIRD, "one fingertip, peak of the last 10 ms"),
        ]))
        div.pair {
            (curves("Ground force over time.", (across, "force, N"), &[
                curve(palette::THIRD, &|point| Some(point.peak_n)),
                curve(palette::SECOND, &|point| Some(point.estimated_n)),
                curve(palette::FIRST, &|point| Some(point.true_n)),
            ]))
            (curves("Centre of pressure over time.", (across, "along the fingers, mm"),
                &[curve(palette::SECOND, &|point| (point.contacts != 0).then_some(point.along_mm))]))
            (curves("Centre of pressure over time.", (across, "across the fingers, mm"),
                &[curve(palette::SECOND, &|point| (point.contacts != 0).then_some(point.across_mm))]))
            (curves("Fingertips in contact over time.", (across, "fingertips in contact"),
                &[curve(palette::FIRST, &|point| Some(f64::from(point.contacts.count_ones())))]))
        }
        (text_table("Ground contact", &landing_table(landed)))
        p.note { "Each point is at the time of its sample: between two samples a short impact is higher than \
            either. Where the landing is harder than the acceleration's sensor tells, the fingertips' own inertia is \
            not compensated completely, and the force is overestimated." }
    };
    Section { id: "landing", heading: "Ground contact".to_owned(), body }
}
