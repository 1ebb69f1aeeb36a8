//! Mapping files, which assign columns of a third-party table to columns of a recording, and the conversion of
//! quaternions to roll, pitch and yaw.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::columns::{force_column, hall_column};
use crate::description::{NominalDesign, parse_toml};
use crate::error::{DataError, ErrorKind, Location, closest_match};
use crate::input::{self, MAX_COLUMNS, MAX_START_S, plausible_range};
use crate::units::{UNITS, Unit, column_unit, find_unit};

/// Content of a mapping file.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Description in every `recording.toml`.
    pub description: String,
    /// True if one clock runs through all sources and gives the start of each recording; otherwise the
    /// recordings are placed end to end.
    #[serde(default)]
    pub one_clock: bool,
    /// Starts of the recordings in seconds, in the order of the sources: for sources whose clocks begin anew. Without it, and without
    /// `one_clock`, they are assumed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub starts_s: Vec<f64>,
    /// Range of the sensor in gauss, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_gauss: Option<f64>,
    /// Scale of columns imported as raw counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gauss_per_lsb: Option<f64>,
    /// Nominal design, if known, as in `recording.toml`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<NominalDesign>,
    /// Mapping to `hall.csv`.
    pub hall: TableMapping,
    /// Mapping to `force.csv`.
    pub force: TableMapping,
}

/// Mapping of one table.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct TableMapping {
    /// File in the folder of the source; absent where the source is one file with both tables.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Clock of the table.
    pub clock: ClockMapping,
    /// Columns to import; may be empty for the forces of an unloaded sensor.
    pub columns: Vec<ColumnMapping>,
    /// Quaternion from body to world (`hall` only), converted to `roll_rad`, `pitch_rad` and `yaw_rad`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attitude: Option<QuaternionColumns>,
}

/// Clock column of the source.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ClockMapping {
    /// Column of the source; absent with `row_s`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub from: String,
    /// Unit of the source.
    #[serde(default = "second")]
    pub unit: String,
    /// Distance of the rows in seconds, for a table without a clock: its times are assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row_s: Option<f64>,
    /// Added to the clock, in seconds: aligns clocks of different epochs.
    #[serde(default)]
    pub offset_s: f64,
    /// Whether times count from the first row of the table: for loggers that begin at the same instant, with clocks of their own.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub from_first_row: bool,
}

/// Mapping of one column.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ColumnMapping {
    /// Column of the source.
    pub from: String,
    /// Unit of the source.
    pub unit: String,
    /// Column of the recording.
    pub to: String,
    /// Factor in addition to that of the unit; -1 inverts the sign.
    #[serde(default = "one")]
    pub scale: f64,
    /// Value of the source for missing measurements (forces only).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<f64>,
}

fn one() -> f64 {
    1.0
}

fn second() -> String {
    "s".to_owned()
}

impl Mapping {
    /// Reads and validates a mapping file.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        let text = input::read_text(path)?;
        let mapping: Self = parse_toml(path, &text)?;
        let location = |column: &str| Location::file(path).column(column);
        for table in [&mapping.hall, &mapping.force] {
            conversion_factor(path, &table.clock.unit, "t_us", &table.clock.from)?;
            for column in &table.columns {
                conversion(path, &column.unit, &column.to, &column.to)?;
                if !column.scale.is_finite() || column.scale == 0.0 {
                    let found = format!("scale = {}", column.scale);
                    let kind = ErrorKind::bad_value(found, "give a number other than zero");
                    return Err(kind.at(location(&column.to)));
                }
                let (min, max) = plausible_range("scale");
                if !(min..=max).contains(&column.scale.abs()) {
                    let found = format!("scale = {:?}", column.scale);
                    let advice = format!("give a factor of {min:e} to {max:e}");
                    return Err(ErrorKind::bad_value(found, advice).at(location(&column.to)));
                }
            }
            table.clock.check(path)?;
            let offset_s = table.clock.offset_s;
            if !(-MAX_START_S..=MAX_START_S).contains(&offset_s) {
                let found = format!("offset_s = {offset_s:?}");
                let kind =
                    ErrorKind::bad_value(found, format!("give seconds up to {MAX_START_S:e}"));
                return Err(kind.at(location(&table.clock.from)));
            }
            if table.columns.len() > MAX_COLUMNS {
                let kind =
                    ErrorKind::TooManyColumns { found: table.columns.len(), max: MAX_COLUMNS };
                return Err(kind.at(location("columns")));
            }
        }
        let is_relative = |table: &TableMapping| table.clock.from_first_row;
        if mapping.one_clock && (is_relative(&mapping.hall) || is_relative(&mapping.force)) {
            let advice = "times that count from the first row do not say when a recording began: set one_clock = false";
            let kind = ErrorKind::bad_value("from_first_row with one_clock", advice);
            return Err(kind.at(location("one_clock")));
        }
        mapping.check_starts(path)?;
        let declared = mapping.covariates();
        for column in &mapping.hall.columns {
            hall_column(&column.to, &declared).map_err(|kind| kind.at(location(&column.to)))?;
            if column.missing.is_some() {
                let advice = "only forces may be missing; other columns need a value in every row";
                let kind = ErrorKind::bad_value("missing", advice);
                return Err(kind.at(location(&column.to)));
            }
        }
        if mapping.force.attitude.is_some() {
            let advice = "the attitude belongs to the board: move it to [hall]";
            let kind = ErrorKind::bad_value("attitude in [force]", advice);
            return Err(kind.at(location("attitude")));
        }
        for column in &mapping.force.columns {
            force_column(&column.to).map_err(|kind| kind.at(location(&column.to)))?;
        }
        Ok(mapping)
    }

    fn check_starts(&self, path: &Path) -> Result<(), DataError> {
        let bad = |found: String, advice: &str| {
            Err(ErrorKind::bad_value(found, advice).at(Location::file(path).column("starts_s")))
        };
        if self.one_clock && !self.starts_s.is_empty() {
            return bad("starts_s with one_clock".to_owned(), "give one of the two");
        }
        match self.starts_s.iter().find(|start_s| !(-MAX_START_S..=MAX_START_S).contains(*start_s))
        {
            Some(start_s) => bad(format!("{start_s:?}"), "give seconds since the first recording"),
            None => Ok(()),
        }
    }

    /// Target columns that `recording.toml` must declare as covariates.
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

impl ClockMapping {
    /// A clock is a column, or the number of the row.
    fn check(&self, path: &Path) -> Result<(), DataError> {
        let (found, advice) = match self.row_s {
            None if self.from.is_empty() => (
                "a clock without `from`",
                "name its column, or give row_s, the seconds from row to row",
            ),
            Some(_) if !self.from.is_empty() => ("row_s with `from`", "give one of the two"),
            Some(row_s) if !(1e-6..=1e6).contains(&row_s) => {
                ("this row_s", "give the seconds from row to row")
            }
            _ => return Ok(()),
        };
        Err(ErrorKind::bad_value(found, advice).at(Location::file(path).column("clock")))
    }
}

/// Value in the unit of a column: of the source times `factor`, plus `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Conversion {
    pub(super) factor: f64,
    pub(super) offset: f64,
}

/// Temperature of 0 degrees Celsius in kelvin.
const CELSIUS_K: f64 = 273.15;

/// Conversion from `unit` to the unit of the column `to`; errors name `key`.
pub(super) fn conversion(
    path: &Path,
    unit: &str,
    to: &str,
    key: &str,
) -> Result<Conversion, DataError> {
    if unit == "K" && column_unit(to) == Some("c") {
        return Ok(Conversion { factor: 1.0, offset: -CELSIUS_K });
    }
    Ok(Conversion { factor: conversion_factor(path, unit, to, key)?, offset: 0.0 })
}

/// Conversion factor from `unit` to the unit of the column `to`; errors name `key`.
pub(super) fn conversion_factor(
    path: &Path,
    unit: &str,
    to: &str,
    key: &str,
) -> Result<f64, DataError> {
    let bad_unit = |advice: String| {
        let kind = ErrorKind::bad_value(format!("the unit {unit:?}"), advice);
        Err(kind.at(Location::file(path).column(key)))
    };
    let wanted = column_unit(to);
    let is_accepted = |unit: &&Unit| wanted.is_none_or(|wanted| unit.canonical == wanted);
    let names = || UNITS.iter().filter(is_accepted).map(|unit| unit.name);
    let Some(unit_spec) = find_unit(unit) else {
        let written = Some(unit).filter(|unit| !unit.is_empty());
        let hint = written
            .and_then(|unit| closest_match(unit, names()))
            .map_or_else(String::new, |name| format!("did you mean {name:?}? "));
        let names = names().collect::<Vec<_>>().join(", ");
        return bad_unit(format!("{hint}accepted units: {names}"));
    };
    if wanted != Some(unit_spec.canonical) {
        let canonical = unit_spec.canonical;
        return bad_unit(format!("{to} is not in a unit that {unit:?} converts to ({canonical})"));
    }
    Ok(unit_spec.factor)
}

/// Columns of the converted attitude: Euler angles about x, y, z, body to world, applied in the order z, y, x.
pub const ATTITUDE_COLUMNS: [&str; 3] = ["roll_rad", "pitch_rad", "yaw_rad"];

/// Minimum norm of a valid quaternion.
const MIN_NORM: f64 = 1e-6;

/// Source columns of a quaternion.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct QuaternionColumns {
    /// Scalar part.
    pub w: String,
    /// Component along x.
    pub x: String,
    /// Component along y.
    pub y: String,
    /// Component along z.
    pub z: String,
}

impl QuaternionColumns {
    /// Column names, scalar part first.
    pub fn columns(&self) -> [&str; 4] {
        [&self.w, &self.x, &self.y, &self.z]
    }
}

/// Roll, pitch and yaw in rad of a quaternion of any norm (scalar part first). Roll and yaw are unwrapped
/// relative to `last`, since rows are averaged later.
pub(crate) fn euler_angles(
    [w, x, y, z]: [f64; 4],
    last: Option<[f64; 3]>,
) -> Result<[f64; 3], ErrorKind> {
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), MIN_NORM);
    let Some(rotation) = rotation else {
        let advice = "it is not a rotation: remove the rows before the first valid attitude";
        return Err(ErrorKind::bad_value("the quaternion 0, 0, 0, 0", advice));
    };
    let (roll, pitch, yaw) = rotation.euler_angles();
    let [last_roll, _, last_yaw] = last.unwrap_or([roll, pitch, yaw]);
    Ok([unwrap_angle(roll, last_roll), pitch, unwrap_angle(yaw, last_yaw)])
}

/// `angle` plus the multiple of a full turn that brings it closest to `last`.
fn unwrap_angle(angle: f64, last: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle + turn * ((last - angle) / turn).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn euler_angles_rotate_a_vector_like_the_quaternion() {
        let parts = [0.9546, 0.0415, 0.0482, -0.2910];
        let [roll, pitch, yaw] = euler_angles(parts.map(|part| 3.0 * part), None).unwrap();
        let by_angles =
            Rotation3::from_euler_angles(roll, pitch, yaw) * Vector3::new(1.0, 2.0, 3.0);
        let [w, x, y, z] = parts;
        let quaternion = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        let turned = quaternion * Vector3::new(1.0, 2.0, 3.0);
        assert!((by_angles - turned).norm() < 1e-12);
    }

    #[test]
    fn quarter_turn_about_z_is_a_quarter_turn_of_yaw() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let [roll, pitch, yaw] = euler_angles([half, 0.0, 0.0, half], None).unwrap();
        assert!(roll.abs() < 1e-12 && pitch.abs() < 1e-12);
        assert!((yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn yaw_is_continuous_beyond_half_a_turn() {
        let at = |yaw: f64| [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()];
        let before = euler_angles(at(3.1), None).unwrap();
        let after = euler_angles(at(3.2), Some(before)).unwrap();
        assert!((after[2] - 3.2).abs() < 1e-9, "{}", after[2]);
    }

    #[test]
    fn numbers_of_a_mapping_are_limited() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("mapping.toml");
        let read = |scale: &str, offset: &str| {
            let clock =
                |offset: &str| format!("{{ from = \"t\", unit = \"s\", offset_s = {offset} }}");
            let text = format!(
                "description = \"\"\n[hall]\nclock = {}\ncolumns = [{{ from = \"b\", unit = \"G\", to = \"s0_x_gauss\", scale = {scale} }}]\n[force]\nclock = {}\ncolumns = []\n",
                clock(offset),
                clock("0.0")
            );
            std::fs::write(&path, text).unwrap();
            Mapping::read(&path)
        };
        for (scale, offset, is_valid) in [
            ("-1e-12", "-1e10", true),
            ("1e12", "1e10", true),
            ("1e13", "0.0", false),
            ("1e-320", "0.0", false),
            ("nan", "0.0", false),
            ("1.0", "nan", false),
            ("1.0", "1.1e10", false),
        ] {
            assert_eq!(read(scale, offset).is_ok(), is_valid, "{scale} {offset}");
        }
    }

    #[test]
    fn zero_quaternion_is_rejected() {
        assert!(euler_angles([0.0; 4], None).is_err());
    }
}
