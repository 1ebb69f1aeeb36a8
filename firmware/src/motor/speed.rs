//! The speed loop: the rotor's speed by the current along q.

use core::f32::consts::TAU;

use super::MOTION_HZ;
use super::limits::Bounds;
use super::number::within;
use super::pi::{Gains, Pi};
use super::settings::Machine;
use crate::params;

/// The integral's corner lies by this factor below the crossover.
const CORNER: f32 = 5.0;

/// Coefficients: the crossover is [`params::SPEED_BANDWIDTH`].
pub fn gains(machine: &Machine) -> Gains {
    let crossover = TAU * params::SPEED_BANDWIDTH.value as f32;
    let gain = crossover * machine.inertia_kg_m2 / machine.torque_nm_a;
    Gains::of(gain, crossover / CORNER, 1.0 / MOTION_HZ as f32)
}

/// Amperes ahead of the loop for a motion that is known: inertia and friction.
pub fn ahead_a(machine: &Machine, speed: f32, acceleration: f32) -> f32 {
    // Below a rad/s the sign of the friction is that of a rotor that hardly moves.
    let friction = machine.dry_nm * within(speed, -1.0, 1.0) + machine.viscous_nm_s * speed;
    (machine.inertia_kg_m2 * acceleration + friction) / machine.torque_nm_a
}

/// The loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpeedLoop {
    pi: Pi,
}

impl SpeedLoop {
    /// Begins with a current in amperes along q that flows.
    pub const fn start(current_a: f32) -> Self {
        Self {
            pi: Pi { sum: current_a },
        }
    }

    /// The current along q in amperes for a speed in rad/s, within bounds, and whether they held it.
    pub fn decide(
        &mut self,
        gains: &Gains,
        [asked, measured]: [f32; 2],
        ahead_a: f32,
        bounds: &Bounds,
    ) -> (f32, bool) {
        let error = asked - measured;
        let wanted = self.pi.ask(gains, error) + ahead_a;
        let given = within(wanted, bounds.low_a, bounds.high_a);
        self.pi.close(gains, error, given - wanted);
        (given, given != wanted)
    }
}
