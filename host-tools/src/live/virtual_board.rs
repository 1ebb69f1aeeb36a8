//! The board in virtual time, which keeps to the wall's clock: the firmware's own loops with a serial line
//! that other programs can open.

#[cfg(unix)]
mod running;
pub mod world;

#[cfg(unix)]
pub use running::VirtualBoard;

use firmware::frame::SENSORS;

/// A sensor whose connector comes off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unplug {
    /// Its number.
    pub sensor: usize,
    /// When, in seconds since the board's start.
    pub at_s: f64,
}

impl std::str::FromStr for Unplug {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("write SENSOR@SECONDS, as 2@5, with a sensor below {SENSORS}");
        let (sensor, seconds) = text.split_once('@').ok_or_else(wrong)?;
        let sensor = sensor.parse().ok().filter(|sensor| *sensor < SENSORS);
        let at_s = seconds.parse().ok();
        let at_s = at_s.filter(|at_s: &f64| at_s.is_finite() && *at_s >= 0.0);
        Ok(Self {
            sensor: sensor.ok_or_else(wrong)?,
            at_s: at_s.ok_or_else(wrong)?,
        })
    }
}

/// There is none without pseudo terminals.
#[cfg(not(unix))]
pub enum VirtualBoard {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unplugging_is_a_sensor_and_a_time() {
        let unplug = Unplug {
            sensor: 2,
            at_s: 5.5,
        };
        assert_eq!("2@5.5".parse(), Ok(unplug));
        for wrong in ["2", "4@1", "2@-1", "2@nan", "x@1", "@"] {
            assert!(wrong.parse::<Unplug>().is_err(), "{wrong}");
        }
    }
}
