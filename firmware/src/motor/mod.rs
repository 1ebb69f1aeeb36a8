//! Motor control: field-oriented current control at 20 kHz, speed and position control at 4 kHz.
//!
//! - [`power_stage`]: interface to the half bridges and the sensors; [`as5047`]: rotor angle sensor.
//! - [`settings`], [`screw`]: parameters and limits.
//! - [`encoder`], [`current_sense`]: rotor angle and speed, phase currents.
//! - [`foc`]: Clarke and Park transforms, space-vector modulation, PI current controllers.
//! - [`CurrentLoop`] and [`MotionLoop`]: the two ticks; [`tick_exchange`]: data between them.
//! - [`trajectory`]: set-points limited in speed, acceleration and jerk.
//! - [`limits`], [`brake_energy`]: current limits and active limit codes; [`diagnostics`]: plausibility checks.
//! - [`commissioning`], [`spin_test`], [`backdrive_test`], [`calibration`]: measurements of motor and screw.
//! - [`state`]: commands, states, trips and status.
//!
//! On the board each tick is an interrupt and the current loop pre-empts the motion loop; a simulation calls
//! [`Motor::period`]. Commands may arrive at any time. A non-finite number switches all bridges off and trips with
//! [`Trip::NotANumber`].

pub mod as5047;
pub mod backdrive_test;
pub mod brake_energy;
pub mod calibration;
pub mod commissioning;
mod current_loop;
pub mod current_sense;
pub mod diagnostics;
pub mod encoder;
pub mod foc;
pub mod limits;
mod motion_loop;
pub mod power_stage;
pub mod screw;
pub mod settings;
pub mod spin_test;
pub mod state;
#[cfg(test)]
mod tests;
pub mod tick_exchange;
mod timing;
pub mod trajectory;

pub use crate::motor::current_loop::CurrentLoop;
pub use crate::motor::motion_loop::MotionLoop;
pub use crate::motor::settings::Settings;
pub use crate::motor::state::{MotorCommand, MotorState, MotorStatus, Setpoint, Trip};
pub use crate::motor::timing::{MOTION_HZ, MOTION_PERIODS, PERIOD_S};

use crate::config::constants;
use crate::motor::power_stage::{MotorSamples, PowerStage};
use crate::motor::settings::IdentifiedMotor;
use crate::motor::tick_exchange::CurrentLoopCommand;

/// PWM periods after which [`Motor`] repeats a set-point: 1 ms, as the grip controller does.
const REPEAT_PERIODS: u8 = (1e-3 * constants::PWM_RATE.value * 1e3) as u8;

/// Both loops run in sequence, for simulations. Repeats the last set-point every millisecond.
#[derive(Clone, Copy, Debug)]
pub struct Motor {
    inner: CurrentLoop,
    outer: MotionLoop,
    /// Output of the motion loop, applied in the next period.
    pending: Option<CurrentLoopCommand>,
    setpoint: Option<Setpoint>,
    periods: u8,
    since_command: u8,
}

impl Motor {
    /// A disarmed motor.
    pub fn new(settings: Settings) -> Self {
        Self {
            inner: CurrentLoop::new(settings),
            outer: MotionLoop::new(settings),
            pending: None,
            setpoint: None,
            periods: 0,
            since_command: 0,
        }
    }

    /// Runs one PWM period: the current loop, and every [`MOTION_PERIODS`] calls the motion loop.
    pub fn period(&mut self, samples: &MotorSamples, stage: &mut impl PowerStage) {
        self.since_command = self.since_command.saturating_add(1);
        if self.since_command >= REPEAT_PERIODS
            && let Some(setpoint) = self.setpoint
        {
            self.handle_command(MotorCommand::Setpoint(setpoint));
        }
        if let Some(command) = self.pending.take() {
            self.inner.apply(command);
        }
        stage.drive(self.inner.tick(samples));
        self.periods = self.periods.saturating_add(1);
        if self.periods >= MOTION_PERIODS {
            self.periods = 0;
            if let Some(identified) = self.inner.take_identification() {
                self.outer.apply_identification(identified);
            }
            self.pending = Some(self.outer.tick(self.inner.take_report()));
        }
    }

    /// See [`MotionLoop::handle_command`].
    pub fn handle_command(&mut self, command: MotorCommand) {
        match command {
            MotorCommand::Setpoint(setpoint) => {
                (self.setpoint, self.since_command) = (Some(setpoint), 0);
            }
            MotorCommand::Disarm => self.setpoint = None,
            MotorCommand::Arm
            | MotorCommand::Commission
            | MotorCommand::SetOpening { .. }
            | MotorCommand::Temperatures(_) => {}
        }
        let Some(urgent) = self.outer.handle_command(command) else {
            return;
        };
        if let Some(earlier) = self.pending.replace(urgent) {
            self.inner.apply(earlier);
        }
    }

    /// Reports that the power stage switched itself off through its break input.
    pub fn trip_power_stage(&mut self) {
        self.inner.trip_power_stage();
    }

    /// Result of the last commissioning, to be stored.
    pub const fn identification(&self) -> Option<IdentifiedMotor> {
        self.outer.identification()
    }

    /// Status at this moment.
    pub fn status(&self) -> MotorStatus {
        self.outer.status_from(&self.inner.report())
    }
}
