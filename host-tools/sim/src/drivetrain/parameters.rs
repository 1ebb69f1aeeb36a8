//! Parameters of the drivetrain in SI units: nominal, simplified for hand calculation, or with tolerances.

use crate::drivetrain::electrical::{Cogging, Inverter, Supply, Windings};
use crate::drivetrain::mechanics::{FingerPair, LeadScrew, Rotor};
use crate::drivetrain::sensors::MotorSensors;
use crate::friction::Stribeck;
use crate::random::{Purpose, stream, uniform};
use firmware::config::constants;
use firmware::motor::screw::Screw as FirmwareScrew;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// The two interpretations of the paper's closing speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Lead {
    /// 58.3 mm/s of the opening: a fine, self-locking screw.
    A,
    /// 58.3 mm/s of each finger: a coarse, backdrivable screw.
    B,
}

impl Lead {
    /// Both screws.
    pub const BOTH: [Self; 2] = [Self::A, Self::B];

    /// Lead, and efficiency at rated torque.
    pub fn constants(self) -> [constants::Constant; 2] {
        match self {
            Self::A => [constants::LEAD_A, constants::EFFICIENCY_A],
            Self::B => [constants::LEAD_B, constants::EFFICIENCY_B],
        }
    }

    /// The firmware's parameters of this screw.
    pub fn screw(self) -> FirmwareScrew {
        match self {
            Self::A => FirmwareScrew::A,
            Self::B => FirmwareScrew::B,
        }
    }

    /// Speed of the opening at the paper's closing speed, in mm/s.
    pub fn closing_mm_s(self) -> f64 {
        match self {
            Self::A => constants::CLOSING_SPEED.value,
            Self::B => 2.0 * constants::CLOSING_SPEED.value,
        }
    }

    /// Travel of the opening per radian of the rotor, in m.
    pub fn travel_m_per_rad(self) -> f64 {
        1e-3 * f64::from(self.screw().ratio_mm)
    }

    /// Friction torque over load torque.
    pub fn friction(self) -> f64 {
        f64::from(self.screw().friction)
    }
}

/// Parameters of the whole drivetrain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantParameters {
    /// Supply and bus capacitor.
    pub supply: Supply,
    /// Half bridges.
    pub inverter: Inverter,
    /// Motor windings.
    pub windings: Windings,
    /// Rotating parts.
    pub rotor: Rotor,
    /// Cogging torque.
    pub cogging: Cogging,
    /// Lead screw.
    pub screw: LeadScrew,
    /// Fingers.
    pub fingers: FingerPair,
    /// Sensors of the motor control.
    pub sensors: MotorSensors,
    /// Rotor angle of zero electrical angle, in rad.
    pub zero_rad: f64,
    /// Phases V and W are swapped.
    pub swapped: bool,
}

/// Relative tolerance of uncertain parameters in scattered grippers.
pub const SCATTER: f64 = 0.2;

/// Damping ratio of the flanks (assumed).
const FLANK_DAMPING: f64 = 0.2;

impl PlantParameters {
    /// Nominal values of [`firmware::config::constants`].
    pub fn nominal(lead: Lead) -> Self {
        let windings = Windings {
            resistance_ohm: constants::PHASE_RESISTANCE.value,
            inductance_h: 1e-3 * constants::PHASE_INDUCTANCE.value,
            flux_wb: constants::TORQUE_CONSTANT.value / (1.5 * constants::POLE_PAIRS.value),
            pole_pairs: constants::POLE_PAIRS.value,
        };
        let fingers = FingerPair {
            mass_kg: 0.5 * constants::FINGER_MASS.value,
            guide_n: constants::GUIDE_FRICTION.value,
            // Two flexures in parallel carry a finger, and the fingers are in series.
            flexures_n_per_m: 1e3 * constants::STIFFNESS_X.value,
            stroke_m: 1e-3 * constants::STROKE.value,
        };
        let stiffness_n_per_m = 1e6 * constants::SCREW_STIFFNESS.value;
        Self {
            supply: Supply {
                voltage_v: constants::BUS_VOLTAGE.value,
                resistance_ohm: constants::SUPPLY_RESISTANCE.value,
                capacitance_f: 1e-6 * constants::BUS_CAPACITANCE.value,
            },
            inverter: Inverter {
                dead_share: 1e-6 * constants::DEAD_TIME.value * constants::PWM_RATE.value,
                diode_v: constants::DIODE_DROP.value,
            },
            windings,
            rotor: Rotor {
                inertia_kg_m2: constants::ROTOR_INERTIA.value,
                viscous_nm_s: constants::VISCOUS_FRICTION.value,
                dry: Stribeck {
                    breakaway_nm: constants::BREAKAWAY_FRICTION.value,
                    dry_nm: constants::DRY_FRICTION.value,
                    half_rad_s: constants::STRIBECK_SPEED.value,
                },
            },
            cogging: Cogging {
                torque_nm: constants::COGGING.value,
                periods: constants::COGGING_PERIODS.value,
            },
            screw: LeadScrew {
                travel_m_per_rad: lead.travel_m_per_rad(),
                friction: lead.friction(),
                play_m: 1e-3 * constants::BACKLASH.value,
                stiffness_n_per_m,
                damping_ns_per_m: 2.0
                    * FLANK_DAMPING
                    * (stiffness_n_per_m * fingers.mass_kg).sqrt(),
            },
            fingers,
            sensors: MotorSensors::nominal(),
            zero_rad: 0.0,
            swapped: false,
        }
    }

    /// Nominal without backlash, cogging, breakaway, guide friction and dead time, with ideal sensors and a
    /// stiff supply, for cases that can be solved by hand.
    pub fn simplified(lead: Lead) -> Self {
        let mut parameters = Self::nominal(lead);
        parameters.screw.play_m = 0.0;
        parameters.cogging.torque_nm = 0.0;
        parameters.rotor.dry.breakaway_nm = parameters.rotor.dry.dry_nm;
        parameters.fingers.guide_n = 0.0;
        parameters.inverter.dead_share = 0.0;
        parameters.supply.resistance_ohm = 0.02;
        parameters.sensors = MotorSensors::ideal();
        parameters
    }

    /// Nominal with all uncertain parameters off by up to `share`, uniformly distributed, and a random rotor
    /// zero.
    pub fn scattered(lead: Lead, share: f64, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Drive, 0);
        let mut parameters = Self::nominal(lead);
        for value in parameters.uncertain() {
            *value *= uniform(&mut rng, 1.0 - share, 1.0 + share);
        }
        parameters.zero_rad = uniform(&mut rng, 0.0, TAU);
        parameters.sensors = MotorSensors::random(&mut rng);
        parameters
    }

    /// Parameters with a tolerance; lengths, tooth and pole numbers and the supply voltage have none.
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

/// Random stream of a plant's sensor noise.
pub fn noise_stream(seed: u64) -> ChaCha8Rng {
    stream(seed, Purpose::DriveNoise, 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn screw_a_is_self_locking_and_b_is_backdrivable() {
        assert!(Lead::A.friction() > 1.0 && Lead::B.friction() < 1.0);
    }

    #[test]
    fn scattered_parameters_are_seeded_and_within_tolerance() {
        let scattered = |seed| PlantParameters::scattered(Lead::A, 0.2, seed);
        assert_eq!(scattered(1), scattered(1));
        assert_ne!(scattered(1).windings, scattered(2).windings);
        for seed in 0..50 {
            let ratio = scattered(seed).windings.resistance_ohm / constants::PHASE_RESISTANCE.value;
            assert!((0.8..=1.2).contains(&ratio));
            assert!(scattered(seed).screw.friction > 1.0);
        }
    }
}
