//! What a column's name means: quantity, number of the sensor or place, axis and unit.

use super::problem::{Fault, closest};
use crate::quantity::{column_unit, column_units};

/// Axis of a sensor, or of a force.
///
/// `x` and `z` lie in the plane in which the magnet moves (lateral and longitudinal); `y` points
/// across the gap along the magnet's axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Axis {
    /// Lateral, grasping.
    X,
    /// Along the magnet's axis, across the gap.
    Y,
    /// Longitudinal, ground reaction.
    Z,
}

impl Axis {
    /// All three, in the order in which fields are stored.
    pub const ALL: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

    /// The letter in column names and tables.
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

/// How a field column is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldUnit {
    /// Raw counts of the sensor.
    Lsb,
    /// Converted.
    Gauss,
}

/// A column of `hall.csv`.
#[derive(Clone, Debug, PartialEq)]
pub enum HallColumn {
    /// `t_us`, the board's clock.
    Time,
    /// `sN_x_lsb` or `sN_x_gauss`.
    Field {
        /// Number of the sensor.
        sensor: u32,
        /// Its axis.
        axis: Axis,
        /// How it is written.
        unit: FieldUnit,
    },
    /// `sN_temp_c`, the sensor's own temperature.
    Temperature {
        /// Number of the sensor.
        sensor: u32,
    },
    /// A covariate of the whole gripper: one of [`COVARIATES`], or declared in `recording.toml`.
    Covariate {
        /// The column's name.
        name: String,
    },
}

/// A column of `force.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForceColumn {
    /// `t_us`, the bench computer's clock.
    Time,
    /// `fN_x_n` or `fN_z_n`.
    Force {
        /// Number of the place: the force that acts where sensor N is.
        place: u32,
        /// Lateral or longitudinal.
        axis: Axis,
    },
}

/// Covariates of the format; any of them may be absent.
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

/// Covariates that are formed from `motor_iq_a` and `motor_angle_rad` as a recording is read: the
/// phase currents in the stator's frame, in amperes.
pub const STATOR_CURRENTS: [&str; 2] = ["motor_alpha_a", "motor_beta_a"];

/// True for columns that wrap around at a full turn.
pub fn is_angle(column: &str) -> bool {
    column.ends_with("_rad")
}

/// Number, rest: `s12_x_lsb` with prefix `s` gives `(12, "x_lsb")`.
fn numbered<'a>(name: &'a str, prefix: &str) -> Option<(u32, &'a str)> {
    let (number, rest) = name.strip_prefix(prefix)?.split_once('_')?;
    let digits = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
    digits.then(|| number.parse().ok())?.map(|n| (n, rest))
}

/// Reads a name of `hall.csv`; `declared` are the covariates that `recording.toml` adds.
pub fn hall_column(name: &str, declared: &[String]) -> Result<HallColumn, Fault> {
    if name == "t_us" {
        return Ok(HallColumn::Time);
    }
    if COVARIATES.contains(&name) || declared.iter().any(|column| column == name) {
        return Ok(HallColumn::Covariate {
            name: name.to_owned(),
        });
    }
    if let Some((sensor, rest)) = numbered(name, "s") {
        if rest == "temp_c" {
            return Ok(HallColumn::Temperature { sensor });
        }
        let (letter, unit) = rest.split_once('_').unwrap_or((rest, ""));
        if let Some(axis) = Axis::from_letter(letter) {
            let unit = match unit {
                "lsb" => FieldUnit::Lsb,
                "gauss" => FieldUnit::Gauss,
                _ => {
                    return Err(wrong_unit(
                        name,
                        &[
                            &format!("s{sensor}_{letter}_lsb"),
                            &format!("s{sensor}_{letter}_gauss"),
                        ],
                    ));
                }
            };
            return Ok(HallColumn::Field { sensor, axis, unit });
        }
        if rest == "temp" || rest.starts_with("temp_") {
            return Err(wrong_unit(name, &[&format!("s{sensor}_temp_c")]));
        }
    }
    let mut known: Vec<String> = COVARIATES.iter().map(|name| (*name).to_owned()).collect();
    known.extend(declared.iter().cloned());
    known.push("t_us".into());
    for sensor in 0..8 {
        known.extend(
            [
                "x_lsb", "y_lsb", "z_lsb", "x_gauss", "y_gauss", "z_gauss", "temp_c",
            ]
            .map(|rest| format!("s{sensor}_{rest}")),
        );
    }
    Err(unknown(
        name,
        &known,
        "declare it in recording.toml as `covariates = [\"NAME_unit\"]`, or remove it",
    ))
}

/// Reads a name of `force.csv`.
pub fn force_column(name: &str) -> Result<ForceColumn, Fault> {
    if name == "t_us" {
        return Ok(ForceColumn::Time);
    }
    if let Some((place, rest)) = numbered(name, "f") {
        let (letter, unit) = rest.split_once('_').unwrap_or((rest, ""));
        match (Axis::from_letter(letter), unit) {
            (Some(axis @ (Axis::X | Axis::Z)), "n") => {
                return Ok(ForceColumn::Force { place, axis });
            }
            (Some(Axis::X | Axis::Z), _) => {
                return Err(wrong_unit(name, &[&format!("f{place}_{letter}_n")]));
            }
            _ => {}
        }
    }
    let mut known = vec!["t_us".to_owned()];
    for place in 0..8 {
        known.extend([format!("f{place}_x_n"), format!("f{place}_z_n")]);
    }
    Err(unknown(
        name,
        &known,
        "force.csv holds t_us and fN_x_n, fN_z_n: remove it",
    ))
}

fn wrong_unit(name: &str, choices: &[&str]) -> Fault {
    let advice = format!("write {}", choices.join(" or "));
    match name.rsplit_once('_') {
        Some((_, unit)) if unit.len() > 1 => Fault::UnknownColumn {
            advice: format!("its unit {unit:?} is not used here: {advice} and convert the values"),
        },
        _ => Fault::UnitlessColumn { advice },
    }
}

fn unknown(name: &str, known: &[String], otherwise: &str) -> Fault {
    let with_unit = |unit: &str| known.iter().any(|k| *k == format!("{name}_{unit}"));
    if let Some(unit) = column_units().into_iter().find(|unit| with_unit(unit)) {
        return Fault::UnitlessColumn {
            advice: format!("write {name}_{unit}"),
        };
    }
    match closest(name, known.iter().map(String::as_str)) {
        Some(candidate) => Fault::UnknownColumn {
            advice: format!("did you mean {candidate}?"),
        },
        None if column_unit(name).is_none() => Fault::UnknownColumn {
            advice: format!(
                "{otherwise}; its name must end in a unit ({})",
                column_units().join(", ")
            ),
        },
        None => Fault::UnknownColumn {
            advice: otherwise.to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(result: Result<impl std::fmt::Debug, Fault>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn a_field_column_is_read_with_sensor_axis_and_unit() {
        let column = hall_column("s12_z_gauss", &[]).unwrap();
        let expected = HallColumn::Field {
            sensor: 12,
            axis: Axis::Z,
            unit: FieldUnit::Gauss,
        };
        assert_eq!(column, expected);
    }

    #[test]
    fn a_column_without_a_unit_is_told_which_to_write() {
        assert_eq!(
            sentence(hall_column("s0_x", &[])),
            "the column has no unit; write s0_x_lsb or s0_x_gauss"
        );
        assert_eq!(
            sentence(hall_column("opening", &[])),
            "the column has no unit; write opening_mm"
        );
        assert_eq!(
            sentence(force_column("f0_z")),
            "the column has no unit; write f0_z_n"
        );
    }

    #[test]
    fn a_misspelt_column_is_told_its_neighbour() {
        assert!(sentence(hall_column("openning_mm", &[])).contains("did you mean opening_mm?"));
        assert!(sentence(hall_column("s0_x_guass", &[])).contains("write s0_x_lsb or s0_x_gauss"));
        assert!(sentence(force_column("f0_x_kg")).contains("write f0_x_n"));
    }

    #[test]
    fn a_declared_covariate_is_known() {
        let declared = vec!["robot_z_mm".to_owned()];
        assert!(hall_column("robot_z_mm", &declared).is_ok());
        assert!(sentence(hall_column("robot_z_mm", &[])).contains("declare it"));
    }

    #[test]
    fn a_force_across_the_gap_is_not_part_of_the_format() {
        assert!(force_column("f0_y_n").is_err());
    }
}
