//! What the control knows of motor, screw and board. Gains are derived from it, nowhere typed in.

use super::commission::Found;
use super::limits::Limits;
use super::screw::Screw;
use crate::params;

/// The motor and what turns with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Machine {
    /// Pole pairs.
    pub pole_pairs: u8,
    /// Of one phase, in ohms.
    pub resistance_ohm: f32,
    /// Of one phase, in henries, the same on both axes.
    pub inductance_h: f32,
    /// Torque of one ampere along q, in newton metres.
    pub torque_nm_a: f32,
    /// Rotor, screws and coupling, in kg m^2.
    pub inertia_kg_m2: f32,
    /// Dry friction without load, in newton metres.
    pub dry_nm: f32,
    /// Viscous friction, in newton metres for one rad/s.
    pub viscous_nm_s: f32,
}

impl Machine {
    /// The motor that is assumed; commissioning measures resistance, inductance and pole pairs.
    pub const ASSUMED: Self = Self {
        pole_pairs: params::POLE_PAIRS.value as u8,
        resistance_ohm: params::PHASE_RESISTANCE.value as f32,
        inductance_h: (params::PHASE_INDUCTANCE.value * 1e-3) as f32,
        torque_nm_a: params::TORQUE_CONSTANT.value as f32,
        inertia_kg_m2: params::ROTOR_INERTIA.value as f32,
        dry_nm: params::DRY_FRICTION.value as f32,
        viscous_nm_s: params::VISCOUS_FRICTION.value as f32,
    };

    /// Flux of the magnets through a phase in webers, by the torque: no second number to get wrong.
    pub fn flux_wb(&self) -> f32 {
        self.torque_nm_a / (1.5 * f32::from(self.pole_pairs))
    }
}

/// How the rotor's sensor sits and the phases are wired; commissioning finds it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wiring {
    /// The electrical angle at which the sensor tells zero, in 2^-32 turns, with its sign turned.
    pub offset: u32,
    /// Phases V and W are swapped: a field that turns forward opens the gripper.
    pub is_swapped: bool,
}

/// Everything that the control is set to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The motor.
    pub machine: Machine,
    /// Sensor and phases.
    pub wiring: Wiring,
    /// The lead screw.
    pub screw: Screw,
    /// Bounds.
    pub limits: Limits,
    /// How old the rotor's angle is when the currents are sensed, in periods of the pulses.
    pub angle_age_periods: f32,
}

impl Settings {
    /// The assumed motor with a screw; the angle is as old as the currents.
    pub const fn assumed(screw: Screw) -> Self {
        Self {
            machine: Machine::ASSUMED,
            wiring: Wiring {
                offset: 0,
                is_swapped: false,
            },
            screw,
            limits: Limits::GRIPPER,
            angle_age_periods: 0.0,
        }
    }

    /// Takes over what commissioning found.
    pub fn adopt(&mut self, found: &Found) {
        self.machine.resistance_ohm = found.resistance_ohm;
        self.machine.inductance_h = found.inductance_h;
        self.machine.pole_pairs = found.pole_pairs;
        self.wiring = found.wiring;
    }

    /// Whether the control can work with it: everything is a number, and what must be positive is.
    pub fn is_sound(&self) -> bool {
        let (machine, screw, limits) = (&self.machine, &self.screw, &self.limits);
        let positive = [
            machine.resistance_ohm,
            machine.inductance_h,
            machine.torque_nm_a,
            machine.inertia_kg_m2,
            screw.ratio_mm,
            limits.rated_a,
            limits.peak_a,
            limits.peak_s,
            limits.trip_a,
            limits.power_w,
            limits.speed,
            limits.trip_speed,
            limits.high_v,
            limits.homing_mm_s,
            limits.sum_a,
            limits.beside_v,
            limits.beside,
            limits.unfollowed_a,
            limits.runaway,
            limits.runaway_a,
        ];
        let not_negative = [
            machine.dry_nm,
            machine.viscous_nm_s,
            screw.play_mm,
            screw.friction,
            self.angle_age_periods,
        ];
        let rising = [
            limits.motor_c,
            limits.stage_c,
            limits.low_v,
            limits.burn_v,
            limits.ends_mm,
        ];
        machine.pole_pairs > 0
            && positive
                .iter()
                .all(|value| value.is_normal() && *value > 0.0)
            && not_negative
                .iter()
                .all(|value| value.is_finite() && *value >= 0.0)
            && rising
                .iter()
                .all(|[from, to]| from.is_finite() && to.is_finite() && from < to)
    }
}
