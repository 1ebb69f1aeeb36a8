//! Periods of the two loops.

use crate::config::constants;

/// PWM period in seconds.
pub const PERIOD_S: f32 = (1e-3 / constants::PWM_RATE.value) as f32;
/// PWM periods per motion-loop tick.
pub const MOTION_PERIODS: u8 = 5;
/// Rate of the motion loop in Hz.
pub const MOTION_HZ: f64 = constants::PWM_RATE.value * 1e3 / MOTION_PERIODS as f64;
