//! Whether the fingers press against something: at once suspected, then believed, and with hysteresis gone.

use crate::limits::Grasp;

/// The contact of the fingers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Contact {
    /// Which of the last three forces were beyond the limit, newest lowest.
    recent: u8,
    /// Milliseconds below the limit at which it ends.
    quiet_ms: u16,
    is_believed: bool,
}

impl Contact {
    /// Takes a millisecond's force in newtons.
    pub fn note(&mut self, force_n: f32, limits: &Grasp) {
        let beyond = u8::from(force_n > limits.contact_n);
        self.recent = ((self.recent << 1) | beyond) & 0b111;
        self.quiet_ms = match force_n < limits.no_contact_n {
            true => self.quiet_ms.saturating_add(1),
            false => 0,
        };
        self.is_believed = match self.is_believed {
            true => self.quiet_ms < limits.no_contact_ms,
            false => self.recent.count_ones() >= 2,
        };
    }

    /// The last force was beyond the limit: enough to slow down.
    pub const fn is_suspected(&self) -> bool {
        self.is_believed || self.recent & 1 != 0
    }

    /// Two of three were, and it has not ended since.
    pub const fn is_believed(&self) -> bool {
        self.is_believed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(forces: &[f32]) -> Contact {
        let mut contact = Contact::default();
        for force in forces {
            contact.note(*force, &Grasp::GRIPPER);
        }
        contact
    }

    #[test]
    fn one_force_is_suspected_and_two_of_three_are_believed() {
        assert!(!after(&[5.0]).is_suspected());
        assert!(after(&[5.1]).is_suspected() && !after(&[5.1]).is_believed());
        assert!(after(&[5.1, 0.0, 5.1]).is_believed());
        assert!(!after(&[5.1, 0.0, 0.0, 5.1]).is_believed());
    }

    #[test]
    fn a_contact_ends_after_five_milliseconds_below_the_lower_limit() {
        let held = [6.0, 6.0, 2.4, 2.4, 2.4, 2.4];
        assert!(after(&held).is_believed());
        assert!(!after(&[&held[..], &[2.4]].concat()).is_believed());
        assert!(after(&[&held[..], &[2.6, 2.4, 2.4, 2.4, 2.4]].concat()).is_believed());
    }
}
