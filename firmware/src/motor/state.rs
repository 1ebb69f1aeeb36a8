//! Commands, states, trips and status of the motor.

use crate::math::greater;
use crate::motor::commissioning::CommissioningError;
use crate::motor::foc::Dq;
use crate::motor::limits::{ActiveLimits, Temperatures};
use crate::motor::power_stage::BridgeCommand;
use crate::motor::settings::{IdentifiedMotor, MotorLimits};

/// Set-point of the motor. Closing is positive; currents are along q.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Setpoint {
    /// All bridges off: the rotor coasts, and a self-locking screw holds.
    #[default]
    Off,
    /// Windings shorted: the rotor brakes without returning energy to the bus.
    Brake,
    /// Current, and thereby torque.
    Current {
        /// In amperes.
        closing_a: f32,
    },
    /// Speed without a ramp.
    Speed {
        /// Speed of the opening in mm/s, closing positive.
        closing_mm_s: f32,
        /// Maximum current in amperes.
        max_a: f32,
    },
    /// Position, on a trajectory limited in speed, acceleration and jerk.
    Position {
        /// In millimetres between the fingers.
        opening_mm: f32,
        /// Maximum speed in mm/s.
        speed_mm_s: f32,
        /// Maximum current in amperes.
        max_a: f32,
    },
}

impl Setpoint {
    /// Whether all its values are finite.
    pub fn is_finite(&self) -> bool {
        match *self {
            Self::Off | Self::Brake => true,
            Self::Current { closing_a } => closing_a.is_finite(),
            Self::Speed { closing_mm_s, max_a } => closing_mm_s.is_finite() && max_a.is_finite(),
            Self::Position { opening_mm, speed_mm_s, max_a } => {
                opening_mm.is_finite() && speed_mm_s.is_finite() && max_a.is_finite()
            }
        }
    }

    /// Its own current limit in amperes, infinite where it has none.
    pub fn max_a(&self) -> f32 {
        match *self {
            Self::Speed { max_a, .. } | Self::Position { max_a, .. } => greater(max_a, 0.0),
            Self::Off | Self::Brake | Self::Current { .. } => f32::INFINITY,
        }
    }
}

/// Command to the motor, small enough for a queue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotorCommand {
    /// Follow set-points after the offset measurement of 26 ms ([`MotorState::Armed`]). Ignored unless disarmed;
    /// trips if the settings are invalid.
    Arm,
    /// Measure windings, phases and rotor sensor in 3 s; nothing may be gripped. Ends disarmed with the result in
    /// use, or in [`MotorState::CommissioningFailed`].
    Commission,
    /// Switch off; the only way out of a trip.
    Disarm,
    /// Follow a set-point; ignored unless armed.
    Setpoint(Setpoint),
    /// Set the present opening, with the closing flanks of the screws in contact: after homing, or from storage.
    /// NaN makes the opening unknown.
    SetOpening {
        /// Millimetres between the fingers.
        opening_mm: f32,
    },
    /// New temperature measurements.
    Temperatures(Temperatures),
}

/// State of the motor. [`MotorState::Tripped`] is left by [`MotorCommand::Disarm`] only.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum MotorState {
    /// Off; set-points are ignored.
    #[default]
    Disarmed,
    /// Offset measurement, 26 ms; then [`MotorState::Armed`] or [`MotorState::Commissioning`].
    Arming,
    /// Follows set-points.
    Armed,
    /// Measures rotor sensor, phases and windings, 3 s.
    Commissioning,
    /// Off after commissioning without a result.
    CommissioningFailed(CommissioningError),
    /// Off, or windings shorted, after a protection tripped.
    Tripped(Trip),
}

/// Why the motor stopped by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trip {
    /// A value is not finite, or the settings are invalid.
    NotANumber,
    /// A phase current exceeds its limit or the range of its measurement.
    OverCurrent,
    /// The rotor is too fast.
    OverSpeed,
    /// The rotor angle is unknown or implausible.
    Encoder,
    /// Current offsets are too large, phase currents do not sum to zero, or currents do not follow the set-point.
    CurrentSense,
    /// The rotor accelerates against the braking current.
    Runaway,
    /// The power stage switched itself off.
    PowerStage,
    /// The motion loop missed three ticks, no set-point arrived for 5 ms, or the status of the motor is older than that.
    CommandTimeout,
}

impl Trip {
    /// Bridge command after the trip: off where numbers, currents or their measurement are invalid, else shorted
    /// windings, which brake without a known angle.
    pub const fn drive(self) -> BridgeCommand {
        match self {
            Self::NotANumber | Self::OverCurrent | Self::CurrentSense | Self::PowerStage => {
                BridgeCommand::Off
            }
            Self::OverSpeed | Self::Encoder | Self::Runaway | Self::CommandTimeout => {
                BridgeCommand::Brake
            }
        }
    }
}

/// Range of the bus voltage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SupplyState {
    /// In range.
    #[default]
    Sound,
    /// Too low to drive.
    Low,
    /// Too high: the windings are shorted until it has fallen.
    High,
}

impl SupplyState {
    /// State at a bus voltage.
    pub fn of(bus_v: f32, limits: &MotorLimits) -> Self {
        let [low_v, _] = limits.undervoltage_v;
        if bus_v > limits.overvoltage_v {
            Self::High
        } else if bus_v < low_v {
            Self::Low
        } else {
            Self::Sound
        }
    }
}

/// Status of the motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotorStatus {
    /// State.
    pub state: MotorState,
    /// Millimetres between the fingers, with the screw's backlash; none before homing.
    pub opening_mm: Option<f32>,
    /// Position set-point on the trajectory in millimetres; none without position control.
    pub setpoint_mm: Option<f32>,
    /// Speed of the opening in mm/s, closing positive.
    pub closing_mm_s: f32,
    /// Rotor position in radians since start, closing positive.
    pub rotor_rad: f32,
    /// Rotor speed in rad/s.
    pub speed: f32,
    /// Angle of the rotor sensor in 2^-32 turns; none where it is unknown.
    pub turn: Option<u32>,
    /// Pole pairs of the motor.
    pub pole_pairs: u8,
    /// Currents in amperes.
    pub current: Dq,
    /// Set-points of the currents in amperes.
    pub current_setpoint: Dq,
    /// Voltages in volts.
    pub voltage: Dq,
    /// Bus voltage in volts.
    pub bus_v: f32,
    /// Present range of the bus voltage, or an abnormal one of the last 3 ms.
    pub supply: SupplyState,
    /// Motor or power stage is too hot for any current.
    pub is_hot: bool,
    /// Active limits.
    pub limits: ActiveLimits,
    /// Result of the last commissioning.
    pub identification: Option<IdentifiedMotor>,
}

/// Orders to the motor control.
pub trait MotorPort {
    /// Queues an order, to be executed within one PWM period.
    ///
    /// # Errors
    /// The order, when the queue is full.
    fn order(&mut self, order: MotorCommand) -> Result<(), MotorCommand>;

    /// Switches the power stage off and resets the chip, because the memory of the grasp is corrupt. Does not return on
    /// the chip.
    fn shut_down(&mut self);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn setpoint_with_nan_is_not_finite() {
        let nan = f32::NAN;
        let speed = |closing_mm_s, max_a| Setpoint::Speed { closing_mm_s, max_a };
        let position = |[opening_mm, speed_mm_s, max_a]: [f32; 3]| Setpoint::Position {
            opening_mm,
            speed_mm_s,
            max_a,
        };
        assert!(speed(1.0, 1.0).is_finite() && position([1.0; 3]).is_finite());
        for setpoint in [
            Setpoint::Current { closing_a: nan },
            speed(nan, 1.0),
            speed(1.0, nan),
            position([nan, 1.0, 1.0]),
            position([1.0, nan, 1.0]),
            position([1.0, 1.0, nan]),
        ] {
            assert!(!setpoint.is_finite(), "{setpoint:?}");
        }
    }
}
