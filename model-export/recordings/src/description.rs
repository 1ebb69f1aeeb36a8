//! `recording.toml`: description, sensor scale and nominal design.

use std::fmt;
use std::path::Path;

use firmware::config::constants;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::error::{DataError, ErrorKind, Location, Notice, closest_match};
use crate::input::{self, MAX_COLUMNS, MAX_START_S, check_plausible};
use crate::units::{column_unit, column_units};

/// Name of the file in the folder of a recording.
pub const RECORDING_FILE: &str = "recording.toml";

/// Supported format version.
pub const FORMAT: i64 = 1;

/// Content of `recording.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingDescription {
    /// Format version, [`FORMAT`].
    pub format: i64,
    /// Free text.
    #[serde(default)]
    pub description: String,
    /// Date of the recording, free text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recorded: Option<String>,
    /// Start of the recording in seconds since the campaign began; zero where it is absent, and then assumed.
    #[serde(default)]
    pub start_s: f64,
    /// Origin of `start_s`: without the key stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<TimeOrigin>,
    /// Origin of the times within the recording: without the key measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock: Option<TimeOrigin>,
    /// Channels with a clock of their own that were joined with the rows, each with its shift.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joined: Vec<JoinedChannel>,
    /// Scale of the raw counts; required where a column ends in `_lsb`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gauss_per_lsb: Option<f64>,
    /// Range of each axis, either sign; enables the exclusion of saturated samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_gauss: Option<f64>,
    /// Additional covariates, each name ending in its unit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub covariates: Vec<String>,
    /// The nominal design; absent where the geometry is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub design: Option<NominalDesign>,
    /// Unrecognised keys, reported as notices.
    #[serde(flatten, skip_serializing)]
    unknown: toml::Table,
}

/// Columns that were sampled at other times than the rows and interpolated to these.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JoinedChannel {
    /// Name in the source.
    pub source: String,
    /// How much later than the nearest row it was sampled, in milliseconds: median, 5 % and 95 % quantile.
    pub shift_ms: [f64; 3],
    /// Columns of the recording.
    pub columns: Vec<String>,
    /// Factor by which interpolation makes the noise that its rows show smaller than that of its samples.
    pub noise_factor: f64,
}

impl fmt::Display for JoinedChannel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [median, low, high] = self.shift_ms;
        write!(
            f,
            "{} was sampled {median:+.2} ms (from {low:+.2} to {high:+.2} ms) after the nearest row: interpolated to the times of the rows",
            self.source
        )
    }
}

/// Where times come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeOrigin {
    /// By one clock for all recordings.
    Measured,
    /// By the user.
    Stated,
    /// Unknown: recordings are placed end to end, rows at equal distances. Nothing that depends on it can be found.
    Assumed,
}

/// Key of the motor's pole pairs in a design.
const POLE_PAIRS: &str = "motor_pole_pairs";

/// The nominal design of the gripper, with the keys of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NominalDesign {
    /// The magnet on the longitudinal flexure.
    pub magnet: MagnetSpec,
    /// Distance from the magnet's face to the Hall element, unloaded.
    pub gap_mm: f64,
    /// Stiffness of the lateral flexure.
    pub stiffness_x_n_per_mm: f64,
    /// Stiffness of the longitudinal flexure.
    pub stiffness_z_n_per_mm: f64,
    /// Design force of each axis, either sign; default: the nominal gripper's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_range_n: Option<f64>,
    /// Number of sensors; default: the nominal gripper's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensors: Option<u32>,
    /// Further keys (beam, motor, screw), used by some effects.
    #[serde(flatten)]
    pub more: toml::Table,
}

/// A permanent magnet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MagnetSpec {
    /// Shape and dimensions.
    #[serde(flatten)]
    pub shape: MagnetShape,
    /// Remanence; negative for a magnet mounted with reversed polarity.
    pub remanence_t: f64,
    /// Direction of the magnetisation, as an axis of the sensor.
    pub axis: MagnetAxis,
    /// Direction of the body axis of a diametrically magnetised cylinder or tube; default: that of the
    /// magnetisation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body_axis: Option<MagnetAxis>,
}

/// Magnet shapes with a closed-form field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum MagnetShape {
    /// Solid cylinder.
    Cylinder {
        /// Diameter.
        diameter_mm: f64,
        /// Length along the body's axis.
        length_mm: f64,
    },
    /// Cylinder with a coaxial through hole.
    Tube {
        /// Diameter.
        diameter_mm: f64,
        /// Diameter of the hole.
        hole_mm: f64,
        /// Length along the body's axis.
        length_mm: f64,
    },
    /// Cube with edges along the sensor's axes.
    Cube {
        /// Length of an edge.
        side_mm: f64,
    },
    /// Sphere.
    Sphere {
        /// Diameter.
        diameter_mm: f64,
    },
}

/// Axis of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MagnetAxis {
    /// Along the lateral motion.
    X,
    /// Across the gap.
    Y,
    /// Along the longitudinal motion.
    Z,
}

impl NominalDesign {
    /// The nominal gripper, from [`firmware::config::constants`].
    pub fn magpie() -> Self {
        Self {
            magnet: MagnetSpec {
                shape: MagnetShape::Cylinder {
                    diameter_mm: constants::MAGNET_DIAMETER.value,
                    length_mm: constants::MAGNET_LENGTH.value,
                },
                remanence_t: constants::REMANENCE.value,
                axis: MagnetAxis::Y,
                body_axis: None,
            },
            gap_mm: constants::GAP.value,
            stiffness_x_n_per_mm: constants::STIFFNESS_X.value,
            stiffness_z_n_per_mm: constants::STIFFNESS_Z.value,
            force_range_n: None,
            sensors: None,
            more: toml::Table::from_iter([(
                "beam_length_mm".to_owned(),
                constants::BEAM_LENGTH.value.into(),
            )]),
        }
    }

    /// Design force of each axis, either sign, in newtons.
    pub fn force_range_n(&self) -> f64 {
        self.force_range_n.unwrap_or(constants::FORCE_RANGE.value)
    }

    /// Number of sensors.
    pub fn sensors(&self) -> u32 {
        self.sensors.unwrap_or(constants::SENSORS.value as u32)
    }

    /// Keys of the fields, and of the further ones that a fit or the device uses.
    const KEYS: [&str; 7] = [
        "magnet",
        "gap_mm",
        "stiffness_x_n_per_mm",
        "stiffness_z_n_per_mm",
        "force_range_n",
        "sensors",
        POLE_PAIRS,
    ];

    /// Pole pairs of the motor, where they are stated.
    pub fn pole_pairs(&self) -> Option<f64> {
        let value = self.more.get(POLE_PAIRS)?;
        value.as_float().or_else(|| value.as_integer().map(|n| n as f64))
    }

    /// Quantities that must be positive, by key.
    pub fn positive_values(&self) -> Vec<(&'static str, f64)> {
        let mut values = vec![
            ("design.gap_mm", self.gap_mm),
            ("design.stiffness_x_n_per_mm", self.stiffness_x_n_per_mm),
            ("design.stiffness_z_n_per_mm", self.stiffness_z_n_per_mm),
            ("design.magnet.remanence_t", self.magnet.remanence_t.abs()),
            ("design.force_range_n", self.force_range_n()),
            ("design.sensors", f64::from(self.sensors())),
        ];
        values.extend(self.magnet.shape.dimensions());
        values
    }
}

impl MagnetShape {
    /// Dimensions that must be positive, by key; of a tube also its wall.
    fn dimensions(self) -> Vec<(&'static str, f64)> {
        const DIAMETER: &str = "design.magnet.diameter_mm";
        const LENGTH: &str = "design.magnet.length_mm";
        match self {
            Self::Cylinder { diameter_mm, length_mm } => {
                vec![(DIAMETER, diameter_mm), (LENGTH, length_mm)]
            }
            Self::Tube { diameter_mm, hole_mm, length_mm } => vec![
                (DIAMETER, diameter_mm),
                ("design.magnet.hole_mm", hole_mm),
                ("design.magnet.diameter_mm less its hole", diameter_mm - hole_mm),
                (LENGTH, length_mm),
            ],
            Self::Cube { side_mm } => vec![("design.magnet.side_mm", side_mm)],
            Self::Sphere { diameter_mm } => vec![(DIAMETER, diameter_mm)],
        }
    }
}

impl MagnetAxis {
    /// Unit vector along the axis.
    pub fn unit(self) -> Vector3<f64> {
        match self {
            Self::X => Vector3::x(),
            Self::Y => Vector3::y(),
            Self::Z => Vector3::z(),
        }
    }
}

impl RecordingDescription {
    /// A description with the required keys only.
    pub fn new(description: impl Into<String>, start_s: f64) -> Self {
        Self {
            format: FORMAT,
            description: description.into(),
            recorded: None,
            start_s,
            start: None,
            clock: None,
            joined: Vec::new(),
            gauss_per_lsb: None,
            range_gauss: None,
            covariates: Vec::new(),
            design: None,
            unknown: toml::Table::new(),
        }
    }

    /// Reads and validates `recording.toml` in `folder`; unrecognised keys become notices.
    pub fn read(folder: &Path) -> Result<(Self, Vec<Notice>), DataError> {
        let path = folder.join(RECORDING_FILE);
        let text = input::read_text(&path).map_err(|error| match &*error.kind {
            ErrorKind::Unreadable(cause) if cause.kind() == std::io::ErrorKind::NotFound => {
                ErrorKind::MissingFile {
                    name: RECORDING_FILE,
                    advice: "it needs at least `format = 1`, for drift `start_s`, and, for raw counts, `gauss_per_lsb`",
                }
                .at(Location::file(folder))
            }
            _ => error,
        })?;
        let mut description: Self = parse_toml(&path, &text)?;
        let has_start = parse_toml::<toml::Table>(&path, &text)?.contains_key("start_s");
        if !has_start {
            description.start = Some(TimeOrigin::Assumed);
        }
        description.check(&path)?;
        let notices = description.unknown_keys(&path);
        Ok((description, notices))
    }

    /// Writes `recording.toml` into `folder`.
    pub fn write(&self, folder: &Path) -> Result<(), DataError> {
        let path = folder.join(RECORDING_FILE);
        let text = toml::to_string(self)
            .map_err(|error| ErrorKind::Toml(error.to_string()).at(Location::file(&path)))?;
        std::fs::write(&path, text)
            .map_err(|error| ErrorKind::Unwritable(error).at(Location::file(&path)))
    }

    /// Noise of a row of this column relative to what its differences from row to row show.
    pub fn noise_factor(&self, column: &str) -> f64 {
        let is_own = |channel: &&JoinedChannel| channel.columns.iter().any(|own| own == column);
        self.joined.iter().find(is_own).map_or(1.0, |channel| channel.noise_factor)
    }

    /// Whether the start of the recording is unknown.
    pub fn is_start_assumed(&self) -> bool {
        self.start == Some(TimeOrigin::Assumed)
    }

    /// Whether the times of the rows are unknown.
    pub fn is_clock_assumed(&self) -> bool {
        self.clock == Some(TimeOrigin::Assumed)
    }

    /// Magnitude in gauss from which a sample counts as saturated; `is_raw`: recorded as raw counts.
    pub fn saturated_gauss(&self, is_raw: bool) -> f64 {
        // One step below full scale: the last code of the converter is below the nominal range.
        match self.range_gauss {
            Some(range) if is_raw => range - 1.5 * self.gauss_per_lsb.unwrap_or(1.0),
            Some(range) => range,
            None => f64::INFINITY,
        }
    }

    fn check(&self, path: &Path) -> Result<(), DataError> {
        let bad = |key: &str, found: String, advice: &str| {
            let location = Location::file(path).column(key);
            Err(ErrorKind::bad_value(found, advice).at(location))
        };
        if self.format != FORMAT {
            let advice = format!("this tool reads format = {FORMAT}");
            return bad("format", self.format.to_string(), &advice);
        }
        if !(-MAX_START_S..=MAX_START_S).contains(&self.start_s) {
            let advice =
                format!("give the seconds since the start of the campaign, up to {MAX_START_S:e}");
            return bad("start_s", format!("{:?}", self.start_s), &advice);
        }
        let scale = [("gauss_per_lsb", self.gauss_per_lsb), ("range_gauss", self.range_gauss)];
        let design = self.design.as_ref().map_or_else(Vec::new, NominalDesign::positive_values);
        let stated = scale.into_iter().filter_map(|(key, value)| Some((key, value?)));
        for (key, value) in stated.chain(design) {
            if !(value.is_finite() && value > 0.0) {
                return bad(key, format!("{value:?}"), "give a positive number");
            }
            check_plausible(key, value)
                .map_err(|kind| kind.at(Location::file(path).column(key)))?;
        }
        if self.covariates.len() > MAX_COLUMNS {
            let kind = ErrorKind::TooManyColumns { found: self.covariates.len(), max: MAX_COLUMNS };
            return Err(kind.at(Location::file(path).column("covariates")));
        }
        for channel in &self.joined {
            if !(0.01..=100.0).contains(&channel.noise_factor) {
                let found = format!("{:?}", channel.noise_factor);
                return bad("joined.noise_factor", found, "give a factor of 0.01 to 100");
            }
        }
        for name in &self.covariates {
            if column_unit(name).is_none() {
                let units = column_units().join(", ");
                let advice = format!("end the name in its unit ({units}), for example robot_z_mm");
                return bad("covariates", format!("{name:?}"), &advice);
            }
        }
        Ok(())
    }

    fn unknown_keys(&self, path: &Path) -> Vec<Notice> {
        let notice = |key: &String, remedy: &str| Notice {
            location: Location::file(path).column(key.as_str()),
            message: format!("unknown key, ignored; {remedy}"),
        };
        let unknown = self.unknown.keys().map(|key| notice(key, "check its spelling"));
        // Designs have further keys, but none that nearly is a key of the fit.
        let more = self.design.iter().flat_map(|design| design.more.keys());
        let misspelt = more.filter(|key| *key != POLE_PAIRS).filter_map(|key| {
            let near = closest_match(key, NominalDesign::KEYS)?;
            Some(notice(key, &format!("did you mean {near}?")))
        });
        unknown.chain(misspelt).collect()
    }
}

/// Parses TOML; errors have the line.
pub fn parse_toml<T: serde::de::DeserializeOwned>(path: &Path, text: &str) -> Result<T, DataError> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let mut location = Location::file(path);
        if let Some(span) = error.span() {
            let before = text.get(..span.start).unwrap_or(text);
            location = location.line(before.matches('\n').count() as u64 + 1);
        }
        ErrorKind::Toml(with_nearest_key(error.message().replace('\n', " "))).at(location)
    })
}

/// The message of an unknown key with the nearest of the keys that it lists.
fn with_nearest_key(message: String) -> String {
    let mut keys = message.split('`').skip(1).step_by(2);
    let unknown = keys.next().filter(|_| message.starts_with("unknown field"));
    match unknown.and_then(|unknown| closest_match(unknown, keys)) {
        Some(nearest) => format!("{message} (did you mean `{nearest}`?)"),
        None => message,
    }
}
