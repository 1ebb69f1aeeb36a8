//! Measures the temperatures of chip, motor and power stage twenty times a second.

use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::clock::{Clock, delay_us};
use crate::motor::limits::Temperatures;
use crate::tasks::SharedState;

/// Time between two measurements: half of the time in which an overheated power stage must be detected.
const PERIOD_US: u64 = 50_000;

/// Temperatures of a board in degrees Celsius.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BoardTemperatures {
    /// Of the microcontroller.
    pub mcu: Option<f32>,
    /// Of motor and power stage, which limit the current.
    pub motor: Temperatures,
}

impl BoardTemperatures {
    /// Before the first measurement.
    pub const UNKNOWN: Self = Self { mcu: None, motor: Temperatures { motor: None, stage: None } };
}

/// Publishes the temperatures; `measure` returns them.
pub async fn temperatures<C: Clock, M: RawMutex>(
    mut measure: impl FnMut() -> BoardTemperatures,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    loop {
        shared.temperatures.set(measure());
        delay_us(clock, PERIOD_US).await;
    }
}
