//! The drive train in time: rotor and screws as one, fingers as the other, play between them.

use super::energy::Ledger;
use super::finger::{Against, Fingers};
use super::friction::{Stribeck, braked};
use super::object::Contact;
use super::screw::{Flank, Screw};

/// What turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotor {
    /// Inertia of rotor, screws and coupling, in kg m^2.
    pub inertia_kg_m2: f64,
    /// Viscous friction in N m s/rad.
    pub viscous_nm_s: f64,
    /// Dry friction without load.
    pub dry: Stribeck,
}

/// Rotor and fingers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Train {
    /// The rotor's angle in rad, closing positive.
    pub angle_rad: f64,
    /// Its speed in rad/s.
    pub speed_rad_s: f64,
    /// The fingers' travel from the open end, in m.
    pub travel_m: f64,
    /// Its speed in m/s.
    pub travel_m_s: f64,
    /// What the screw does to the nut.
    pub flank: Flank,
    /// What the fingers meet.
    pub against: Against,
}

impl Train {
    /// At rest, with the closing flank just touching.
    pub fn at(travel_m: f64, screw: &Screw) -> Self {
        Self {
            angle_rad: (travel_m + 0.5 * screw.play_m) / screw.travel_m_per_rad,
            travel_m,
            ..Self::default()
        }
    }

    /// Goes on by `dt_s` with a torque on the rotor; `tips` is the travel where the tips touch, and how.
    pub fn step(
        &mut self,
        (rotor, screw, fingers): (&Rotor, &Screw, &Fingers),
        torque_nm: f64,
        tips: &(f64, Contact),
        (ledger, dt_s): (&mut Ledger, f64),
    ) {
        let ratio = screw.travel_m_per_rad;
        let ahead_m = self.angle_rad * ratio - self.travel_m;
        let faster_m_s = self.speed_rad_s * ratio - self.travel_m_s;
        let flank = screw.flank(ahead_m, faster_m_s);
        let against = fingers.against(self.travel_m, self.travel_m_s, tips);

        let viscous_nm = rotor.viscous_nm_s * self.speed_rad_s;
        let push_nm = torque_nm + screw.load_nm(flank.force_n) - viscous_nm;
        let free = self.speed_rad_s + push_nm / rotor.inertia_kg_m2 * dt_s;
        let friction_nm = rotor.dry.torque_nm(free) + screw.friction_nm(flank.force_n);
        let turning = braked(free, friction_nm / rotor.inertia_kg_m2 * dt_s);

        let push_n = flank.force_n - against.tips.force_n + against.stop.force_n;
        let (moving, guides_j) = fingers.moved(self.travel_m_s, push_n, dt_s);

        let inertia = rotor.inertia_kg_m2;
        ledger.friction_j += 0.5 * inertia * (free * free - turning * turning)
            + viscous_nm * 0.5 * (self.speed_rad_s + free) * dt_s;
        ledger.guides_j += guides_j;
        ledger.damping_j += (flank.damping_n * faster_m_s
            + against.tips.damping_n * self.travel_m_s
            - against.stop.damping_n * self.travel_m_s)
            * dt_s;

        (self.speed_rad_s, self.travel_m_s) = (turning, moving);
        self.angle_rad += turning * dt_s;
        self.travel_m += moving * dt_s;
        (self.flank, self.against) = (flank, against);
    }

    /// Energy of what moves, in J.
    pub fn kinetic_j(&self, rotor: &Rotor, fingers: &Fingers) -> f64 {
        0.5 * rotor.inertia_kg_m2 * self.speed_rad_s * self.speed_rad_s
            + 0.5 * fingers.mass_kg * self.travel_m_s * self.travel_m_s
    }

    /// Energy in everything that gives way, in J.
    pub fn springs_j(&self) -> f64 {
        self.flank.stored_j + self.against.tips.stored_j + self.against.stop.stored_j
    }
}
