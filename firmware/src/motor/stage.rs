//! The border to what switches and senses: a board on one side or a simulated motor, control on the other.

/// What the three half bridges do in the next period of the pulses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Drive {
    /// All switches are off: currents die out through the diodes, then the motor coasts.
    #[default]
    Off,
    /// All low sides are on: the windings are shorted and brake the rotor.
    Brake,
    /// Share of the period for which the high side is on, phases U, V, W: 0 to 1.
    Duty([f32; 3]),
}

/// The half bridges.
pub trait PowerStage {
    /// Takes over at the next period's beginning.
    fn drive(&mut self, drive: Drive);
}

/// Why the rotor's angle is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderError {
    /// The sensor did not answer.
    Silent,
    /// Its checksum is wrong.
    Checksum,
    /// It says of itself that it cannot be trusted (its magnet is too near, too far or gone).
    Field,
}

/// The rotor's angle sensor.
pub trait Encoder {
    /// The mechanical angle in counts, [`crate::params::ENCODER_BITS`] a turn, rising as the gripper
    /// closes if the motor's phases are not swapped.
    fn angle(&mut self) -> Result<u16, EncoderError>;
}

/// What is sensed in the middle of a period, while all low sides are on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensed {
    /// Currents into the phases U, V, W, in counts of [`crate::params::CURRENT_SCALE`] about 2048.
    pub phases: [u16; 3],
    /// The bus voltage in counts of [`crate::params::BUS_SCALE`].
    pub bus: u16,
    /// The rotor's angle in counts.
    pub angle: Result<u16, EncoderError>,
}
