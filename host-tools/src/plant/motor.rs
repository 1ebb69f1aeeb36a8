//! The motor's windings: three phases in a star, with resistance, inductance and the magnets' flux.

use std::f64::consts::FRAC_PI_3;

use super::phasor::Phasor;

/// What the windings are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windings {
    /// Of one phase, in ohm.
    pub resistance_ohm: f64,
    /// Of one phase, the same on d and q, in H.
    pub inductance_h: f64,
    /// Flux linkage of the magnets, peak, in Wb.
    pub flux_wb: f64,
    /// Pole pairs.
    pub pole_pairs: f64,
}

impl Windings {
    /// Torque for one ampere of quadrature current, in N m/A.
    pub fn torque_constant(&self) -> f64 {
        1.5 * self.pole_pairs * self.flux_wb
    }
}

/// What flowed in a step, means over it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flow {
    /// Out of the bus, in A; negative where the motor returns some.
    pub bus_a: f64,
    /// Torque on the rotor in N m.
    pub torque_nm: f64,
    /// Heat in the windings in W.
    pub copper_w: f64,
    /// Heat in the diodes in W.
    pub diodes_w: f64,
}

/// The windings in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motor {
    /// Into the phases, in A; their sum is zero.
    pub currents_a: [f64; 3],
}

/// Shapes of the phases' back-EMF where the electrical angle has this phasor: a current of this shape is
/// quadrature current.
fn shapes(electrical: &Phasor) -> [f64; 3] {
    let (half, across) = (0.5 * electrical.sin, FRAC_PI_3.sin() * electrical.cos);
    [-electrical.sin, half + across, half - across]
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Motor {
    /// Direct and quadrature current in A.
    pub fn direct_quadrature_a(&self, electrical: &Phasor) -> [f64; 2] {
        let ahead = Phasor {
            cos: -electrical.sin,
            sin: electrical.cos,
        };
        // The shape a quarter turn ahead is that of minus the direct current.
        [
            -dot(&shapes(&ahead), &self.currents_a) / 1.5,
            dot(&shapes(electrical), &self.currents_a) / 1.5,
        ]
    }

    /// Energy in the inductances in J.
    pub fn stored_j(&self, windings: &Windings) -> f64 {
        0.5 * windings.inductance_h * dot(&self.currents_a, &self.currents_a)
    }

    /// Goes on by a step with the terminals held at shares of the bus voltage. `keep` is what a current
    /// keeps of itself in the step, exp(-R dt/L).
    pub fn held(
        &mut self,
        windings: &Windings,
        (electrical, speed_rad_s): (&Phasor, f64),
        (shares, bus_v): (&[f64; 3], f64),
        keep: f64,
    ) -> Flow {
        let shapes = shapes(electrical);
        let emf_v = windings.flux_wb * windings.pole_pairs * speed_rad_s;
        let star = (shares[0] + shares[1] + shares[2]) / 3.0;
        let driven = (1.0 - keep) / windings.resistance_ohm;
        let mut mean_a = self.currents_a;
        for phase in 0..3 {
            let across_v = (shares[phase] - star) * bus_v - emf_v * shapes[phase];
            let current = &mut self.currents_a[phase];
            *current = *current * keep + across_v * driven;
            mean_a[phase] = 0.5 * (mean_a[phase] + *current);
        }
        Flow {
            bus_a: dot(shares, &mean_a),
            torque_nm: windings.pole_pairs * windings.flux_wb * dot(&shapes, &mean_a),
            copper_w: windings.resistance_ohm * dot(&mean_a, &mean_a),
            diodes_w: 0.0,
        }
    }

    /// Goes on by `dt_s` with all switches off: each current flows on through a diode until it is gone, and
    /// none begins but where the back-EMF exceeds the bus.
    pub fn free(
        &mut self,
        windings: &Windings,
        (electrical, speed_rad_s): (&Phasor, f64),
        (diode_v, bus_v): (f64, f64),
        dt_s: f64,
    ) -> Flow {
        let shapes = shapes(electrical);
        let emf_v = windings.flux_wb * windings.pole_pairs * speed_rad_s;
        let emf_v = shapes.map(|shape| emf_v * shape);
        let (low, high) = (-diode_v, bus_v + diode_v);
        let before = self.currents_a;
        let Some((signs, terminals, star)) = conducting(&before, &emf_v, low, high) else {
            return Flow::default();
        };
        for phase in 0..3 {
            if signs[phase] == 0.0 {
                continue;
            }
            let lost_v = windings.resistance_ohm * before[phase];
            let across_v = terminals[phase] - star - emf_v[phase] - lost_v;
            let after = before[phase] + across_v / windings.inductance_h * dt_s;
            // A diode lets nothing back.
            self.currents_a[phase] = if after * signs[phase] > 0.0 { after } else { 0.0 };
        }
        balance(&mut self.currents_a);
        let mean_a = [0, 1, 2].map(|phase| 0.5 * (before[phase] + self.currents_a[phase]));
        Flow {
            bus_a: mean_a.iter().map(|current| current.min(0.0)).sum(),
            torque_nm: windings.pole_pairs * windings.flux_wb * dot(&shapes, &mean_a),
            copper_w: windings.resistance_ohm * dot(&mean_a, &mean_a),
            diodes_w: diode_v * mean_a.iter().map(|current| current.abs()).sum::<f64>(),
        }
    }
}

/// Signs of the currents that flow or begin to, their terminals' voltages, and the star point's. Nothing
/// where no current flows.
fn conducting(
    currents_a: &[f64; 3],
    emf_v: &[f64; 3],
    low: f64,
    high: f64,
) -> Option<([f64; 3], [f64; 3], f64)> {
    let mut signs = currents_a.map(|current| match current == 0.0 {
        true => 0.0,
        false => current.signum(),
    });
    if signs == [0.0; 3] {
        let order = |sign: f64| (0..3).max_by(|a, b| (sign * emf_v[*a]).total_cmp(&(sign * emf_v[*b])));
        let (most, least) = (order(1.0)?, order(-1.0)?);
        if emf_v[most] - emf_v[least] <= high - low {
            return None;
        }
        (signs[most], signs[least]) = (-1.0, 1.0);
    }
    let terminal = |sign: f64| if sign > 0.0 { low } else { high };
    let star_of = |signs: &[f64; 3]| {
        let flowing = (0..3).filter(|phase| signs[*phase] != 0.0);
        let sum: f64 = flowing.clone().map(|p| terminal(signs[p]) - emf_v[p]).sum();
        sum / flowing.count() as f64
    };
    let star = star_of(&signs);
    for phase in 0..3 {
        let floats_v = star + emf_v[phase];
        if signs[phase] == 0.0 && !(low..=high).contains(&floats_v) {
            signs[phase] = if floats_v > high { -1.0 } else { 1.0 };
        }
    }
    Some((signs, signs.map(terminal), star_of(&signs)))
}

/// What is left where a current ended within a step: the other two are opposite, and none flows alone.
fn balance(currents_a: &mut [f64; 3]) {
    let sum: f64 = currents_a.iter().sum();
    let flowing = currents_a.iter().filter(|current| **current != 0.0).count();
    for current in currents_a.iter_mut().filter(|current| **current != 0.0) {
        *current = match flowing {
            1 => 0.0,
            _ => *current - sum / flowing as f64,
        };
    }
}
