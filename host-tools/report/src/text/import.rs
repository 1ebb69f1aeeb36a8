//! Text and JSON of an import and of a proposed mapping.

use std::path::{Path, PathBuf};

use analysis::import::ImportedCampaign;
use model_export::recordings::guess::Proposal;
use model_export::recordings::units::round_significant;
use serde_json::{Value, json};

use crate::text::terminal;

/// The recordings, and what to do next.
pub fn format_import(imported: &ImportedCampaign, mapping: &Path, output: &Path) -> String {
    let mut table = terminal::table([
        "recording",
        "start s",
        "length s",
        "sensors",
        "board rows",
        "reference rows",
        "rows with force",
    ]);
    for (recording, converted) in imported.campaign.recordings.iter().zip(&imported.recordings) {
        let ends = recording.time_s.first().zip(recording.time_s.last());
        let (hall, force, measured) = converted.rows;
        table.add_row([
            converted.folder.display().to_string(),
            format!("{:.1}", recording.description.start_s),
            format!("{:.1}", ends.map_or(0.0, |(first, last)| last - first)),
            recording.sensors.len().to_string(),
            hall.to_string(),
            force.to_string(),
            measured.to_string(),
        ]);
    }
    terminal::right_align(&mut table, 1);
    let mut next = String::new();
    let base = if imported.campaign.design().is_some() { "" } else { " --base polynomial" };
    if !base.is_empty() {
        next += "Without [design] in the mapping the base is a polynomial of the forces; with \
                 [design] (see --help), import again and fit without --base.\n";
    }
    next += &if imported.is_refused() {
        let what = if imported.has_wrong_unit() {
            format!("units are what {} states: correct `unit` there", mapping.display())
        } else {
            format!("correct what the note names in {}", mapping.display())
        };
        format!("Next: {what}, and import again to another folder.")
    } else {
        format!("Next: cargo magpie fit {output:?}{base} -o model.toml")
    };
    format!("{table}\n{next}\n")
}

/// End of a column's range; a dash where it is not known.
fn range_end(value: f64) -> String {
    if value.is_finite() { round_significant(value, 6).to_string() } else { "-".to_owned() }
}

/// The columns, and what to check.
pub fn format_proposal(proposal: &Proposal, output: &Path, sources: &[PathBuf]) -> String {
    let mut table = terminal::table(["column", "unit", "minimum", "maximum", "becomes"]);
    for column in &proposal.columns {
        let (min, max) = column.range;
        table.add_row([
            column.from.clone(),
            column.unit.to_owned(),
            range_end(min),
            range_end(max),
            column.to.clone(),
        ]);
    }
    for column in [2, 3] {
        terminal::right_align(&mut table, column);
    }
    let mut text = format!("{table}\n");
    if !proposal.ignored.is_empty() {
        let names = proposal.ignored.iter().map(|(name, reason)| format!("{name} ({reason})"));
        text += &format!("Not imported: {}.\n", names.collect::<Vec<_>>().join(", "));
    }
    if !proposal.checks.is_empty() {
        text += "Please check in the file:\n";
    }
    for check in &proposal.checks {
        text += &format!("  - {check}\n");
    }
    let paths = std::iter::once(output).chain(sources.iter().map(PathBuf::as_path));
    let paths = shell_words::join(paths.map(|path| path.display().to_string()));
    text += &format!("Written to {}.\n", output.display());
    text + &format!("Next: cargo magpie import {paths} -o my-campaign\n")
}

/// The recordings of a new campaign.
pub fn to_json(imported: &ImportedCampaign) -> Value {
    let recordings = imported.recordings.iter().map(|recording| {
        let (hall, force, measured) = recording.rows;
        json!({ "folder": recording.folder, "hall_rows": hall, "force_rows": force, "measured_rows": measured })
    });
    json!({
        "campaign": imported.campaign.folder,
        "recordings": recordings.collect::<Vec<_>>(),
        "fit_error": imported.fit_error.as_ref().map(ToString::to_string),
    })
}

/// A proposed mapping, written to `output`.
pub fn proposal_json(proposal: &Proposal, output: &Path) -> Value {
    let columns = proposal.columns.iter().map(|column| {
        let (from, to) = column.range;
        json!({ "from": column.from, "unit": column.unit, "to": column.to, "range": [from, to] })
    });
    let ignored = proposal.ignored.iter();
    let ignored = ignored.map(|(name, reason)| json!({ "column": name, "reason": reason }));
    json!({
        "mapping": output,
        "columns": columns.collect::<Vec<_>>(),
        "checks": proposal.checks.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "ignored": ignored.collect::<Vec<_>>(),
    })
}
