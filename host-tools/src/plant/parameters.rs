//! What a plant is made of, in SI units: nominal from the parameter card, or scattered about it.

use std::f64::consts::TAU;

use firmware::motor::screw::Screw as Known;
use firmware::params;
use rand_chacha::ChaCha8Rng;

use super::bus::Supply;
use super::cogging::Cogging;
use super::finger::Fingers;
use super::friction::Stribeck;
use super::inverter::Inverter;
use super::motor::Windings;
use super::screw::Screw;
use super::sensing::Sensors;
use super::train::Rotor;
use crate::bench::draw::{Purpose, between, stream};

/// The two readings of the paper's closing speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Lead {
    /// 58.3 mm/s of the opening: a fine screw that locks itself.
    A,
    /// 58.3 mm/s of each finger: a coarse screw that is driven back.
    B,
}

impl Lead {
    /// Both.
    pub const BOTH: [Self; 2] = [Self::A, Self::B];

    /// Lead of each screw and its efficiency at rated torque.
    pub fn constants(self) -> [params::Constant; 2] {
        match self {
            Self::A => [params::LEAD_A, params::EFFICIENCY_A],
            Self::B => [params::LEAD_B, params::EFFICIENCY_B],
        }
    }

    /// The firmware's own: one screw, one set of constants.
    pub fn screw(self) -> Known {
        match self {
            Self::A => Known::A,
            Self::B => Known::B,
        }
    }

    /// Speed of the opening in mm/s that is the paper's closing speed.
    pub fn closing_mm_s(self) -> f64 {
        match self {
            Self::A => params::CLOSING_SPEED.value,
            Self::B => 2.0 * params::CLOSING_SPEED.value,
        }
    }

    /// Travel of the opening for a radian of the rotor, in m.
    pub fn travel_m_per_rad(self) -> f64 {
        1e-3 * f64::from(self.screw().ratio_mm)
    }

    /// Torque of friction over torque of load.
    pub fn friction(self) -> f64 {
        f64::from(self.screw().friction)
    }
}

/// All of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// What feeds the power stage.
    pub supply: Supply,
    /// The half bridges.
    pub inverter: Inverter,
    /// The motor's windings.
    pub windings: Windings,
    /// What turns.
    pub rotor: Rotor,
    /// The magnets' pull towards the teeth.
    pub cogging: Cogging,
    /// The lead screw.
    pub screw: Screw,
    /// The fingers.
    pub fingers: Fingers,
    /// What the control sees.
    pub sensors: Sensors,
    /// Rotor's angle at which the electrical angle is zero, in rad.
    pub zero_rad: f64,
    /// Phases V and W are swapped.
    pub swapped: bool,
}

/// Damping of the flanks as a share of the critical (assumed).
const FLANK_DAMPING: f64 = 0.2;

impl Parameters {
    /// As the card says.
    pub fn nominal(lead: Lead) -> Self {
        let windings = Windings {
            resistance_ohm: params::PHASE_RESISTANCE.value,
            inductance_h: 1e-3 * params::PHASE_INDUCTANCE.value,
            flux_wb: params::TORQUE_CONSTANT.value / (1.5 * params::POLE_PAIRS.value),
            pole_pairs: params::POLE_PAIRS.value,
        };
        let fingers = Fingers {
            mass_kg: 0.5 * params::FINGER_MASS.value,
            guide_n: params::GUIDE_FRICTION.value,
            // Two sensors' flexures carry a finger, and the fingers give way one behind the other.
            flexures_n_per_m: 1e3 * params::STIFFNESS_X.value,
            stroke_m: 1e-3 * params::STROKE.value,
        };
        let stiffness_n_per_m = 1e6 * params::SCREW_STIFFNESS.value;
        Self {
            supply: Supply {
                voltage_v: params::BUS_VOLTAGE.value,
                resistance_ohm: params::SUPPLY_RESISTANCE.value,
                capacitance_f: 1e-6 * params::BUS_CAPACITANCE.value,
            },
            inverter: Inverter {
                dead_share: 1e-6 * params::DEAD_TIME.value * params::PWM_RATE.value,
                diode_v: params::DIODE_DROP.value,
            },
            windings,
            rotor: Rotor {
                inertia_kg_m2: params::ROTOR_INERTIA.value,
                viscous_nm_s: params::VISCOUS_FRICTION.value,
                dry: Stribeck {
                    breakaway_nm: params::BREAKAWAY_FRICTION.value,
                    dry_nm: params::DRY_FRICTION.value,
                    half_rad_s: params::STRIBECK_SPEED.value,
                },
            },
            cogging: Cogging {
                torque_nm: params::COGGING.value,
                periods: params::COGGING_PERIODS.value,
            },
            screw: Screw {
                travel_m_per_rad: lead.travel_m_per_rad(),
                friction: lead.friction(),
                play_m: 1e-3 * params::PLAY.value,
                stiffness_n_per_m,
                damping_ns_per_m: 2.0
                    * FLANK_DAMPING
                    * (stiffness_n_per_m * fingers.mass_kg).sqrt(),
            },
            fingers,
            sensors: Sensors::nominal(),
            zero_rad: 0.0,
            swapped: false,
        }
    }

    /// Without what makes hand-worked cases hard: no play, no cogging, no breakaway, no friction of guides,
    /// no dead time, ideal sensors and a supply without resistance to speak of.
    pub fn plain(lead: Lead) -> Self {
        let mut parameters = Self::nominal(lead);
        parameters.screw.play_m = 0.0;
        parameters.cogging.torque_nm = 0.0;
        parameters.rotor.dry.breakaway_nm = parameters.rotor.dry.dry_nm;
        parameters.fingers.guide_n = 0.0;
        parameters.inverter.dead_share = 0.0;
        parameters.supply.resistance_ohm = 0.02;
        parameters.sensors = Sensors::ideal();
        parameters
    }

    /// As another gripper of the same drawing may come out: all that is not cut to size is off by up to
    /// `share`, evenly, and the rotor's zero is anywhere.
    pub fn scattered(lead: Lead, share: f64, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Drive, 0);
        let mut parameters = Self::nominal(lead);
        for value in parameters.uncertain() {
            *value *= between(&mut rng, 1.0 - share, 1.0 + share);
        }
        parameters.zero_rad = between(&mut rng, 0.0, TAU);
        parameters.sensors = Sensors::drawn(&mut rng);
        parameters
    }

    /// What is not cut to size. Lengths, numbers of teeth and poles are; the supply's voltage is held.
    fn uncertain(&mut self) -> [&mut f64; 18] {
        [
            &mut self.supply.resistance_ohm,
            &mut self.supply.capacitance_f,
            &mut self.inverter.dead_share,
            &mut self.inverter.diode_v,
            &mut self.windings.resistance_ohm,
            &mut self.windings.inductance_h,
            &mut self.windings.flux_wb,
            &mut self.rotor.inertia_kg_m2,
            &mut self.rotor.viscous_nm_s,
            &mut self.rotor.dry.breakaway_nm,
            &mut self.rotor.dry.dry_nm,
            &mut self.cogging.torque_nm,
            &mut self.screw.friction,
            &mut self.screw.play_m,
            &mut self.screw.stiffness_n_per_m,
            &mut self.fingers.mass_kg,
            &mut self.fingers.guide_n,
            &mut self.fingers.flexures_n_per_m,
        ]
    }
}

/// A stream for the noise of a plant.
pub fn noise(seed: u64) -> ChaCha8Rng {
    stream(seed, Purpose::DriveNoise, 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn screw_a_locks_itself_and_b_is_driven_back() {
        assert!(Lead::A.friction() > 1.0 && Lead::B.friction() < 1.0);
    }

    #[test]
    fn a_scattered_gripper_is_the_same_for_the_same_seed_and_within_its_share() {
        let drawn = |seed| Parameters::scattered(Lead::A, 0.2, seed);
        assert_eq!(drawn(1), drawn(1));
        assert_ne!(drawn(1).windings, drawn(2).windings);
        for seed in 0..50 {
            let ratio = drawn(seed).windings.resistance_ohm / params::PHASE_RESISTANCE.value;
            assert!((0.8..=1.2).contains(&ratio));
            assert!(drawn(seed).screw.friction > 1.0);
        }
    }
}
