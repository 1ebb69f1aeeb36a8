//! Message authentication codes of the hosts' messages: AES-128-CMAC (NIST SP 800-38B), in the manner of AUTOSAR SecOC with a
//! message of its own for freshness value and code ([`Authentication`](crate::protocol::messages::Authentication)).
//!
//! Gripper and hosts share a [`Key`]. A session has a key of its own, derived from the shared one and the gripper's random
//! challenge of 48 bits, so that messages of one session are invalid in every other one, also after a reset. Within a session
//! each message has a freshness counter that must exceed that of every message accepted before. The counter has 48 bits,
//! of which the lower 24 are transmitted: it cannot be exhausted, and 2,047 messages in a row may be lost.
//!
//! The owner of a session advances the counter by steps that only holders of the key can compute ([`SessionMac::following`]):
//! by its counter the gripper recognises its message before it checks the code, so that a flood of forged ones
//! cannot use up the checks. A counter of another owner's choice is valid, but without that protection.
//!
//! A code has 40 bits, which leaves a frame of eight bytes for code and counter. A random code is accepted with a probability of
//! 2^-40. Under a flood on a full bus at most 635 are checked in a second in addition to 50 messages of the owner
//! ([`crate::protocol::session`], `SECURITY.md`): one forged message in 54 years.

use aes::Aes128;
use aes::cipher::{Array, BlockCipherEncrypt, KeyInit};
use cmac::digest::InnerInit;
use cmac::{Cmac, Mac};
use dbl::Dbl;

/// Bytes of a key.
pub const KEY_BYTES: usize = 16;
/// Bytes of a code.
pub const TAG_BYTES: usize = 5;
/// Transmitted bits of the freshness counter.
pub const COUNTER_BITS: u32 = 24;
/// Those bits.
pub const COUNTER_MASK: u64 = (1 << COUNTER_BITS) - 1;
/// Bits of the step from one counter to the next. 2,047 messages in a row may be lost, as many as 200 in a second are until a
/// session expires.
const STEP_BITS: u32 = 13;
/// In the place of an identifier, which has 11 bits: separates steps from codes.
const STEP_ID: u16 = 0xFFFF;
/// Bits of a challenge.
pub const CHALLENGE_MASK: u64 = (1 << 48) - 1;

/// A code.
pub type Tag = [u8; TAG_BYTES];

/// Secret that a gripper shares with its hosts.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key(pub [u8; KEY_BYTES]);

impl Key {
    /// Stands for a missing key: known to everybody, so that messages are checked for errors and freshness, and nobody is kept
    /// out.
    pub const NONE: Self = Self([0; KEY_BYTES]);

    /// First four bytes of the code of the key itself, as a number: by it a gripper detects that it did not receive a key as it
    /// was sent.
    pub fn check_number(self) -> u32 {
        let mut mac = Cmac::<Aes128>::new(&self.0.into());
        mac.update(b"key check");
        DataMac(mac).finish()
    }
}

/// Hides the key.
impl core::fmt::Debug for Key {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str(if *self == Self::NONE { "Key(none)" } else { "Key(..)" })
    }
}

/// Computes the codes of one session.
#[derive(Clone)]
pub struct SessionMac {
    cipher: Aes128,
    /// Subkey K1 of CMAC, by which the code of a single block takes one call of the cipher instead of two.
    subkey: [u8; 16],
}

impl SessionMac {
    /// Codes of the session of this node that began with this challenge.
    pub fn new(key: &Key, node: u16, challenge: u64) -> Self {
        let mut mac = Cmac::<Aes128>::new(&key.0.into());
        mac.update(b"session");
        mac.update(&node.to_le_bytes());
        mac.update(&challenge.to_le_bytes());
        let cipher = Aes128::new(&mac.finalize().into_bytes());
        let mut subkey = Array::default();
        cipher.encrypt_block(&mut subkey);
        Self { cipher, subkey: subkey.dbl().into() }
    }

    /// Code of a message: over the identifier of its frame, the lower 48 bits of the counter, and its bytes, together one block
    /// of the cipher.
    #[inline(never)] // Space: it has several callers.
    pub fn tag(&self, counter: u64, id: u16, message: [u8; 8]) -> Tag {
        let [i0, i1] = id.to_le_bytes();
        let [c0, c1, c2, c3, c4, c5, ..] = counter.to_le_bytes();
        let [m0, m1, m2, m3, m4, m5, m6, m7] = message;
        let mut block = [i0, i1, c0, c1, c2, c3, c4, c5, m0, m1, m2, m3, m4, m5, m6, m7];
        for (byte, mask) in block.iter_mut().zip(self.subkey) {
            *byte ^= mask;
        }
        let mut block = Array::from(block);
        self.cipher.encrypt_block(&mut block);
        truncate(block.into())
    }

    /// Counter that the owner uses after this one, or first after 0: greater by 1 to 2^13, from the code of no message.
    pub fn following(&self, counter: u64) -> u64 {
        let [low, high, ..] = self.tag(counter, STEP_ID, [0; 8]);
        let step = u64::from(u16::from_le_bytes([low, high])) & ((1 << STEP_BITS) - 1);
        counter.saturating_add(step).saturating_add(1)
    }

    /// Whether a code is that of the message, in a time that does not depend on its content.
    pub fn is_valid(&self, counter: u64, id: u16, message: [u8; 8], tag: Tag) -> bool {
        let expected = self.tag(counter, id, message);
        let differing = expected.into_iter().zip(tag).fold(0, |bits, (a, b)| bits | (a ^ b));
        core::hint::black_box(differing) == 0
    }

    /// Code of data that is longer than a message.
    pub fn digest(&self) -> DataMac {
        DataMac(Cmac::inner_init(self.cipher.clone()))
    }
}

impl core::fmt::Debug for SessionMac {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str("SessionMac(..)")
    }
}

/// Code of data in progress.
#[derive(Clone)]
pub struct DataMac(Cmac<Aes128>);

impl DataMac {
    /// Appends data.
    pub fn update(&mut self, data: &[u8]) {
        self.0.update(data);
    }

    /// First four bytes of the code, as a number.
    pub fn finish(self) -> u32 {
        let [b0, b1, b2, b3, ..]: [u8; 16] = self.0.finalize().into_bytes().into();
        u32::from_le_bytes([b0, b1, b2, b3])
    }
}

impl core::fmt::Debug for DataMac {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str("DataMac(..)")
    }
}

/// The smallest counter above `last` with these lower bits.
pub const fn next_counter(last: u64, low: u32) -> u64 {
    let low = low as u64 & COUNTER_MASK;
    let counter = last >> COUNTER_BITS << COUNTER_BITS | low;
    if counter > last { counter } else { counter.saturating_add(1 << COUNTER_BITS) }
}

const fn truncate([b0, b1, b2, b3, b4, ..]: [u8; 16]) -> Tag {
    [b0, b1, b2, b3, b4]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn codes_equal_those_of_another_program() {
        // By PyCryptodome, `CMAC.new(key, ciphermod=AES)`, over the same bytes.
        let key = Key(*b"0123456789abcdef");
        let session = SessionMac::new(&key, 0x10, 0x0000_1122_3344_5566);
        let message = [1, 2, 3, 4, 5, 6, 7, 8];
        assert_eq!(session.tag(1, 0x203, message), [0x7A, 0xFB, 0xEB, 0xBD, 0xF8]);
        let later = session.tag(0x0001_0203_0405, 0x203, message);
        assert_eq!(later, [0xB2, 0xC1, 0x53, 0xC3, 0xD9]);
        assert_eq!(key.check_number(), 0x98F6_A80E);
    }

    #[test]
    fn neither_key_nor_codes_are_printed() {
        let key = Key([0xAB; KEY_BYTES]);
        let session = SessionMac::new(&key, 16, 1);
        let printed = std::format!("{key:?} {:?} {session:?} {:?}", Key::NONE, session.digest());
        assert_eq!(printed, "Key(..) Key(none) SessionMac(..) DataMac(..)");
    }

    #[test]
    fn lengths_are_those_of_the_messages() {
        // A challenge is sent in 16 and 32 bits, a counter in 24, a code in 32 and 8.
        assert_eq!(CHALLENGE_MASK, 0xFFFF_FFFF_FFFF);
        assert_eq!((COUNTER_MASK, TAG_BYTES), (0xFF_FFFF, 5));
    }

    proptest! {
        /// The code of a single block agrees with the library's for data of any length.
        #[test]
        fn code_of_a_message_is_that_of_its_bytes(
            key in any::<[u8; 16]>(), counter in 0_u64..1 << 48, id in 0_u16..0x800, message in any::<[u8; 8]>(),
        ) {
            let session = SessionMac::new(&Key(key), 16, 77);
            let mut all = session.digest();
            all.update(&id.to_le_bytes());
            all.update(&counter.to_le_bytes()[..6]);
            all.update(&message);
            let [b0, b1, b2, b3, _] = session.tag(counter, id, message);
            prop_assert_eq!(all.finish(), u32::from_le_bytes([b0, b1, b2, b3]));
        }

        #[test]
        fn counter_is_the_next_with_its_lower_bits(last in 0_u64..1 << 47, ahead in 1_u64..1 << 24) {
            let sent = last + ahead;
            prop_assert_eq!(next_counter(last, sent as u32), sent);
        }

        #[test]
        fn repeated_counter_is_never_the_same(last in 0_u64..1 << 47, back in 0_u64..1 << 23) {
            let earlier = last.saturating_sub(back);
            prop_assert!(next_counter(last, earlier as u32) > last);
        }

        #[test]
        fn every_changed_bit_changes_the_code(
            counter in 0_u64..1 << 48, id in 0_u16..0x800, message in any::<[u8; 8]>(), bit in 0_usize..123,
        ) {
            let session = SessionMac::new(&Key([7; 16]), 3, 9);
            let (mut c, mut i, mut m) = (counter, id, message);
            match bit {
                0..48 => c ^= 1 << bit,
                48..59 => i ^= 1 << (bit - 48),
                _ => m[(bit - 59) / 8] ^= 1 << ((bit - 59) % 8),
            }
            let tag = session.tag(counter, id, message);
            prop_assert!(session.is_valid(counter, id, message, tag));
            prop_assert!(!session.is_valid(c, i, m, tag));
        }
    }
}
