//! The drive: the firmware's own control of the motor on the plant, and what the two come to.
//!
//! - [`trace`]: what is noted over time.
//! - [`runs`]: a way to a place, a speed, a brake, a squeeze.
//! - [`response`]: the current loop's answer to a step and to sines.
//! - [`grasp`]: the grasp on top of it; [`course`]: how one went; [`gripped`]: what is told of it; [`landing`]: the gripper as a foot.
//! - [`figures`], [`grasp_figures`]: what is asked of drive and grasp beside what they reach.
//! - [`told`]: what is told of a run.
//! - [`world`]: the gripper at a board's lines.
//! - [`workcell`]: with board and host; [`tables`] for it.

pub mod course;
pub mod figures;
pub mod grasp;
pub mod grasp_figures;
pub mod gripped;
pub mod landing;
pub mod response;
pub mod runs;
pub mod tables;
pub mod told;
pub mod trace;
pub mod workcell;
pub mod world;

#[cfg(test)]
mod tests;

use std::f64::consts::TAU;

use firmware::motor::limits::Limits;
use firmware::motor::settings::Wiring;
use firmware::motor::stage::{Drive, PowerStage, Sensed};
use firmware::motor::{Motor, Order, Setpoint, Settings, State, Telling};

use crate::plant::parameters::{Lead, Parameters};
use crate::plant::{PERIOD_S, Plant};

/// Arming is given up after this.
const ARMING_S: f64 = 0.1;

/// The control on a plant.
pub struct Rig {
    /// What is driven.
    pub plant: Plant,
    /// The firmware's control.
    pub motor: Motor,
    drive: Drive,
    settings: Settings,
}

/// Takes over what the control decides.
struct Switches<'a>(&'a mut Drive);

impl PowerStage for Switches<'_> {
    fn drive(&mut self, drive: Drive) {
        *self.0 = drive;
    }
}

impl Rig {
    /// Switched on with the fingers this far apart; disarmed. The control is set to the card's motor, whatever
    /// this plant's is, and to how its sensor sits and its phases are wired.
    pub fn new(lead: Lead, parameters: Parameters, opening_mm: f64, seed: u64) -> Self {
        Self::within(Limits::GRIPPER, lead, parameters, opening_mm, seed)
    }

    /// The same with other bounds of the motor.
    pub fn within(
        limits: Limits,
        lead: Lead,
        parameters: Parameters,
        opening_mm: f64,
        seed: u64,
    ) -> Self {
        let settings = Settings {
            wiring: wiring(&parameters),
            limits,
            ..Settings::assumed(lead.screw())
        };
        Self::set(settings, parameters, opening_mm, seed)
    }

    /// The same with the control set to something else.
    pub fn set(settings: Settings, parameters: Parameters, opening_mm: f64, seed: u64) -> Self {
        Self {
            plant: Plant::new(parameters, 1e-3 * opening_mm, seed),
            motor: Motor::new(settings),
            drive: Drive::Off,
            settings,
        }
    }

    /// The same, armed and told where the fingers are.
    pub fn armed(lead: Lead, parameters: Parameters, opening_mm: f64, seed: u64) -> Self {
        let mut rig = Self::new(lead, parameters, opening_mm, seed);
        rig.motor.obey(Order::Arm);
        rig.run_while(ARMING_S, |telling| telling.state != State::Armed);
        let opening_mm = opening_mm as f32;
        rig.motor.obey(Order::Opening { opening_mm });
        rig.run_while(ARMING_S, |telling| telling.opening_mm.is_none());
        rig
    }

    /// Switches off and starts the control anew: it knows no opening.
    pub fn restart(&mut self) {
        self.motor = Motor::new(self.settings);
        self.drive = Drive::Off;
    }

    /// One period of the pulses.
    pub fn period(&mut self) {
        self.period_with(|_| {});
    }

    /// The same with something done to what is sensed.
    pub fn period_with(&mut self, spoil: impl FnOnce(&mut Sensed)) {
        let mut sensed = self.plant.step(self.drive);
        spoil(&mut sensed);
        self.motor.period(&sensed, &mut Switches(&mut self.drive));
    }

    /// Goes on so long.
    pub fn run(&mut self, seconds: f64) {
        self.run_while(seconds, |_| true);
    }

    /// Goes on while something holds, but no longer than this.
    pub fn run_while(&mut self, seconds: f64, holds: impl Fn(&Telling) -> bool) {
        for _ in 0..periods(seconds) {
            if !holds(&self.motor.telling()) {
                break;
            }
            self.period();
        }
    }

    /// Commands and goes on so long.
    pub fn under(&mut self, setpoint: Setpoint, seconds: f64) {
        self.motor.obey(Order::Do(setpoint));
        self.run(seconds);
    }
}

/// Periods of the pulses in a time.
pub fn periods(seconds: f64) -> u32 {
    (seconds / PERIOD_S).round() as u32
}

/// What commissioning finds of a plant whose sensor sits like this.
fn wiring(parameters: &Parameters) -> Wiring {
    let turns = -parameters.zero_rad * parameters.windings.pole_pairs / TAU;
    Wiring {
        offset: (turns.rem_euclid(1.0) * 4_294_967_296.0) as u32,
        is_swapped: parameters.swapped,
    }
}
