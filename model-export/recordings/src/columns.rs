//! Column names (quantity, sensor, axis, unit) and the channel layout of a recording.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::error::{ErrorKind, closest_match};
use crate::units::{self, column_unit, column_units};

/// Axis of a field or a force. The magnet moves in the plane of `x` and `z`; `y` points across the gap, along
/// the magnet's axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// Lateral: grasping.
    X,
    /// Along the magnet's axis, across the gap.
    Y,
    /// Longitudinal: ground reaction.
    Z,
}

impl Axis {
    /// All axes in storage order.
    pub const ALL: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

    /// Letter in column names.
    pub fn letter(self) -> &'static str {
        match self {
            Axis::X => "x",
            Axis::Y => "y",
            Axis::Z => "z",
        }
    }

    fn from_letter(letter: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|axis| axis.letter() == letter)
    }
}

/// Unit of a field column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldUnit {
    /// Raw counts.
    Lsb,
    /// Gauss.
    Gauss,
    /// Another unit, by its suffix: the signal of a sensor that is not a magnetometer, such as a load cell's voltage.
    Other(&'static str),
}

impl FieldUnit {
    /// Suffix of the column.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Lsb => "lsb",
            Self::Gauss => "gauss",
            Self::Other(suffix) => suffix,
        }
    }

    /// Unit with this suffix; a time is none.
    fn of_suffix(suffix: &str) -> Option<Self> {
        match column_units().into_iter().find(|unit| *unit == suffix)? {
            "us" => None,
            "lsb" => Some(Self::Lsb),
            "gauss" => Some(Self::Gauss),
            other => Some(Self::Other(other)),
        }
    }
}

/// A column of `hall.csv`.
#[derive(Clone, Debug, PartialEq)]
pub enum HallColumn {
    /// `t_us`: the board's clock in microseconds.
    Time,
    /// `sN_x_lsb`, `sN_x_gauss`, or a signal in another unit such as `sN_x_v`.
    Field {
        /// Index of the sensor.
        sensor: u32,
        /// Field axis.
        axis: Axis,
        /// Unit of the values.
        unit: FieldUnit,
    },
    /// `sN_temp_c`: temperature of the sensor.
    Temperature {
        /// Index of the sensor.
        sensor: u32,
    },
    /// A covariate of the gripper: one of [`COVARIATES`], or declared in `recording.toml`.
    Covariate {
        /// Column name.
        name: String,
    },
}

/// Unit of a sensor's signal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SignalUnit {
    /// A magnetic field, in gauss.
    #[default]
    Gauss,
    /// Symbol of the unit of a signal that is no field.
    Other(&'static str),
}

impl SignalUnit {
    /// Symbol of the unit.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Gauss => "G",
            Self::Other(symbol) => symbol,
        }
    }
}

impl HallColumn {
    /// Unit of a sensor's signal as it is read; gauss for other columns.
    pub fn signal_unit(&self) -> SignalUnit {
        match self {
            Self::Field { unit: FieldUnit::Other(suffix), .. } => {
                SignalUnit::Other(units::symbol(suffix).unwrap_or(suffix))
            }
            _ => SignalUnit::Gauss,
        }
    }

    /// True for a field in raw counts.
    pub(super) fn is_raw_field(&self) -> bool {
        matches!(self, Self::Field { unit, .. } if *unit == FieldUnit::Lsb)
    }
}

/// A column of `force.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForceColumn {
    /// `t_us`: the reference clock in microseconds.
    Time,
    /// `fN_x_n` or `fN_z_n`.
    Force {
        /// Index of the sensor on which the force acts.
        sensor: u32,
        /// [`Axis::X`] or [`Axis::Z`].
        axis: Axis,
    },
}

/// Standard covariates, all optional.
pub const COVARIATES: &[&str] = &[
    "opening_mm",
    "motor_iq_a",
    "motor_angle_rad",
    "accel_x_mps2",
    "accel_y_mps2",
    "accel_z_mps2",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
];

/// Covariates derived from `motor_iq_a` and `motor_angle_rad`: the phase currents in the stator frame in
/// amperes.
pub const STATOR_CURRENTS: [&str; 2] = ["motor_alpha_a", "motor_beta_a"];

/// True for angles, which wrap at a full turn.
pub(crate) fn is_angle(column: &str) -> bool {
    column.ends_with("_rad")
}

/// Index and rest: `s12_x_lsb` with prefix `s` gives `(12, "x_lsb")`.
fn split_index<'a>(name: &'a str, prefix: &str) -> Option<(u32, &'a str)> {
    let (number, rest) = name.strip_prefix(prefix)?.split_once('_')?;
    let digits = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
    digits.then(|| number.parse().ok())?.map(|n| (n, rest))
}

/// Parses a column name of `hall.csv`; `declared`: covariates declared in `recording.toml`.
pub fn hall_column(name: &str, declared: &[String]) -> Result<HallColumn, ErrorKind> {
    if name == "t_us" {
        return Ok(HallColumn::Time);
    }
    if COVARIATES.contains(&name) || declared.iter().any(|column| column == name) {
        return Ok(HallColumn::Covariate { name: name.to_owned() });
    }
    if let Some((sensor, rest)) = split_index(name, "s") {
        if rest == "temp_c" {
            return Ok(HallColumn::Temperature { sensor });
        }
        let (letter, unit) = rest.split_once('_').unwrap_or((rest, ""));
        if let Some(axis) = Axis::from_letter(letter) {
            let unit = FieldUnit::of_suffix(unit).ok_or_else(|| {
                let [raw, field] =
                    ["lsb", "gauss"].map(|unit| format!("s{sensor}_{letter}_{unit}"));
                wrong_unit(name, &[&raw, &field])
            })?;
            return Ok(HallColumn::Field { sensor, axis, unit });
        }
        if rest == "temp" || rest.starts_with("temp_") {
            return Err(wrong_unit(name, &[&format!("s{sensor}_temp_c")]));
        }
    }
    let mut candidates: Vec<String> = COVARIATES.iter().map(|name| (*name).to_owned()).collect();
    candidates.extend(declared.iter().cloned());
    candidates.push("t_us".into());
    for sensor in 0..8 {
        candidates.extend(
            ["x_lsb", "y_lsb", "z_lsb", "x_gauss", "y_gauss", "z_gauss", "temp_c"]
                .map(|rest| format!("s{sensor}_{rest}")),
        );
    }
    Err(unknown_column(
        name,
        &candidates,
        "declare it in recording.toml as `covariates = [\"NAME_unit\"]`, or remove it",
    ))
}

/// Column name of the force on a sensor along an axis.
pub fn force_column_name((sensor, axis): (u32, Axis)) -> String {
    format!("f{sensor}_{}_n", axis.letter())
}

/// Parses a column name of `force.csv`.
pub fn force_column(name: &str) -> Result<ForceColumn, ErrorKind> {
    if name == "t_us" {
        return Ok(ForceColumn::Time);
    }
    if let Some((sensor, rest)) = split_index(name, "f") {
        let (letter, unit) = rest.split_once('_').unwrap_or((rest, ""));
        match (Axis::from_letter(letter), unit) {
            (Some(axis @ (Axis::X | Axis::Z)), "n") => {
                return Ok(ForceColumn::Force { sensor, axis });
            }
            (Some(Axis::X | Axis::Z), _) => {
                return Err(wrong_unit(name, &[&format!("f{sensor}_{letter}_n")]));
            }
            _ => {}
        }
    }
    let mut candidates = vec!["t_us".to_owned()];
    for sensor in 0..8 {
        candidates.extend([format!("f{sensor}_x_n"), format!("f{sensor}_z_n")]);
    }
    Err(unknown_column(
        name,
        &candidates,
        "force.csv contains t_us, fN_x_n and fN_z_n only: remove it",
    ))
}

fn wrong_unit(name: &str, choices: &[&str]) -> ErrorKind {
    let advice = format!("write {}", choices.join(" or "));
    match name.rsplit_once('_') {
        Some((_, unit)) if unit.len() > 1 => ErrorKind::UnknownColumn {
            advice: format!(
                "its unit {unit:?} is not accepted here: {advice} and convert the values"
            ),
        },
        _ => ErrorKind::MissingUnit { advice },
    }
}

fn unknown_column(name: &str, candidates: &[String], otherwise: &str) -> ErrorKind {
    let with_unit = |unit: &str| candidates.iter().any(|k| *k == format!("{name}_{unit}"));
    if let Some(unit) = column_units().into_iter().find(|unit| with_unit(unit)) {
        return ErrorKind::MissingUnit { advice: format!("write {name}_{unit}") };
    }
    match closest_match(name, candidates.iter().map(String::as_str)) {
        Some(candidate) => {
            ErrorKind::UnknownColumn { advice: format!("did you mean {candidate}?") }
        }
        None if column_unit(name).is_none() => ErrorKind::UnknownColumn {
            advice: format!(
                "{otherwise}; its name must end in a unit ({})",
                column_units().join(", ")
            ),
        },
        None => ErrorKind::UnknownColumn { advice: otherwise.to_owned() },
    }
}

/// Channels of a recording's rows.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelLayout {
    /// Columns of `hall.csv`, without the clock.
    pub hall: Vec<HallColumn>,
    /// Columns of `force.csv`, without the clock.
    pub forces: Vec<ForceColumn>,
}

impl ChannelLayout {
    /// Indices of the sensors, ascending.
    pub fn sensors(&self) -> Vec<u32> {
        let sensors: BTreeSet<u32> = self
            .hall
            .iter()
            .filter_map(|column| match column {
                HallColumn::Field { sensor, .. } => Some(*sensor),
                _ => None,
            })
            .collect();
        sensors.into_iter().collect()
    }

    /// Channels of the three axes of a sensor in [`ChannelLayout::hall`]. A sensor of one or two axes has its first one in the place
    /// of each missing one.
    pub fn field_channels(&self, sensor: u32) -> Option<[usize; 3]> {
        let channel = |of_axis: Axis| {
            self.hall.iter().position(|column| {
                matches!(column, HallColumn::Field { sensor: s, axis, .. } if *s == sensor && *axis == of_axis)
            })
        };
        let channels = Axis::ALL.map(channel);
        let first = channels.into_iter().flatten().next()?;
        Some(channels.map(|channel| channel.unwrap_or(first)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(result: Result<impl std::fmt::Debug, ErrorKind>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn field_column_parses_to_sensor_axis_and_unit() {
        let column = hall_column("s12_z_gauss", &[]).unwrap();
        let expected = HallColumn::Field { sensor: 12, axis: Axis::Z, unit: FieldUnit::Gauss };
        assert_eq!(column, expected);
    }

    #[test]
    fn signals_in_other_units_are_fields_of_a_sensor() {
        let column = hall_column("s0_x_v", &[]).unwrap();
        let expected = HallColumn::Field { sensor: 0, axis: Axis::X, unit: FieldUnit::Other("v") };
        assert_eq!(column, expected);
        assert!(hall_column("s0_x_us", &[]).is_err());
        let layout = ChannelLayout { hall: vec![HallColumn::Time, expected], forces: Vec::new() };
        assert_eq!(layout.field_channels(0), Some([1; 3]));
        assert_eq!(layout.field_channels(1), None);
    }

    #[test]
    fn invalid_column_yields_the_name_to_write() {
        let hall = |name| message(hall_column(name, &[]));
        let force = |name| message(force_column(name));
        let without_unit = "the column has no unit; write";
        for (found, expected) in [
            (hall("s0_x"), format!("{without_unit} s0_x_lsb or s0_x_gauss")),
            (hall("opening"), format!("{without_unit} opening_mm")),
            (force("f0_z"), format!("{without_unit} f0_z_n")),
            (hall("openning_mm"), "did you mean opening_mm?".to_owned()),
            (hall("s0_x_guass"), "write s0_x_lsb or s0_x_gauss".to_owned()),
            (force("f0_x_kg"), "write f0_x_n".to_owned()),
        ] {
            assert!(found.contains(&expected), "{found}");
        }
    }

    #[test]
    fn declared_covariate_is_accepted() {
        let declared = vec!["robot_z_mm".to_owned()];
        assert!(hall_column("robot_z_mm", &declared).is_ok());
        assert!(message(hall_column("robot_z_mm", &[])).contains("declare it"));
    }

    #[test]
    fn force_across_the_gap_is_rejected() {
        assert!(force_column("f0_y_n").is_err());
    }
}
