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
        let bit = |place: u32, is_set: bool| u32::from(is_set) << place;
        let states = self.power as u32 | (self.task as u32) << 8 | (self.reaction as u32) << 16;
        let hold_mm = self.hold_mm.unwrap_or_default();
        [
            states
                | bit(24, self.self_locking)
                | bit(25, self.is_gripped)
                | bit(26, self.has_settled)
                | bit(27, self.backs_off)
                | bit(28, self.is_opening)
                | bit(29, self.hold_mm.is_some()),
            self.setpoint_n.to_bits(),
            self.target.setpoint_n.to_bits(),
            self.target.cap_n.to_bits(),
            self.target.max_mm_s.to_bits(),
            // A single bit error in either value changes the combination.
            self.move_target.opening_mm.to_bits() ^ hold_mm.to_bits(),
            self.move_target.speed_mm_s.to_bits(),
            self.hold_a.to_bits(),
        ]
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
        let flip = |value: &mut f32| *value = f32::from_bits(value.to_bits() ^ (1 << (bit % 32)));
        match bit / 32 {
            0 => self.copies = self.copies.map(|word| word ^ (1 << bit)),
            1 => flip(&mut self.setpoint_n),
            2 => flip(&mut self.target.setpoint_n),
            3 => flip(&mut self.target.cap_n),
            4 => flip(&mut self.target.max_mm_s),
            5 => flip(&mut self.move_target.opening_mm),
            6 => flip(&mut self.move_target.speed_mm_s),
            _ => flip(&mut self.hold_a),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grip::fault_reactions::Reaction;
    use crate::grip::states::PowerState;
    use crate::grip::states::TaskState;
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
    fn any_changed_state_flag_or_position_is_detected() {
        type Change = fn(&mut GripController);
        let flags: [Change; 7] = [
            |grip| grip.self_locking ^= true,
            |grip| grip.is_gripped ^= true,
            |grip| grip.has_settled ^= true,
            |grip| grip.backs_off ^= true,
            |grip| grip.is_opening ^= true,
            |grip| grip.hold_mm = grip.hold_mm.xor(Some(0.0)),
            |grip| grip.hold_mm = Some(grip.hold_mm.map_or(1e-3, |mm| mm + 1e-3)),
        ];
        for rig in rigs() {
            let is_detected = |change: &dyn Fn(&mut GripController)| {
                let mut grip = rig.grip.clone();
                change(&mut grip);
                !grip.is_intact()
            };
            for (place, flag) in flags.iter().enumerate() {
                assert!(is_detected(flag), "{place}");
            }
            for power in PowerState::ALL.iter().filter(|power| **power != rig.grip.power) {
                assert!(is_detected(&|grip| grip.power = *power), "{power:?}");
            }
            for task in TaskState::ALL.iter().filter(|task| **task != rig.grip.task) {
                assert!(is_detected(&|grip| grip.task = *task), "{task:?}");
            }
            let another = match rig.grip.reaction {
                Reaction::Off => Reaction::Warn,
                _ => Reaction::Off,
            };
            assert!(is_detected(&|grip| grip.reaction = another));
        }
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
        let mut grip = GripRig::new(true).grip;
        grip.setpoint_n = 100.0;
        grip.target.cap_n = -2.0;
        grip.copy();
        // 100 is 1.5625 * 2^6: 0x42C8_0000; -2 is 0xC000_0000.
        assert_eq!(grip.copies[1], 0xBD37_FFFF);
        assert_eq!(grip.copies[3], 0x3FFF_FFFF);
        assert_eq!(grip.copies[7], u32::MAX);
    }
}
