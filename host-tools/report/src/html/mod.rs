//! HTML pages: one self-contained file per result.
//!
//! - [`palette`]: colours for light and dark mode. [`plot`]: common parts of all plots.
//! - [`summary`]: verdict, error scale, setup errors, provenance.
//! - [`errors`] and [`tables`]: errors by sensor; [`histograms`]: distribution of the errors.
//! - [`traces`]: measured and modelled values over time; [`pack`]: their curves for the page's script.
//! - [`attribution`], [`map`]: dependence of the error on covariates.
//! - [`parameters`]: fitted parameters with errors and correlations.
//! - [`diagnosis`]: sections of a diagnosis.
//! - [`design`]: sections of sensor designs.
//! - [`drive`]: sections of a run of the drive; [`grasp`]: of a grasp and of a ground contact.
//! - [`workbench`]: the page of the workbench, which is served and not written.
//!
//! Plots are rendered to inline SVG; the page's script only zooms and switches between sensors.

pub mod attribution;
pub mod design;
pub mod diagnosis;
pub mod drive;
pub mod errors;
#[cfg(test)]
mod fixture;
pub mod grasp;
pub mod histograms;
pub mod map;
pub mod pack;
pub mod palette;
pub mod parameters;
pub mod plot;
pub mod summary;
pub mod tables;
pub mod traces;
pub mod workbench;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use model_export::output::Output;
use model_export::recordings::DataError;

use analysis::compare::Comparison;
use palette::Role;

/// First line of every report.
pub const MARK: &str = "<!-- report of magpie -->\n";

#[derive(Clone, Debug)]
pub struct Section {
    pub id: &'static str,
    pub heading: String,
    pub body: Markup,
}

pub fn page(comparison: &Comparison) -> String {
    page_with(comparison, &[])
}

/// Page of a comparison with additional sections after the summary.
pub fn page_with(comparison: &Comparison, more: &[Section]) -> String {
    let title = format!("magpie: {} versus {}", comparison.model, comparison.campaign);
    // With a diagnosis, the two models are those before and after what it found: their forces come first.
    let is_before_and_after = comparison.other.is_some() && !more.is_empty();
    let body = html! {
        (summary::head(comparison))
        @if !stopped(comparison) { (links(more, is_before_and_after)) }
        (summary::findings_section(comparison))
        @if stopped(comparison) {
            p.empty { "No results: fix the setup errors first." }
            @for section in more { (placed(section)) }
        } @else {
            (summary::section(comparison))
            @if is_before_and_after { (traces::section(comparison)) }
            @for section in more { (placed(section)) }
            (errors::section(comparison))
            @if !is_before_and_after { (traces::section(comparison)) }
            (histograms::section(comparison))
            (attribution::section(comparison))
            (map::section(comparison))
            (attribution::worst_section(comparison))
            (parameters::section(comparison))
        }
        (summary::provenance_section(comparison))
    };
    whole(&title, &body)
}

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

/// Head of every page; `more` follows the common style.
fn head(title: &str, more: Markup) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="color-scheme" content="light dark";
            // Browsers ask for an icon otherwise.
            link rel="icon" href="data:,";
            title { (title) }
            style { (PreEscaped(palette::style())) (PreEscaped(include_str!("page.css"))) }
            (more)
        }
    }
}

/// Frame of every page.
fn whole(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(title, html! { noscript { style { (PreEscaped(WITHOUT_SCRIPT)) } } }))
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

fn links(more: &[Section], is_before_and_after: bool) -> Markup {
    let mut places = vec![("scale", "Overall error")];
    places.extend(more.iter().map(|section| (section.id, section.heading.as_str())));
    places.push(("errors", "By sensor"));
    places.insert(if is_before_and_after { 1 } else { places.len() }, ("overlay", "Over time"));
    places.extend([
        ("histograms", "Distribution of the errors"),
        ("located", "Dependence on covariates"),
        ("map", "Map"),
        ("worst", "Worst stretches"),
        ("parameters", "Fitted parameters"),
        ("origin", "Provenance"),
    ]);
    html! {
        nav aria-label="On this page" {
            @for (place, words) in places { a href=(format!("#{place}")) { (words) } }
        }
    }
}

/// True where a setup error prevents the evaluation.
fn stopped(comparison: &Comparison) -> bool {
    comparison.axes.is_empty() && comparison.findings.iter().any(|finding| finding.stops)
}

/// Writes the page atomically.
///
/// # Errors
/// Writing failed.
pub fn write(output: &Output, comparison: &Comparison, more: &[Section]) -> Result<(), DataError> {
    output.write(page_with(comparison, more).as_bytes())
}

/// Writes a page of sections atomically.
///
/// # Errors
/// Writing failed.
pub fn write_sections(output: &Output, title: &str, sections: &[Section]) -> Result<(), DataError> {
    output.write(page_of(title, sections).as_bytes())
}

/// Without a script all sensors are visible, each with its name.
const WITHOUT_SCRIPT: &str =
    ".of-sensor[hidden]{display:block!important}.static-only{display:inline}";

/// Model and baseline, if any: colour, letter where there are two, results.
fn both(comparison: &Comparison) -> Vec<(Role, &'static str, &Comparison)> {
    match comparison.other.as_deref() {
        None => vec![(palette::FIRST, "", comparison)],
        Some(other) => vec![(palette::FIRST, "A", comparison), (palette::SECOND, "B", other)],
    }
}

/// Sensor with the largest RMS error over its axes.
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
