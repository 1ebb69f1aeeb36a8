//! Inertial sensors: what the compensation of weight and inertia needs. A gripper without one works;
//! then the effects that need it are off, and the estimates say so.

pub mod lsm6ds3;

/// One reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Motion {
    /// Specific force (gravity included) in mm/s^2, sensor's axes.
    pub acceleration: [i32; 3],
    /// Rate of turn in millidegrees per second.
    pub turn: [i32; 3],
}

/// A part that measures specific force and rate of turn.
pub trait Imu {
    /// What its bus may fail with.
    type Error;

    /// Wakes the part up and checks that it is the right one.
    fn start(&mut self) -> impl Future<Output = Result<(), Trouble<Self::Error>>>;

    /// Reads once.
    fn read(&mut self) -> impl Future<Output = Result<Motion, Trouble<Self::Error>>>;
}

/// Why a part cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble<E> {
    /// The bus failed.
    Bus(E),
    /// Another part answers; its identity.
    Stranger(u8),
}

impl<E> From<E> for Trouble<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}
