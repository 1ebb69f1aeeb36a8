//! The gripper's drive as physics, in virtual time: from what the switches do to what is sensed.
//!
//! What controls it is the firmware's own code, behind the same border as on the board
//! ([`firmware::motor::stage`]). Nothing here knows what the control is about to do, and nothing there
//! what is in here.
//!
//! - [`parameters`]: what it is made of; two screws, nominal or scattered.
//! - [`phasor`], [`friction`]: what several share.
//! - [`bus`]: supply, resistance, capacitor; nothing flows back.
//! - [`inverter`]: half bridges, dead time.
//! - [`motor`]: three phases, diodes when the switches are off.
//! - [`cogging`]: the pull of the teeth.
//! - [`screw`]: travel, play, friction that grows with the load.
//! - [`object`]: what is grasped; [`pulled`]: what drags at it; [`finger`]: guides, flexures, stops.
//! - [`train`]: rotor and fingers in time.
//! - [`sensing`]: currents, voltage, angle, in counts, with their errors.
//! - [`hall`]: forces into what the Hall sensors read; [`impact`]: steps on the ground; [`imu`]: what is felt
//!   of them.
//! - [`energy`]: where the energy went.
//!
//! What this leaves out: the ripple of the pulses within a period, the fingers' and flexures' own
//! vibration, saturation of iron, heat (resistance and flux stay as they are), wear.

pub mod bus;
pub mod cogging;
pub mod energy;
pub mod finger;
pub mod friction;
pub mod hall;
pub mod impact;
pub mod imu;
pub mod inverter;
pub mod motor;
pub mod object;
pub mod parameters;
pub mod phasor;
pub mod pulled;
pub mod screw;
pub mod sensing;
pub mod train;

#[cfg(test)]
mod tests;

use firmware::motor::stage::{Drive, Sensed};
use firmware::params;
use rand_chacha::ChaCha8Rng;

use bus::Bus;
use energy::{Ledger, Stored};
use inverter::Terminals;
use motor::{Flow, Motor};
use object::{Contact, Object};
use parameters::Parameters;
use phasor::Phasor;
use train::Train;

/// A period of the pulses in seconds.
pub const PERIOD_S: f64 = 1e-3 / params::PWM_RATE.value;

/// Steps in half a period: 2.5 us each. Half of that changes the peak force of a grasp at full speed by less
/// than a thousandth (a test).
const HALF_STEPS: u32 = 10;

/// The drive in time.
pub struct Plant {
    parameters: Parameters,
    /// Rotor and fingers.
    pub train: Train,
    /// Currents in the windings.
    pub motor: Motor,
    /// Supply and capacitor.
    pub bus: Bus,
    /// Where the energy went.
    pub ledger: Ledger,
    tips: (f64, Contact),
    rng: ChaCha8Rng,
    half_steps: u32,
    dt_s: f64,
    keep: f64,
    /// Half periods since the beginning.
    halves: u64,
}

impl Plant {
    /// A drive at rest with the fingers this far apart, in m; the seed is that of its noise.
    pub fn new(parameters: Parameters, opening_m: f64, seed: u64) -> Self {
        let travel_m = parameters.fingers.stroke_m - opening_m;
        let mut plant = Self {
            train: Train::at(travel_m, &parameters.screw),
            motor: Motor::default(),
            bus: Bus::new(&parameters.supply),
            ledger: Ledger::default(),
            tips: (0.0, parameters.fingers.closed()),
            rng: parameters::noise(seed),
            half_steps: 0,
            dt_s: 0.0,
            keep: 0.0,
            halves: 0,
            parameters,
        };
        plant.refine(1);
        plant.hold(None);
        plant
    }

    /// Takes steps so many times as fine.
    pub fn refine(&mut self, times: u32) {
        let windings = &self.parameters.windings;
        self.half_steps = HALF_STEPS * times;
        self.dt_s = 0.5 * PERIOD_S / f64::from(self.half_steps);
        self.keep = libm::exp(-windings.resistance_ohm / windings.inductance_h * self.dt_s);
    }

    /// Puts an object between the fingers, or takes it away.
    pub fn hold(&mut self, object: Option<&Object>) {
        let fingers = &self.parameters.fingers;
        self.tips = match object {
            Some(object) => (fingers.stroke_m - object.width_m, fingers.contact(object)),
            None => (fingers.stroke_m, fingers.closed()),
        };
    }

    /// One period of the pulses under this drive; what is sensed in its middle.
    pub fn step(&mut self, drive: Drive) -> Sensed {
        self.half_period(drive);
        let (phases, bus) = self.convert();
        let angle = Ok(self.angle());
        self.half_period(drive);
        Sensed { phases, bus, angle }
    }

    /// Half a period of the pulses under this drive.
    pub fn half_period(&mut self, drive: Drive) {
        let wired = |[u, v, w]: [f32; 3]| [u, w, v];
        self.half(match drive {
            Drive::Duty(duties) if self.parameters.swapped => Drive::Duty(wired(duties)),
            drive => drive,
        });
        self.halves += 1;
    }

    /// Counts of the converters now: phases' currents, bus voltage.
    pub fn convert(&mut self) -> ([u16; 3], u16) {
        let [u, v, w] = self.motor.currents_a;
        let currents_a = if self.parameters.swapped {
            [u, w, v]
        } else {
            [u, v, w]
        };
        let sensors = &self.parameters.sensors;
        sensors.convert(&currents_a, self.bus.voltage_v, &mut self.rng)
    }

    /// Counts of the rotor's angle now.
    pub fn angle(&mut self) -> u16 {
        let sensors = &self.parameters.sensors;
        sensors.angle(self.train.angle_rad, &mut self.rng)
    }

    fn half(&mut self, drive: Drive) {
        let Parameters {
            rotor,
            screw,
            fingers,
            cogging,
            windings,
            ..
        } = self.parameters;
        let mut electrical = self.electrical();
        let mut teeth = Phasor::at(cogging.periods * self.train.angle_rad);
        for _ in 0..self.half_steps {
            let flow = self.flow(drive, &electrical);
            let torque_nm = flow.torque_nm + cogging.torque_nm(&teeth);
            let trains = (&rotor, &screw, &fingers);
            let books = (&mut self.ledger, self.dt_s);
            self.train.step(trains, torque_nm, &self.tips, books);
            self.take(&flow);
            let turned_rad = self.train.speed_rad_s * self.dt_s;
            electrical.turn(windings.pole_pairs * turned_rad);
            teeth.turn(cogging.periods * turned_rad);
        }
    }

    /// Currents through a step.
    fn flow(&mut self, drive: Drive, electrical: &Phasor) -> Flow {
        let Parameters {
            inverter, windings, ..
        } = &self.parameters;
        let rotor = (electrical, self.train.speed_rad_s);
        let bus_v = self.bus.voltage_v;
        match inverter.terminals(drive, &self.motor.currents_a) {
            Terminals::Held(shares) => {
                self.motor
                    .held(windings, rotor, (&shares, bus_v), self.keep)
            }
            Terminals::Free => {
                let voltages = (inverter.diode_v, bus_v);
                self.motor.free(windings, rotor, voltages, self.dt_s)
            }
        }
    }

    /// The bus through a step, and what became of the power.
    fn take(&mut self, flow: &Flow) {
        let supply = &self.parameters.supply;
        self.bus.step(supply, flow.bus_a, self.dt_s);
        let supply_a = self.bus.supply_a;
        self.ledger.supplied_j += supply.voltage_v * supply_a * self.dt_s;
        self.ledger.cable_j += supply.resistance_ohm * supply_a * supply_a * self.dt_s;
        self.ledger.copper_j += flow.copper_w * self.dt_s;
        self.ledger.diodes_j += flow.diodes_w * self.dt_s;
    }

    fn electrical(&self) -> Phasor {
        let from_rad = self.train.angle_rad - self.parameters.zero_rad;
        Phasor::at(self.parameters.windings.pole_pairs * from_rad)
    }

    /// The supply gives another voltage from now on, in V.
    pub fn feed(&mut self, voltage_v: f64) {
        self.parameters.supply.voltage_v = voltage_v;
    }

    /// What it is made of.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Time since the beginning, in seconds.
    pub fn time_s(&self) -> f64 {
        self.halves as f64 * (0.5 * PERIOD_S)
    }

    /// Between the fingertips, in m.
    pub fn opening_m(&self) -> f64 {
        self.parameters.fingers.stroke_m - self.train.travel_m
    }

    /// Force between the fingertips, in N.
    pub fn grip_n(&self) -> f64 {
        self.train.against.tips.force_n
    }

    /// Direct and quadrature current in A.
    pub fn direct_quadrature_a(&self) -> [f64; 2] {
        self.motor.direct_quadrature_a(&self.electrical())
    }

    /// What is stored now.
    pub fn stored(&self) -> Stored {
        let Parameters {
            rotor,
            fingers,
            cogging,
            ..
        } = &self.parameters;
        let teeth = Phasor::at(cogging.periods * self.train.angle_rad);
        Stored {
            capacitor_j: self.bus.stored_j(&self.parameters.supply),
            windings_j: self.motor.stored_j(&self.parameters.windings),
            kinetic_j: self.train.kinetic_j(rotor, fingers),
            springs_j: self.train.springs_j() + cogging.stored_j(&teeth),
        }
    }
}
