//! Allegro ALS31300: three axes of 12 bit, +-2000 G, I2C (registers as in the Linux driver `als31300.c`). A documented
//! relative of the A31301, as a second implementation of the driver trait. Registers are big-endian 32-bit words;
//! each axis is split over two consecutive words.

use crate::config::constants;
use crate::sensors::hall::{HallReading, HallSample, HallSensor, TRANSFER_BYTES};

/// Register with the upper eight bits of X, Y, Z, the new-data flag and the upper six bits of the temperature; the
/// lower bits are in the next.
pub const UPPER: u8 = 0x28;
/// Sensing mode, bandwidth and checksums, in the upper half of the word.
pub const CONFIGURATION: u8 = 0x02;
/// 7-bit addresses selected by the strap.
pub const ADDRESSES: [u8; 4] = [0x60, 0x61, 0x62, 0x63];
/// Flag in the upper word: not read before.
pub const NEW_DATA: u32 = 1 << 7;
/// Temperature word at 0 C.
pub const TEMPERATURE_ZERO: i32 = 1708;
/// Temperature span of 4096 counts in kelvin.
pub const TEMPERATURE_SPAN_K: i32 = 302;

/// [`HallReading`] counts per count of this part (1 G).
const COUNTS: i16 = (1.0 / constants::SENSOR_SCALE.value) as i16;
const COUNTS_PER_KELVIN: i32 = constants::TEMPERATURE_SCALE.value as i32;
/// Temperature of zero [`HallReading`] counts.
const ZERO_C: i32 = 25;

/// Driver of the part.
#[derive(Clone, Copy, Debug)]
pub struct Als31300;

impl HallSensor for Als31300 {
    const ADDRESSES: [u8; 4] = ADDRESSES;

    const READING: u8 = UPPER;

    const CONFIGURATION: u8 = CONFIGURATION;

    const FIELD_LIMITS: (i16, i16) = (-2048 * COUNTS, 2047 * COUNTS);

    fn decode(bytes: [u8; TRANSFER_BYTES]) -> HallSample {
        decode(bytes)
    }
}

/// Decodes a measurement.
pub const fn decode(bytes: [u8; TRANSFER_BYTES]) -> HallSample {
    let [a, b, c, d, e, f, g, h] = bytes;
    let upper = u32::from_be_bytes([a, b, c, d]);
    let lower = u32::from_be_bytes([e, f, g, h]);
    if upper & NEW_DATA == 0 {
        return HallSample::Stale;
    }
    let temperature = (((upper & 0x3F) << 6) | (lower & 0x3F)) as i32 - TEMPERATURE_ZERO;
    // At most 2388 * 302 * 8: no overflow of 32 bits.
    let counts = (temperature * TEMPERATURE_SPAN_K * COUNTS_PER_KELVIN) >> 12;
    HallSample::New(HallReading {
        field: [
            axis(upper >> 24, lower >> 16),
            axis(upper >> 16, lower >> 12),
            axis(upper >> 8, lower >> 8),
        ],
        temperature: (counts - ZERO_C * COUNTS_PER_KELVIN) as i16,
    })
}

/// Twelve bits: the lowest eight of one word and the lowest four of another.
const fn axis(upper: u32, lower: u32) -> i16 {
    let word = ((upper & 0xFF) << 4) | (lower & 0xF);
    ((word << 4) as u16 as i16 >> 4) * COUNTS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decode_converts_field_and_temperature() {
        // X = 0x7FF = 2047 G, Y = 0x800 = -2048 G, Z = 0xFFF = -1 G, new; temperature 0b011011_101000 = 1768.
        let bytes = [0x7F, 0x80, 0xFF, 0b1001_1011, 0x00, 0x0F, 0x0F, 0b0010_1000];
        // (1768 - 1708) * 302 / 4096 = 4.42 C: 20.58 K below 25 C are 164.6 counts of 1/8 K.
        let expected = HallReading { field: [16376, -16384, -8], temperature: -165 };
        assert_eq!(decode(bytes), HallSample::New(expected));
    }

    #[test]
    fn a_cleared_new_data_flag_gives_a_stale_sample() {
        let bytes = [0x12, 0x34, 0x56, 0b0101_1011, 0, 1, 2, 3];
        assert_eq!(decode(bytes), HallSample::Stale);
    }
}
