//! The report: one HTML file that shows all that a [`Comparison`] knows, with nothing to fetch.
//!
//! - [`palette`]: colours, in the light and in the dark.
//! - [`plot`]: what every plot shares.
//! - [`numbers`]: numbers as they are written.
//! - [`summary`]: the verdict, and all errors on one scale; [`findings`]: mistakes of the rig.
//! - [`errors`] and [`tables`]: the errors by sensor; [`histograms`]: how often each size occurs.
//! - [`overlay`]: measured and modelled over time; [`pack`]: its curves for the page's script.
//! - [`located`], [`map`], [`worst`]: where the error lies.
//! - [`diagnosis`]: the sections of a diagnosis.
//! - [`design`]: the sections of designs.
//! - [`drive`]: the sections of a run of the drive; [`grasp`]: of a grasp, and of a landing; [`faults`]: of a
//!   campaign of faults.
//! - [`training`]: the sections of a comparison of networks.
//! - [`origin`]: where all this comes from.
//!
//! The plots are drawn here and stand in the page as SVG; its script only zooms and switches.

pub mod design;
pub mod diagnosis;
pub mod drive;
pub mod errors;
pub mod faults;
pub mod findings;
#[cfg(test)]
mod fixture;
pub mod grasp;
pub mod histograms;
pub mod located;
pub mod map;
pub mod numbers;
pub mod origin;
pub mod overlay;
pub mod pack;
pub mod palette;
pub mod plot;
pub mod summary;
pub mod tables;
pub mod training;
pub mod worst;

use std::path::Path;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use model_export::output::write_output;
use model_export::recordings::Problem;

use crate::compare::Comparison;
use palette::Role;

/// First line of every report: a file that begins otherwise is somebody else's, and is not replaced.
pub const MARK: &str = "<!-- report of magpie -->\n";

/// A section that another command adds to the page.
#[derive(Clone, Debug)]
pub struct Section {
    /// Where links find it.
    pub id: &'static str,
    /// Its heading.
    pub heading: String,
    /// What stands below.
    pub body: Markup,
}

/// The whole page.
pub fn page(comparison: &Comparison) -> String {
    page_with(comparison, &[])
}

/// The whole page with more sections, which stand first after the summary: they say what to do.
pub fn page_with(comparison: &Comparison, more: &[Section]) -> String {
    let title = format!(
        "magpie: {} beside {}",
        comparison.model, comparison.campaign
    );
    let body = html! {
        (summary::head(comparison))
        @if !stopped(comparison) { (links(more)) }
        (findings::section(comparison))
        @if stopped(comparison) {
            p.empty { "No figures: none would mean anything before this is mended." }
            @for section in more { (placed(section)) }
        } @else {
            (summary::section(comparison))
            @for section in more { (placed(section)) }
            (errors::section(comparison))
            (overlay::section(comparison))
            (histograms::section(comparison))
            (located::section(comparison))
            (map::section(comparison))
            (worst::section(comparison))
        }
        (origin::section(comparison))
    };
    whole(&title, &body)
}

/// A page of nothing but sections, each behind a link.
pub fn page_of(title: &str, sections: &[Section]) -> String {
    let body = html! {
        h1 { (title) }
        nav aria-label="On this page" {
            @for section in sections { a href=(format!("#{}", section.id)) { (section.heading) } }
        }
        @for section in sections { (placed(section)) }
    };
    whole(title, &body)
}

/// What every page is around its body.
fn whole(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                // Browsers ask for an icon otherwise.
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(palette::style())) (PreEscaped(include_str!("page.css"))) }
                noscript { style { (PreEscaped(WITHOUT_SCRIPT)) } }
            }
            body {
                main { (body) }
                script { (PreEscaped(include_str!("page.js"))) }
            }
        }
    };
    MARK.to_owned() + &page.into_string()
}

fn placed(section: &Section) -> Markup {
    html! { section id=(section.id) { h2 { (section.heading) } (section.body) } }
}

/// Where things are on a long page.
fn links(more: &[Section]) -> Markup {
    let more = more.iter().map(|s| (s.id, s.heading.as_str()));
    let first = std::iter::once(("scale", "How good it is")).chain(more);
    let places = [
        ("errors", "By sensor"),
        ("overlay", "Over time"),
        ("histograms", "Sizes of errors"),
        ("located", "Where the error lies"),
        ("map", "Map"),
        ("worst", "Worst stretches"),
        ("origin", "Origin"),
    ];
    html! {
        nav aria-label="On this page" {
            @for (place, words) in first.chain(places) { a href=(format!("#{place}")) { (words) } }
        }
    }
}

/// A mistake of the rig kept everything else from being judged.
fn stopped(comparison: &Comparison) -> bool {
    comparison.axes.is_empty() && comparison.findings.iter().any(|finding| finding.stops)
}

/// Writes the page to `path`, complete or not at all.
///
/// # Errors
/// A file that is no report stands there, or the file system refuses.
pub fn write(path: &Path, comparison: &Comparison, more: &[Section]) -> Result<(), Problem> {
    write_output(path, page_with(comparison, more).as_bytes(), MARK)
}

/// Writes a page of sections to `path`, complete or not at all.
///
/// # Errors
/// A file that is no report stands there, or the file system refuses.
pub fn write_sections(path: &Path, title: &str, sections: &[Section]) -> Result<(), Problem> {
    write_output(path, page_of(title, sections).as_bytes(), MARK)
}

/// Without a script all sensors are shown, each with its name.
const WITHOUT_SCRIPT: &str =
    ".of-sensor[hidden]{display:block!important}.static-only{display:inline}";

/// The model, and the one beside it if there is one: colour, letter where there are two, figures.
fn both(comparison: &Comparison) -> Vec<(Role, &'static str, &Comparison)> {
    match comparison.other.as_deref() {
        None => vec![(palette::FIRST, "", comparison)],
        Some(other) => vec![
            (palette::FIRST, "A", comparison),
            (palette::SECOND, "B", other),
        ],
    }
}

/// Number of the sensor with the greatest root mean square over its axes.
fn sensor_that_errs_most(comparison: &Comparison) -> Option<u32> {
    let squares = |sensor: u32| -> f64 {
        let axes = comparison.axes.iter().filter(|a| a.sensor == sensor);
        axes.map(|a| a.error.rms * a.error.rms).sum()
    };
    let sensors = comparison.axes.iter().map(|axis| axis.sensor);
    sensors.max_by(|a, b| squares(*a).total_cmp(&squares(*b)))
}

#[cfg(test)]
mod tests;
