//! Data exchanged between the two ticks. Neither accesses the other's state, so that on the board the current loop
//! may pre-empt the motion loop at any point.

use crate::motor::encoder::AngleTracker;
use crate::motor::foc::Dq;
use crate::motor::state::{MotorState, Trip};

/// From the current loop to the motion loop.
#[derive(Clone, Copy, Debug, Default)]
pub struct CurrentLoopReport {
    /// State of the motor.
    pub state: MotorState,
    /// Rotor angle and speed.
    pub rotor: AngleTracker,
    /// Currents in amperes.
    pub current: Dq,
    /// Currents one period before.
    pub previous: Dq,
    /// Voltages in volts applied between the two.
    pub voltage: Dq,
    /// The voltage is limited by the bus.
    pub is_limited: bool,
    /// Bus voltage in volts.
    pub bus_v: f32,
    /// The windings are shorted until an overvoltage of the bus has ended.
    pub is_shorted: bool,
    /// The current controllers were reset since the last report; the outer controllers must reset too.
    pub is_reset: bool,
    /// The rotor angle was lost since the last report; its turns are no longer counted.
    pub is_angle_lost: bool,
}

/// From the motion loop to the current loop; valid until the next one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CurrentLoopCommand {
    /// One-time change of state.
    pub change: Option<StateChange>,
    /// Action of the armed motor.
    pub action: CurrentLoopAction,
}

/// A change of state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StateChange {
    /// [`super::MotorCommand::Arm`].
    Arm,
    /// [`super::MotorCommand::Commission`].
    Commission,
    /// [`super::MotorCommand::Disarm`].
    Disarm,
    /// The motion loop detected a trip condition.
    Trip(Trip),
}

/// Action of the armed motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CurrentLoopAction {
    /// All bridges off.
    #[default]
    Off,
    /// Windings shorted.
    Brake,
    /// Control the currents to these set-points in amperes.
    Follow(Dq),
}
