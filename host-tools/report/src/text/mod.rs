//! Results as text, tables and JSON: one module for each result.

use analysis::statistics::Moments;

pub mod calibration;
pub mod causes;
pub mod comparison;
pub mod design;
pub mod design_search;
pub mod diagnosis;
#[cfg(test)]
pub mod diagnosis_fixture;
pub mod edit_model;
pub mod effects;
pub mod export;
pub mod findings;
pub mod fit;
pub mod force_error;
pub mod grasp;
pub mod import;
pub mod notes;
pub mod parameters;
pub mod recording_check;
pub mod recording_plan;
pub mod replay;
pub mod simulate;
pub mod terminal;
pub mod training;

/// Names of the two forces of a sensor: in text, in JSON.
pub const FORCES: [(&str, &str); 2] = [("Fx", "x"), ("Fz", "z")];

/// RMS to three decimals; a dash for `None`.
pub fn rms_or_dash(moments: Option<Moments>) -> String {
    let rms = moments.map(|moments| moments.rms()).filter(|rms| rms.is_finite());
    rms.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.3}"))
}
