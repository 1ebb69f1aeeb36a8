//! Mountings of the sensors of a simulated gripper.

use std::collections::BTreeMap;
use std::str::FromStr;

use anyhow::{Result, bail};
use model_export::physics::SensorMounting;

/// Mounting of one sensor, as given to `simulate`: `SENSOR=+y-x+z`, or `SENSOR=+y-x+z:reversed` with an exchanged polarity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MountedSensor {
    sensor: u32,
    mounting: SensorMounting,
}

impl FromStr for MountedSensor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (sensor, mounting) =
            text.split_once('=').ok_or("give SENSOR=AXES, such as 2=+y-x+z")?;
        let no_number = |_| format!("{sensor} is no number of a sensor");
        Ok(Self { sensor: sensor.parse().map_err(no_number)?, mounting: mounting.parse()? })
    }
}

/// Mountings by sensor; nominal where there is none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mountings(BTreeMap<u32, SensorMounting>);

impl Mountings {
    /// Of these sensors of a gripper with `count` of them.
    ///
    /// # Errors
    /// A sensor is given twice, or the gripper does not have it.
    pub fn new(sensors: &[MountedSensor], count: u32) -> Result<Self> {
        let mut mountings = BTreeMap::new();
        for &MountedSensor { sensor, mounting } in sensors {
            if sensor >= count {
                bail!(
                    "orientation of sensor {sensor}: the gripper has {count} sensors, numbered from 0"
                );
            }
            if mountings.insert(sensor, mounting).is_some() {
                bail!("orientation of sensor {sensor} is given twice");
            }
        }
        Ok(Self(mountings))
    }

    /// Mounting of a sensor.
    pub fn of(&self, sensor: u32) -> SensorMounting {
        self.0.get(&sensor).copied().unwrap_or_default()
    }
}

impl FromIterator<(u32, SensorMounting)> for Mountings {
    fn from_iter<I: IntoIterator<Item = (u32, SensorMounting)>>(mountings: I) -> Self {
        let nominal = SensorMounting::default();
        Self(mountings.into_iter().filter(|(_, mounting)| *mounting != nominal).collect())
    }
}
