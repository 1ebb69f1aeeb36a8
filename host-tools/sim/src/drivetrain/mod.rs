//! Physics of the gripper's drive in virtual time: from the switches to the sensed quantities.
//!
//! It is controlled by the firmware's own code through the same interface as on the board
//! ([`firmware::motor::power_stage`]); neither side has access to the other's state.
//!
//! - [`parameters`]: two screws; nominal or with tolerances.
//! - [`electrical`]: supply, power stage, windings, cogging.
//! - [`mechanics`]: rotor, screw, fingers, object.
//! - [`sensors`]: current, voltage, angle and inertial sensors.
//! - [`fingertips`]: Hall readings under load; landings.
//!
//! Not simulated: PWM ripple within a period, vibration of fingers and flexures, iron saturation, heating, wear.

pub mod electrical;
pub mod fingertips;
pub mod mechanics;
pub mod parameters;
pub mod sensors;

#[cfg(test)]
mod tests;

use firmware::config::constants;
use firmware::motor::power_stage::{BridgeCommand, MotorSamples};
use rand_chacha::ChaCha8Rng;

use crate::drivetrain::electrical::{Bus, PhaseCurrents, Phasor, PowerFlow, Terminals};
use crate::drivetrain::mechanics::{
    DriveTrain, EnergyLedger, FingerContacts, Object, StoredEnergy,
};
use crate::drivetrain::parameters::PlantParameters;

/// PWM period in seconds.
pub const PERIOD_S: f64 = 1e-3 / constants::PWM_RATE.value;

/// Integration steps per half period, 5 us each. Halving them changes the peak force of a grasp at full speed by
/// 0.05 % (a test: less than 0.1 %).
const HALF_STEPS: u32 = 5;

/// The drivetrain in time.
#[derive(Clone)]
pub struct Plant {
    parameters: PlantParameters,
    /// Mechanical state.
    pub train: DriveTrain,
    /// Currents of the windings.
    pub motor: PhaseCurrents,
    /// DC bus.
    pub bus: Bus,
    /// Energy balance.
    pub ledger: EnergyLedger,
    contacts: FingerContacts,
    rng: ChaCha8Rng,
    half_steps: u32,
    dt_s: f64,
    decay: f64,
    /// Half periods since the start.
    halves: u64,
}

impl Plant {
    /// A drivetrain at rest with this opening in m; `seed` is that of its sensor noise.
    pub fn new(parameters: PlantParameters, opening_m: f64, seed: u64) -> Self {
        let travel_m = parameters.fingers.stroke_m - opening_m;
        let mut plant = Self {
            train: DriveTrain::at(travel_m, &parameters.screw),
            motor: PhaseCurrents::default(),
            bus: Bus::new(&parameters.supply),
            ledger: EnergyLedger::default(),
            contacts: FingerContacts { inner: (0.0, parameters.fingers.closed()), outer: None },
            rng: parameters::noise_stream(seed),
            half_steps: 0,
            dt_s: 0.0,
            decay: 0.0,
            halves: 0,
            parameters,
        };
        plant.refine(1);
        plant.set_object(None);
        plant
    }

    /// Refines the integration step by this factor.
    pub fn refine(&mut self, times: u32) {
        let windings = &self.parameters.windings;
        self.half_steps = HALF_STEPS * times;
        self.dt_s = 0.5 * PERIOD_S / f64::from(self.half_steps);
        self.decay = libm::exp(-windings.resistance_ohm / windings.inductance_h * self.dt_s);
    }

    /// Places an object between the fingers, or removes it.
    pub fn set_object(&mut self, object: Option<&Object>) {
        let fingers = &self.parameters.fingers;
        self.contacts.inner = match object {
            Some(object) => (fingers.stroke_m - object.width_m, fingers.contact(object)),
            None => (fingers.stroke_m, fingers.closed()),
        };
    }

    /// Places something around the fingers, as wide as an opening, or removes it.
    pub fn set_outer_object(&mut self, object: Option<&Object>) {
        let fingers = &self.parameters.fingers;
        self.contacts.outer =
            object.map(|object| (fingers.stroke_m - object.width_m, fingers.contact(object)));
    }

    /// One PWM period; returns the samples taken in its middle.
    pub fn step(&mut self, drive: BridgeCommand) -> MotorSamples {
        self.half_period(drive);
        let (phases, bus) = self.convert();
        let angle = Ok(self.angle());
        self.half_period(drive);
        MotorSamples { phases, bus, angle }
    }

    /// Half a PWM period.
    pub fn half_period(&mut self, drive: BridgeCommand) {
        let swap = |[u, v, w]: [f32; 3]| [u, w, v];
        self.integrate_half_period(match drive {
            BridgeCommand::Duty(duties) if self.parameters.swapped => {
                BridgeCommand::Duty(swap(duties))
            }
            drive => drive,
        });
        self.halves += 1;
    }

    /// ADC counts: phase currents and bus voltage.
    pub fn convert(&mut self) -> ([u16; 3], u16) {
        let [u, v, w] = self.motor.currents_a;
        let currents_a = if self.parameters.swapped { [u, w, v] } else { [u, v, w] };
        let sensors = &self.parameters.sensors;
        sensors.convert(&currents_a, self.bus.voltage_v, &mut self.rng)
    }

    /// Counts of the rotor angle sensor.
    pub fn angle(&mut self) -> u16 {
        let sensors = &self.parameters.sensors;
        sensors.angle(self.train.angle_rad, &mut self.rng)
    }

    fn integrate_half_period(&mut self, drive: BridgeCommand) {
        let PlantParameters { rotor, screw, fingers, cogging, windings, .. } = self.parameters;
        let mut electrical = self.electrical();
        let mut cogging_angle = Phasor::at(cogging.periods * self.train.angle_rad);
        for _ in 0..self.half_steps {
            let flow = self.flow(drive, &electrical);
            let torque_nm = flow.torque_nm + cogging.torque_nm(&cogging_angle);
            let trains = (&rotor, &screw, &fingers);
            let balance = (&mut self.ledger, self.dt_s);
            self.train.step(trains, torque_nm, &self.contacts, balance);
            self.book(&flow);
            let turned_rad = self.train.speed_rad_s * self.dt_s;
            electrical.rotate(windings.pole_pairs * turned_rad);
            cogging_angle.rotate(cogging.periods * turned_rad);
        }
    }

    /// Advances the phase currents by a step.
    fn flow(&mut self, drive: BridgeCommand, electrical: &Phasor) -> PowerFlow {
        let PlantParameters { inverter, windings, .. } = &self.parameters;
        let rotor = (electrical, self.train.speed_rad_s);
        let bus_v = self.bus.voltage_v;
        match inverter.terminals(drive, &self.motor.currents_a) {
            Terminals::Driven(shares) => {
                self.motor.step_driven(windings, rotor, (&shares, bus_v), self.decay)
            }
            Terminals::Freewheeling => {
                let voltages = (inverter.diode_v, bus_v);
                self.motor.step_freewheeling(windings, rotor, voltages, self.dt_s)
            }
        }
    }

    /// Advances the bus by a step and books the energy.
    fn book(&mut self, flow: &PowerFlow) {
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

    /// Sets the supply voltage in V.
    pub fn set_supply(&mut self, voltage_v: f64) {
        self.parameters.supply.voltage_v = voltage_v;
    }

    /// Parameters of this plant.
    pub fn parameters(&self) -> &PlantParameters {
        &self.parameters
    }

    /// Time since the start, in seconds.
    pub fn time_s(&self) -> f64 {
        self.halves as f64 * (0.5 * PERIOD_S)
    }

    /// Opening between the fingertips, in m.
    pub fn opening_m(&self) -> f64 {
        self.parameters.fingers.stroke_m - self.train.travel_m
    }

    /// Force between the fingertips in N, positive where something between them presses, negative where something around
    /// them does.
    pub fn grip_n(&self) -> f64 {
        self.train.contact_forces.tips.force_n - self.train.contact_forces.outer.force_n
    }

    /// Direct and quadrature current in A.
    pub fn direct_quadrature_a(&self) -> [f64; 2] {
        self.motor.direct_quadrature_a(&self.electrical())
    }

    /// Stored energy now.
    pub fn stored(&self) -> StoredEnergy {
        let PlantParameters { rotor, fingers, cogging, .. } = &self.parameters;
        let cogging_angle = Phasor::at(cogging.periods * self.train.angle_rad);
        StoredEnergy {
            capacitor_j: self.bus.stored_j(&self.parameters.supply),
            windings_j: self.motor.stored_j(&self.parameters.windings),
            kinetic_j: self.train.kinetic_j(rotor, fingers),
            springs_j: self.train.springs_j() + cogging.stored_j(&cogging_angle),
        }
    }
}
