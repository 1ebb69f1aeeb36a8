//! JSON of an import and of a proposed mapping.

use std::path::Path;

use analysis::import::ImportedCampaign;
use model_export::recordings::guess::Proposal;
use serde_json::{Value, json};

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
        "checks": proposal.checks,
        "ignored": ignored.collect::<Vec<_>>(),
    })
}
