//! Extension module of the Python package `magpie`: the library's functions over paths, and the device over arrays.
//!
//! Results cross the border as JSON, the same as `--json` of the command; `magpie/__init__.py` makes dataclasses of it.

mod calibration;
mod device;
mod gripper;
mod interrupt;

use std::path::PathBuf;

use analysis::import::ImportError;
use analysis::notes::{ErrorWithNotes, Note};
use model_export::fit::FitError;
use model_export::inverse::build::BuildError;
use model_export::recordings::DataError;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyString;
use pyo3::{PyTypeInfo, create_exception};
use report::text::notes;
use serde_json::{Value, json};

create_exception!(
    magpie,
    MagpieError,
    PyValueError,
    "Input that cannot be used, with the remedy. Attributes: file, line and column where known (else None), notes."
);

/// Texts of the commands, with options, and the same with arguments of the functions; longer ones first.
const ARGUMENTS: [(&str, &str); 26] = [
    (
        "add it to recording.toml or to the mapping of the import",
        "give design= to Campaign.from_arrays or Campaign.from_files, or add it to recording.toml or to the mapping of the import",
    ),
    ("--base polynomial", "base=\"polynomial\""),
    ("--delay-ms ", "delay_ms="),
    ("--delay-ms", "delay_ms"),
    ("--degree", "degree"),
    ("--expr", "exprs"),
    ("--range ", "ranges: "),
    ("--network", "network"),
    ("--hold-out", "hold_out"),
    ("--hidden", "hidden"),
    ("--seed", "seed"),
    ("--epochs", "epochs"),
    ("--patience", "patience"),
    ("--rate", "rate"),
    ("--zero-weight", "zero_weight"),
    ("without --resume", "with another checkpoint"),
    ("--clear-faults", "clear_faults=True"),
    ("--force", "force_n"),
    ("--home", "home=True"),
    ("--key FILE", "key="),
    ("--position", "position_mm"),
    ("--profile", "profile"),
    ("--release", "opening_mm"),
    ("--speed", "speed_mm_s"),
    ("--uncalibrated", "uncalibrated=True"),
    ("--width", "width"),
];

/// An error's text with arguments in place of options, except in commands (`` `cargo ...` ``).
fn with_arguments(text: &str) -> String {
    let replace = |part: &str| {
        let replaced = |text: String, (option, argument)| text.replace(option, argument);
        ARGUMENTS.into_iter().fold(part.to_owned(), replaced)
    };
    let parts = text.split('`');
    let parts =
        parts.map(|part| if part.starts_with("cargo ") { part.to_owned() } else { replace(part) });
    parts.collect::<Vec<_>>().join("`")
}

/// An error with its place as attributes.
fn to_python(py: Python<'_>, error: anyhow::Error) -> PyErr {
    let raised = MagpieError::new_err(with_arguments(&format!("{error:#}")));
    let (error, notes) = match error.downcast::<ErrorWithNotes>() {
        Ok(with_notes) => (with_notes.error, texts(&with_notes.notes)),
        Err(error) => (error, Vec::new()),
    };
    let place = error.chain().find_map(|cause| {
        let of_import = cause.downcast_ref::<ImportError>().map(|explained| &explained.error);
        let of_model = cause.downcast_ref::<BuildError>().and_then(|error| match error {
            BuildError::File(error) => Some(error),
            _ => None,
        });
        let of_data = cause.downcast_ref::<DataError>().or(of_import).or(of_model);
        let of_data = of_data.map(|error| &*error.location);
        of_data.or_else(|| cause.downcast_ref::<FitError>()?.place())
    });
    let place = place.cloned().unwrap_or_default();
    let file = (place.file != PathBuf::new()).then_some(place.file);
    let value = raised.value(py);
    let set = value
        .setattr("file", file)
        .and_then(|()| value.setattr("line", place.line))
        .and_then(|()| value.setattr("column", place.column))
        .and_then(|()| value.setattr("notes", notes));
    set.err().unwrap_or(raised)
}

/// Notes as sentences.
fn texts(list: &[Note]) -> Vec<String> {
    notes::texts(list)
}

/// A result with its notes.
fn with_notes(mut result: Value, list: &[Note]) -> Value {
    if let Some(object) = result.as_object_mut() {
        object.entry("notes").or_insert_with(|| json!(texts(list)));
    }
    result
}

/// JSON as a Python string.
fn to_text(py: Python<'_>, value: &Value) -> Py<PyString> {
    PyString::new(py, &value.to_string()).unbind()
}

#[pymodule]
fn _magpie(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("MagpieError", MagpieError::type_object(module.py()))?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<device::Device>()?;
    module.add("GripperError", gripper::GripperError::type_object(module.py()))?;
    module.add_class::<gripper::Gripper>()?;
    calibration::register(module)
}
