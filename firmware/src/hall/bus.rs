//! A bus with sensors on it: transfers that end in time, and the way out when a line is held low.
//!
//! A sensor that lost count in the middle of a byte may hold the data line low; no start is possible
//! then. Nine clocks bring it to the end of whatever it sends, and a stop ends the transfer (UM10204,
//! 3.1.16).

use embedded_hal_async::i2c::I2c;

use crate::clock::{Clock, pause};

/// A bus that can be cleared.
pub trait SensorBus: I2c {
    /// Clears the lines and starts the peripheral anew; says whether both lines are free then.
    fn recover(&mut self) -> impl Future<Output = bool>;
}

/// The lines of a bus as pins: open drain, pulled up.
pub trait Lines {
    /// Lets the clock rise, or pulls it low.
    fn set_clock(&mut self, high: bool);
    /// Lets the data rise, or pulls them low.
    fn set_data(&mut self, high: bool);
    /// The levels of clock and data.
    fn levels(&mut self) -> [bool; 2];
}

/// Half a period of the clock while lines are cleared: 100 kHz, which every part follows.
pub const HALF_PERIOD_US: u64 = 5;
/// Clocks that bring any part to the end of its byte and past the acknowledge.
const CLOCKS: u8 = 9;

/// Sends nine clocks and a stop; says whether both lines are high in the end. Takes 105 us.
pub async fn clear<L: Lines, C: Clock>(lines: &mut L, clock: &C) -> bool {
    lines.set_data(true);
    for _ in 0..CLOCKS {
        lines.set_clock(false);
        pause(clock, HALF_PERIOD_US).await;
        lines.set_clock(true);
        pause(clock, HALF_PERIOD_US).await;
    }
    // A stop: data rise while the clock is high.
    lines.set_clock(false);
    lines.set_data(false);
    pause(clock, HALF_PERIOD_US).await;
    lines.set_clock(true);
    pause(clock, HALF_PERIOD_US).await;
    lines.set_data(true);
    pause(clock, HALF_PERIOD_US).await;
    lines.levels() == [true; 2]
}
