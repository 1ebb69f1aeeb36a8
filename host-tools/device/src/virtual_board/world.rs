//! Input of the virtual board's sensors, and their disconnection.

use std::f64::consts::TAU;
use std::path::PathBuf;
use std::str::FromStr;

use firmware::sensors::hall::SENSORS;
use model_export::inverse::build::DeviceModel;
use model_export::recordings::DataError;
use model_export::recordings::align::Alignment;
use model_export::recordings::stream::RawStream;

use sim::board::world::{PressedWorld, RecordedWorld, World};

/// Seed of the sensor noise.
const SEED: u64 = 1;
/// Duration of a grasp in seconds, and its longitudinal and lateral force per sensor.
const GRASP_S: f64 = 8.0;
const GRASP_N: f64 = 40.0;
const ACROSS_N: f64 = 12.0;

/// Simulated environment.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorInput {
    /// Periodic grasps of an object.
    Grasps,
    /// Constant forces in newtons on each finger: lateral, against the other
    /// finger, and longitudinal.
    Pressed([f64; 2]),
    /// Replay of a recording.
    Recorded(PathBuf),
}

impl SensorInput {
    /// Opens the recording; `None` for other inputs.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn stream(&self) -> Result<Option<RawStream>, DataError> {
        match self {
            Self::Recorded(folder) => {
                RawStream::open_folder(folder, Alignment { delay_us: 0.0 }).map(Some)
            }
            Self::Grasps | Self::Pressed(_) => Ok(None),
        }
    }

    /// Simulation input, from the recording where there is one.
    pub fn world(&self, stream: Option<RawStream>, built: &DeviceModel) -> Box<dyn World> {
        let (model, pressed) = (&built.model, |newtons: [f64; 2]| {
            let [x, z] = newtons;
            [[x, z], [x, z], [-x, z], [-x, z]]
        });
        match (self, stream) {
            (_, Some(stream)) => Box::new(RecordedWorld::new(stream, built)),
            (Self::Pressed(newtons), None) => {
                let forces = pressed(*newtons);
                Box::new(PressedWorld::new(model, SEED, move |_| forces))
            }
            (_, None) => Box::new(PressedWorld::new(model, SEED, move |s| pressed(grasp(s)))),
        }
    }
}

/// Lateral and longitudinal force of a grasp over time: one second without load for the tare.
fn grasp(seconds: f64) -> [f64; 2] {
    let phase = TAU * (seconds - 1.0).max(0.0) / GRASP_S;
    [
        GRASP_N * (1.0 - phase.cos()) / 2.0,
        ACROSS_N * (1.0 - phase.cos()) / 2.0 * (2.0 * phase).sin(),
    ]
}

/// Maximum time of a disconnection in seconds: the end of a day.
const MAX_UNPLUG_S: f64 = 86_400.0;

/// Simulated disconnection of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unplug {
    pub sensor: usize,
    /// Time in seconds since the board's start.
    pub at_s: f64,
}

impl FromStr for Unplug {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("write SENSOR@SECONDS, as 2@5, with a sensor below {SENSORS}");
        let (sensor, seconds) = text.split_once('@').ok_or_else(wrong)?;
        let sensor = sensor.parse().ok().filter(|sensor| *sensor < SENSORS);
        let at_s = seconds.parse().ok();
        let at_s = at_s.filter(|at_s| (0.0..=MAX_UNPLUG_S).contains(at_s));
        Ok(Self { sensor: sensor.ok_or_else(wrong)?, at_s: at_s.ok_or_else(wrong)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unplug_is_parsed_from_sensor_and_time() {
        let unplug = Unplug { sensor: 2, at_s: 5.5 };
        assert_eq!("2@5.5".parse(), Ok(unplug));
        for wrong in ["2", "4@1", "2@-1", "2@nan", "2@1e308", "x@1", "@"] {
            assert!(wrong.parse::<Unplug>().is_err(), "{wrong}");
        }
    }
}
