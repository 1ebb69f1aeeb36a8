//! The rotor's place and speed from its angle sensor: a loop that follows the counts, bridges what is missing
//! and refuses what the rotor cannot do.

use core::f32::consts::TAU;

use super::PERIOD_S;
use super::settings::Settings;
use super::stage::EncoderError;
use crate::params;

/// One turn.
const TURN: f32 = 4_294_967_296.0;
/// Width of a count.
const SHIFT: u32 = 32 - params::ENCODER_BITS.value as u32;
/// Natural frequency of the loop, critically damped: a ramp of the speed leaves no error of the speed, and
/// 16,000 rad/s^2 leave 0.1 mrad of the place.
const FOLLOWS: f32 = TAU * params::ENCODER_BANDWIDTH.value as f32 * PERIOD_S;
/// Periods without an angle, one after the other, that are bridged: half a millisecond.
const BRIDGED: u8 = 10;
/// Further beside what the loop expects than this, in radians, is no angle of this rotor.
const STRANGE_RAD: f32 = 0.05;

/// Follows the rotor.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tracker {
    /// Turns in the upper, 2^-32 turns in the lower half.
    angle: i64,
    /// In 2^-32 turns a period.
    speed: f32,
    /// Periods since an angle was believed; none was yet.
    missing: Option<u8>,
}

/// The rotor's angle is not known any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lost;

impl Tracker {
    /// Takes the angle of one period.
    pub fn take(
        &mut self,
        counts: Result<u16, EncoderError>,
        age_periods: f32,
    ) -> Result<(), Lost> {
        let sensed = counts.map(|counts| u32::from(counts) << SHIFT);
        let Some(missing) = self.missing else {
            let first = sensed.map_err(|_| Lost)?;
            *self = Self {
                angle: i64::from(first),
                speed: 0.0,
                missing: Some(0),
            };
            return Ok(());
        };
        self.angle = self.angle.wrapping_add((self.speed as i32).into());
        let expected = (self.angle as u32).wrapping_sub((self.speed * age_periods) as i32 as u32);
        let beside = sensed.map(|sensed| sensed.wrapping_sub(expected) as i32 as f32);
        match beside {
            Ok(beside) if (-STRANGE..STRANGE).contains(&beside) => {
                self.angle = self
                    .angle
                    .wrapping_add(((2.0 * FOLLOWS * beside) as i32).into());
                self.speed += FOLLOWS * FOLLOWS * beside;
                self.missing = Some(0);
                Ok(())
            }
            _ if missing < BRIDGED => {
                self.missing = Some(missing.saturating_add(1));
                Ok(())
            }
            _ => {
                self.missing = None;
                Err(Lost)
            }
        }
    }

    /// The rotor's speed in rad/s, closing positive.
    pub fn speed(&self) -> f32 {
        self.speed * (TAU / TURN / PERIOD_S)
    }

    /// Where the rotor is, to be counted from.
    pub fn place(&self) -> Place {
        Place(self.angle)
    }

    /// Whether the rotor's angle is known.
    pub const fn is_known(&self) -> bool {
        self.missing.is_some()
    }

    /// The rotor's angle by its sensor in 2^-32 turns.
    pub const fn angle(&self) -> u32 {
        self.angle as u32
    }

    /// The same in radians, -pi to pi; none where it is not known.
    pub fn angle_rad(&self) -> Option<f32> {
        let angle = self.angle as i32 as f32 * (TAU / TURN);
        self.is_known().then_some(angle)
    }

    /// The electrical angle in 2^-32 turns.
    pub fn electrical(&self, settings: &Settings) -> u32 {
        (self.angle as u32)
            .wrapping_mul(settings.machine.pole_pairs.into())
            .wrapping_add(settings.wiring.offset)
    }
}

const STRANGE: f32 = STRANGE_RAD / TAU * TURN;

/// A place of the rotor, over many turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place(i64);

impl Place {
    /// How far the rotor has turned from `from` to here, in radians; further than 2000 turns it is not told
    /// apart.
    pub fn since(self, from: Self) -> f32 {
        (self.0.wrapping_sub(from.0) >> 12) as i32 as f32 * (TAU / 1_048_576.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;

    /// The counts of a rotor at an angle in radians.
    fn counts(radians: f64) -> Result<u16, EncoderError> {
        Ok((radians / std::f64::consts::TAU * 16384.0).floor() as i64 as u16 & 0x3fff)
    }

    /// A tracker after a rotor has turned at a speed for some periods.
    fn tracked(speed: f64, periods: u32) -> (Tracker, f64) {
        let mut tracker = Tracker::default();
        let mut angle = 0.0;
        for period in 0..periods {
            angle = f64::from(period) * speed * f64::from(PERIOD_S);
            tracker.take(counts(angle), 0.0).unwrap();
        }
        (tracker, angle)
    }

    #[test]
    fn a_steady_speed_is_told_over_many_turns() {
        for speed in [114.0, -114.0, 1.0, 0.0] {
            let (tracker, angle) = tracked(speed, 60_000);
            assert!(
                (f64::from(tracker.speed()) - speed).abs() < 0.5,
                "{}",
                tracker.speed()
            );
            let turned = f64::from(tracker.place().since(Place(0)));
            assert!((turned - angle).abs() < 1e-3, "{turned} {angle}");
        }
    }

    #[test]
    fn half_a_millisecond_without_an_angle_is_bridged_and_no_longer() {
        let (mut tracker, _) = tracked(100.0, 2000);
        let before = tracker.place().since(Place(0));
        for _ in 0..BRIDGED {
            assert_eq!(tracker.take(Err(EncoderError::Checksum), 0.0), Ok(()));
        }
        let turned = tracker.place().since(Place(0)) - before;
        assert!((turned - 100.0 * PERIOD_S * f32::from(BRIDGED)).abs() < 1e-3);
        assert_eq!(tracker.take(Err(EncoderError::Silent), 0.0), Err(Lost));
    }

    #[test]
    fn a_jump_that_no_rotor_makes_is_not_followed() {
        let (mut tracker, _) = tracked(0.0, 100);
        assert_eq!(tracker.take(counts(1.0), 0.0), Ok(()));
        assert!(tracker.speed().abs() < 0.1 && tracker.place().since(Place(0)).abs() < 1e-3);
        let held = (0..20).all(|_| tracker.take(counts(1.0), 0.0).is_ok());
        assert!(!held);
    }

    #[test]
    fn an_angle_of_one_period_ago_leaves_no_lag() {
        let mut tracker = Tracker::default();
        for period in 0..20_000 {
            let angle = 1.0 + f64::from(period - 1) * 114.0 * f64::from(PERIOD_S);
            tracker.take(counts(angle), 1.0).unwrap();
        }
        let angle = 1.0 + 19_999.0 * 114.0 * f64::from(PERIOD_S);
        assert!((f64::from(tracker.place().since(Place(0))) - angle).abs() < 1e-3);
    }

    #[test]
    fn the_electrical_angle_turns_pole_pairs_as_fast() {
        let mut settings = Settings::assumed(Screw::A);
        settings.wiring.offset = 1 << 30;
        // A fifth of a turn: 7/5 electrical turns and a quarter.
        let tracker = Tracker {
            angle: (1_i64 << 32) / 5,
            ..Tracker::default()
        };
        let expected = ((0.4 + 0.25) * f64::from(TURN)) as u32;
        assert!(tracker.electrical(&settings).abs_diff(expected) < 16);
    }
}
