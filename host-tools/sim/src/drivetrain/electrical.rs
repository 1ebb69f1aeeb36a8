//! Electrical part of the drivetrain: supply and DC bus, half bridges, three-phase windings, cogging.
use firmware::motor::power_stage::BridgeCommand;
use std::f64::consts::FRAC_PI_3;

/// Parameters of the windings: three phases in a star.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windings {
    /// Phase resistance in ohm.
    pub resistance_ohm: f64,
    /// Phase inductance, equal on d and q, in H.
    pub inductance_h: f64,
    /// Peak flux linkage of the magnets in Wb.
    pub flux_wb: f64,
    /// Pole pairs.
    pub pole_pairs: f64,
}

impl Windings {
    /// Torque constant in N m per ampere of quadrature current.
    pub fn torque_constant(&self) -> f64 {
        1.5 * self.pole_pairs * self.flux_wb
    }
}

/// Means over one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PowerFlow {
    /// Bus current in A; negative when regenerating.
    pub bus_a: f64,
    /// Torque on the rotor in N m.
    pub torque_nm: f64,
    /// Copper loss in W.
    pub copper_w: f64,
    /// Diode loss in W.
    pub diodes_w: f64,
}

/// State of the windings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhaseCurrents {
    /// Phase currents in A; their sum is zero.
    pub currents_a: [f64; 3],
}

/// Normalised back-EMF of the phases at this electrical angle: a current of this shape is
/// quadrature current.
fn emf_shapes(electrical: &Phasor) -> [f64; 3] {
    let (half, across) = (0.5 * electrical.sin, FRAC_PI_3.sin() * electrical.cos);
    [-electrical.sin, half + across, half - across]
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl PhaseCurrents {
    /// Direct and quadrature current in A.
    pub fn direct_quadrature_a(&self, electrical: &Phasor) -> [f64; 2] {
        let ahead = Phasor { cos: -electrical.sin, sin: electrical.cos };
        // The shape a quarter turn ahead is that of minus the direct current.
        [
            -dot(&emf_shapes(&ahead), &self.currents_a) / 1.5,
            dot(&emf_shapes(electrical), &self.currents_a) / 1.5,
        ]
    }

    /// Energy stored in the inductances in J.
    pub fn stored_j(&self, windings: &Windings) -> f64 {
        0.5 * windings.inductance_h * dot(&self.currents_a, &self.currents_a)
    }

    /// Advances by a step with driven terminals at shares of the bus voltage. `decay` is exp(-R dt/L).
    pub fn step_driven(
        &mut self,
        windings: &Windings,
        (electrical, speed_rad_s): (&Phasor, f64),
        (shares, bus_v): (&[f64; 3], f64),
        decay: f64,
    ) -> PowerFlow {
        let emf_shapes = emf_shapes(electrical);
        let emf_v = windings.flux_wb * windings.pole_pairs * speed_rad_s;
        let star = (shares[0] + shares[1] + shares[2]) / 3.0;
        let driven = (1.0 - decay) / windings.resistance_ohm;
        let mut mean_a = self.currents_a;
        for phase in 0..3 {
            let across_v = (shares[phase] - star) * bus_v - emf_v * emf_shapes[phase];
            let current = &mut self.currents_a[phase];
            *current = *current * decay + across_v * driven;
            mean_a[phase] = 0.5 * (mean_a[phase] + *current);
        }
        PowerFlow {
            bus_a: dot(shares, &mean_a),
            torque_nm: windings.pole_pairs * windings.flux_wb * dot(&emf_shapes, &mean_a),
            copper_w: windings.resistance_ohm * dot(&mean_a, &mean_a),
            diodes_w: 0.0,
        }
    }

    /// Advances by `dt_s` with all switches off: each current flows through a diode until it is zero, and
    /// starts only where the back-EMF exceeds the bus.
    pub fn step_freewheeling(
        &mut self,
        windings: &Windings,
        (electrical, speed_rad_s): (&Phasor, f64),
        (diode_v, bus_v): (f64, f64),
        dt_s: f64,
    ) -> PowerFlow {
        let emf_shapes = emf_shapes(electrical);
        let emf_v = windings.flux_wb * windings.pole_pairs * speed_rad_s;
        let emf_v = emf_shapes.map(|shape| emf_v * shape);
        let (low, high) = (-diode_v, bus_v + diode_v);
        let before = self.currents_a;
        let Some((signs, terminals, star)) = conducting(&before, &emf_v, low, high) else {
            return PowerFlow::default();
        };
        for phase in 0..3 {
            if signs[phase] == 0.0 {
                continue;
            }
            let lost_v = windings.resistance_ohm * before[phase];
            let across_v = terminals[phase] - star - emf_v[phase] - lost_v;
            let after = before[phase] + across_v / windings.inductance_h * dt_s;
            // A diode blocks reverse current.
            self.currents_a[phase] = if after * signs[phase] > 0.0 { after } else { 0.0 };
        }
        balance(&mut self.currents_a);
        let mean_a = [0, 1, 2].map(|phase| 0.5 * (before[phase] + self.currents_a[phase]));
        PowerFlow {
            bus_a: mean_a.iter().map(|current| current.min(0.0)).sum(),
            torque_nm: windings.pole_pairs * windings.flux_wb * dot(&emf_shapes, &mean_a),
            copper_w: windings.resistance_ohm * dot(&mean_a, &mean_a),
            diodes_w: diode_v * mean_a.iter().map(|current| current.abs()).sum::<f64>(),
        }
    }
}

/// Signs of the flowing currents, their terminal voltages, and the star point voltage; none without
/// current.
fn conducting(
    currents_a: &[f64; 3],
    emf_v: &[f64; 3],
    low: f64,
    high: f64,
) -> Option<([f64; 3], [f64; 3], f64)> {
    let mut signs = currents_a.map(|current| if current == 0.0 { 0.0 } else { current.signum() });
    if signs == [0.0; 3] {
        let extreme =
            |sign: f64| (0..3).max_by(|a, b| (sign * emf_v[*a]).total_cmp(&(sign * emf_v[*b])));
        let (max, min) = (extreme(1.0)?, extreme(-1.0)?);
        if emf_v[max] - emf_v[min] <= high - low {
            return None;
        }
        (signs[max], signs[min]) = (-1.0, 1.0);
    }
    let terminal = |sign: f64| if sign > 0.0 { low } else { high };
    let star_of = |signs: &[f64; 3]| {
        let flowing = (0..3).filter(|phase| signs[*phase] != 0.0);
        let sum: f64 = flowing.clone().map(|p| terminal(signs[p]) - emf_v[p]).sum();
        sum / flowing.count() as f64
    };
    let star = star_of(&signs);
    for phase in 0..3 {
        let floating_v = star + emf_v[phase];
        if signs[phase] == 0.0 && !(low..=high).contains(&floating_v) {
            signs[phase] = if floating_v > high { -1.0 } else { 1.0 };
        }
    }
    Some((signs, signs.map(terminal), star_of(&signs)))
}

/// Restores a zero sum after a current ended within a step.
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

/// Parameters of the half bridges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverter {
    /// Dead time as a share of the PWM period.
    pub dead_share: f64,
    /// Forward voltage of the diodes, in V.
    pub diode_v: f64,
}

/// Below this current in A its ripple changes the sign within a period, and the dead time error decreases
/// with it.
const RIPPLE_A: f64 = 0.2;

/// State of the motor terminals, mean over a PWM period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terminals {
    /// Driven: share of the bus voltage on each terminal.
    Driven([f64; 3]),
    /// All switches off: the diodes conduct.
    Freewheeling,
}

impl Inverter {
    /// Terminals for these phase currents in A.
    pub fn terminals(&self, drive: BridgeCommand, currents_a: &[f64; 3]) -> Terminals {
        match drive {
            BridgeCommand::Off => Terminals::Freewheeling,
            BridgeCommand::Brake => Terminals::Driven([0.0; 3]),
            BridgeCommand::Duty(duties) => Terminals::Driven(
                [0, 1, 2].map(|phase| self.share(f64::from(duties[phase]), currents_a[phase])),
            ),
        }
    }

    /// Share of the bus voltage on a terminal: in the dead time the current selects the diode. A leg
    /// without switching has no dead time; NaN switches nothing on.
    fn share(&self, duty: f64, current_a: f64) -> f64 {
        if duty > 0.0 && duty < 1.0 {
            let lost = self.dead_share * (current_a / RIPPLE_A).clamp(-1.0, 1.0);
            (duty - lost).clamp(0.0, 1.0)
        } else if duty >= 1.0 {
            1.0
        } else {
            0.0
        }
    }
}

/// Parameters of supply and bus capacitor. The supply sources current only: regenerated energy raises
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supply {
    /// Open-circuit voltage in V.
    pub voltage_v: f64,
    /// Resistance of supply and cable, in ohm.
    pub resistance_ohm: f64,
    /// Capacitance at the power stage, in F.
    pub capacitance_f: f64,
}

/// State of the DC bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bus {
    /// Capacitor voltage in V.
    pub voltage_v: f64,
    /// Supply current in A.
    pub supply_a: f64,
}

impl Bus {
    /// Bus at the supply voltage.
    pub fn new(supply: &Supply) -> Self {
        Self { voltage_v: supply.voltage_v, supply_a: 0.0 }
    }

    /// Advances by `dt_s` while the power stage draws this current; negative when regenerating.
    pub fn step(&mut self, supply: &Supply, drawn_a: f64, dt_s: f64) {
        self.supply_a = ((supply.voltage_v - self.voltage_v) / supply.resistance_ohm).max(0.0);
        let charged_v = (self.supply_a - drawn_a) / supply.capacitance_f * dt_s;
        self.voltage_v = (self.voltage_v + charged_v).max(0.0);
    }

    /// Energy stored in the capacitor, in J.
    pub fn stored_j(&self, supply: &Supply) -> f64 {
        0.5 * supply.capacitance_f * self.voltage_v * self.voltage_v
    }
}

/// Cogging torque, a sine of the rotor angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cogging {
    /// Amplitude in N m.
    pub torque_nm: f64,
    /// Periods per turn.
    pub periods: f64,
}

impl Cogging {
    /// Torque in N m, where `phasor` is that of the angle times the periods.
    pub fn torque_nm(&self, phasor: &Phasor) -> f64 {
        -self.torque_nm * phasor.sin
    }

    /// Stored energy in J, zero at a stable angle.
    pub fn stored_j(&self, phasor: &Phasor) -> f64 {
        if self.periods > 0.0 { self.torque_nm / self.periods * (1.0 - phasor.cos) } else { 0.0 }
    }
}

/// Sine and cosine of an angle that advances in small steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phasor {
    /// Cosine.
    pub cos: f64,
    /// Sine.
    pub sin: f64,
}

impl Phasor {
    /// Phasor of this angle in rad.
    pub fn at(angle_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(angle_rad);
        Self { cos, sin }
    }

    /// Rotates by a small angle. Fourth-order series: error 1e-12 at a hundredth of a radian.
    pub fn rotate(&mut self, by_rad: f64) {
        let square = by_rad * by_rad;
        let cos = 1.0 - 0.5 * square * (1.0 - square / 12.0);
        let sin = by_rad * (1.0 - square / 6.0);
        *self = Self { cos: self.cos * cos - self.sin * sin, sin: self.sin * cos + self.cos * sin };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INVERTER: Inverter = Inverter { dead_share: 0.01, diode_v: 0.8 };

    fn step_driven(duties: [f32; 3], currents_a: [f64; 3]) -> [f64; 3] {
        match INVERTER.terminals(BridgeCommand::Duty(duties), &currents_a) {
            Terminals::Driven(shares) => shares,
            Terminals::Freewheeling => panic!("duties drive the terminals"),
        }
    }

    #[test]
    fn dead_time_shifts_switching_legs_against_the_current() {
        let cases = [
            ([0.5, 0.5, 0.5], [5.0, -5.0, 0.0], [0.49, 0.51, 0.5]),
            // Without switching there is no dead time.
            ([0.0, 1.0, f32::NAN], [-5.0, 5.0, 5.0], [0.0, 1.0, 0.0]),
        ];
        for (duties, currents_a, shares) in cases {
            assert_eq!(step_driven(duties, currents_a), shares, "{duties:?}");
        }
    }

    const SUPPLY: Supply = Supply { voltage_v: 24.0, resistance_ohm: 0.1, capacitance_f: 470e-6 };

    #[test]
    fn ten_amperes_lower_the_bus_by_one_volt() {
        let mut bus = Bus::new(&SUPPLY);
        (0..1000).for_each(|_| bus.step(&SUPPLY, 10.0, 2.5e-6));
        assert!((bus.voltage_v - 23.0).abs() < 1e-9);
        assert!((bus.supply_a - 10.0).abs() < 1e-8);
    }

    #[test]
    fn regenerated_95_mj_raise_the_bus_to_31_3_v() {
        let mut bus = Bus::new(&SUPPLY);
        let mut returned_j = 0.0;
        while returned_j < 0.095 {
            returned_j += 5.0 * bus.voltage_v * 2.5e-6;
            bus.step(&SUPPLY, -5.0, 2.5e-6);
        }
        // sqrt(24^2 + 2 * 0.095 / 470e-6) = 31.3.
        assert!((bus.voltage_v - 31.3).abs() < 0.05, "{}", bus.voltage_v);
    }

    #[test]
    fn small_rotations_add_up() {
        let mut turned = Phasor::at(0.3);
        (0..20).for_each(|_| turned.rotate(0.01));
        let exact = Phasor::at(0.5);
        assert!((turned.cos - exact.cos).abs() < 1e-10 && (turned.sin - exact.sin).abs() < 1e-10);
    }
}
