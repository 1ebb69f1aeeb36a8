//! `recording.toml`: what was recorded, the sensor's scale, and the nominal design.

use std::path::Path;

use firmware::params;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::problem::{Fault, Notice, Place, Problem};
use crate::quantity::{column_unit, column_units};

/// The file's name in a recording's folder.
pub const FILE: &str = "recording.toml";

/// The format that this code reads and writes.
pub const FORMAT: i64 = 1;

/// What `recording.toml` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// Version of the format, [`FORMAT`].
    pub format: i64,
    /// In a person's words.
    #[serde(default)]
    pub description: String,
    /// When it was recorded, as a date in the user's words; optional.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
    /// Start of the recording in seconds since the campaign began.
    pub start_s: f64,
    /// Scale of the raw counts; needed where a column ends in `_lsb`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gauss_per_lsb: Option<f64>,
    /// Range of each axis, either sign; where it is given, saturated samples are left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_gauss: Option<f64>,
    /// Covariates beyond those of the format, each name ending in its unit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub covariates: Vec<String>,
    /// The nominal design; absent where nobody knows the geometry.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<Design>,
    /// Keys that this version does not know.
    #[serde(flatten, skip_serializing)]
    unknown: toml::Table,
}

/// The nominal design, in the words and units of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Design {
    /// The magnet on the longitudinal flexure.
    pub magnet: Magnet,
    /// From the magnet's face to the Hall element, unloaded.
    pub gap_mm: f64,
    /// Lateral flexure.
    pub stiffness_x_n_per_mm: f64,
    /// Longitudinal flexure.
    pub stiffness_z_n_per_mm: f64,
    /// Force that each axis of each sensor is designed for, either way; the gripper's own where it is
    /// not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_range_n: Option<f64>,
    /// Number of sensors; the gripper's own where it is not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<u32>,
    /// What the file says beyond this (beam, motor, screw), kept for the effects that need it.
    #[serde(flatten)]
    pub more: toml::Table,
}

/// A permanent magnet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Magnet {
    /// Shape and size.
    #[serde(flatten)]
    pub shape: Shape,
    /// Remanence; negative where the magnet is mounted the other way round.
    pub remanence_t: f64,
    /// The sensor's axis along which the magnet is magnetised.
    pub axis: MagnetAxis,
    /// Where the axis of the body lies, of a cylinder or tube that is magnetised across it
    /// (diametrically); otherwise they are one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body_axis: Option<MagnetAxis>,
}

/// Shapes whose field is known in closed form here, in millimetres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum Shape {
    /// Full, round.
    Cylinder {
        /// Diameter.
        diameter_mm: f64,
        /// Length along the body's axis.
        length_mm: f64,
    },
    /// With a round hole all along its axis.
    Tube {
        /// Diameter.
        diameter_mm: f64,
        /// Diameter of the hole.
        hole_mm: f64,
        /// Length along the body's axis.
        length_mm: f64,
    },
    /// Edges along the sensor's axes.
    Cube {
        /// Length of an edge.
        side_mm: f64,
    },
    /// A ball.
    Sphere {
        /// Diameter.
        diameter_mm: f64,
    },
}

/// One of the sensor's axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MagnetAxis {
    /// Lying, along the lateral motion.
    X,
    /// Facing the sensor across the gap.
    Y,
    /// Lying, along the longitudinal motion.
    Z,
}

impl Design {
    /// The gripper's own nominal design, from [`firmware::params`].
    pub fn magpie() -> Self {
        Self {
            magnet: Magnet {
                shape: Shape::Cylinder {
                    diameter_mm: params::MAGNET_DIAMETER.value,
                    length_mm: params::MAGNET_LENGTH.value,
                },
                remanence_t: params::REMANENCE.value,
                axis: MagnetAxis::Y,
                body_axis: None,
            },
            gap_mm: params::GAP.value,
            stiffness_x_n_per_mm: params::STIFFNESS_X.value,
            stiffness_z_n_per_mm: params::STIFFNESS_Z.value,
            force_range_n: None,
            sensors: None,
            more: toml::Table::from_iter([(
                "beam_length_mm".to_owned(),
                params::BEAM_LENGTH.value.into(),
            )]),
        }
    }

    /// Force that each axis is designed for, either way, in newtons.
    pub fn force_range_n(&self) -> f64 {
        self.force_range_n.unwrap_or(params::FORCE_RANGE.value)
    }

    /// Number of sensors.
    pub fn sensors(&self) -> u32 {
        self.sensors.unwrap_or(params::SENSORS.value as u32)
    }

    /// A number among what the file says beyond this.
    pub fn number(&self, key: &str) -> Option<f64> {
        let value = self.more.get(key)?;
        value
            .as_float()
            .or_else(|| value.as_integer().map(|n| n as f64))
    }

    /// Everything that must be above zero, by its key.
    pub(crate) fn sizes(&self) -> Vec<(&'static str, f64)> {
        let mut sizes = vec![
            ("design.gap_mm", self.gap_mm),
            ("design.stiffness_x_n_per_mm", self.stiffness_x_n_per_mm),
            ("design.stiffness_z_n_per_mm", self.stiffness_z_n_per_mm),
            ("design.magnet.remanence_t", self.magnet.remanence_t.abs()),
            ("design.force_range_n", self.force_range_n()),
            ("design.sensors", f64::from(self.sensors())),
        ];
        sizes.extend(self.magnet.shape.sizes());
        sizes
    }
}

impl Shape {
    /// Everything that must be above zero, by its key. Of a tube also its wall.
    fn sizes(self) -> Vec<(&'static str, f64)> {
        const DIAMETER: &str = "design.magnet.diameter_mm";
        const LENGTH: &str = "design.magnet.length_mm";
        match self {
            Self::Cylinder {
                diameter_mm,
                length_mm,
            } => vec![(DIAMETER, diameter_mm), (LENGTH, length_mm)],
            Self::Tube {
                diameter_mm,
                hole_mm,
                length_mm,
            } => vec![
                (DIAMETER, diameter_mm),
                ("design.magnet.hole_mm", hole_mm),
                (
                    "design.magnet.diameter_mm less its hole",
                    diameter_mm - hole_mm,
                ),
                (LENGTH, length_mm),
            ],
            Self::Cube { side_mm } => vec![("design.magnet.side_mm", side_mm)],
            Self::Sphere { diameter_mm } => vec![(DIAMETER, diameter_mm)],
        }
    }
}

impl MagnetAxis {
    /// The unit vector along it.
    pub fn unit(self) -> Vector3<f64> {
        match self {
            Self::X => Vector3::x(),
            Self::Y => Vector3::y(),
            Self::Z => Vector3::z(),
        }
    }
}

impl Description {
    /// A description with nothing but what every recording has.
    pub fn new(description: impl Into<String>, start_s: f64) -> Self {
        Self {
            format: FORMAT,
            description: description.into(),
            recorded: None,
            start_s,
            gauss_per_lsb: None,
            range_gauss: None,
            covariates: Vec::new(),
            design: None,
            unknown: toml::Table::new(),
        }
    }

    /// Reads and checks `recording.toml` in `folder`.
    pub fn read(folder: &Path) -> Result<(Self, Vec<Notice>), Problem> {
        let path = folder.join(FILE);
        let text = std::fs::read_to_string(&path).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => Fault::MissingFile {
                name: FILE,
                advice: "it needs at least `format = 1`, `start_s` and, for raw counts, `gauss_per_lsb`",
            }
            .at(Place::file(folder)),
            _ => Fault::Unreadable(error).at(Place::file(&path)),
        })?;
        let description: Self = parse_toml(&path, &text)?;
        description.check(&path)?;
        let notices = description.unknown_keys(&path);
        Ok((description, notices))
    }

    /// Writes `recording.toml` into `folder`.
    pub fn write(&self, folder: &Path) -> Result<(), Problem> {
        let path = folder.join(FILE);
        let text = toml::to_string(self)
            .map_err(|error| Fault::Toml(error.to_string()).at(Place::file(&path)))?;
        std::fs::write(&path, text).map_err(|error| Fault::Unwritable(error).at(Place::file(&path)))
    }

    /// Field in gauss from which on a sample is saturated, of raw counts or of a converted field.
    pub fn saturated_gauss(&self, raw: bool) -> f64 {
        // A step below full scale: converters stop at the last code, not at the round number.
        match self.range_gauss {
            Some(range) if raw => range - 1.5 * self.gauss_per_lsb.unwrap_or(1.0),
            Some(range) => range,
            None => f64::INFINITY,
        }
    }

    fn check(&self, path: &Path) -> Result<(), Problem> {
        let bad = |key: &str, found: String, advice: String| {
            Err(Fault::BadValue { found, advice }.at(Place::file(path).column(key)))
        };
        if self.format != FORMAT {
            let advice = format!("this tool reads format = {FORMAT}");
            return bad("format", self.format.to_string(), advice);
        }
        if !self.start_s.is_finite() {
            let advice = "give the seconds since the campaign began".to_owned();
            return bad("start_s", self.start_s.to_string(), advice);
        }
        let scale = [
            ("gauss_per_lsb", self.gauss_per_lsb),
            ("range_gauss", self.range_gauss),
        ];
        let design = self.design.as_ref().map_or_else(Vec::new, Design::sizes);
        let stated = scale
            .into_iter()
            .filter_map(|(key, value)| Some((key, value?)));
        for (key, value) in stated.chain(design) {
            if !(value.is_finite() && value > 0.0) {
                return bad(
                    key,
                    value.to_string(),
                    "give a number above zero".to_owned(),
                );
            }
        }
        for name in &self.covariates {
            if column_unit(name).is_none() {
                let units = column_units().join(", ");
                let advice = format!("end the name in its unit ({units}), for example robot_z_mm");
                return bad("covariates", format!("{name:?}"), advice);
            }
        }
        Ok(())
    }

    fn unknown_keys(&self, path: &Path) -> Vec<Notice> {
        self.unknown
            .keys()
            .map(|key| Notice {
                place: Place::file(path).column(key.as_str()),
                message: "this key is not known and was ignored; check its spelling".to_owned(),
            })
            .collect()
    }
}

/// Parses TOML; an error names the line.
pub(crate) fn parse_toml<T: serde::de::DeserializeOwned>(
    path: &Path,
    text: &str,
) -> Result<T, Problem> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let mut place = Place::file(path);
        if let Some(span) = error.span() {
            let before = text.get(..span.start).unwrap_or(text);
            place = place.line(before.matches('\n').count() as u64 + 1);
        }
        Fault::Toml(error.message().replace('\n', " ")).at(place)
    })
}
