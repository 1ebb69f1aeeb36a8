//! Angle tracker (phase-locked loop): rotor position and speed from the angle sensor. Bridges missing angles and
//! rejects implausible ones.

use core::f32::consts::TAU;

use crate::config::constants;
use crate::math::TURN_UNITS;
use crate::motor::power_stage::EncoderError;
use crate::motor::settings::Settings;
use crate::motor::timing::PERIOD_S;

/// Sensor counts to tracker units.
const SHIFT: u32 = 32 - constants::ENCODER_BITS.value as u32;
/// Natural frequency of the critically damped loop: no speed error on a ramp of the speed, and a position error of
/// 0.1 mrad at 16,000 rad/s^2.
const FREQUENCY: f32 = TAU * constants::ENCODER_BANDWIDTH.value as f32 * PERIOD_S;
/// Innovation in radians above which an angle is rejected.
const MAX_INNOVATION_RAD: f32 = 0.05;
const MAX_INNOVATION: f32 = MAX_INNOVATION_RAD / TAU * TURN_UNITS;

/// Tracks the rotor.
#[derive(Clone, Copy, Debug, Default)]
pub struct AngleTracker {
    /// Turns in the upper half, 2^-32 turns in the lower half.
    angle: i64,
    /// In 2^-32 turns per period.
    speed: f32,
    /// Periods since the last valid angle; none where the angle is unknown.
    missing: Option<u8>,
}

/// The rotor angle has become unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AngleLost;

impl AngleTracker {
    /// Adds the angle of one period; its age is in the settings.
    pub fn update(
        &mut self,
        counts: Result<u16, EncoderError>,
        settings: &Settings,
    ) -> Result<(), AngleLost> {
        let measured = counts.map(|counts| u32::from(counts) << SHIFT);
        let Some(missing) = self.missing else {
            let first = measured.map_err(|_| AngleLost)?;
            *self = Self { angle: i64::from(first), speed: 0.0, missing: Some(0) };
            return Ok(());
        };
        self.angle = self.angle.wrapping_add((self.speed as i32).into());
        let expected = (self.angle as u32)
            .wrapping_sub((self.speed * settings.angle_age_periods) as i32 as u32);
        let innovation = measured.map(|measured| measured.wrapping_sub(expected) as i32 as f32);
        match innovation {
            Ok(innovation) if (-MAX_INNOVATION..MAX_INNOVATION).contains(&innovation) => {
                self.angle =
                    self.angle.wrapping_add(((2.0 * FREQUENCY * innovation) as i32).into());
                self.speed += FREQUENCY * FREQUENCY * innovation;
                self.missing = Some(0);
                Ok(())
            }
            _ if missing < settings.limits.bridged_angles => {
                self.missing = Some(missing.saturating_add(1));
                Ok(())
            }
            _ => {
                self.missing = None;
                Err(AngleLost)
            }
        }
    }

    /// Rotor speed in rad/s, closing positive.
    pub fn speed(&self) -> f32 {
        self.speed * (TAU / TURN_UNITS / PERIOD_S)
    }

    /// Multi-turn position.
    pub fn position(&self) -> RotorPosition {
        RotorPosition(self.angle)
    }

    /// Whether the angle is known.
    pub const fn is_known(&self) -> bool {
        self.missing.is_some()
    }

    /// Angle of the sensor in 2^-32 turns.
    pub const fn angle(&self) -> u32 {
        self.angle as u32
    }

    /// Electrical angle in 2^-32 turns.
    pub fn electrical(&self, settings: &Settings) -> u32 {
        (self.angle as u32)
            .wrapping_mul(settings.machine.pole_pairs.into())
            .wrapping_add(settings.wiring.offset)
    }
}

/// Multi-turn position of the rotor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RotorPosition(i64);

impl RotorPosition {
    /// Rotation since `from` in radians; wraps beyond 2000 turns.
    pub fn since(self, from: Self) -> f32 {
        (self.0.wrapping_sub(from.0) >> 12) as i32 as f32 * (TAU / 1_048_576.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;

    /// Settings whose angle has an age in PWM periods.
    fn settings(angle_age_periods: f32) -> Settings {
        Settings { angle_age_periods, ..Settings::assumed(Screw::A) }
    }

    /// Sensor counts at an angle in radians.
    fn counts(radians: f64) -> Result<u16, EncoderError> {
        Ok((radians / std::f64::consts::TAU * 16384.0).floor() as i64 as u16 & 0x3fff)
    }

    /// A tracker after some periods at a constant speed, and the rotor angle.
    fn tracked(speed: f64, periods: u32) -> (AngleTracker, f64) {
        let mut tracker = AngleTracker::default();
        let mut angle = 0.0;
        for period in 0..periods {
            angle = f64::from(period) * speed * f64::from(PERIOD_S);
            tracker.update(counts(angle), &settings(0.0)).unwrap();
        }
        (tracker, angle)
    }

    #[test]
    fn tracker_follows_constant_speed_over_many_turns() {
        for speed in [114.0, -114.0, 1.0, 0.0] {
            let (tracker, angle) = tracked(speed, 60_000);
            assert!((f64::from(tracker.speed()) - speed).abs() < 0.5, "{}", tracker.speed());
            let turned = f64::from(tracker.position().since(RotorPosition(0)));
            assert!((turned - angle).abs() < 1e-3, "{turned} {angle}");
        }
    }

    #[test]
    fn missing_angles_are_bridged_for_half_a_millisecond() {
        let settings = settings(0.0);
        let bridged = settings.limits.bridged_angles;
        let (mut tracker, _) = tracked(100.0, 2000);
        let before = tracker.position().since(RotorPosition(0));
        for _ in 0..bridged {
            assert_eq!(tracker.update(Err(EncoderError::Checksum), &settings), Ok(()));
        }
        let turned = tracker.position().since(RotorPosition(0)) - before;
        assert!((turned - 100.0 * PERIOD_S * f32::from(bridged)).abs() < 1e-3);
        assert_eq!(tracker.update(Err(EncoderError::Silent), &settings), Err(AngleLost));
    }

    #[test]
    fn implausible_jump_is_rejected_then_lost() {
        let (mut tracker, _) = tracked(0.0, 100);
        assert_eq!(tracker.update(counts(1.0), &settings(0.0)), Ok(()));
        assert!(
            tracker.speed().abs() < 0.1 && tracker.position().since(RotorPosition(0)).abs() < 1e-3
        );
        let is_bridged = (0..20).all(|_| tracker.update(counts(1.0), &settings(0.0)).is_ok());
        assert!(!is_bridged);
    }

    #[test]
    fn angle_age_is_compensated() {
        let mut tracker = AngleTracker::default();
        for period in 0..20_000 {
            let angle = 1.0 + f64::from(period - 1) * 114.0 * f64::from(PERIOD_S);
            tracker.update(counts(angle), &settings(1.0)).unwrap();
        }
        let angle = 1.0 + 19_999.0 * 114.0 * f64::from(PERIOD_S);
        assert!((f64::from(tracker.position().since(RotorPosition(0))) - angle).abs() < 1e-3);
    }

    #[test]
    fn electrical_angle_is_pole_pairs_times_the_mechanical() {
        let mut settings = Settings::assumed(Screw::A);
        settings.wiring.offset = 1 << 30;
        // A fifth of a turn: 7/5 electrical turns and a quarter.
        let tracker = AngleTracker { angle: (1_i64 << 32) / 5, ..AngleTracker::default() };
        let expected = ((0.4 + 0.25) * f64::from(TURN_UNITS)) as u32;
        assert!(tracker.electrical(&settings).abs_diff(expected) < 16);
    }
}
