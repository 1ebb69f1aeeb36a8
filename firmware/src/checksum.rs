//! The checksum of what is kept: parameters in flash, tables, a crash record. Packets on a line have their
//! own, of 16 bits: [`crate::wire::serial::CHECKSUM`].

use crc::{CRC_32_ISO_HDLC, Crc, Digest, NoTable};

/// CRC-32 as Ethernet and zip have it: polynomial 0x04C11DB7, reflected, from all ones. Every error of up to
/// 32 bits in a row is noticed, and another one but for one in 2^32.
/// Bit by bit: what it guards is read at boot and over seconds, and a table would take 1 KB of flash.
pub static CRC32: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// A checksum on its way.
pub type Digest32 = Digest<'static, u32, NoTable>;
