//! Three-axis Hall sensors: what a reading is, the parts that give one, and whether they still do.

pub mod a31301;
pub mod als31300;
pub mod bus;
pub mod read_back;
pub mod registers;
pub mod watch;

use embedded_hal_async::i2c::I2c;

/// One reading of one sensor, in the units of the model's tables whatever the part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    /// Field in counts of 0.125 G: x, y, z.
    pub field: [i16; 3],
    /// Temperature in counts of 1/8 K from 25 C; for the A31301 the scale is assumed.
    pub temperature: i16,
}

/// What a transfer gave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sample {
    /// A reading.
    New(Reading),
    /// The part says that nothing is new since the last transfer.
    Old,
}

/// A kind of sensor.
pub trait Part {
    /// Addresses that its straps can give, in the order of the gripper's sensors.
    const ADDRESSES: [u8; 4];

    /// First register of a reading.
    const READING: u8;

    /// First register of what the part is configured as ([`read_back`]).
    const CONFIGURATION: u8;

    /// The reading in the bytes of one transfer.
    fn decode(bytes: [u8; TRANSFER_BYTES]) -> Sample;
}

/// Reads registers from this one on, in one transfer: no other call of a bus driver ends when a sensor holds the
/// clock.
///
/// # Errors
/// The bus's.
pub async fn read<B: I2c>(
    bus: &mut B,
    address: u8,
    register: u8,
    bytes: &mut [u8],
) -> Result<(), B::Error> {
    bus.write_read(address, &[register], bytes).await
}

/// Bytes of a reading, the same for every part.
pub const TRANSFER_BYTES: usize = 8;
/// Bytes of the word that is read back ([`read_back`]).
pub const WORD_BYTES: usize = 2;
