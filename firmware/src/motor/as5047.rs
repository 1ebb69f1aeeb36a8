//! AS5047P, a magnetic angle sensor: 14 bits, absolute, 16-bit SPI in mode 1 up to 10 MHz. A frame contains the answer
//! to the previous one. That this sensor is on the rotor is assumed; the paper names none.

use crate::motor::power_stage::EncoderError;

/// Command to read the angle with compensation of the sensor's delay (ANGLECOM, 0x3FFF): parity, read, address.
pub const READ_ANGLE: u16 = with_parity(1 << 14 | 0x3FFF);
/// Error bit of an answer: the previous command frame was invalid.
const ERROR: u16 = 1 << 14;
/// Angle bits of an answer.
const ANGLE: u16 = 0x3FFF;

/// Sets bit 15 for even parity.
const fn with_parity(word: u16) -> u16 {
    word | ((word.count_ones() as u16 & 1) << 15)
}

/// The angle in an answer. A data line stuck high is a silent sensor; one stuck low reads as angle zero and is
/// detected as a jump ([`super::encoder`]) or a stuck sensor ([`super::diagnostics`]).
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

/// Answer of a working sensor, for simulations.
pub const fn answer(angle: u16) -> u16 {
    with_parity(angle & ANGLE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn read_angle_command_matches_the_datasheet() {
        assert_eq!(READ_ANGLE, 0xFFFF);
        // Other commands of the datasheet: no operation, error register.
        assert_eq!(with_parity(0), 0);
        assert_eq!(with_parity(1 << 14 | 1), 0x4001);
        assert_eq!(with_parity(1 << 14), 0xC000);
    }

    #[test]
    fn answer_of_a_working_sensor_round_trips() {
        for counts in 0..=ANGLE {
            assert_eq!(angle(answer(counts)), Ok(counts));
        }
    }

    #[test]
    fn answer_bits_decode_to_angle_or_error() {
        assert_eq!(angle(0x0003), Ok(3));
        assert_eq!(angle(0xA000), Ok(0x2000));
        assert_eq!(angle(0x3FFF), Ok(0x3FFF));
        assert_eq!(angle(0x0001), Err(EncoderError::Checksum));
        assert_eq!(angle(0xC000), Err(EncoderError::Field));
        assert_eq!(angle(0xFFFF), Err(EncoderError::Silent));
    }
}
