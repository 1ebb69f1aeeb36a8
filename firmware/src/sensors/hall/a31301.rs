//! Allegro A31301: three axes, +-2000 G, I2C. Registers are big-endian 16-bit words at even addresses with
//! auto-increment; no configuration is needed after power-up.
//!
//! The full datasheet is not public. Facts without a public source are marked *unverified*. EEPROM is never
//! written.

use crate::sensors::hall::{HallReading, HallSample, HallSensor, TRANSFER_BYTES};

/// First register of a measurement: temperature, then X, Y, Z.
pub const TEMPERATURE: u8 = 0x1C;
/// Bytes of a measurement.
pub const READING_BYTES: usize = TRANSFER_BYTES;
/// Configuration word. *Unverified*: the address, taken from the related ALS31300, and that its content is constant.
/// It is only compared with its value at the start, never written.
pub const CONFIGURATION: u8 = 0x02;
/// 7-bit addresses selected by the straps SA0 and SA1. *Unverified*: public sources state 0x60 (both low) and 0x6F
/// (factory EEPROM, both high); 0x63 was observed; 0x6C is inferred.
pub const ADDRESSES: [u8; 4] = [0x60, 0x63, 0x6C, 0x6F];
/// Field words are two's complement in the lower 15 bits. *Unverified*: the meaning of bit 15, which is masked.
pub const FIELD_SPARE_BITS: u32 = 1;
/// Temperature words are two's complement in the lower 12 bits. *Unverified*: their scale.
pub const TEMPERATURE_SPARE_BITS: u32 = 4;

/// Driver without a data-ready flag: every transfer counts as a new measurement.
#[derive(Clone, Copy, Debug)]
pub struct A31301;

impl HallSensor for A31301 {
    const ADDRESSES: [u8; 4] = ADDRESSES;

    const READING: u8 = TEMPERATURE;

    const CONFIGURATION: u8 = CONFIGURATION;

    const FIELD_LIMITS: (i16, i16) = FIELD_LIMITS;

    fn decode(bytes: [u8; READING_BYTES]) -> HallSample {
        HallSample::New(decode(bytes))
    }
}

/// Minimum and maximum field in counts, at which the sensor saturates.
pub const FIELD_LIMITS: (i16, i16) = (i16::MIN >> FIELD_SPARE_BITS, i16::MAX >> FIELD_SPARE_BITS);

/// Decodes a measurement.
pub const fn decode(bytes: [u8; READING_BYTES]) -> HallReading {
    let [t1, t0, x1, x0, y1, y0, z1, z0] = bytes;
    let field = [
        signed(u16::from_be_bytes([x1, x0]), FIELD_SPARE_BITS),
        signed(u16::from_be_bytes([y1, y0]), FIELD_SPARE_BITS),
        signed(u16::from_be_bytes([z1, z0]), FIELD_SPARE_BITS),
    ];
    HallReading { field, temperature: signed(u16::from_be_bytes([t1, t0]), TEMPERATURE_SPARE_BITS) }
}

/// Inverse of [`decode`] for replay and simulated buses. Counts beyond the word's range lose their upper bits, as
/// on the wire.
pub const fn encode(reading: HallReading) -> [u8; READING_BYTES] {
    let [x, y, z] = reading.field;
    let [t1, t0] = word(reading.temperature, TEMPERATURE_SPARE_BITS);
    let [x1, x0] = word(x, FIELD_SPARE_BITS);
    let [y1, y0] = word(y, FIELD_SPARE_BITS);
    let [z1, z0] = word(z, FIELD_SPARE_BITS);
    [t1, t0, x1, x0, y1, y0, z1, z0]
}

const fn word(counts: i16, spare_bits: u32) -> [u8; 2] {
    (counts as u16 & (u16::MAX >> spare_bits)).to_be_bytes()
}

const fn signed(word: u16, spare_bits: u32) -> i16 {
    ((word << spare_bits) as i16) >> spare_bits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decode_ignores_spare_bits() {
        // T = -2048, X = 1, Y = -1, Z = -16384, with the spare bits clear and set.
        let expected = HallReading { field: [1, -1, -16384], temperature: -2048 };
        for bytes in [
            [0x08, 0x00, 0x00, 0x01, 0x7F, 0xFF, 0x40, 0x00],
            [0xF8, 0x00, 0x80, 0x01, 0xFF, 0xFF, 0xC0, 0x00],
        ] {
            assert_eq!(decode(bytes), expected);
        }
    }

    #[test]
    fn decode_inverts_encode_over_the_whole_range() {
        let (min, max) = FIELD_LIMITS;
        assert_eq!((min, max), (-16384, 16383));
        for counts in min..=max {
            let reading = HallReading {
                field: [counts, -counts.max(-16383), counts / 2],
                temperature: counts / 8,
            };
            assert_eq!(decode(encode(reading)), reading);
        }
    }
}
