//! Inertial sensors, which the compensation of the fingertip's weight and inertia needs. Without one the estimator
//! works, flags the missing input and skips these effects.
//!
//! The driver is for the ST LSM6DS3TR-C: acceleration and angular rate over I2C (datasheet DocID030071).

use embedded_hal_async::i2c::I2c;

use crate::fixed_point::mul_q;

/// One measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuReading {
    /// Specific force (gravity included) in mm/s^2, sensor axes.
    pub acceleration: [i32; 3],
    /// Angular rate in millidegrees per second.
    pub turn: [i32; 3],
}

/// A sensor of specific force and angular rate.
pub trait Imu {
    /// Error of its bus.
    type Error;

    /// Checks the part's identity and configures it.
    fn start(&mut self) -> impl Future<Output = Result<(), ImuError<Self::Error>>>;

    /// Reads one measurement.
    fn read(&mut self) -> impl Future<Output = Result<ImuReading, ImuError<Self::Error>>>;
}

/// Reason of a failed access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuError<E> {
    /// The bus failed.
    Bus(E),
    /// A part with this other identity answered.
    UnexpectedDevice(u8),
}

impl<E> From<E> for ImuError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// 7-bit address with SA0 low; 0x6B with SA0 high.
pub const ADDRESS: u8 = 0x6A;

const WHO_AM_I: u8 = 0x0F;
const IDENTITY: u8 = 0x6A;
const CTRL1_XL: u8 = 0x10;
const CTRL2_G: u8 = 0x11;
const CTRL3_C: u8 = 0x12;
const OUTX_L_G: u8 = 0x22;

/// 833 Hz, +-4 g.
const ACCELERATION_SETTING: u8 = 0b0111_1000;
/// 833 Hz, +-2000 degrees per second.
const RATE_SETTING: u8 = 0b0111_1100;
/// Block data update and auto-increment of the register address.
const BLOCK_UPDATE: u8 = 0b0100_0100;

/// At +-4 g a count is 0.122 mg; 0.122e-3 * 9806.65 mm/s^2 = 1.1964113, with 16 fractional bits.
const ACCELERATION_PER_COUNT: i32 = 78_408;
/// At +-2000 degrees per second a count is 70 millidegrees per second.
const RATE_PER_COUNT: i32 = 70;

/// LSM6DS3TR-C on an I2C bus.
pub struct Lsm6ds3<B> {
    bus: B,
    address: u8,
}

impl<B> Lsm6ds3<B> {
    /// Driver of the part at `address`; no access yet.
    pub const fn new(bus: B, address: u8) -> Self {
        Self { bus, address }
    }
}

impl<B: I2c> Imu for Lsm6ds3<B> {
    type Error = B::Error;

    async fn start(&mut self) -> Result<(), ImuError<B::Error>> {
        let mut identity = [0];
        self.bus.write_read(self.address, &[WHO_AM_I], &mut identity).await?;
        let [found] = identity;
        if found != IDENTITY {
            return Err(ImuError::UnexpectedDevice(found));
        }
        for setting in
            [[CTRL3_C, BLOCK_UPDATE], [CTRL1_XL, ACCELERATION_SETTING], [CTRL2_G, RATE_SETTING]]
        {
            self.bus.write(self.address, &setting).await?;
        }
        Ok(())
    }

    async fn read(&mut self) -> Result<ImuReading, ImuError<B::Error>> {
        let mut bytes = [0; 12];
        self.bus.write_read(self.address, &[OUTX_L_G], &mut bytes).await?;
        Ok(decode(bytes))
    }
}

/// Decodes angular rate and acceleration (little-endian, in this order), as the LSM6DS3 sends them.
pub fn decode(bytes: [u8; 12]) -> ImuReading {
    let [gx0, gx1, gy0, gy1, gz0, gz1, ax0, ax1, ay0, ay1, az0, az1] = bytes;
    let word = |low, high| i32::from(i16::from_le_bytes([low, high]));
    let turn = [word(gx0, gx1), word(gy0, gy1), word(gz0, gz1)];
    let acceleration = [word(ax0, ax1), word(ay0, ay1), word(az0, az1)];
    ImuReading {
        acceleration: acceleration.map(|counts| mul_q(counts, ACCELERATION_PER_COUNT, 16)),
        turn: turn.map(|counts| counts * RATE_PER_COUNT),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decode_scales_acceleration_and_rate() {
        // 8197 counts of 0.122 mg are 1 g; -1 count of rate is -70 millidegrees per second.
        let bytes = [0xFF, 0xFF, 0, 0, 1, 0, 0x05, 0x20, 0, 0, 0xFB, 0xDF];
        let reading = decode(bytes);
        assert_eq!(reading.turn, [-70, 0, 70]);
        assert!(
            (reading.acceleration[0] - 9807).abs() <= 1
                && (reading.acceleration[2] + 9807).abs() <= 1
        );
    }
}
