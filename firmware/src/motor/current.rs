//! The current loop: currents along the rotor's axes, by a voltage within the circle.
//!
//! Its controllers cancel the windings' own pole, so that what is left is one integrator and the delay of a
//! period; what turning couples between the axes, and the voltage that the magnets induce, is added ahead.

use core::f32::consts::TAU;

use super::PERIOD_S;
use super::number::inverse_sqrt;
use super::pi::{Gains, Pi};
use super::settings::Machine;
use super::transform::Dq;
use crate::params;

/// What the loop knows of the windings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windings {
    gains: Gains,
    inductance_h: f32,
    flux_wb: f32,
}

impl Windings {
    /// From resistance, inductance and flux; the crossover is [`params::CURRENT_BANDWIDTH`].
    pub fn of(machine: &Machine) -> Self {
        let crossover = TAU * params::CURRENT_BANDWIDTH.value as f32;
        let corner = machine.resistance_ohm / machine.inductance_h;
        Self {
            gains: Gains::of(crossover * machine.inductance_h, corner, PERIOD_S),
            inductance_h: machine.inductance_h,
            flux_wb: machine.flux_wb(),
        }
    }
}

/// Both controllers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CurrentLoop {
    d: Pi,
    q: Pi,
}

/// What the loop decided.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Decided {
    /// Volts.
    pub voltage: Dq,
    /// The circle was too small.
    pub is_limited: bool,
}

impl CurrentLoop {
    /// The voltage for the next period. `speed` is electrical, in rad/s.
    pub fn decide(
        &mut self,
        windings: &Windings,
        asked: Dq,
        measured: Dq,
        speed: f32,
        greatest_v: f32,
    ) -> Decided {
        let gains = &windings.gains;
        let error = Dq {
            d: asked.d - measured.d,
            q: asked.q - measured.q,
        };
        let turning = speed * windings.inductance_h;
        let wanted = Dq {
            d: self.d.ask(gains, error.d) - turning * measured.q,
            q: self.q.ask(gains, error.q) + turning * measured.d + speed * windings.flux_wb,
        };
        let squared = wanted.squared();
        let is_limited = squared > greatest_v * greatest_v;
        let scale = match is_limited {
            true => greatest_v * inverse_sqrt(squared),
            false => 1.0,
        };
        let voltage = Dq {
            d: scale * wanted.d,
            q: scale * wanted.q,
        };
        self.d.close(gains, error.d, voltage.d - wanted.d);
        self.q.close(gains, error.q, voltage.q - wanted.q);
        Decided {
            voltage,
            is_limited,
        }
    }
}
