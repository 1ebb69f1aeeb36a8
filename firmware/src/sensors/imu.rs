//! Inertial sensors, which the compensation of the fingertip's weight and inertia needs. Without one the estimator
//! works, flags the missing input and skips these effects.
//!
//! The driver is for the ST LSM6DS3TR-C: acceleration and angular rate over SPI (datasheet DocID030071). Its I2C interface
//! is limited to 400 kHz and cannot share the 1 MHz buses of the Hall sensors.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::SpiDevice;

use crate::fixed_point::mul_q;

/// One measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuReading {
    /// Specific force (gravity included) in mm/s^2, sensor axes.
    pub acceleration: [i32; 3],
    /// Angular rate in millidegrees per second.
    pub rate: [i32; 3],
}

/// Rotation from the axes of the inertial sensor to those of the gripper, by rows: assumed, the paper names no inertial
/// sensor. A board with another mounting changes it here.
pub const IMU_AXES: [[i8; 3]; 3] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/// A sensor of specific force and angular rate.
pub trait Imu {
    /// Error of its bus.
    type Error;

    /// Checks the part's identity and configures it.
    fn start(
        &mut self,
        delay: &mut impl DelayNs,
    ) -> impl Future<Output = Result<(), ImuError<Self::Error>>>;

    /// Reads one measurement.
    fn read(&mut self) -> impl Future<Output = Result<ImuReading, ImuError<Self::Error>>>;
}

/// Reason of a failed access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImuError<E> {
    /// The bus failed.
    Bus(E),
    /// A part with this other identity answered; 0 or 0xFF: none.
    UnexpectedDevice(u8),
    /// This register did not accept its setting.
    NotConfigured(u8),
}

impl<E> From<E> for ImuError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// Bit of the register address that makes a transfer a read.
const READ: u8 = 1 << 7;
const WHO_AM_I: u8 = 0x0F;
const IDENTITY: u8 = 0x6A;
const CTRL1_XL: u8 = 0x10;
const CTRL2_G: u8 = 0x11;
const CTRL3_C: u8 = 0x12;
const OUTX_L_G: u8 = 0x22;

/// Registers and their settings: block data update and auto-increment of the register address; 833 Hz, +-4 g; 833 Hz,
/// +-2000 degrees per second.
const SETTINGS: [(u8, u8); 3] =
    [(CTRL3_C, 0b0100_0100), (CTRL1_XL, 0b0111_1000), (CTRL2_G, 0b0111_1100)];

/// Time from power-up to the first access in milliseconds.
const POWER_UP_MS: u32 = 15;
/// Attempts to read the identity.
const START_ATTEMPTS: u8 = 3;

/// At +-4 g a count is 0.122 mg; 0.122e-3 * 9806.65 mm/s^2 = 1.1964113, with 16 fractional bits.
const ACCELERATION_PER_COUNT: i32 = 78_408;
/// At +-2000 degrees per second a count is 70 millidegrees per second.
const RATE_PER_COUNT: i32 = 70;

/// LSM6DS3TR-C on an SPI bus, mode 3 (or 0), at most 10 MHz.
#[derive(Debug)]
pub struct Lsm6ds3<D>(D);

impl<D: SpiDevice> Lsm6ds3<D> {
    /// Driver of a part; no access yet.
    pub const fn new(device: D) -> Self {
        Self(device)
    }

    async fn read_register(&mut self, register: u8) -> Result<u8, D::Error> {
        let mut bytes = [READ | register, 0];
        self.0.transfer_in_place(&mut bytes).await?;
        let [_, value] = bytes;
        Ok(value)
    }

    /// Writes the settings and reads them back: a write over SPI is not acknowledged.
    async fn configure(&mut self) -> Result<(), ImuError<D::Error>> {
        for (register, setting) in SETTINGS {
            self.0.transfer_in_place(&mut [register, setting]).await?;
            if self.read_register(register).await? != setting {
                return Err(ImuError::NotConfigured(register));
            }
        }
        Ok(())
    }
}

impl<D: SpiDevice> Imu for Lsm6ds3<D> {
    type Error = D::Error;

    async fn start(&mut self, delay: &mut impl DelayNs) -> Result<(), ImuError<D::Error>> {
        let mut identity = self.read_register(WHO_AM_I).await?;
        for _ in 1..START_ATTEMPTS {
            if identity == IDENTITY {
                break;
            }
            delay.delay_ms(POWER_UP_MS).await;
            identity = self.read_register(WHO_AM_I).await?;
        }
        if identity != IDENTITY {
            return Err(ImuError::UnexpectedDevice(identity));
        }
        self.configure().await
    }

    async fn read(&mut self) -> Result<ImuReading, ImuError<D::Error>> {
        // One transfer, so that the bus is set up once.
        let mut bytes = [0; 13];
        let [command, ..] = &mut bytes;
        *command = READ | OUTX_L_G;
        self.0.transfer_in_place(&mut bytes).await?;
        let [_, registers @ ..] = bytes;
        // A sensor that does not answer leaves its line high or low; a live one shows noise.
        for level in [0x00, 0xFF] {
            if registers == [level; 12] {
                return Err(ImuError::UnexpectedDevice(level));
            }
        }
        Ok(decode(registers))
    }
}

/// Decodes angular rate and acceleration (little-endian, in this order), as the LSM6DS3 sends them.
pub fn decode(bytes: [u8; 12]) -> ImuReading {
    let [gx0, gx1, gy0, gy1, gz0, gz1, ax0, ax1, ay0, ay1, az0, az1] = bytes;
    let word = |low, high| i32::from(i16::from_le_bytes([low, high]));
    let rate = [word(gx0, gx1), word(gy0, gy1), word(gz0, gz1)];
    let acceleration = [word(ax0, ax1), word(ay0, ay1), word(az0, az1)];
    ImuReading {
        acceleration: acceleration.map(|counts| mul_q(counts, ACCELERATION_PER_COUNT, 16)),
        rate: rate.map(|counts| counts * RATE_PER_COUNT),
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
        assert_eq!(reading.rate, [-70, 0, 70]);
        assert!(
            (reading.acceleration[0] - 9807).abs() <= 1
                && (reading.acceleration[2] + 9807).abs() <= 1
        );
    }
}
