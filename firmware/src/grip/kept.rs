//! Copies of what would be dangerous if a bit of it turned in memory: the states of both layers and what is done about
//! faults, what is gripped and how the screw holds it, the forces, speeds, places and the current that are asked for.
//! Inverse, so that memory that is cleared or filled is noticed too.
//!
//! They are made at the end of each millisecond and compared before the next begins: whatever turns between,
//! which is nearly all the time, is found at the next tick, before anything is asked of the motor. The motor's own
//! memory has none; what goes wrong there shows in currents, angles and the opening.

use super::Grip;

/// Words that are copied.
pub const WORDS: usize = 8;

impl Grip {
    fn words(&self) -> [u32; WORDS] {
        let bit = |place: u32, is_set: bool| u32::from(is_set) << place;
        let states = self.power as u32 | (self.task as u32) << 8 | (self.reaction as u32) << 16;
        let place = self.place_mm.unwrap_or_default();
        [
            states
                | bit(24, self.locks)
                | bit(25, self.is_gripped)
                | bit(26, self.has_settled)
                | bit(27, self.backs_off)
                | bit(28, self.is_opening)
                | bit(29, self.place_mm.is_some()),
            self.set_n.to_bits(),
            self.grip.set_n.to_bits(),
            self.grip.cap_n.to_bits(),
            self.grip.most_mm_s.to_bits(),
            // One bit in either of two shows in both together.
            self.way.opening_mm.to_bits() ^ place.to_bits(),
            self.way.speed_mm_s.to_bits(),
            self.hold_a.to_bits(),
        ]
    }

    /// Whether all of it is as the last tick left it. Where it is not, no tick may follow.
    pub fn is_intact(&self) -> bool {
        let both = self.words().into_iter().zip(self.copies);
        // Comparing arrays would be a call that goes byte by byte.
        both.fold(0, |turned, (word, copy)| turned | !(word ^ copy)) == 0
    }

    /// Copies it.
    pub(super) fn copy(&mut self) {
        self.copies = self.words().map(|word| !word);
    }

    /// Turns one of [`WORDS`] times 32 bits, for simulations: of the first word, whose states are not numbers, in its
    /// copy, of the others in what is copied.
    pub fn spoil(&mut self, bit: u32) {
        let turned = |value: &mut f32| *value = f32::from_bits(value.to_bits() ^ (1 << (bit % 32)));
        match bit / 32 {
            0 => self.copies = self.copies.map(|word| word ^ (1 << bit)),
            1 => turned(&mut self.set_n),
            2 => turned(&mut self.grip.set_n),
            3 => turned(&mut self.grip.cap_n),
            4 => turned(&mut self.grip.most_mm_s),
            5 => turned(&mut self.way.opening_mm),
            6 => turned(&mut self.way.speed_mm_s),
            _ => turned(&mut self.hold_a),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::react::Reaction;
    use super::super::states::{Power, Task};
    use super::super::tests::rig::Rig;
    use super::*;

    fn rigs() -> [Rig; 4] {
        [
            Rig::new(true),
            Rig::enabled(false),
            Rig::holding(true),
            Rig::foot(false),
        ]
    }

    #[test]
    fn any_single_bit_is_noticed_at_the_next_tick() {
        for rig in rigs() {
            for bit in 0..32 * WORDS as u32 {
                let mut grip = rig.grip.clone();
                assert!(grip.is_intact());
                grip.spoil(bit);
                assert!(!grip.is_intact(), "{bit}");
                grip.spoil(bit);
                assert!(grip.is_intact(), "{bit}");
            }
        }
    }

    #[test]
    fn any_other_state_flag_or_place_is_noticed() {
        type Change = fn(&mut Grip);
        let flags: [Change; 7] = [
            |grip| grip.locks ^= true,
            |grip| grip.is_gripped ^= true,
            |grip| grip.has_settled ^= true,
            |grip| grip.backs_off ^= true,
            |grip| grip.is_opening ^= true,
            |grip| grip.place_mm = grip.place_mm.xor(Some(0.0)),
            |grip| grip.place_mm = Some(grip.place_mm.map_or(1e-3, |mm| mm + 1e-3)),
        ];
        for rig in rigs() {
            let is_noticed = |change: &dyn Fn(&mut Grip)| {
                let mut grip = rig.grip.clone();
                change(&mut grip);
                !grip.is_intact()
            };
            for (place, flag) in flags.iter().enumerate() {
                assert!(is_noticed(flag), "{place}");
            }
            for power in Power::ALL.iter().filter(|power| **power != rig.grip.power) {
                assert!(is_noticed(&|grip| grip.power = *power), "{power:?}");
            }
            for task in Task::ALL.iter().filter(|task| **task != rig.grip.task) {
                assert!(is_noticed(&|grip| grip.task = *task), "{task:?}");
            }
            let another = match rig.grip.reaction {
                Reaction::Off => Reaction::Warn,
                _ => Reaction::Off,
            };
            assert!(is_noticed(&|grip| grip.reaction = another));
        }
    }

    #[test]
    fn the_copies_are_inverse_word_by_word() {
        let mut grip = Rig::new(true).grip;
        grip.set_n = 100.0;
        grip.grip.cap_n = -2.0;
        grip.copy();
        // 100 is 1.5625 * 2^6: 0x42C8_0000; -2 is 0xC000_0000.
        assert_eq!(grip.copies[1], 0xBD37_FFFF);
        assert_eq!(grip.copies[3], 0x3FFF_FFFF);
        assert_eq!(grip.copies[7], u32::MAX);
    }
}
