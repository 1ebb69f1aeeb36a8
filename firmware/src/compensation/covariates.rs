//! What the board measures besides the fields: opening, motor, acceleration, attitude. Each is optional; an effect that
//! needs a missing one is not compensated, and the estimate is flagged.
//!
//! [`Covariates`] are the values as sent on the serial line, in steps finer than their noise. The device compensates with
//! exactly these values ([`Covariates::inputs`]), and so does the replay of a recording.

use serde::{Deserialize, Serialize};

use crate::compensation::auxiliary_inputs::{Attitude, AuxiliaryInputs, MotorInputs};

/// Covariates at the time of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Covariates {
    /// Distance of the fingertips in micrometres; none before homing.
    pub opening_um: Option<i32>,
    /// Current and rotor angle of the motor.
    pub motor: Option<MotorSample>,
    /// Specific force.
    pub acceleration: Option<AccelerationSample>,
    /// Orientation.
    pub attitude: Option<AttitudeSample>,
}

/// Current and rotor angle of the motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MotorSample {
    /// Age of the measurement at the tick in microseconds. The angle is extrapolated over it.
    pub age_us: i16,
    /// Quadrature current in milliamperes.
    pub iq_ma: i16,
    /// Mechanical angle of the rotor sensor in 2^-16 turns (96 microradians).
    pub turn: u16,
}

/// Specific force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AccelerationSample {
    /// Age of the measurement at the tick in microseconds.
    pub age_us: i16,
    /// Specific force (gravity included) in mm/s^2, gripper axes.
    pub mm_s2: [i32; 3],
}

/// Orientation of the gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AttitudeSample {
    /// Age of the oldest part, commonly the yaw, at the tick in milliseconds.
    pub age_ms: u8,
    /// Roll, pitch and yaw from gripper to world axes: rotations about x, then y, then z, in 1e-4 rad.
    pub euler: [i16; 3],
}

impl AttitudeSample {
    /// Units of [`Self::euler`] per radian.
    pub const PER_RAD: f32 = 1e4;

    /// Roll, pitch and yaw in radians.
    pub fn radians(&self) -> [f32; 3] {
        self.euler.map(|angle| f32::from(angle) / Self::PER_RAD)
    }
}

impl Covariates {
    /// Inputs of the compensation, for a motor with these pole pairs.
    pub fn inputs(&self, pole_pairs: u8) -> AuxiliaryInputs {
        AuxiliaryInputs {
            opening_um: self.opening_um,
            motor: self.motor.map(|motor| {
                MotorInputs::new(motor.iq_ma.into(), u32::from(motor.turn) << 16, pole_pairs)
            }),
            acceleration: self.acceleration.map(|sample| sample.mm_s2),
            attitude: self.attitude.map(|sample| Attitude::from_euler(sample.radians())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotor_angle_is_0_to_2_pi_and_the_electrical_angle_is_its_multiple() {
        // 3/4 of a turn: 4.712389 rad; 7 * 3/4 = 5 1/4 turns: sine 1, cosine 0.
        let motor = Some(MotorSample { age_us: 0, iq_ma: -2500, turn: 0xC000 });
        let inputs = Covariates { motor, ..Covariates::default() }.inputs(7).motor.unwrap();
        assert_eq!((inputs.iq_ma, inputs.angle_urad), (-2500, 4_712_388));
        let [sin, cos] = inputs.electrical;
        assert!((sin - (1 << 15)).abs() < 40 && cos.abs() < 40, "{sin} {cos}");
    }
}
