//! Three-axis Hall sensors: the trait of a driver, the frame of all sensors, and the I2C bus they share.
//!
//! A new part is a file with an implementation of [`HallSensor`]; [`GripperHallSensor`] selects the part.

pub mod a31301;
pub mod als31300;
pub mod config_readback;
pub mod liveness;

use embedded_hal_async::i2c::I2c;

use crate::clock::{Clock, delay_us};

/// The part on the gripper. Portable, because the default parameters depend on its addresses.
#[cfg(not(feature = "als31300"))]
pub type GripperHallSensor = a31301::A31301;
/// The part on the gripper. Portable, because the default parameters depend on its addresses.
#[cfg(feature = "als31300")]
pub type GripperHallSensor = als31300::Als31300;

/// Number of Hall sensors of the gripper.
pub const SENSORS: usize = crate::config::constants::SENSORS.value as usize;
/// Sensors that are read first, one on each bus; then the others.
pub const FIRST_SENSORS: [bool; SENSORS] = [true, false, true, false];
/// Bytes of a measurement on the bus, equal for all parts.
pub const TRANSFER_BYTES: usize = 8;
/// Bytes of the configuration word ([`config_readback`]).
pub const WORD_BYTES: usize = 2;

/// One measurement, in units that are the same for all parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HallReading {
    /// Field along x, y, z in counts of 0.125 G.
    pub field: [i16; 3],
    /// Temperature in counts of 1/8 K relative to 25 C; for the A31301 the scale is assumed.
    pub temperature: i16,
}

/// Temperature in degrees Celsius of a reading's counts, for the status of the board.
pub fn celsius(counts: i16) -> f32 {
    const ZERO_C: f32 = 25.0;
    ZERO_C + f32::from(counts) / crate::config::constants::TEMPERATURE_SCALE.value as f32
}

/// Result of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HallSample {
    /// A new measurement.
    New(HallReading),
    /// The part reports no new data since the last transfer.
    Stale,
}

/// Measurements of all sensors in one tick of 1 ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HallFrame {
    /// Start of the tick in microseconds of the board's clock, wrapping.
    pub time_us: u32,
    /// One reading per sensor; `None` if its transfer failed or its data are unusable.
    pub readings: [Option<HallReading>; SENSORS],
}

/// Register map and data format of a Hall sensor.
pub trait HallSensor {
    /// 7-bit addresses of the sensors, in the order of the gripper's sensors.
    const ADDRESSES: [u8; 4];

    /// First register of a measurement.
    const READING: u8;

    /// Register of the configuration word ([`config_readback`]).
    const CONFIGURATION: u8;

    /// Minimum and maximum of a field axis in [`HallReading`] counts, at which the sensor saturates.
    const FIELD_LIMITS: (i16, i16);

    /// Decodes the bytes of a measurement.
    fn decode(bytes: [u8; TRANSFER_BYTES]) -> HallSample;
}

/// Reads consecutive registers in a single transfer, the only kind of call with a timeout when a sensor
/// stretches the clock forever.
///
/// # Errors
/// Errors of the bus.
pub async fn read_registers<B: I2c>(
    bus: &mut B,
    address: u8,
    register: u8,
    bytes: &mut [u8],
) -> Result<(), B::Error> {
    bus.write_read(address, &[register], bytes).await
}

/// An I2C bus with transfers of bounded duration and a recovery from stuck lines.
pub trait SensorBus: I2c {
    /// Clears the bus and re-initialises the peripheral. Returns whether both lines are high afterwards.
    fn recover(&mut self) -> impl Future<Output = bool>;
}

/// The lines of an I2C bus as open-drain pins with pull-up.
pub trait BusLines {
    /// Releases the clock line, or pulls it low.
    fn set_clock(&mut self, high: bool);
    /// Releases the data line, or pulls it low.
    fn set_data(&mut self, high: bool);
    /// Levels of clock and data.
    fn levels(&mut self) -> [bool; 2];
}

/// Half a clock period during a bus clear: 100 kHz, within the range of every part.
pub const HALF_PERIOD_US: u64 = 5;
/// Enough for any part to complete its byte and the acknowledge.
const CLOCKS: u8 = 9;

/// Bus clear (UM10204, 3.1.16): a sensor that lost a clock edge may pull the data line low and block every
/// start condition. Nine clocks complete its byte, then a stop ends the transfer. Takes 105 us; returns whether
/// both lines are high afterwards.
pub async fn clear_bus<L: BusLines, C: Clock>(lines: &mut L, clock: &C) -> bool {
    lines.set_data(true);
    for _ in 0..CLOCKS {
        lines.set_clock(false);
        delay_us(clock, HALF_PERIOD_US).await;
        lines.set_clock(true);
        delay_us(clock, HALF_PERIOD_US).await;
    }
    // Stop condition: rising data while the clock is high.
    lines.set_clock(false);
    lines.set_data(false);
    delay_us(clock, HALF_PERIOD_US).await;
    lines.set_clock(true);
    delay_us(clock, HALF_PERIOD_US).await;
    lines.set_data(true);
    delay_us(clock, HALF_PERIOD_US).await;
    lines.levels() == [true; 2]
}
