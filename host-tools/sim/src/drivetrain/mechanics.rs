//! Mechanics of the drivetrain: rotor, lead screw with backlash, fingers, contacts, energy balance.

use crate::friction::{Stribeck, apply_coulomb};
use crate::motion::GRAVITY;

/// Rotating parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotor {
    /// Inertia of rotor, screws and coupling, in kg m^2.
    pub inertia_kg_m2: f64,
    /// Viscous friction in N m s/rad.
    pub viscous_nm_s: f64,
    /// Friction without load.
    pub dry: Stribeck,
}

/// State of rotor and fingers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveTrain {
    /// Rotor angle in rad, closing positive.
    pub angle_rad: f64,
    /// Its speed in rad/s.
    pub speed_rad_s: f64,
    /// The fingers' travel from the open end, in m.
    pub travel_m: f64,
    /// Its speed in m/s.
    pub travel_m_s: f64,
    /// Force of the screw on the nut.
    pub flank: FlankForce,
    /// Contact forces on the fingers.
    pub contact_forces: ContactForces,
}

impl DriveTrain {
    /// At rest, with the closing flank in contact.
    pub fn at(travel_m: f64, screw: &LeadScrew) -> Self {
        Self {
            angle_rad: (travel_m + 0.5 * screw.play_m) / screw.travel_m_per_rad,
            travel_m,
            ..Self::default()
        }
    }

    /// Advances by `dt_s` with a torque on the rotor.
    pub fn step(
        &mut self,
        (rotor, screw, fingers): (&Rotor, &LeadScrew, &FingerPair),
        torque_nm: f64,
        contacts: &FingerContacts,
        (ledger, dt_s): (&mut EnergyLedger, f64),
    ) {
        let ratio = screw.travel_m_per_rad;
        let lead_m = self.angle_rad * ratio - self.travel_m;
        let relative_m_s = self.speed_rad_s * ratio - self.travel_m_s;
        let flank = screw.flank(lead_m, relative_m_s);
        let contact_forces = contacts.forces(self.travel_m, self.travel_m_s);

        let viscous_nm = rotor.viscous_nm_s * self.speed_rad_s;
        let push_nm = torque_nm + screw.load_nm(flank.force_n) - viscous_nm;
        let free = self.speed_rad_s + push_nm / rotor.inertia_kg_m2 * dt_s;
        let friction_nm = rotor.dry.torque_nm(free) + screw.friction_nm(flank.force_n);
        let turning = apply_coulomb(free, friction_nm / rotor.inertia_kg_m2 * dt_s);

        let opposing_n = contact_forces.tips.force_n;
        let outer_n = contact_forces.outer.force_n + contact_forces.stop.force_n;
        let push_n = flank.force_n - opposing_n + outer_n;
        let (moving, guides_j) = fingers.accelerate(self.travel_m_s, push_n, dt_s);

        let inertia = rotor.inertia_kg_m2;
        let mean_rad_s = 0.5 * (self.speed_rad_s + turning);
        ledger.friction_j += (inertia * (free - turning) + viscous_nm * dt_s) * mean_rad_s;
        ledger.guides_j += guides_j;
        ledger.damping_j += (flank.damping_n * relative_m_s
            + contact_forces.tips.damping_n * self.travel_m_s
            - (contact_forces.outer.damping_n + contact_forces.stop.damping_n) * self.travel_m_s)
            * dt_s;

        (self.speed_rad_s, self.travel_m_s) = (turning, moving);
        self.angle_rad += turning * dt_s;
        self.travel_m += moving * dt_s;
        (self.flank, self.contact_forces) = (flank, contact_forces);
    }

    /// Kinetic energy in J.
    pub fn kinetic_j(&self, rotor: &Rotor, fingers: &FingerPair) -> f64 {
        0.5 * rotor.inertia_kg_m2 * self.speed_rad_s * self.speed_rad_s
            + 0.5 * fingers.mass_kg * self.travel_m_s * self.travel_m_s
    }

    /// Elastic energy in J.
    pub fn springs_j(&self) -> f64 {
        let ContactForces { tips, outer, stop } = self.contact_forces;
        self.flank.stored_j + tips.stored_j + outer.stored_j + stop.stored_j
    }
}

/// Parameters of screw and nut. Travel is that of the opening, both fingers together; closing is positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeadScrew {
    /// Travel per radian of the rotor, in m/rad.
    pub travel_m_per_rad: f64,
    /// Friction torque over load torque; self-locking above one.
    pub friction: f64,
    /// Play between the flanks, in m.
    pub play_m: f64,
    /// Stiffness of the flanks, in N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the flanks, in N s/m.
    pub damping_ns_per_m: f64,
}

/// What the screw does to the nut.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlankForce {
    /// Force on the nut, closing positive, in N.
    pub force_n: f64,
    /// Dissipative part of the force, in N.
    pub damping_n: f64,
    /// Energy stored in the flank, in J.
    pub stored_j: f64,
}

impl LeadScrew {
    /// Force of the flank in contact; the screw leads the nut by `lead_m`, closing at `relative_m_s`.
    /// Flanks push and never pull.
    pub fn flank(&self, lead_m: f64, relative_m_s: f64) -> FlankForce {
        let side = lead_m.signum();
        let pressed_m = lead_m.abs() - 0.5 * self.play_m;
        if pressed_m <= 0.0 {
            return FlankForce::default();
        }
        let spring_n = self.stiffness_n_per_m * pressed_m;
        let size_n = (spring_n + self.damping_ns_per_m * side * relative_m_s).max(0.0);
        FlankForce {
            force_n: side * size_n,
            damping_n: side * (size_n - spring_n),
            stored_j: 0.5 * spring_n * pressed_m,
        }
    }

    /// Load torque of this nut force on the rotor, in N m.
    pub fn load_nm(&self, force_n: f64) -> f64 {
        -self.travel_m_per_rad * force_n
    }

    /// Maximum friction torque under this force, in N m.
    pub fn friction_nm(&self, force_n: f64) -> f64 {
        self.friction * self.travel_m_per_rad * force_n.abs()
    }
}

/// Stop at the open end, stiffness in N/m and damping in N s/m (assumed: steel on steel).
const OPEN_STOP: ContactModel = ContactModel { stiffness_n_per_m: 5e6, damping_ns_per_m: 1e3 };

/// Parameters of both fingers; each moves half of the travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerPair {
    /// Effective mass of the travel: half of one finger's, in kg.
    pub mass_kg: f64,
    /// Friction of the guides, referred to the travel, in N.
    pub guide_n: f64,
    /// Stiffness of both fingers' flexures in series, in N/m; quasi-static, since their vibration is
    /// near 900 Hz.
    pub flexures_n_per_m: f64,
    /// Opening at zero travel, in m; the travel ends at zero opening.
    pub stroke_m: f64,
}

/// Contact forces against the travel, closing positive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactForces {
    /// Between the fingertips.
    pub tips: ContactForce,
    /// Around the fingertips; its force acts towards closing.
    pub outer: ContactForce,
    /// At the open stop; its force acts towards closing.
    pub stop: ContactForce,
}

/// What the fingers touch: the travel at each contact in m, and its model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerContacts {
    /// An object between the fingertips, or the other fingertip.
    pub inner: (f64, ContactModel),
    /// Something around the fingertips.
    pub outer: Option<(f64, ContactModel)>,
}

impl FingerContacts {
    /// Contact forces at this travel and speed.
    pub fn forces(&self, travel_m: f64, speed_m_s: f64) -> ContactForces {
        let (from_m, inner) = self.inner;
        let outer = self.outer.map(|(from_m, outer)| outer.push(from_m - travel_m, -speed_m_s));
        ContactForces {
            tips: inner.push(travel_m - from_m, speed_m_s),
            outer: outer.unwrap_or_default(),
            stop: OPEN_STOP.push(-travel_m, -speed_m_s),
        }
    }
}

impl FingerPair {
    /// Contact of the tips with an object, in series with the flexures.
    pub fn contact(&self, object: &Object) -> ContactModel {
        let (own, tips) = (object.stiffness_n_per_m, self.flexures_n_per_m);
        ContactModel {
            stiffness_n_per_m: own * tips / (own + tips),
            damping_ns_per_m: object.damping_ns_per_m,
        }
    }

    /// Contact of the tips with each other.
    pub fn closed(&self) -> ContactModel {
        ContactModel {
            stiffness_n_per_m: self.flexures_n_per_m,
            damping_ns_per_m: Object::DAMPING_NS_PER_M,
        }
    }

    /// Speed after `dt_s` under a force, and the friction loss in the guides in J.
    pub fn accelerate(&self, speed_m_s: f64, force_n: f64, dt_s: f64) -> (f64, f64) {
        let free = speed_m_s + force_n / self.mass_kg * dt_s;
        let slowed = apply_coulomb(free, self.guide_n / self.mass_kg * dt_s);
        let lost_j = 0.5 * self.mass_kg * (free - slowed) * (speed_m_s + slowed);
        (slowed, lost_j)
    }
}

/// An object between the fingers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// Opening at contact, in m.
    pub width_m: f64,
    /// Stiffness in N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the contact, in N s/m.
    pub damping_ns_per_m: f64,
}

impl Object {
    /// Damping of every contact, in N s/m (assumed).
    pub const DAMPING_NS_PER_M: f64 = 100.0;

    /// An object of this width and stiffness, with default damping.
    pub fn new(width_m: f64, stiffness_n_per_mm: f64) -> Self {
        Self {
            width_m,
            stiffness_n_per_m: 1e3 * stiffness_n_per_mm,
            damping_ns_per_m: Self::DAMPING_NS_PER_M,
        }
    }
}

/// Unilateral spring and damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactModel {
    /// In N/m.
    pub stiffness_n_per_m: f64,
    /// In N s/m.
    pub damping_ns_per_m: f64,
}

/// Force and energy of a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactForce {
    /// Force in N.
    pub force_n: f64,
    /// Of it, what is lost, in N.
    pub damping_n: f64,
    /// Energy stored, in J.
    pub stored_j: f64,
}

impl ContactModel {
    /// Contact force at this indentation and indentation speed.
    pub fn push(&self, pressed_m: f64, inwards_m_s: f64) -> ContactForce {
        if pressed_m <= 0.0 {
            return ContactForce::default();
        }
        let spring_n = self.stiffness_n_per_m * pressed_m;
        let force_n = (spring_n + self.damping_ns_per_m * inwards_m_s).max(0.0);
        ContactForce {
            force_n,
            damping_n: force_n - spring_n,
            stored_j: 0.5 * spring_n * pressed_m,
        }
    }
}

/// Sliding over static friction (assumed).
const SLIDING: f64 = 0.8;
/// Minimum mass of the object in kg.
const MIN_KG: f64 = 0.05;

/// An object that is pulled along the fingers: it sticks or slips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PulledObject {
    /// Pulling force in N.
    pub pull_n: f64,
    /// Friction coefficient between fingertip and object.
    pub friction: f64,
    /// Slip speed in m/s.
    pub speed_m_s: f64,
    /// Slip distance in m.
    pub slipped_m: f64,
}

impl PulledObject {
    /// At rest, without a pulling force.
    pub fn new(friction: f64) -> Self {
        Self { pull_n: 0.0, friction, speed_m_s: 0.0, slipped_m: 0.0 }
    }

    /// Advances by `dt_s` under a grip force; returns the drag on both fingers together, in N.
    pub fn step(&mut self, grip_n: f64, dt_s: f64) -> f64 {
        let static_n = 2.0 * self.friction * grip_n;
        if self.speed_m_s == 0.0 && self.pull_n <= static_n {
            return self.pull_n;
        }
        let sliding_n = SLIDING * static_n;
        // The pulling force is the weight of a suspended load.
        let mass_kg = f64::max(self.pull_n / GRAVITY, MIN_KG);
        let faster = self.speed_m_s + (self.pull_n - sliding_n) / mass_kg * dt_s;
        self.speed_m_s = faster.max(0.0);
        self.slipped_m += self.speed_m_s * dt_s;
        sliding_n
    }
}

/// Supplied energy and losses since the start, in J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnergyLedger {
    /// Supplied.
    pub supplied_j: f64,
    /// Loss in supply resistance and cable.
    pub cable_j: f64,
    /// Copper loss.
    pub copper_j: f64,
    /// Diode loss.
    pub diodes_j: f64,
    /// Friction of rotor and screw, viscous friction included.
    pub friction_j: f64,
    /// Friction of the guides.
    pub guides_j: f64,
    /// Damping of flanks and contacts.
    pub damping_j: f64,
}

impl EnergyLedger {
    /// Sum of all losses.
    pub fn heat_j(&self) -> f64 {
        self.cable_j
            + self.copper_j
            + self.diodes_j
            + self.friction_j
            + self.guides_j
            + self.damping_j
    }
}

/// Stored energy at one time, in J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StoredEnergy {
    /// In the bus capacitor.
    pub capacitor_j: f64,
    /// In the windings' inductance.
    pub windings_j: f64,
    /// Kinetic.
    pub kinetic_j: f64,
    /// In flanks, flexures, objects, stops and cogging.
    pub springs_j: f64,
}

impl StoredEnergy {
    /// Sum of all terms.
    pub fn all_j(&self) -> f64 {
        self.capacitor_j + self.windings_j + self.kinetic_j + self.springs_j
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCREW: LeadScrew = LeadScrew {
        travel_m_per_rad: 5e-4,
        friction: 2.0,
        play_m: 30e-6,
        stiffness_n_per_m: 2e7,
        damping_ns_per_m: 500.0,
    };

    #[test]
    fn flank_is_elastic_beyond_the_backlash_and_never_pulls() {
        let cases = [
            // Within the backlash of 15 um either way.
            (14.9e-6, 1.0, 0.0, 0.0),
            (-14.9e-6, -1.0, 0.0, 0.0),
            (20e-6, 0.0, 100.0, 0.0),
            (-20e-6, 0.0, -100.0, 0.0),
            // Separates faster than the elastic force.
            (20e-6, -1.0, 0.0, -100.0),
        ];
        for (deflection_m, speed_m_s, force_n, damping_n) in cases {
            let flank = SCREW.flank(deflection_m, speed_m_s);
            let is_equal = |a: f64, b: f64| (a - b).abs() < 1e-9;
            assert!(is_equal(flank.force_n, force_n), "{deflection_m} m: {flank:?}");
            assert!(is_equal(flank.damping_n, damping_n), "{deflection_m} m: {flank:?}");
        }
    }

    #[test]
    fn friction_is_proportional_to_the_load() {
        assert!((SCREW.load_nm(100.0) + 0.05).abs() < 1e-12);
        assert!((SCREW.friction_nm(-100.0) - 0.1).abs() < 1e-12);
    }

    const FINGERS: FingerPair =
        FingerPair { mass_kg: 0.1, guide_n: 1.0, flexures_n_per_m: 500e3, stroke_m: 0.08 };

    #[test]
    fn object_and_flexures_act_in_series() {
        let contact = FINGERS.contact(&Object::new(0.04, 1000.0));
        assert!((contact.stiffness_n_per_m - 1e6 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn forces_below_guide_friction_do_not_move_the_fingers() {
        assert_eq!(FINGERS.accelerate(0.0, 0.99, 1e-3), (0.0, 0.0));
        let (speed, _) = FINGERS.accelerate(0.0, 3.0, 1e-3);
        assert!((speed - 0.02).abs() < 1e-12);
    }

    #[test]
    fn coasting_finger_dissipates_its_energy_in_the_guides() {
        let (mut speed, mut lost) = (0.05, 0.0);
        while speed > 0.0 {
            let (slower, one) = FINGERS.accelerate(speed, 0.0, 1e-5);
            (speed, lost) = (slower, lost + one);
        }
        assert!((lost - 0.5 * 0.1 * 0.05 * 0.05).abs() < 1e-12);
    }

    #[test]
    fn contact_is_elastic_and_never_pulls() {
        let contact = ContactModel { stiffness_n_per_m: 333e3, damping_ns_per_m: 100.0 };
        assert!((contact.push(0.3e-3, 0.0).force_n - 99.9).abs() < 1e-9);
        assert!((contact.push(0.3e-3, 0.05).force_n - 104.9).abs() < 1e-9);
        assert_eq!(contact.push(0.01e-3, -0.1).force_n, 0.0);
        assert_eq!(contact.push(-1e-6, 0.1), ContactForce::default());
    }

    #[test]
    fn object_slips_beyond_static_friction_until_gripped_harder() {
        // Both fingers at 100 N bear 0.5 * 200 N.
        let mut pulled = PulledObject::new(0.5);
        pulled.pull_n = 99.0;
        assert_eq!((pulled.step(100.0, 1e-3), pulled.slipped_m), (99.0, 0.0));
        pulled.pull_n = 101.0;
        // It slides against 80 N: 21 N on 10.3 kg are 2.04 m/s^2.
        assert_eq!(pulled.step(100.0, 1e-3), 80.0);
        assert!((pulled.speed_m_s - 2.04e-3).abs() < 1e-5, "{pulled:?}");
        // At 150 N it slides against 120 N, and comes to rest.
        for _ in 0..3 {
            pulled.step(150.0, 1e-3);
        }
        assert_eq!(pulled.speed_m_s, 0.0);
        let at_m = pulled.slipped_m;
        assert_eq!(pulled.step(150.0, 1e-3), 101.0);
        assert_eq!(pulled.slipped_m, at_m);
    }
}
