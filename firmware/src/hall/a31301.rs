//! Allegro A31301: three axes over I2C, +-2000 G.

use super::registers::a31301::{
    ADDRESSES, CONFIGURATION, FIELD_SPARE_BITS, READING_BYTES, TEMPERATURE, TEMPERATURE_SPARE_BITS,
};
use super::{Part, Reading, Sample};

/// The part. It has no sign for new data that is known, so every reading counts as new.
#[derive(Clone, Copy, Debug)]
pub struct A31301;

impl Part for A31301 {
    const ADDRESSES: [u8; 4] = ADDRESSES;

    const READING: u8 = TEMPERATURE;

    const CONFIGURATION: u8 = CONFIGURATION;

    fn decode(bytes: [u8; READING_BYTES]) -> Sample {
        Sample::New(decode(bytes))
    }
}

/// Least and greatest field in counts: the word's ends, where the sensor stays.
pub const FIELD_LIMITS: (i16, i16) = (i16::MIN >> FIELD_SPARE_BITS, i16::MAX >> FIELD_SPARE_BITS);

/// The reading in the eight bytes of a transfer.
pub const fn decode(bytes: [u8; READING_BYTES]) -> Reading {
    let [t1, t0, x1, x0, y1, y0, z1, z0] = bytes;
    let field = [
        signed(u16::from_be_bytes([x1, x0]), FIELD_SPARE_BITS),
        signed(u16::from_be_bytes([y1, y0]), FIELD_SPARE_BITS),
        signed(u16::from_be_bytes([z1, z0]), FIELD_SPARE_BITS),
    ];
    Reading {
        field,
        temperature: signed(u16::from_be_bytes([t1, t0]), TEMPERATURE_SPARE_BITS),
    }
}

/// The bytes that a sensor with this reading sends: what replay and simulated buses feed to
/// [`decode`]. Counts that do not fit the word lose their upper bits, as on the wire.
pub const fn encode(reading: Reading) -> [u8; READING_BYTES] {
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
    fn a_transfer_written_out_byte_for_byte_is_the_reading() {
        // T = -2048, X = 1, Y = -1 with the unknown bit 15 clear, Z = -16384.
        let bytes = [0x08, 0x00, 0x00, 0x01, 0x7F, 0xFF, 0x40, 0x00];
        let reading = decode(bytes);
        assert_eq!(reading.field, [1, -1, -16384]);
        assert_eq!(reading.temperature, -2048);
    }

    #[test]
    fn the_unknown_bits_do_not_matter() {
        assert_eq!(
            decode([0xF8, 0x00, 0x80, 0x01, 0xFF, 0xFF, 0xC0, 0x00]),
            decode([0x08, 0x00, 0x00, 0x01, 0x7F, 0xFF, 0x40, 0x00])
        );
    }

    #[test]
    fn what_is_encoded_is_decoded_over_the_whole_range() {
        let (least, greatest) = FIELD_LIMITS;
        assert_eq!((least, greatest), (-16384, 16383));
        for counts in least..=greatest {
            let reading = Reading {
                field: [counts, -counts.max(-16383), counts / 2],
                temperature: counts / 8,
            };
            assert_eq!(decode(encode(reading)), reading);
        }
    }
}
