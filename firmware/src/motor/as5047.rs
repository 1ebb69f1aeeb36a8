//! The AS5047P, a magnetic sensor of a shaft's angle: 14 bits, absolute, SPI of 16 bits in mode 1 up to 10 MHz.
//!
//! A frame holds the answer to the frame before. That this part sits on the rotor is assumed: the paper names
//! none.

use super::stage::EncoderError;

/// Reads the angle, compensated for its own delay (ANGLECOM, 0x3FFF): parity, read, address.
pub const READ_ANGLE: u16 = with_parity(1 << 14 | 0x3FFF);
/// The last frame was in error.
const ERROR: u16 = 1 << 14;
/// The angle.
const ANGLE: u16 = 0x3FFF;

/// Bit 15 makes the number of ones even.
const fn with_parity(word: u16) -> u16 {
    word | ((word.count_ones() as u16 & 1) << 15)
}

/// The angle in an answer. A line that stays high is a sensor that does not answer; one that stays low cannot
/// be told from the angle zero, and is found as a rotor that jumps there ([`super::encoder`]) or rests.
pub const fn angle(answer: u16) -> Result<u16, EncoderError> {
    if answer == u16::MAX {
        Err(EncoderError::Silent)
    } else if answer.count_ones() % 2 == 1 {
        Err(EncoderError::Checksum)
    } else if answer & ERROR != 0 {
        Err(EncoderError::Field)
    } else {
        Ok(answer & ANGLE)
    }
}

/// The answer of a sensor in health, for simulations.
pub const fn answer(angle: u16) -> u16 {
    with_parity(angle & ANGLE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_is_that_of_the_datasheet() {
        assert_eq!(READ_ANGLE, 0xFFFF);
        // Its other words: no operation, and the register of errors.
        assert_eq!(with_parity(0), 0);
        assert_eq!(with_parity(1 << 14 | 1), 0x4001);
        assert_eq!(with_parity(1 << 14), 0xC000);
    }

    #[test]
    fn an_answer_in_health_is_its_angle() {
        for counts in 0..=ANGLE {
            assert_eq!(angle(answer(counts)), Ok(counts));
        }
    }

    #[test]
    fn answers_are_read_bit_by_bit() {
        assert_eq!(angle(0x0003), Ok(3));
        assert_eq!(angle(0xA000), Ok(0x2000));
        assert_eq!(angle(0x3FFF), Ok(0x3FFF));
        assert_eq!(angle(0x0001), Err(EncoderError::Checksum));
        assert_eq!(angle(0xC000), Err(EncoderError::Field));
        assert_eq!(angle(0xFFFF), Err(EncoderError::Silent));
    }
}
