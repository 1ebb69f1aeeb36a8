//! Covariates of a tick from the newest samples of motor, inertial sensor and host.

use core::f32::consts::TAU;

use crate::clock::Timed;
use crate::compensation::auxiliary_inputs::Attitude;
use crate::compensation::covariates::{
    AccelerationSample, AttitudeSample, Covariates, MotorSample,
};
use crate::math::TURN_UNITS;
use crate::motor::MotorStatus;
use crate::protocol::messages::{HostAcceleration, HostAttitude, Message};
use crate::tasks::inertial::InertialSample;

/// Age above which the motor's status is not used: five of its periods.
const MAX_MOTOR_US: i64 = 5_000;
/// Age above which the inertial sensor's sample is not used: ten of its periods.
const MAX_INERTIAL_US: i64 = 10_000;
/// Age above which the motion that a host reports is not used: at 1 rad/s the yaw is then wrong by 0.1 rad.
const MAX_HOST_US: i64 = 100_000;
/// Standard gravity in mm/s^2.
const GRAVITY_MM_S2: i32 = 9_807;

/// Motion of the gripper as a host reports it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HostMotion {
    /// Orientation.
    attitude: Option<Timed<HostAttitude>>,
    /// Acceleration in mm/s^2, without gravity, gripper axes.
    acceleration: Option<Timed<[i32; 3]>>,
}

impl HostMotion {
    /// Without any report.
    pub const NONE: Self = Self { attitude: None, acceleration: None };

    /// Takes over a host's message, received at `time_us`; false if it is another one.
    pub fn update(&mut self, message: &Message, time_us: u64) -> bool {
        let measured_us = |age_ms: u8| time_us.saturating_sub(u64::from(age_ms) * 1000);
        match message {
            Message::HostAttitude(attitude) => {
                let time_us = measured_us(attitude.age);
                self.attitude = Some(Timed { time_us, value: *attitude });
            }
            Message::HostAcceleration(acceleration) => {
                const MM_S2_PER_COUNT: i32 = 2;
                let HostAcceleration { x, y, z, age } = *acceleration;
                let value = [x, y, z].map(|count| i32::from(count) * MM_S2_PER_COUNT);
                self.acceleration = Some(Timed { time_us: measured_us(age), value });
            }
            _ => return false,
        }
        true
    }

    /// Acceleration without gravity in mm/s^2, if it is recent.
    pub fn acceleration_at(&self, time_us: u64) -> Option<[i32; 3]> {
        let (_, acceleration) = self.acceleration?.fresh(time_us, MAX_HOST_US)?;
        Some(acceleration)
    }
}

/// The newest samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CovariateSamples {
    /// State of the motor.
    pub motor: Option<Timed<MotorStatus>>,
    /// Inertial sensor.
    pub inertial: Option<Timed<InertialSample>>,
    /// Motion as a host reports it.
    pub host: HostMotion,
}

impl CovariateSamples {
    /// Covariates at a time in microseconds: opening and rotor angle extrapolated by the speed, the others as sampled.
    /// Samples that are too old are left out.
    pub fn at(&self, time_us: u64) -> Covariates {
        let motor = self.motor.and_then(|motor| motor.fresh(time_us, MAX_MOTOR_US));
        let inertial = self.inertial.and_then(|sample| sample.fresh(time_us, MAX_INERTIAL_US));
        let attitude = self.attitude_at(time_us, inertial);
        let acceleration = match inertial {
            Some((age_us, sample)) => {
                Some(AccelerationSample { age_us: short(age_us), mm_s2: sample.mm_s2 })
            }
            None => self.host_specific_force(time_us, attitude),
        };
        Covariates {
            opening_um: motor.and_then(|(age_us, motor)| {
                let moved_um = motor.closing_mm_s * 1e-3 * age_us as f32;
                Some((motor.opening_mm? * 1e3 - moved_um) as i32)
            }),
            motor: motor.and_then(|(age_us, motor)| {
                const TURNS_PER_URAD: f32 = TURN_UNITS / TAU * 1e-6;
                let turned = (motor.speed * TURNS_PER_URAD * age_us as f32) as i32;
                Some(MotorSample {
                    age_us: short(age_us),
                    iq_ma: short((motor.current.q * 1e3) as i64),
                    turn: (motor.turn?.wrapping_add_signed(turned) >> 16) as u16,
                })
            }),
            acceleration,
            attitude,
        }
    }

    /// Roll and pitch of the inertial sensor, else of the host; yaw of the host.
    fn attitude_at(
        &self,
        time_us: u64,
        inertial: Option<(i64, InertialSample)>,
    ) -> Option<AttitudeSample> {
        let (age_us, host) = self.host.attitude?.fresh(time_us, MAX_HOST_US)?;
        let [roll, pitch] = match inertial.and_then(|(_, sample)| sample.roll_pitch) {
            Some(angles) => angles.map(|angle| (angle * AttitudeSample::PER_RAD) as i16),
            None if host.yaw_only => return None,
            None => [host.roll, host.pitch],
        };
        let age_ms = (age_us / 1000).clamp(0, u8::MAX.into()) as u8;
        Some(AttitudeSample { age_ms, euler: [roll, pitch, host.yaw] })
    }

    /// Specific force from a host's acceleration and gravity, without an inertial sensor.
    fn host_specific_force(
        &self,
        time_us: u64,
        attitude: Option<AttitudeSample>,
    ) -> Option<AccelerationSample> {
        let (age_us, acceleration) = self.host.acceleration?.fresh(time_us, MAX_HOST_US)?;
        let gravity = Attitude::from_euler(attitude?.radians()).to_body([0, 0, GRAVITY_MM_S2]);
        let mut mm_s2 = acceleration;
        for (sum, gravity) in mm_s2.iter_mut().zip(gravity) {
            *sum = sum.saturating_add(gravity);
        }
        Some(AccelerationSample { age_us: short(age_us), mm_s2 })
    }
}

fn short(value: i64) -> i16 {
    value.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::foc::Dq;

    fn at<T>(time_us: u64, value: T) -> Option<Timed<T>> {
        Some(Timed { time_us, value })
    }

    fn moving() -> MotorStatus {
        MotorStatus {
            opening_mm: Some(40.0),
            closing_mm_s: 50.0,
            // A turn in 62.8 ms.
            speed: 100.0,
            turn: Some(u32::MAX - (1 << 24)),
            pole_pairs: 7,
            current: Dq { d: 0.0, q: -2.5 },
            ..MotorStatus::default()
        }
    }

    #[test]
    fn opening_and_angle_are_extrapolated_to_the_tick() {
        let samples =
            CovariateSamples { motor: at(1_000_000, moving()), ..CovariateSamples::default() };
        let covariates = samples.at(1_000_800);
        // 50 mm/s over 0.8 ms are 40 um; 0.08 rad are 834.4 of 65536, from 256 before the end of a turn.
        assert_eq!(covariates.opening_um, Some(39_960));
        let motor = covariates.motor.unwrap();
        assert_eq!((motor.age_us, motor.iq_ma), (800, -2500));
        assert!((577..=579).contains(&motor.turn), "{}", motor.turn);
        // A sample taken after the tick.
        let before = samples.at(999_900);
        assert_eq!(before.opening_um, Some(40_005));
        assert_eq!(before.motor.unwrap().age_us, -100);
    }

    #[test]
    fn old_samples_are_left_out() {
        let inertial = InertialSample { mm_s2: [0, 0, 9807], roll_pitch: Some([0.1, 0.2]) };
        let attitude = HostAttitude { yaw: 3000, yaw_only: true, ..HostAttitude::default() };
        let mut samples = CovariateSamples {
            motor: at(1_000_000, moving()),
            inertial: at(1_000_000, inertial),
            host: HostMotion::NONE,
        };
        assert!(samples.host.update(&Message::HostAttitude(attitude), 1_000_000));
        let present = |time_us| {
            let all = samples.at(time_us);
            [all.motor.is_some(), all.acceleration.is_some(), all.attitude.is_some()]
        };
        assert_eq!(present(1_005_000), [true, true, true]);
        assert_eq!(present(1_005_001), [false, true, true]);
        // Without its tilt a yaw alone is no attitude.
        assert_eq!(present(1_010_001), [false, false, false]);
        assert_eq!(samples.at(1_004_000).attitude.unwrap().euler, [1000, 2000, 3000]);
    }

    #[test]
    fn a_host_replaces_the_inertial_sensor() {
        let mut samples = CovariateSamples::default();
        // Rolled by 90 degrees: gravity along y. 1 m/s^2 along x.
        let attitude = HostAttitude { roll: 15_708, age: 3, ..HostAttitude::default() };
        let acceleration = HostAcceleration { x: 500, age: 2, ..HostAcceleration::default() };
        assert!(samples.host.update(&Message::HostAttitude(attitude), 500_000));
        assert_eq!(samples.at(500_000).acceleration, None);
        assert!(samples.host.update(&Message::HostAcceleration(acceleration), 500_000));
        let covariates = samples.at(501_000);
        assert_eq!(covariates.attitude.unwrap().age_ms, 4);
        let acceleration = covariates.acceleration.unwrap();
        assert_eq!(acceleration.age_us, 3000);
        let [x, y, z] = acceleration.mm_s2;
        assert!((x - 1000).abs() < 20 && (y - 9807).abs() < 20 && z.abs() < 20, "{x} {y} {z}");
        assert_eq!(samples.host.acceleration_at(501_000), Some([1000, 0, 0]));
        assert_eq!(samples.host.acceleration_at(700_000), None);
    }

    #[test]
    fn false_acceleration_is_at_most_66_m_s2() {
        for (x, mm_s2) in [(i16::MAX, 65_534), (i16::MIN, -65_536)] {
            let mut host = HostMotion::NONE;
            let acceleration = HostAcceleration { x, ..HostAcceleration::default() };
            assert!(host.update(&Message::HostAcceleration(acceleration), 0));
            assert_eq!(host.acceleration_at(0), Some([mm_s2, 0, 0]));
        }
    }
}
