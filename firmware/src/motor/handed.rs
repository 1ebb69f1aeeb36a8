//! What the two ticks hand to each other. Neither touches what the other owns, so that on the board the inner
//! one may interrupt the outer one anywhere.

use super::encoder::Tracker;
use super::state::{State, Trip};
use super::transform::Dq;

/// What the inner tick felt, for the outer one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Felt {
    /// What the motor does.
    pub state: State,
    /// Where the rotor is, and how fast it turns.
    pub rotor: Tracker,
    /// Currents in amperes.
    pub current: Dq,
    /// What they were a period before.
    pub before: Dq,
    /// The voltages in volts that acted between.
    pub voltage: Dq,
    /// The circle of the voltage is too small for what is wanted.
    pub is_limited: bool,
    /// Bus voltage in volts.
    pub bus_v: f32,
    /// The bus is too high: the windings are shorted until it has fallen.
    pub is_shorted: bool,
    /// Since the last time the current was let go: what the loops above have gathered counts no more.
    pub is_let_go: bool,
    /// Since the last time the rotor's angle was not known: turns are not counted on.
    pub is_lost: bool,
}

/// What the outer tick asks of the inner one; it holds until the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ask {
    /// Another state, once.
    pub change: Option<Change>,
    /// What the armed motor does.
    pub action: Action,
}

/// Another state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// [`super::Order::Arm`].
    Arm,
    /// [`super::Order::Commission`].
    Commission,
    /// [`super::Order::Disarm`].
    Disarm,
    /// Something is wrong.
    Trip(Trip),
}

/// What the armed motor does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Action {
    /// All switches off.
    #[default]
    Off,
    /// The windings shorted.
    Brake,
    /// Currents in amperes are followed.
    Follow(Dq),
}
