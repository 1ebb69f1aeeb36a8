//! The mapping file: which column of a foreign table becomes which column of a recording.

use std::path::Path;

use serde::Deserialize;

use super::attitude::Attitude;
use super::columns::{force_column, hall_column};
use super::description::{Design, parse_toml};
use super::problem::{Fault, Place, Problem, closest};
use crate::quantity::{UNITS, column_unit, unit_named};

/// What a mapping file holds.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Goes into every `recording.toml`.
    pub description: String,
    /// One clock runs on through all sources: their distance in it is their distance in time.
    /// Otherwise recordings are placed end to end.
    #[serde(default)]
    pub one_clock: bool,
    /// Range of the sensor in gauss, if it is known.
    #[serde(default)]
    pub range_gauss: Option<f64>,
    /// Scale of columns that stay raw counts.
    #[serde(default)]
    pub gauss_per_lsb: Option<f64>,
    /// The nominal design, if it is known, as in `recording.toml`.
    #[serde(default)]
    pub design: Option<Design>,
    /// The board's side.
    pub hall: Side,
    /// The reference's side.
    pub force: Side,
}

/// One of the two tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Side {
    /// File in the source's folder; absent where the source is one file for both sides.
    #[serde(default)]
    pub file: Option<String>,
    /// The side's own clock.
    pub clock: Clock,
    /// Columns to take. The reference's may be none: a sensor that nothing pushes.
    pub columns: Vec<Column>,
    /// The quaternion from the body to the world (the board's side only); it becomes `roll_rad`,
    /// `pitch_rad` and `yaw_rad`.
    #[serde(default)]
    pub attitude: Option<Attitude>,
}

/// A clock of the source.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clock {
    /// Column of the source.
    pub from: String,
    /// Its unit.
    pub unit: String,
    /// Added to it, in seconds: brings two clocks of different epochs together.
    #[serde(default)]
    pub offset_s: f64,
}

/// One column.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    /// Column of the source.
    pub from: String,
    /// Its unit, as people write it.
    pub unit: String,
    /// Column of the recording.
    pub to: String,
    /// Multiplies the value after its unit; -1 turns a sign.
    #[serde(default = "one")]
    pub scale: f64,
    /// Value that the source writes where nothing was measured (forces only).
    #[serde(default)]
    pub missing: Option<f64>,
}

fn one() -> f64 {
    1.0
}

impl Mapping {
    /// Reads and checks a mapping file.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| Fault::Unreadable(error).at(Place::file(path)))?;
        let mapping: Self = parse_toml(path, &text)?;
        for side in [&mapping.hall, &mapping.force] {
            factor(path, &side.clock.unit, "t_us", &side.clock.from)?;
            for column in &side.columns {
                factor(path, &column.unit, &column.to, &column.to)?;
                if !column.scale.is_finite() || column.scale == 0.0 {
                    let found = format!("scale = {}", column.scale);
                    let advice = "give a number other than zero".to_owned();
                    return Err(Fault::BadValue { found, advice }
                        .at(Place::file(path).column(column.to.as_str())));
                }
            }
        }
        let declared = mapping.covariates();
        for column in &mapping.hall.columns {
            hall_column(&column.to, &declared)
                .map_err(|fault| fault.at(Place::file(path).column(column.to.as_str())))?;
            if column.missing.is_some() {
                let found = "missing".to_owned();
                let advice =
                    "only forces may be missing; a covariate is there in every row or not at all"
                        .to_owned();
                return Err(Fault::BadValue { found, advice }
                    .at(Place::file(path).column(column.to.as_str())));
            }
        }
        if mapping.force.attitude.is_some() {
            let found = "attitude beside the forces".to_owned();
            let advice = "the attitude is the board's: move it to [hall]".to_owned();
            return Err(Fault::BadValue { found, advice }.at(Place::file(path).column("attitude")));
        }
        for column in &mapping.force.columns {
            force_column(&column.to)
                .map_err(|fault| fault.at(Place::file(path).column(column.to.as_str())))?;
        }
        Ok(mapping)
    }

    /// Names of covariates that the format does not know.
    pub(super) fn covariates(&self) -> Vec<String> {
        let names = self.hall.columns.iter().map(|column| &column.to);
        names
            .filter(|name| hall_column(name, &[]).is_err() && column_unit(name).is_some())
            // A misspelt field is not a covariate.
            .filter(|name| {
                !name.starts_with('s') || !name[1..].starts_with(|c: char| c.is_ascii_digit())
            })
            .cloned()
            .collect()
    }
}

/// Factor from the stated unit to that of the target column.
pub(super) fn factor(path: &Path, unit: &str, to: &str, key: &str) -> Result<f64, Problem> {
    let bad = |found: String, advice: String| {
        Err(Fault::BadValue { found, advice }.at(Place::file(path).column(key)))
    };
    let names = || UNITS.iter().map(|unit| unit.name);
    let Some(known) = unit_named(unit) else {
        let hint = closest(unit, names())
            .map_or_else(String::new, |name| format!("did you mean {name:?}? "));
        return bad(
            format!("the unit {unit:?}"),
            format!(
                "{hint}known units: {}",
                names().collect::<Vec<_>>().join(", ")
            ),
        );
    };
    if column_unit(to) != Some(known.canonical) {
        return bad(
            format!("the unit {unit:?}"),
            format!(
                "{to} is not in a unit that {unit:?} converts to ({})",
                known.canonical
            ),
        );
    }
    Ok(known.factor)
}
