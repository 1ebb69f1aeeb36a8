//! Registers of the Hall sensors, and what is known of them.
//!
//! The A31301's full datasheet is not public: what no public source states is marked *unverified*, and
//! nothing depends on it but what this file says. No EEPROM is ever written.

/// Allegro A31301: words of 16 bit, big-endian, at even addresses; the pointer moves on by itself.
pub mod a31301 {
    /// First register of a reading: temperature, then X, Y, Z. No configuration is needed after power-up.
    pub const TEMPERATURE: u8 = 0x1C;
    /// Bytes of a reading.
    pub const READING_BYTES: usize = 8;
    /// A word of what the sensor is configured as. *Unverified*: that it stands here, as in the relative ALS31300, and
    /// that it stands still. Only whether it is what it was at the start counts, and it is never written.
    pub const CONFIGURATION: u8 = 0x02;
    /// 7-bit addresses by the straps SA0 and SA1. *Unverified*: public sources state 0x60 (both low) and 0x6F
    /// (from the factory's EEPROM, both high); 0x63 was seen; 0x6C is inferred.
    pub const ADDRESSES: [u8; 4] = [0x60, 0x63, 0x6C, 0x6F];
    /// Field words are two's complement in the lower 15 bits. *Unverified*: what bit 15 means; it is masked.
    pub const FIELD_SPARE_BITS: u32 = 1;
    /// Temperature words are two's complement in the lower 12 bits. *Unverified*: their scale.
    pub const TEMPERATURE_SPARE_BITS: u32 = 4;
}

/// Allegro ALS31300: words of 32 bit, big-endian, one after the other; 12 bit an axis, split over two words.
pub mod als31300 {
    /// Upper eight bits of X, Y, Z; new data; upper six bits of the temperature. The lower ones follow.
    pub const UPPER: u8 = 0x28;
    /// Bytes of a reading: both words.
    pub const READING_BYTES: usize = 8;
    /// Sensing mode, bandwidth and checksums, in the upper half of the word.
    pub const CONFIGURATION: u8 = 0x02;
    /// 7-bit addresses by the strap.
    pub const ADDRESSES: [u8; 4] = [0x60, 0x61, 0x62, 0x63];
    /// In the upper word: set where the reading was not read before.
    pub const NEW_DATA: u32 = 1 << 7;
    /// Temperature word at 0 C.
    pub const TEMPERATURE_ZERO: i32 = 1708;
    /// Kelvins of 4096 counts of temperature.
    pub const TEMPERATURE_SPAN_K: i32 = 302;
}
