//! The fingers: carriages on guides with flexures at their tips, both together as one travel.

use super::friction::braked;
use super::object::{Contact, Object, Push};

/// Stiffness of the stop at the open end, in N/m, and its damping in N s/m (assumed: steel on steel).
const OPEN_STOP: Contact = Contact {
    stiffness_n_per_m: 5e6,
    damping_ns_per_m: 1e3,
};

/// What a pair of fingers is made of. Each goes half of the travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingers {
    /// Mass that the travel moves: half of one finger's, in kg.
    pub mass_kg: f64,
    /// Friction of the guides as the travel meets it, in N.
    pub guide_n: f64,
    /// Stiffness of the flexures of both, one finger's behind the other's, in N/m. Their own vibration,
    /// at some 900 Hz, is left out: they give way at once.
    pub flexures_n_per_m: f64,
    /// Opening where the travel begins, in m; it ends where the fingers meet.
    pub stroke_m: f64,
}

/// What pushes against a travel, closing positive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Against {
    /// Between the fingertips.
    pub tips: Push,
    /// At the open end; its force pushes towards closing.
    pub stop: Push,
}

impl Fingers {
    /// The contact of the tips with an object, which gives way in series with the flexures.
    pub fn contact(&self, object: &Object) -> Contact {
        let (own, tips) = (object.stiffness_n_per_m, self.flexures_n_per_m);
        Contact {
            stiffness_n_per_m: own * tips / (own + tips),
            damping_ns_per_m: object.damping_ns_per_m,
        }
    }

    /// The contact of the tips with each other.
    pub fn closed(&self) -> Contact {
        Contact {
            stiffness_n_per_m: self.flexures_n_per_m,
            damping_ns_per_m: Object::DAMPING_NS_PER_M,
        }
    }

    /// What pushes back at this travel and speed; `tips` is where the tips touch, as travel, and how.
    pub fn against(&self, travel_m: f64, speed_m_s: f64, tips: &(f64, Contact)) -> Against {
        let (from_m, contact) = tips;
        Against {
            tips: contact.push(travel_m - from_m, speed_m_s),
            stop: OPEN_STOP.push(-travel_m, -speed_m_s),
        }
    }

    /// The speed after `dt_s` under a force, and the energy that the guides took, in J.
    pub fn moved(&self, speed_m_s: f64, force_n: f64, dt_s: f64) -> (f64, f64) {
        let free = speed_m_s + force_n / self.mass_kg * dt_s;
        let slowed = braked(free, self.guide_n / self.mass_kg * dt_s);
        let lost_j = 0.5 * self.mass_kg * (free * free - slowed * slowed);
        (slowed, lost_j)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FINGERS: Fingers = Fingers {
        mass_kg: 0.1,
        guide_n: 1.0,
        flexures_n_per_m: 500e3,
        stroke_m: 0.08,
    };

    #[test]
    fn a_thousand_newtons_to_the_millimetre_behind_the_flexures_are_a_third() {
        let contact = FINGERS.contact(&Object::new(0.04, 1000.0));
        assert!((contact.stiffness_n_per_m - 1e6 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn the_guides_hold_what_pushes_less_than_their_friction() {
        assert_eq!(FINGERS.moved(0.0, 0.99, 1e-3), (0.0, 0.0));
        let (speed, _) = FINGERS.moved(0.0, 3.0, 1e-3);
        assert!((speed - 0.02).abs() < 1e-12);
    }

    #[test]
    fn a_finger_that_coasts_to_rest_leaves_its_energy_in_the_guides() {
        let (mut speed, mut lost) = (0.05, 0.0);
        while speed > 0.0 {
            let (slower, one) = FINGERS.moved(speed, 0.0, 1e-5);
            (speed, lost) = (slower, lost + one);
        }
        assert!((lost - 0.5 * 0.1 * 0.05 * 0.05).abs() < 1e-12);
    }
}
