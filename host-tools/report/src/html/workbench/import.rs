//! The page on which tables of other programs become a campaign: a mapping as a form, with the values of each column.

use std::fmt::Write as _;

use analysis::import::ImportedCampaign;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use model_export::recordings::columns::COVARIATES;
use model_export::recordings::description::{MagnetShape, NominalDesign};
use model_export::recordings::guess::{SourceColumn, Survey};
use model_export::recordings::mapping::{ColumnMapping, Mapping, TableMapping};
use model_export::recordings::units::{UNITS, column_unit, round_significant};
use serde_json::{Value, json};

use crate::html::head;
use crate::text::notes;

/// What the form shows at first.
pub struct ImportForm {
    /// Paths of the sources, in their order.
    pub sources: Vec<String>,
    /// Tables of the first source, and the mapping that is proposed for them; or why they cannot be read.
    pub tables: Result<(Survey, Option<Mapping>), String>,
    /// Folder of the new campaign, and its mapping file.
    pub outputs: [String; 2],
}

/// The page; its script is the one with the `nonce`.
pub fn page(form: &ImportForm, nonce: &str) -> String {
    let sources = form.sources.join(", ");
    let style = html! { style { (PreEscaped(include_str!("import.css"))) } };
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("magpie workbench: import of {sources}"), style))
            body { main {
                h1 { "Workbench: import of " (sources) }
                @match &form.tables {
                    Err(error) => {
                        pre #error role="alert" { (error) }
                        p { "Correct the file, then load this page again." }
                    }
                    Ok((survey, mapping)) => (body(form, survey, mapping.as_ref())),
                }
            } script nonce=(nonce) { (PreEscaped(include_str!("import.js"))) } }
        }
    };
    page.into_string()
}

/// An import as the page shows it; `next` are the outputs of another one.
pub fn imported(imported: &ImportedCampaign, next: &[String; 2]) -> Value {
    let rows = imported.recordings.iter().map(|one| one.rows);
    let [board, force, measured] =
        rows.fold([0; 3], |[a, b, c], one| [a + one.0, b + one.1, c + one.2]);
    let (count, folder) = (imported.recordings.len(), imported.campaign.folder.display());
    let mut text = format!(
        "{folder}: {count} recordings, {board} rows of the board, {force} of the reference, {measured} with a force."
    );
    let mut remarks = notes::texts(&imported.notes);
    if let Some(error) = &imported.fit_error {
        remarks.insert(0, format!("a fit will refuse these recordings: {error}"));
    }
    if imported.is_refused() {
        text += " Correct what the notes name, and import again to another folder.";
    }
    json!({ "text": text, "notes": remarks, "is_refused": imported.is_refused(), "next": next })
}

fn body(form: &ImportForm, survey: &Survey, mapping: Option<&Mapping>) -> Markup {
    let design = mapping.and_then(|mapping| mapping.design.as_ref());
    let checks = survey.proposal.as_ref().map_or(&[][..], |proposal| &proposal.checks);
    let names: Vec<&str> = columns(survey).map(|(_, column)| column.name.as_str()).collect();
    // Those of columns are next to them.
    let general =
        || checks.iter().filter(|check| !check.about.iter().any(|name| names.contains(&&**name)));
    let starts = mapping.map_or_else(String::new, |mapping| list(mapping.starts_s.iter().copied()));
    let is_one_clock = mapping.is_some_and(|mapping| mapping.one_clock);
    let times = if is_one_clock {
        "one_clock"
    } else {
        ["stated", "unknown"][usize::from(starts.is_empty())]
    };
    html! {
        pre #error role="alert" {}
        section #result hidden {
            h2 { "Campaign" }
            p #imported role="status" {}
            ul.note #notes {}
            button #open type="button" { "Open the workbench" }
        }
        @if let Err(error) = &survey.proposal {
            p.doubt { "No mapping is proposed: " (error) ". Or choose the meaning of each column here." }
        }
        form #form novalidate {
            section {
                h2 { "Recordings" }
                ul.doubts { @for check in general() { li.doubt { (check) } } }
                div.fields {
                    (text("description", "What was recorded", mapping.map_or("", |one| &one.description)))
                    label { "Starts of the recordings" select name="times" {
                        (option("unknown", "not known: assumed end to end", times))
                        (option("one_clock", "measured: one running clock", times))
                        (option("stated", "stated in seconds", times))
                    } }
                    (text("starts_s", "Starts, s: 0, 60, 120", &starts))
                    (number("range_gauss", "Full scale of the sensor, G (optional)", mapping.and_then(|one| one.range_gauss), false))
                    (number("gauss_per_lsb", "Scale of raw counts, G per count", mapping.and_then(|one| one.gauss_per_lsb), false))
                }
                div.pair {
                    (clock("hall", "Clock of the field", survey, mapping.map(|one| &one.hall)))
                    (clock("force", "Clock of the force", survey, mapping.map(|one| &one.force)))
                }
            }
            section {
                h2 { "Columns" }
                p.note { "x is lateral (grasping), y across the gap, z longitudinal. The plots show the first " (rows(survey)) " rows of the first recording." }
                ul #columns {
                    @for (file, column) in columns(survey) { (meanings(file, column, survey, mapping)) }
                    (unexamined(survey, mapping))
                }
                @let unread: Vec<_> = unread(survey);
                @if !unread.is_empty() { p.note { "Without numbers: " (unread.join(", ")) "." } }
            }
            (geometry(design))
            section {
                h2 { "Import" }
                div.fields {
                    (text("campaign", "New folder of the campaign", &form.outputs[0]))
                    (text("mapping", "New file of the mapping", &form.outputs[1]))
                }
                button #import type="submit" { "Import" }
                p #progress role="status" {}
                details { summary { "The same on the command line" } pre #commands data-sources=(shell_words::join(&form.sources)) {} }
                details { summary { "Mapping file" } pre #text {} }
            }
        }
    }
}

fn list(values: impl Iterator<Item = f64>) -> String {
    values.map(|value| value.to_string()).collect::<Vec<_>>().join(", ")
}

fn rows(survey: &Survey) -> u64 {
    survey.tables.iter().map(|table| table.rows).max().unwrap_or(0)
}

/// Columns with numbers, and the name of their file where a folder has several.
fn columns(survey: &Survey) -> impl Iterator<Item = (String, &SourceColumn)> {
    survey.tables.iter().flat_map(|table| {
        let name = table.path.file_name().unwrap_or_default().to_string_lossy();
        let file = if table.is_in_folder { name.into_owned() } else { String::new() };
        let numeric = table.columns.iter().filter(|column| column.is_numeric());
        numeric.map(move |column| (file.clone(), column))
    })
}

/// Other columns, with the reason.
fn unread(survey: &Survey) -> Vec<String> {
    let all = survey.tables.iter().flat_map(|table| &table.columns);
    let texts = all.filter(|column| !column.is_numeric());
    texts.map(|column| format!("{} ({})", column.name, column.text_reason())).collect()
}

fn option(value: &str, words: &str, selected: &str) -> Markup {
    html! { option value=(value) selected[value == selected] { (words) } }
}

fn text(name: &str, words: &str, value: &str) -> Markup {
    html! { label { (words) input type="text" name=(name) value=(value) spellcheck="false" autocomplete="off"; } }
}

fn number(name: &str, words: &str, value: Option<f64>, required: bool) -> Markup {
    html! { label { (words) input type="number" step="any" name=(name) value=[value] required[required]; } }
}

fn clock(side: &str, words: &str, survey: &Survey, table: Option<&TableMapping>) -> Markup {
    let clock = table.map(|table| &table.clock);
    let from = clock.map_or("", |clock| &clock.from);
    let file = table.and_then(|table| table.file.as_deref()).unwrap_or("");
    let mut files: Vec<String> = columns(survey).map(|(file, _)| file).collect();
    files.dedup();
    let mut names: Vec<&str> = columns(survey).map(|(_, column)| column.name.as_str()).collect();
    names.extend((!from.is_empty()).then_some(from));
    names.sort_unstable();
    names.dedup();
    let offset_s = clock.map(|clock| clock.offset_s).filter(|offset_s| *offset_s != 0.0);
    html! {
        fieldset data-side=(side) data-column="clock" {
            legend { (words) }
            @if files.iter().any(|file| !file.is_empty()) {
                label { "File" select name=(format!("{side}.file")) { @for one in &files { (option(one, one, file)) } } }
            }
            label { "Column" select name=(format!("{side}.from")) {
                (option("", "none: rows at equal distances", from))
                @for name in names { (option(name, name, from)) }
            } }
            label.of-column { "Unit" select name=(format!("{side}.unit")) required {
                option value="" { "choose" }
                @for unit in UNITS.iter().filter(|unit| unit.canonical == "us") { (option(unit.name, unit.name, clock.map_or("", |clock| &clock.unit))) }
            } }
            (number(&format!("{side}.row_s"), "From row to row, s", clock.and_then(|clock| clock.row_s), true))
            (number(&format!("{side}.offset_s"), "Added to the clock, s", offset_s, false))
            label.check { input type="checkbox" name=(format!("{side}.from_first_row")) checked[clock.is_some_and(|clock| clock.from_first_row)]; " counts from its first row in each recording" }
        }
    }
}

/// Sensors that the form offers; others are written as another quantity.
const MAX_SENSORS: usize = 32;

fn tables(mapping: Option<&Mapping>) -> impl Iterator<Item = &TableMapping> {
    mapping.into_iter().flat_map(|mapping| [&mapping.hall, &mapping.force])
}

/// Number of sensors to choose from.
fn sensors(mapping: Option<&Mapping>) -> usize {
    let targets = tables(mapping).flat_map(|table| &table.columns);
    let sensors =
        targets.filter_map(|one| one.to.get(1..)?.split('_').next()?.parse::<usize>().ok());
    // The nominal gripper has four.
    sensors.max().map_or(4, |last| last.saturating_add(1).clamp(4, MAX_SENSORS))
}

/// A column that a bag's own mapping names, but whose values were not examined.
fn unexamined(survey: &Survey, mapping: Option<&Mapping>) -> Markup {
    let is_examined =
        |one: &&ColumnMapping| columns(survey).any(|(_, column)| column.name == one.from);
    let all = tables(mapping).flat_map(|table| &table.columns);
    html! {
        @for one in all.filter(|one| !is_examined(one)) {
            li.column data-from=(one.from) data-file="" {
                h3 { (one.from) span.tag {} }
                div.uses { (usage(Some(one), None, None, sensors(mapping))) }
            }
        }
    }
}

/// A column with each of its meanings.
fn meanings(
    file: String,
    column: &SourceColumn,
    survey: &Survey,
    mapping: Option<&Mapping>,
) -> Markup {
    let tables = || tables(mapping);
    let is_own = |table: &&TableMapping| table.file.as_deref().unwrap_or("") == file;
    let own = tables().filter(is_own).flat_map(|table| &table.columns);
    let own: Vec<_> = own.filter(|one| one.from == column.name).collect();
    let quaternion = tables().filter(is_own).find_map(|table| table.attitude.as_ref());
    let mut parts =
        quaternion.into_iter().flat_map(|parts| parts.columns().into_iter().zip("wxyz".chars()));
    let part =
        parts.find(|(name, _)| *name == column.name).map(|(_, part)| format!("attitude.{part}"));
    let (min, max) = column.range();
    let proposal = survey.proposal.as_ref().ok();
    let checks = proposal.into_iter().flat_map(|proposal| &proposal.checks);
    let doubts =
        checks.filter(|check| check.about.contains(&column.name)).map(|check| check.text.clone());
    let ignored = proposal.into_iter().flat_map(|proposal| &proposal.ignored);
    let reason = ignored
        .filter(|(name, _)| *name == column.name)
        .map(|(_, reason)| format!("not used: {reason}"));
    let sensors = sensors(mapping);
    html! {
        li.column data-from=(column.name) data-file=(file) {
            div.of-values {
                h3 { (column.name) span.tag {} }
                (plot(column))
                p.note { (round_significant(min, 5)) " to " (round_significant(max, 5)) @if !file.is_empty() { ", " (file) } }
            }
            div.uses {
                @if own.is_empty() { (usage(None, part.as_deref(), column.unit(), sensors)) }
                @for one in own { (usage(Some(one), None, None, sensors)) }
                button.again type="button" { "Another meaning" }
                @for doubt in doubts.chain(reason) { p.doubt { (doubt) } }
            }
        }
    }
}

fn usage(
    mapped: Option<&ColumnMapping>,
    part: Option<&str>,
    stated: Option<&str>,
    sensors: usize,
) -> Markup {
    // Counts and gauss are one meaning in two units.
    let to = mapped
        .map(|one| one.to.replace("_lsb", "_gauss"))
        .or(part.map(str::to_owned))
        .unwrap_or_default();
    let unit = mapped.map(|one| one.unit.as_str()).or(stated).unwrap_or("");
    let mut groups: Vec<(&str, Vec<(String, String)>)> =
        vec![("Field", vec![]), ("Force", vec![]), ("Temperature", vec![])];
    for sensor in 0..sensors {
        for axis in ["x", "y", "z"] {
            groups[0].1.push((
                format!("s{sensor}_{axis}_gauss"),
                format!("field {axis}, sensor {sensor}"),
            ));
        }
        for axis in ["x", "z"] {
            groups[1]
                .1
                .push((format!("f{sensor}_{axis}_n"), format!("force {axis}, sensor {sensor}")));
        }
        groups[2].1.push((format!("s{sensor}_temp_c"), format!("temperature, sensor {sensor}")));
    }
    groups.push((
        "Gripper",
        COVARIATES.iter().map(|name| ((*name).to_owned(), (*name).to_owned())).collect(),
    ));
    let parts =
        ["w", "x", "y", "z"].map(|part| (format!("attitude.{part}"), format!("quaternion {part}")));
    groups.push(("Attitude, body to world", parts.to_vec()));
    let is_listed = groups.iter().flat_map(|group| &group.1).any(|(name, _)| *name == to);
    let is_other = !to.is_empty() && !is_listed;
    let scale = mapped.map_or(1.0, |one| one.scale);
    html! {
        div.use {
            label { "Meaning" select.to {
                (option("", "not used", if is_other { "other" } else { &to }))
                @for (group, names) in &groups {
                    optgroup label=(group) { @for (name, words) in names {
                        @let label = if words.contains(',') { format!("{words} ({name})") } else { words.clone() };
                        option value=(name) data-of=[column_unit(name)] selected[*name == to] { (label) }
                    } }
                }
                (option("other", "another quantity, for formulas", if is_other { "other" } else { "" }))
            } }
            label.name { "Name with unit, as in humidity_percent" input.other type="text" value=[is_other.then_some(&to)] spellcheck="false" required; }
            label.of-use { "Unit" select.unit required {
                option value="" { "choose" }
                @for one in UNITS.iter().filter(|one| one.canonical != "us") { option value=(one.name) data-of=(one.canonical) selected[one.name == unit] { (one.name) } }
            } }
            label.of-use { "Scale; -1 inverts" input.factor type="number" step="any" value=(scale) required; }
            label.missing { "Code of missing values" input.code type="number" step="any" value=[mapped.and_then(|one| one.missing)]; }
        }
    }
}

/// Size of a plot in units of its drawing.
const PLOT: (f64, f64) = (240.0, 48.0);

fn plot(column: &SourceColumn) -> Markup {
    let stretches = &column.trace.stretches;
    let (low, high) =
        stretches.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), one| {
            (low.min(one.0), high.max(one.1))
        });
    let step = PLOT.0 / stretches.len().max(1) as f64;
    let span = high - low;
    let has_span = span > 0.0 && span.is_finite();
    let y = |value| if has_span { 2.0 + (PLOT.1 - 4.0) * (high - value) / span } else { 24.0 };
    let mut path = String::new();
    for (i, (min, max)) in stretches.iter().enumerate() {
        let start = if i == 0 { 'M' } else { 'L' };
        let _ = write!(path, "{start}{:.1} {:.1}V{:.1}", step * (i as f64 + 0.5), y(*min), y(*max));
    }
    html! {
        svg.plot viewBox=(format!("0 0 {} {}", PLOT.0, PLOT.1)) preserveAspectRatio="none" role="img" aria-label=(format!("Values of {}", column.name)) {
            path d=(path) {}
        }
    }
}

fn geometry(design: Option<&NominalDesign>) -> Markup {
    let magnet = design.map(|design| &design.magnet);
    let shape = magnet.map(|magnet| magnet.shape);
    let (kind, [diameter, hole, length, side]) = match shape {
        Some(MagnetShape::Tube { diameter_mm, hole_mm, length_mm }) => {
            ("tube", [Some(diameter_mm), Some(hole_mm), Some(length_mm), None])
        }
        Some(MagnetShape::Cube { side_mm }) => ("cube", [None, None, None, Some(side_mm)]),
        Some(MagnetShape::Sphere { diameter_mm }) => {
            ("sphere", [Some(diameter_mm), None, None, None])
        }
        Some(MagnetShape::Cylinder { diameter_mm, length_mm }) => {
            ("cylinder", [Some(diameter_mm), None, Some(length_mm), None])
        }
        None => ("cylinder", [None; 4]),
    };
    let axes = ["x", "y", "z"];
    let letter = |axis| axes[axis as usize];
    let axis = magnet.map_or("y", |magnet| letter(magnet.axis));
    let body_axis = magnet.and_then(|magnet| magnet.body_axis).map_or("", letter);
    // Keys that the form does not have.
    let more = design.map_or_else(String::new, |design| {
        let sensors =
            design.sensors.map_or_else(String::new, |sensors| format!("sensors = {sensors}\n"));
        design.more.iter().fold(sensors, |text, (key, value)| format!("{text}{key} = {value}\n"))
    });
    let base = if design.is_some() { "known" } else { "unknown" };
    html! {
        section {
            h2 { "Geometry" }
            label { "The fit begins with " select name="geometry" {
                (option("unknown", "polynomials: the geometry is not known", base))
                (option("known", "the nominal geometry below", base))
            } }
            div #geometry.pair {
                figure { (PreEscaped(DRAWING)) figcaption.note { "Unloaded. x is the lateral (grasping) motion of the magnet, z the longitudinal one, y is across the gap." } }
                div.fields {
                    (number("gap_mm", "Gap, mm: magnet to Hall element", design.map(|one| one.gap_mm), true))
                    (number("stiffness_x_n_per_mm", "Lateral stiffness x, N/mm", design.map(|one| one.stiffness_x_n_per_mm), true))
                    (number("stiffness_z_n_per_mm", "Longitudinal stiffness z, N/mm", design.map(|one| one.stiffness_z_n_per_mm), true))
                    (number("force_range_n", "Largest force of an axis, N", design.and_then(|one| one.force_range_n), true))
                    label { "Magnet" select name="shape" { @for one in ["cylinder", "tube", "cube", "sphere"] { (option(one, one, kind)) } } }
                    (number("diameter_mm", "Diameter, mm", diameter, true))
                    (number("hole_mm", "Diameter of the hole, mm", hole, true))
                    (number("length_mm", "Length, mm", length, true))
                    (number("side_mm", "Edge, mm", side, true))
                    (number("remanence_t", "Remanence, T (negative: reversed)", magnet.map(|one| one.remanence_t), true))
                    label { "Magnetised along" select name="axis" { @for one in axes { (option(one, one, axis)) } } }
                    label.body { "Axis of the body" select name="body_axis" { (option("", "as magnetised", body_axis)) @for one in axes { (option(one, one, body_axis)) } } }
                    textarea name="more" aria-label="Further keys of the design" hidden { (more) }
                }
            }
        }
    }
}

/// Magnet on its flexures above the Hall element.
const DRAWING: &str = include_str!("geometry.svg");
