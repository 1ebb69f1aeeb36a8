//! Contact detection: suspected at the first force above the threshold, confirmed by 2 of 3 samples, ended with
//! hysteresis. A sample is a tick of 1 ms with a valid force.

use crate::config::limits::GripLimits;
use crate::grip::debounce::next_ms;

/// Detects contact of the fingers.
#[derive(Clone, Copy, Debug, Default)]
pub struct ContactDetector {
    /// Bit n is set where the force n steps ago was above the threshold; three bits.
    recent: u8,
    /// Milliseconds below the lower threshold.
    quiet_ms: u16,
    is_confirmed: bool,
}

impl ContactDetector {
    /// Adds a sample of the force in newtons.
    pub fn update(&mut self, force_n: f32, limits: &GripLimits) {
        let is_above = u8::from(force_n > limits.contact_n);
        self.recent = ((self.recent << 1) | is_above) & 0b111;
        self.quiet_ms = next_ms(self.quiet_ms, force_n < limits.no_contact_n);
        self.is_confirmed = if self.is_confirmed {
            self.quiet_ms < limits.no_contact_ms
        } else {
            self.recent.count_ones() >= 2
        };
    }

    /// A contact is confirmed or the last force was above the threshold: enough to slow down.
    pub const fn is_suspected(&self) -> bool {
        self.is_confirmed || self.recent & 1 != 0
    }

    /// Two of three forces were above the threshold, and the contact has not ended since.
    pub const fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(forces: &[f32]) -> ContactDetector {
        let mut contact = ContactDetector::default();
        for force in forces {
            contact.update(*force, &GripLimits::GRIPPER);
        }
        contact
    }

    #[test]
    fn two_of_three_forces_confirm_a_contact() {
        assert!(!after(&[5.0]).is_suspected());
        assert!(after(&[5.1]).is_suspected() && !after(&[5.1]).is_confirmed());
        assert!(after(&[5.1, 0.0, 5.1]).is_confirmed());
        assert!(!after(&[5.1, 0.0, 0.0, 5.1]).is_confirmed());
    }

    #[test]
    fn contact_ends_after_five_quiet_milliseconds() {
        let ended = [6.0, 6.0, 2.4, 2.4, 2.4, 2.4];
        assert!(after(&ended).is_confirmed());
        assert!(!after(&[&ended[..], &[2.4]].concat()).is_confirmed());
        assert!(after(&[&ended[..], &[2.6, 2.4, 2.4, 2.4, 2.4]].concat()).is_confirmed());
    }

    #[test]
    fn force_at_the_lower_threshold_does_not_end_a_contact() {
        assert!(after(&[&[6.0, 6.0][..], &[2.5; 20]].concat()).is_confirmed());
    }
}
