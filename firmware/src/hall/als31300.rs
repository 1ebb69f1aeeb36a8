//! Allegro ALS31300: three axes of 12 bit over I2C, +-2000 G (registers as in the Linux driver
//! `als31300.c`). A relative of the gripper's own sensor that is documented: the data path does not
//! hang on one part.

use super::registers::als31300::{
    ADDRESSES, CONFIGURATION, NEW_DATA, READING_BYTES, TEMPERATURE_SPAN_K, TEMPERATURE_ZERO, UPPER,
};
use super::{Part, Reading, Sample};
use crate::params;

/// Counts of a [`Reading`] in one of this part's, which is 1 G.
const COUNTS: i16 = (1.0 / params::SENSOR_SCALE.value) as i16;
/// Counts of a [`Reading`]'s temperature in a kelvin, and the temperature that is zero there.
const COUNTS_PER_KELVIN: i32 = params::TEMPERATURE_SCALE.value as i32;
const ZERO_C: i32 = 25;

/// The part.
#[derive(Clone, Copy, Debug)]
pub struct Als31300;

impl Part for Als31300 {
    const ADDRESSES: [u8; 4] = ADDRESSES;

    const READING: u8 = UPPER;

    const CONFIGURATION: u8 = CONFIGURATION;

    fn decode(bytes: [u8; READING_BYTES]) -> Sample {
        decode(bytes)
    }
}

/// The reading in the eight bytes of a transfer.
pub const fn decode(bytes: [u8; READING_BYTES]) -> Sample {
    let [a, b, c, d, e, f, g, h] = bytes;
    let upper = u32::from_be_bytes([a, b, c, d]);
    let lower = u32::from_be_bytes([e, f, g, h]);
    if upper & NEW_DATA == 0 {
        return Sample::Old;
    }
    let temperature = (((upper & 0x3F) << 6) | (lower & 0x3F)) as i32 - TEMPERATURE_ZERO;
    // At most 2388 * 302: far from the ends of 32 bit.
    let counts = (temperature * TEMPERATURE_SPAN_K * COUNTS_PER_KELVIN) >> 12;
    Sample::New(Reading {
        field: [
            axis(upper >> 24, lower >> 16),
            axis(upper >> 16, lower >> 12),
            axis(upper >> 8, lower >> 8),
        ],
        temperature: (counts - ZERO_C * COUNTS_PER_KELVIN) as i16,
    })
}

/// Twelve bits from the last eight of one word and the last four of another.
const fn axis(upper: u32, lower: u32) -> i16 {
    let word = ((upper & 0xFF) << 4) | (lower & 0xF);
    ((word << 4) as u16 as i16 >> 4) * COUNTS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transfer_written_out_byte_for_byte_is_the_reading() {
        // X = 0x7FF = 2047 G, Y = 0x800 = -2048 G, Z = 0xFFF = -1 G, new; temperature 0b011011_101000 = 1768.
        let bytes = [0x7F, 0x80, 0xFF, 0b1001_1011, 0x00, 0x0F, 0x0F, 0b0010_1000];
        let Sample::New(reading) = decode(bytes) else {
            panic!("not new");
        };
        assert_eq!(reading.field, [16376, -16384, -8]);
        // (1768 - 1708) * 302 / 4096 = 4.42 C: 20.58 K below 25 C are 164.6 counts of 1/8 K.
        assert_eq!(reading.temperature, -165);
    }

    #[test]
    fn what_was_read_before_is_no_new_reading() {
        assert_eq!(
            decode([0x12, 0x34, 0x56, 0b0101_1011, 0, 1, 2, 3]),
            Sample::Old
        );
    }
}
