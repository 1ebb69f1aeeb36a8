//! The firmware's tasks in virtual time, synchronised to the wall clock, with a serial line that other programs can
//! open.

#[cfg(unix)]
mod running;
pub mod world;

#[cfg(unix)]
pub use running::VirtualBoard;

use firmware::sensors::hall::SENSORS;

/// Maximum time of a disconnection in seconds: the end of a day.
const MAX_UNPLUG_S: f64 = 86_400.0;

/// Simulated disconnection of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unplug {
    pub sensor: usize,
    /// Time in seconds since the board's start.
    pub at_s: f64,
}

impl std::str::FromStr for Unplug {
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

/// Not available without pseudo terminals.
#[cfg(not(unix))]
pub enum VirtualBoard {}

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
