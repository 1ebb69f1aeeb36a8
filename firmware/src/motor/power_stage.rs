//! Interface between control and hardware (a board or a simulated motor).

/// Command to the three half bridges for the next PWM period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum BridgeCommand {
    /// All switches off: currents decay through the diodes, then the motor coasts.
    #[default]
    Off,
    /// All low sides on: the shorted windings brake the rotor.
    Brake,
    /// Duty cycles of the high sides of U, V, W: 0 to 1.
    Duty([f32; 3]),
}

/// The half bridges.
pub trait PowerStage {
    /// Applies a command from the beginning of the next period.
    fn drive(&mut self, drive: BridgeCommand);
}

/// Why the rotor angle is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderError {
    /// The sensor did not answer.
    Silent,
    /// The checksum is wrong.
    Checksum,
    /// The sensor reports an error.
    ErrorFlag,
}

/// The rotor angle sensor.
pub trait Encoder {
    /// Mechanical angle in counts, [`crate::config::constants::ENCODER_BITS`] per turn, increasing while the gripper closes
    /// unless the phases are swapped.
    fn angle(&mut self) -> Result<u16, EncoderError>;
}

/// Samples from the middle of a period, while all low sides are on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSamples {
    /// Currents into the phases U, V, W, in counts of [`crate::config::constants::CURRENT_SCALE`] around 2048.
    pub phases: [u16; 3],
    /// Bus voltage in counts of [`crate::config::constants::BUS_SCALE`].
    pub bus: u16,
    /// Rotor angle in counts.
    pub angle: Result<u16, EncoderError>,
}
