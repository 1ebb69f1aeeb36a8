//! Checksums.

use crc::{CRC_16_IBM_3740, CRC_32_ISO_HDLC, Crc, Digest, Table};

/// CRC-16 of serial packets and of commands: polynomial 0x1021, initial value all ones.
pub static CRC16: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// CRC-32 of parameters in flash, tables and crash records, as in Ethernet and zip: polynomial 0x04C11DB7, reflected,
/// initial value all ones. Detects every burst error of up to 32 bits, and all others with probability 1 - 2^-32.
///
/// The table of 1 KB processes a byte at a time: bit by bit the first check of all tables would take eight times as long.
pub static CRC32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A CRC-32 in progress.
pub type Digest32 = Digest<'static, u32, Table<1>>;
