//! Mounting of a Hall sensor and its magnet: orientation by right angles, polarity.
//!
//! Small angles, and the deviation of the remanence, are parameters of the [`ForwardModel`].

use std::fmt;
use std::str::FromStr;

use firmware::model::axis_map::AxisMap;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::physics::ForwardModel;
use crate::recordings::columns::Axis;

/// Orientation of a Hall sensor by right angles. Its text is the gripper's axis along each axis of the sensor, x to z: `+y-x+z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SensorOrientation(AxisMap);

/// Orientation and polarity. Its text is that of the orientation, with `:reversed` where the poles of the magnet are exchanged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorMounting {
    /// Orientation of the sensor.
    pub orientation: SensorOrientation,
    /// Whether the remanence has the opposite sign of the design's.
    pub is_reversed: bool,
}

impl SensorOrientation {
    /// All 24 orientations.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..0o1000).map(AxisMap).filter(|map| map.is_rotation()).map(Self)
    }

    /// Whether the sensor's axes are those of the gripper.
    pub fn is_nominal(&self) -> bool {
        self.0 == AxisMap::NOMINAL
    }

    /// The map that the device applies to its readings.
    pub fn axis_map(self) -> AxisMap {
        self.0
    }

    /// Axis of the sensor along each axis of the gripper, 0 to 2, and whether it points the other way.
    pub(crate) fn sensor_axes(self) -> [(usize, bool); 3] {
        self.0.axes().map(|(axis, is_negated)| (axis.into(), is_negated))
    }

    /// Axis of the gripper along each axis of the sensor, 0 to 2, and whether it points the other way.
    pub(crate) fn gripper_axes(self) -> [(usize, bool); 3] {
        let mut axes = [(0, false); 3];
        for (gripper, (sensor, is_negated)) in self.sensor_axes().into_iter().enumerate() {
            axes[sensor] = (gripper, is_negated);
        }
        axes
    }

    /// A field in the sensor's axes, in those of the gripper.
    pub(crate) fn to_gripper(self, field: Vector3<f64>) -> Vector3<f64> {
        self.0.apply(field.into()).into()
    }

    /// A field in the gripper's axes, in those of the sensor.
    pub fn to_sensor(self, field: Vector3<f64>) -> Vector3<f64> {
        let value = |(axis, is_negated): (usize, bool)| {
            if is_negated { -field[axis] } else { field[axis] }
        };
        self.gripper_axes().map(value).into()
    }
}

impl Default for SensorOrientation {
    fn default() -> Self {
        Self(AxisMap::NOMINAL)
    }
}

impl fmt::Display for SensorOrientation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.gripper_axes().iter().try_for_each(|(axis, is_negated)| {
            write!(f, "{}{}", if *is_negated { '-' } else { '+' }, Axis::ALL[*axis].letter())
        })
    }
}

impl FromStr for SensorOrientation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::all().find(|orientation| orientation.to_string() == text).ok_or_else(|| {
            format!(
                "{text} is no orientation: give the gripper's axis along the sensor's x, y and z, which are right-handed: +x+y+z is nominal, +y-x+z is turned about z"
            )
        })
    }
}

impl TryFrom<String> for SensorOrientation {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<SensorOrientation> for String {
    fn from(orientation: SensorOrientation) -> Self {
        orientation.to_string()
    }
}

impl SensorMounting {
    /// The nominal design with this polarity, in the gripper's axes.
    pub fn nominal(self, design: &ForwardModel) -> ForwardModel {
        let sign = if self.is_reversed { -1.0 } else { 1.0 };
        ForwardModel { remanence_t: sign * design.remanence_t, ..*design }
    }

    /// Whether the readings equal those of the nominal mounting with one field column negated or two exchanged.
    pub fn equals_column_error(self) -> bool {
        let axes = self.orientation.sensor_axes();
        let is_in_order = axes.map(|(axis, _)| axis) == [0, 1, 2];
        // The readings are negated by the polarity, and once more where an axis points the other way.
        let negated = axes.iter().filter(|(_, is_negated)| !is_negated).count();
        self.is_reversed && negated == usize::from(is_in_order)
    }
}

impl fmt::Display for SensorMounting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.orientation, if self.is_reversed { REVERSED } else { "" })
    }
}

/// Suffix of an exchanged polarity.
const REVERSED: &str = ":reversed";

impl FromStr for SensorMounting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let axes = text.strip_suffix(REVERSED);
        Ok(Self { orientation: axes.unwrap_or(text).parse()?, is_reversed: axes.is_some() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientations_round_trip_as_text_and_as_fields() {
        let field = Vector3::new(1.0, 20.0, 300.0);
        let mut images = Vec::new();
        for orientation in SensorOrientation::all() {
            assert_eq!(orientation.to_string().parse(), Ok(orientation));
            let reading = orientation.to_sensor(field);
            assert_eq!(orientation.to_gripper(reading), field, "{orientation}");
            assert_eq!(orientation.to_sensor(orientation.to_gripper(field)), field);
            assert!(!images.contains(&reading), "{orientation}");
            images.push(reading);
        }
        assert_eq!(images.len(), 24);
        let turned: SensorOrientation = "+y-x+z".parse().unwrap();
        assert_eq!(turned.to_sensor(field), Vector3::new(20.0, -1.0, 300.0));
        // A mirror, an axis given twice, and text that is none.
        for text in ["-x+y+z", "+x+x+z", "+y-x", "nominal"] {
            assert!(text.parse::<SensorOrientation>().is_err(), "{text}");
        }
    }

    #[test]
    fn six_mountings_equal_one_column_error() {
        let field = Vector3::new(1.0, 20.0, 300.0);
        let errors = [
            [-1.0, 20.0, 300.0],
            [1.0, -20.0, 300.0],
            [1.0, 20.0, -300.0],
            [20.0, 1.0, 300.0],
            [300.0, 20.0, 1.0],
            [1.0, 300.0, 20.0],
        ];
        let mut found = 0;
        for orientation in SensorOrientation::all() {
            for is_reversed in [false, true] {
                let mounting = SensorMounting { orientation, is_reversed };
                assert_eq!(mounting.to_string().parse(), Ok(mounting));
                let sign = if is_reversed { -1.0 } else { 1.0 };
                let reading = orientation.to_sensor(sign * field);
                let is_error = errors.iter().any(|error| reading == Vector3::from(*error));
                assert_eq!(mounting.equals_column_error(), is_error, "{mounting}");
                found += u32::from(is_error);
            }
        }
        assert_eq!(found, 6);
    }
}
