//! Redundant copies of the safety-relevant state, to detect bit errors in memory: states and reaction, gripped object
//! and screw, and all force, speed, position and current set-points. The copies are inverted, so that cleared or
//! filled memory is detected too.
//!
//! They are made at the end of each step and compared before the next, so that a bit error between steps is detected
//! before it affects the motor. The motor loops have no copies: their errors appear in currents, angles and opening.

pub use crate::grip::COPY_WORDS;

use crate::grip::GripController;

impl GripController {
    fn words(&self) -> [u32; COPY_WORDS] {
        let mut words = self.task.copy_words();
        let [states, ..] = &mut words;
        *states |= self.power.copy_word() | u32::from(self.settings.self_locking) << 24;
        words
    }

    /// Whether the state equals its copies. If not, no further step may run.
    pub fn is_intact(&self) -> bool {
        let both = self.words().into_iter().zip(self.copies);
        // Comparing the arrays would call a bytewise comparison.
        both.fold(0, |differing, (word, copy)| differing | !(word ^ copy)) == 0
    }

    /// Updates the copies; outside of a step only for simulations.
    pub fn copy(&mut self) {
        self.copies = self.words().map(|word| !word);
    }

    /// Flips one of [`COPY_WORDS`] * 32 bits, for simulations: for the first word, whose states cannot hold any
    /// value, in the copy; for the others in the original.
    pub fn flip_bit(&mut self, bit: u32) {
        match bit / 32 {
            0 => self.copies = self.copies.map(|word| word ^ (1 << bit)),
            _ => self.task.flip_bit(bit),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grip::tests::rig::GripRig;

    fn rigs() -> [GripRig; 4] {
        [GripRig::new(true), GripRig::enabled(false), GripRig::holding(true), GripRig::foot(false)]
    }

    #[test]
    fn any_flipped_bit_is_detected() {
        for rig in rigs() {
            for bit in 0..32 * COPY_WORDS as u32 {
                let mut grip = rig.grip.clone();
                assert!(grip.is_intact());
                grip.flip_bit(bit);
                assert!(!grip.is_intact(), "{bit}");
                grip.flip_bit(bit);
                assert!(grip.is_intact(), "{bit}");
            }
        }
    }

    #[test]
    fn changed_screw_is_detected() {
        let mut rig = GripRig::new(true);
        rig.run(5);
        assert!(rig.grip.is_intact());
        rig.grip.set_self_locking(false);
        assert!(!rig.grip.is_intact());
    }

    #[test]
    fn flipped_bit_belongs_to_its_word() {
        let grip = GripRig::holding(true).grip;
        for bit in [0, 5, 31] {
            let mut flipped = grip.clone();
            flipped.flip_bit(bit);
            assert_eq!(flipped.words(), grip.words());
            assert_eq!(flipped.copies[0] ^ grip.copies[0], 1 << bit);
        }
        for word in 1..COPY_WORDS {
            for place in [0, 5, 31] {
                let mut flipped = grip.clone();
                flipped.flip_bit(32 * word as u32 + place);
                let mut expected = grip.words();
                expected[word] ^= 1 << place;
                assert_eq!(flipped.words(), expected, "{word} {place}");
            }
        }
    }

    #[test]
    fn copies_are_bitwise_inverse() {
        let grip = GripRig::holding(true).grip;
        // 100 is 1.5625 * 2^6: 0x42C8_0000.
        assert_eq!([1, 2, 3].map(|word: usize| grip.copies[word]), [0xBD37_FFFF; 3]);
        assert_eq!(GripRig::new(true).grip.copies[7], u32::MAX);
    }
}
