//! What the motor is asked to do, what it does, and why it does not.

use super::commission::{Found, Refusal};
use super::limits::{Active, Temperatures};
use super::number::{Direction, greater};
use super::plausible::Supply;
use super::stage::Drive;
use super::transform::Dq;
use crate::surroundings::{self, Surroundings};

/// What is asked of the motor. Closing is positive; amperes are along q.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Setpoint {
    /// All switches off: the rotor coasts, and a screw that locks itself holds.
    #[default]
    Off,
    /// The windings shorted: the rotor brakes by itself, whatever the bus bears.
    Brake,
    /// A current, and so a torque.
    Current {
        /// In amperes.
        closing_a: f32,
    },
    /// A speed, at once: what lies above shapes it.
    Speed {
        /// In mm/s of the opening, closing positive.
        closing_mm_s: f32,
        /// Greatest current in amperes.
        most_a: f32,
    },
    /// A place, along a way bounded in speed, acceleration and jerk.
    Position {
        /// In millimetres between the fingers.
        opening_mm: f32,
        /// Greatest speed in mm/s.
        speed_mm_s: f32,
        /// Greatest current in amperes.
        most_a: f32,
    },
}

impl Setpoint {
    /// Whether every number in it is one.
    pub fn is_finite(&self) -> bool {
        match *self {
            Self::Off | Self::Brake => true,
            Self::Current { closing_a } => closing_a.is_finite(),
            Self::Speed {
                closing_mm_s,
                most_a,
            } => closing_mm_s.is_finite() && most_a.is_finite(),
            Self::Position {
                opening_mm,
                speed_mm_s,
                most_a,
            } => opening_mm.is_finite() && speed_mm_s.is_finite() && most_a.is_finite(),
        }
    }

    /// Greatest current in amperes that it allows itself.
    pub fn most_a(&self) -> f32 {
        match *self {
            Self::Speed { most_a, .. } | Self::Position { most_a, .. } => greater(most_a, 0.0),
            Self::Off | Self::Brake | Self::Current { .. } => f32::INFINITY,
        }
    }
}

/// What those above tell the motor to do, in one word for a queue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Follow set-points once the currents' offsets are taken, 26 ms: [`State::Armed`] tells when. Nothing where
    /// the motor is not disarmed; a trip where its settings are unsound.
    Arm,
    /// Measure windings, phases and sensor, 3 s; nothing may be gripped. Ends disarmed, and what was found holds
    /// from then on, or in [`State::Refused`].
    Commission,
    /// Everything off; the only way out of a trip.
    Disarm,
    /// A set-point; nothing while not armed.
    Do(Setpoint),
    /// The fingers are this far apart now, the flanks of the screws that close touching: from a homing, or from
    /// what was stored. What is not a number: it is not known any more.
    Opening {
        /// Millimetres between the fingers.
        opening_mm: f32,
    },
    /// Temperatures, as often as they are measured.
    Temperatures(Temperatures),
}

/// What the motor does. From [`State::Tripped`] only [`Order::Disarm`] leads on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum State {
    /// Off; set-points move nothing.
    #[default]
    Disarmed,
    /// The currents' offsets are being taken, 26 ms; then [`State::Armed`], or commissioning.
    Arming,
    /// Set-points are followed.
    Armed,
    /// Sensor, phases and windings are being measured, 3 s.
    Commissioning,
    /// Commissioning ended without a result; off.
    Refused(Refusal),
    /// Something is wrong; off, or shorted where the rotor may turn.
    Tripped(Trip),
}

/// Why the motor stopped by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trip {
    /// Something is not a number, or settings with which nothing can be computed.
    NotANumber,
    /// A phase's current is beyond its bound, or beyond what is measured.
    OverCurrent,
    /// The rotor turns too fast.
    OverSpeed,
    /// The rotor's angle is not known.
    Encoder,
    /// At no current the amplifiers told one, the phases' currents do not sum to nothing, or they do not follow.
    CurrentSense,
    /// The current that should brake the rotor does not.
    Runaway,
    /// The power stage has switched itself off.
    PowerStage,
    /// The outer tick has missed its turn three times, or whoever gives it set-points five times.
    Unled,
}

impl Trip {
    /// What the switches do: where numbers, currents or their measurement are wrong, nothing; where the rotor
    /// is, or those who lead it, the windings are shorted, which brakes without knowing its angle.
    pub const fn drive(self) -> Drive {
        match self {
            Self::NotANumber | Self::OverCurrent | Self::CurrentSense | Self::PowerStage => {
                Drive::Off
            }
            Self::OverSpeed | Self::Encoder | Self::Runaway | Self::Unled => Drive::Brake,
        }
    }
}

/// What the motor tells of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Telling {
    /// What it does.
    pub state: State,
    /// Millimetres between the fingers, the screw's play counted; none before it is homed.
    pub opening_mm: Option<f32>,
    /// Millimetres that the position loop asks for now; none without a place as set-point.
    pub asked_mm: Option<f32>,
    /// Speed of the opening in mm/s, closing positive.
    pub closing_mm_s: f32,
    /// Radians of the rotor since it was first seen, closing positive.
    pub turned_rad: f32,
    /// Rotor's speed in rad/s.
    pub speed: f32,
    /// The rotor's angle within a turn of its sensor, in radians, -pi to pi; none where it is not known.
    pub angle_rad: Option<f32>,
    /// The rotor's electrical angle.
    pub electrical: Direction,
    /// Currents in amperes.
    pub current: Dq,
    /// Currents asked for, in amperes.
    pub asked: Dq,
    /// Voltages in volts.
    pub voltage: Dq,
    /// Bus voltage in volts.
    pub bus_v: f32,
    /// The same as a verdict, or one of the last 3 ms.
    pub supply: Supply,
    /// Motor or power stage is too hot for any current.
    pub is_hot: bool,
    /// Bounds that are active.
    pub limits: Active,
    /// What commissioning found last.
    pub found: Option<Found>,
}

impl Telling {
    /// For those who undo what the motor does to the fields.
    pub fn surroundings(&self) -> Surroundings {
        const ONE: f32 = 32_768.0;
        let Direction { sin, cos } = self.electrical;
        Surroundings {
            opening_um: self.opening_mm.map(|mm| (mm * 1e3) as i32),
            motor: self.angle_rad.map(|angle_rad| surroundings::Motor {
                iq_ma: (self.current.q * 1e3) as i32,
                electrical: [(sin * ONE) as i32, (cos * ONE) as i32],
                angle_urad: (angle_rad * 1e6) as i32,
            }),
            ..Surroundings::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_point_with_a_number_that_is_none_is_known() {
        let nan = f32::NAN;
        for (closing_mm_s, most_a) in [(nan, 1.0), (1.0, nan)] {
            let setpoint = Setpoint::Speed {
                closing_mm_s,
                most_a,
            };
            assert!(!setpoint.is_finite());
        }
        for place in 0..3 {
            let mut numbers = [1.0; 3];
            numbers[place] = nan;
            let [opening_mm, speed_mm_s, most_a] = numbers;
            let setpoint = Setpoint::Position {
                opening_mm,
                speed_mm_s,
                most_a,
            };
            assert!(!setpoint.is_finite());
        }
        assert!(!Setpoint::Current { closing_a: nan }.is_finite());
    }

    #[test]
    fn the_surroundings_are_told_in_their_integers() {
        let telling = Telling {
            opening_mm: Some(12.5),
            angle_rad: Some(-0.25),
            electrical: Direction {
                sin: -0.5,
                cos: 0.75,
            },
            current: Dq { d: 1.0, q: -2.5 },
            ..Telling::default()
        };
        let told = telling.surroundings();
        let motor = told.motor.unwrap();
        assert_eq!(told.opening_um, Some(12_500));
        assert_eq!((motor.iq_ma, motor.angle_urad), (-2500, -250_000));
        assert_eq!(motor.electrical, [-16_384, 24_576]);
        assert_eq!(Telling::default().surroundings(), Surroundings::default());
    }
}
