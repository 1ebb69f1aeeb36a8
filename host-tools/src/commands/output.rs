//! What several commands print on stderr.

use analysis::notes::Note;
use firmware::sensors::hall::SENSORS;
use model_export::inverse::build::{DeviceModel, ExportHeader};

/// Prints notes on stderr.
pub fn print_notes(notes: &[Note]) {
    for note in report::text::notes::texts(notes) {
        eprintln!("note: {note}");
    }
}

/// Refuses a model with an effect that the device never compensates; `command` can override that.
///
/// # Errors
/// There is one; the error has the reason.
pub fn check_compensated(built: &DeviceModel, command: &str) -> anyhow::Result<()> {
    let remedy = format!(
        "remove it from the model (`cargo magpie remove`), or {command} with --uncompensated"
    );
    analysis::notes::check_compensated(built, &remedy)
}

/// Prints on stderr under which conditions the board compensates the effects of a model.
pub fn print_conditions(built: &DeviceModel) {
    if let Some(state) = &built.header.valid_from {
        eprintln!(
            "note: the tables hold the gripper's state of {state}: calibrate again after further changes"
        );
    }
    for (effect, conditions) in &built.conditions {
        eprintln!("note: the board compensates {effect} {}", conditions.join("; "));
    }
}

/// States that the board reads sensors that the tables do not have.
pub fn print_missing_sensors(header: &ExportHeader) {
    let image: Vec<u32> = (0..SENSORS as u32).collect();
    if header.sensors != image {
        eprintln!(
            "note: the board reads sensors {image:?}, these tables have {:?}: it reports the forces of the others as missing",
            header.sensors
        );
    }
}
