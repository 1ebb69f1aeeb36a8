//! The checksum of what is kept: parameters in flash, tables, a crash record. Packets on a line have their
//! own, of 16 bits: [`crate::wire::serial::CHECKSUM`].

use crc::{CRC_32_ISO_HDLC, Crc, Digest, Table};

/// CRC-32 as Ethernet and zip have it: polynomial 0x04C11DB7, reflected, from all ones. Every error of up to
/// 32 bits in a row is noticed, and another one but for one in 2^32.
/// By a table of 1 KB, a byte at a time: bit by bit the first check of all tables would take eight times as long.
pub static CRC32: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A checksum in progress.
pub type Digest32 = Digest<'static, u32, Table<1>>;
