//! The position loop: a way to an opening, and the rotor's speed that follows it.

use super::number::within;
use super::settings::Settings;
use super::speed;
use super::trajectory::Trajectory;
use crate::params;

/// What a place asks of the speed loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Rotor's speed in rad/s, closing positive.
    pub speed: f32,
    /// Amperes ahead of the speed loop.
    pub ahead_a: f32,
}

/// The loop.
#[derive(Clone, Copy, Debug)]
pub struct PositionLoop {
    way: Trajectory,
}

impl PositionLoop {
    /// Speed in 1/s for a place that is off.
    pub const GAIN: f32 = core::f32::consts::TAU * params::POSITION_BANDWIDTH.value as f32;

    /// Begins where the rotor is: an opening in millimetres that grows by a speed in mm/s.
    pub fn start(opening_mm: f32, opening_mm_s: f32) -> Self {
        Self {
            way: Trajectory::start(opening_mm, opening_mm_s),
        }
    }

    /// Goes on by a tick towards a target; `opening_mm` is the rotor's place as an opening.
    pub fn tick(
        &mut self,
        settings: &Settings,
        target_mm: f32,
        speed_mm_s: f32,
        opening_mm: f32,
    ) -> Wanted {
        let (limits, screw) = (&settings.limits, &settings.screw);
        let fastest = within(speed_mm_s, 0.0, screw.closing_mm_s(limits.speed));
        self.way.tick(target_mm, fastest);
        let off_mm = self.way.place_mm() - opening_mm;
        let opening_mm_s = self.way.speed_mm_s() + Self::GAIN * off_mm;
        let radians = -screw.rotor_speed(1.0);
        let along = radians * self.way.speed_mm_s();
        let acceleration = radians * self.way.acceleration_mm_s2();
        Wanted {
            speed: radians * opening_mm_s,
            ahead_a: speed::ahead_a(&settings.machine, along, acceleration),
        }
    }

    /// The opening in millimetres that is asked for now.
    pub fn asked_mm(&self) -> f32 {
        self.way.place_mm()
    }

    /// Whether the way has ended.
    pub fn is_at_rest(&self) -> bool {
        self.way.is_at_rest()
    }
}
