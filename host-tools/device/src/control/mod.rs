//! Control of a gripper in sessions: arm, enable, home, command, hold, and the end of a session.
//!
//! - here: requests and options of a session.
//! - [`session`]: the steps of a session.
//! - `ending`: the end of a session, which undoes only what the session has begun.
//! - [`log`]: states and measurements during a session.
//! - [`outcome`]: the result of a session; [`result_code`]: results as codes.

mod ending;
pub mod log;
pub mod outcome;
pub mod result_code;
pub mod session;

use anyhow::{Result, bail};
use firmware::config::constants;
use firmware::config::limits::GripLimits;
use firmware::grip::commands::{GripProfile, flag, mode};
use firmware::protocol::messages::Command;
use sim::closed_loop::grasp_rig::grip_command;
use sim::closed_loop::landing::FootContact;

/// Default speed of motions and speed of a release in mm/s.
const DEFAULT_SPEED_MM_S: f64 = 15.0;
/// Speed range of the command message.
const SPEED_RANGE_MM_S: std::ops::RangeInclusive<f64> = 0.25..=58.0;
/// Margin to the ends of the travel in mm.
pub const MARGIN_MM: f64 = 2.0;
/// Opening in mm of fingers that are closed for ground contact and do not press on each other.
pub const CLOSED_MM: f64 = 0.5 * GripLimits::GRIPPER.flat_contact_mm as f64;
/// Minimum force of a grasp in newtons.
pub const MIN_FORCE_N: f64 = 5.0;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SessionOptions {
    /// Home the gripper if required.
    pub home: bool,
    /// Clear latched faults first.
    pub clear_faults: bool,
    /// Time at the set-point in seconds; none: until the interrupt, except for a position.
    pub hold_s: Option<f64>,
    /// Leave an own grip gripped.
    pub keep: bool,
}

/// Width window of a grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidthWindow {
    /// Expected width in mm.
    pub width_mm: f64,
    /// Half of the window in mm: 1, 2, 4, 8, 16, 32 or 64.
    pub half_mm: f64,
    /// Full speed until close to the window.
    pub is_fast: bool,
}

/// The set-point of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Request {
    /// Move to an opening.
    Position {
        /// Target in mm.
        opening_mm: f64,
        /// Maximum speed in mm/s.
        speed_mm_s: f64,
        /// The forces are not believed.
        is_uncalibrated: bool,
    },
    /// Grip.
    Force {
        /// Set-point in newtons.
        set_n: f64,
        /// With profile, speed and window.
        command: Command,
    },
    /// Ground contact.
    Foot(FootContact),
    /// Open, from every state but ground contact.
    Release {
        /// Target in mm.
        opening_mm: f64,
    },
}

impl Request {
    /// A move.
    ///
    /// # Errors
    /// Opening or speed is out of range.
    pub fn position(
        opening_mm: f64,
        speed_mm_s: Option<f64>,
        is_uncalibrated: bool,
    ) -> Result<Self> {
        check_opening("--position", opening_mm, CLOSED_MM)?;
        check_speed(speed_mm_s)?;
        let speed_mm_s = speed_mm_s.unwrap_or(DEFAULT_SPEED_MM_S);
        Ok(Self::Position { opening_mm, speed_mm_s, is_uncalibrated })
    }

    /// A grip; without a profile that of the force, without a speed that of the profile and the force.
    ///
    /// # Errors
    /// A value is out of range.
    pub fn force(
        set_n: f64,
        profile: Option<GripProfile>,
        speed_mm_s: Option<f64>,
        window: Option<WidthWindow>,
    ) -> Result<Self> {
        check_force(set_n)?;
        check_speed(speed_mm_s)?;
        let mut command = grip_command(set_n);
        if let Some(profile) = profile {
            let max_n = f64::from(profile.max_n());
            if set_n > max_n {
                bail!(
                    "--force {set_n:?} is not possible with this --profile; give up to {max_n} N"
                );
            }
            let bits = (0..=flag::PROFILE).find(|bits| GripProfile::of(*bits) == Some(profile));
            command.flags = bits.unwrap_or_default();
        }
        if let Some(WidthWindow { width_mm, half_mm, is_fast }) = window {
            let field = (1..=7).find(|field| f64::from(1_u8 << (field - 1)) == half_mm);
            let Some(field) = field.filter(|_| (0.0..=constants::STROKE.value).contains(&width_mm))
            else {
                bail!(
                    "--width {width_mm}:{half_mm} is not possible here; give the width within the stroke, and half of the \
                     window: 1, 2, 4, 8, 16, 32 or 64 mm"
                );
            };
            command.position = counts("position", width_mm) as u16;
            command.flags |= field << flag::WINDOW.trailing_zeros();
            command.flags |= if is_fast { flag::FAST } else { 0 };
        }
        command.speed = speed_mm_s.map_or(0, |mm_s| counts("speed", mm_s) as u8);
        Ok(Self::Force { set_n, command })
    }

    /// An opening; by default the largest.
    ///
    /// # Errors
    /// The opening is out of range.
    pub fn release(opening_mm: Option<f64>) -> Result<Self> {
        let opening_mm = opening_mm.unwrap_or(constants::STROKE.value - MARGIN_MM);
        check_opening("--release", opening_mm, MARGIN_MM)?;
        Ok(Self::Release { opening_mm })
    }

    fn command(&self) -> Command {
        match *self {
            Self::Position { opening_mm, speed_mm_s, is_uncalibrated } => Command {
                flags: if is_uncalibrated { flag::UNCALIBRATED } else { 0 },
                ..motion(mode::MOVE, opening_mm, speed_mm_s)
            },
            Self::Force { command, .. } => command,
            Self::Foot(contact) => contact.command(),
            Self::Release { opening_mm } => motion(mode::RELEASE, opening_mm, DEFAULT_SPEED_MM_S),
        }
    }
}

/// Checks that an opening is within the travel.
///
/// # Errors
/// It is not; `option` is what gave it.
pub fn check_opening(option: &str, mm: f64, min_mm: f64) -> Result<()> {
    let max_mm = constants::STROKE.value - MARGIN_MM;
    if !(min_mm..=max_mm).contains(&mm) {
        bail!("{option} {mm:?} is not possible here; give {min_mm} to {max_mm} mm");
    }
    Ok(())
}

/// Checks the range of a grasp force.
///
/// # Errors
/// It is out of range.
pub fn check_force(set_n: f64) -> Result<()> {
    let max_n = f64::from(GripProfile::Strong.max_n());
    if !(MIN_FORCE_N..=max_n).contains(&set_n) {
        bail!("--force {set_n:?} is not possible here; give {MIN_FORCE_N} to {max_n} N");
    }
    Ok(())
}

fn check_speed(speed_mm_s: Option<f64>) -> Result<()> {
    match speed_mm_s.filter(|mm_s| !SPEED_RANGE_MM_S.contains(mm_s)) {
        Some(mm_s) => {
            let (min, max) = (SPEED_RANGE_MM_S.start(), SPEED_RANGE_MM_S.end());
            bail!("--speed {mm_s:?} is not possible here; give {min} to {max} mm/s")
        }
        None => Ok(()),
    }
}

const fn mode_command(mode: u8) -> Command {
    Command { mode, position: 0, speed: 0, force: 0, flags: 0 }
}

fn motion(mode: u8, opening_mm: f64, speed_mm_s: f64) -> Command {
    Command {
        mode,
        position: counts("position", opening_mm) as u16,
        speed: counts("speed", speed_mm_s) as u8,
        ..Command::default()
    }
}

/// Raw value of a field of the command message.
fn counts(field: &str, value: f64) -> f64 {
    let field = Command::LAYOUT.signals.iter().find(|candidate| candidate.name == field);
    field.map_or(0.0, |field| (value / field.scale).round())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grip_has_profile_speed_and_window() {
        let command = |profile, window| {
            let request = Request::force(15.0, profile, Some(4.0), window).unwrap();
            request.command()
        };
        let plain = Command { mode: mode::GRIP, force: 150, speed: 16, ..Command::default() };
        assert_eq!(command(None, None), plain);
        let window = WidthWindow { width_mm: 40.0, half_mm: 4.0, is_fast: true };
        let flags = 1 | 3 << 2 | flag::FAST;
        let expected = Command { position: 800, flags, ..plain };
        assert_eq!(command(Some(GripProfile::Fragile), Some(window)), expected);
    }

    #[test]
    fn values_out_of_range_name_the_range() {
        let narrow = WidthWindow { width_mm: 40.0, half_mm: 3.0, is_fast: false };
        for (request, words) in [
            (Request::position(0.4, None, false), "give 0.5 to 78 mm"),
            (Request::position(20.0, Some(70.0), false), "give 0.25 to 58 mm/s"),
            (Request::force(4.0, None, None, None), "give 5 to 350 N"),
            (Request::force(30.0, Some(GripProfile::Fragile), None, None), "up to 20 N"),
            (Request::force(30.0, None, None, Some(narrow)), "1, 2, 4, 8, 16, 32 or 64 mm"),
            (Request::release(Some(79.0)), "give 2 to 78 mm"),
        ] {
            let message = request.unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
