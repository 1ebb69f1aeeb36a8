//! ST LSM6DS3TR-C: three axes of acceleration and of turn over I2C (datasheet DocID030071).

use embedded_hal_async::i2c::I2c;

use super::{Imu, Motion, Trouble};
use crate::fixed::share_of;

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
const TURN_SETTING: u8 = 0b0111_1100;
/// Registers are updated as a whole, and the address moves on by itself.
const WHOLE_SAMPLES: u8 = 0b0100_0100;

/// At +-4 g a count is 0.122 mg; 0.122e-3 * 9806.65 mm/s^2 = 1.1964113, with 16 fractional bits.
const ACCELERATION_PER_COUNT: i32 = 78_408;
/// At +-2000 degrees per second a count is 70 millidegrees per second.
const TURN_PER_COUNT: i32 = 70;

/// The part on its bus.
pub struct Lsm6ds3<B> {
    bus: B,
    address: u8,
}

impl<B> Lsm6ds3<B> {
    /// The part at `address`.
    pub const fn new(bus: B, address: u8) -> Self {
        Self { bus, address }
    }
}

impl<B: I2c> Imu for Lsm6ds3<B> {
    type Error = B::Error;

    async fn start(&mut self) -> Result<(), Trouble<B::Error>> {
        let mut identity = [0];
        self.bus
            .write_read(self.address, &[WHO_AM_I], &mut identity)
            .await?;
        let [found] = identity;
        if found != IDENTITY {
            return Err(Trouble::Stranger(found));
        }
        for setting in [
            [CTRL3_C, WHOLE_SAMPLES],
            [CTRL1_XL, ACCELERATION_SETTING],
            [CTRL2_G, TURN_SETTING],
        ] {
            self.bus.write(self.address, &setting).await?;
        }
        Ok(())
    }

    async fn read(&mut self) -> Result<Motion, Trouble<B::Error>> {
        let mut bytes = [0; 12];
        self.bus
            .write_read(self.address, &[OUTX_L_G], &mut bytes)
            .await?;
        Ok(decode(bytes))
    }
}

/// The reading in the twelve bytes from the first register of the turn on: turn, then acceleration, little-endian.
pub fn decode(bytes: [u8; 12]) -> Motion {
    let [gx0, gx1, gy0, gy1, gz0, gz1, ax0, ax1, ay0, ay1, az0, az1] = bytes;
    let word = |low, high| i32::from(i16::from_le_bytes([low, high]));
    let turn = [word(gx0, gx1), word(gy0, gy1), word(gz0, gz1)];
    let acceleration = [word(ax0, ax1), word(ay0, ay1), word(az0, az1)];
    Motion {
        acceleration: acceleration.map(|counts| share_of(counts, ACCELERATION_PER_COUNT, 16)),
        turn: turn.map(|counts| counts * TURN_PER_COUNT),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_g_and_a_turn_written_out_byte_for_byte() {
        // 8197 counts of 0.122 mg are 1 g; -1 count of turn is -70 millidegrees per second.
        let bytes = [0xFF, 0xFF, 0, 0, 1, 0, 0x05, 0x20, 0, 0, 0xFB, 0xDF];
        let motion = decode(bytes);
        assert_eq!(motion.turn, [-70, 0, 70]);
        assert!(
            (motion.acceleration[0] - 9807).abs() <= 1
                && (motion.acceleration[2] + 9807).abs() <= 1
        );
    }
}
