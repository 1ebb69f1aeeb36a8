//! Commands to a gripper on a serial line or CAN bus: arm, home, command, disable.
//!
//! - here: requests, and the threads: the session has its own, which no output delays.
//! - `session`: the steps of a session.
//! - `ending`: the end of a session, which undoes only what the session has begun.
//! - `log`: states and measurements during a session, and its result.

mod ending;
mod log;
mod session;

use std::io::Write;
use std::sync::mpsc::channel;
use std::thread;

use anyhow::{Result, bail};
use firmware::config::constants;
use firmware::grip::commands::{GripProfile, flag, mode};
use firmware::grip::states::TaskState;
use firmware::protocol::messages::Command;
use serde_json::json;

use crate::commands::grasp::simulated::check_force;
use crate::commands::grasp::{Args, MARGIN_MM, Profile, WidthArg, check_opening};
use crate::commands::result_code::ResultCode;
use device::format;
use device::session::CLOSED_MM;
use report::text::terminal;
use session::{Session, WaitResult};
use sim::closed_loop::grasp_rig::grip_command;
use sim::closed_loop::landing::FootContact;

/// Timeout of a stop in seconds.
const STOP_S: f64 = 1.0;
/// Default speed of motions and speed of a release in mm/s.
const DEFAULT_SPEED_MM_S: f64 = 15.0;
/// Position tolerance in mm.
const TOLERANCE_MM: f64 = 0.5;
/// Speed range of the command message.
const SPEED_RANGE_MM_S: std::ops::RangeInclusive<f64> = 0.25..=58.0;

/// The set-point of the command.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Request {
    Position { opening_mm: f64, speed_mm_s: f64, is_uncalibrated: bool },
    Force { set_n: f64, command: Command },
    Foot(FootContact),
    Release { opening_mm: f64 },
}

impl Request {
    fn of(args: &Args) -> Result<Self> {
        if let Some(opening_mm) = args.release {
            let opening_mm = opening_mm.unwrap_or(constants::STROKE.value - MARGIN_MM);
            check_opening("--release", opening_mm, MARGIN_MM)?;
            return Ok(Self::Release { opening_mm });
        }
        if args.foot.flatten().is_some() {
            bail!("--foot takes no force with --port or --can");
        }
        if args.foot.is_some() {
            return Ok(Self::Foot(args.contact));
        }
        if let Some(set_n) = args.force {
            check_force(set_n)?;
            return Ok(Self::Force { set_n, command: grip(args, set_n)? });
        }
        let Some(opening_mm) = args.position else {
            bail!("--speed without --position is possible in the simulation only");
        };
        check_opening("--position", opening_mm, CLOSED_MM)?;
        let speed_mm_s = checked_speed(args)?.unwrap_or(DEFAULT_SPEED_MM_S);
        Ok(Self::Position { opening_mm, speed_mm_s, is_uncalibrated: args.uncalibrated })
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

/// The speed that is given, if it is possible.
fn checked_speed(args: &Args) -> Result<Option<f64>> {
    if let Some(speed_mm_s) = args.speed.filter(|mm_s| !SPEED_RANGE_MM_S.contains(mm_s)) {
        let (min, max) = (SPEED_RANGE_MM_S.start(), SPEED_RANGE_MM_S.end());
        bail!("--speed {speed_mm_s:?} is not possible here; give {min} to {max} mm/s");
    }
    Ok(args.speed)
}

/// Command of a grasp.
fn grip(args: &Args, set_n: f64) -> Result<Command> {
    let mut command = grip_command(set_n);
    if let Some(profile) = args.profile {
        let (bits, limits) = match profile {
            Profile::Normal => (0, GripProfile::Normal),
            Profile::Fragile => (1, GripProfile::Fragile),
            Profile::Strong => (2, GripProfile::Strong),
        };
        let max_n = f64::from(limits.max_n());
        if set_n > max_n {
            bail!("--force {set_n:?} is not possible with this --profile; give up to {max_n} N");
        }
        command.flags = bits;
    }
    if let Some(WidthArg { width_mm, window }) = args.width {
        command.position = counts("position", width_mm) as u16;
        command.flags |= window << flag::WINDOW.trailing_zeros();
    }
    if args.fast {
        command.flags |= flag::FAST;
    }
    command.speed = checked_speed(args)?.map_or(0, |mm_s| counts("speed", mm_s) as u8);
    Ok(command)
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

pub(super) fn run(args: &Args) -> Result<()> {
    if args.stop {
        return stop(args);
    }
    let request = Request::of(args)?;
    let (lines, printed) = channel();
    let session = Session::open(args, lines)?;
    session.print(format!(
        "warning: the gripper at {} moves: keep hands clear of the fingers; Ctrl-C ends the motion and opens a grasp of \
         this command, a second one is an emergency stop",
        session.client.name()
    ));
    // A terminal that is paused, or a full pipe, must not delay the commands that keep the gripper alive.
    let (page, error) = thread::scope(|scope| {
        let control = scope.spawn(move || session.run(args, request));
        for line in printed {
            if args.json_lines {
                // As on stderr, a closed pipe ends the output only.
                let _ = writeln!(std::io::stdout(), "{line}");
            } else {
                eprintln!("{line}");
            }
        }
        control.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    });
    terminal::print(&page)?;
    error.map_or(Ok(()), Err)
}

/// Stops the gripper; needs no session.
fn stop(args: &Args) -> Result<()> {
    let (lines, _) = channel();
    let mut session = Session::open(args, lines)?;
    session.is_shutting_down = true;
    session.connect(args)?;
    session.client.stop()?;
    let is_stopped = |session: &Session| !session.task().is_some_and(TaskState::moves);
    if session.wait(STOP_S, is_stopped)? != WaitResult::Done {
        return Err(ResultCode::Fault.error("the gripper still moves: switch its supply off"));
    }
    let state = session.code().map_or_else(String::new, format::state_name);
    terminal::print_result(
        args.json,
        || json!({ "stopped": true, "state": state }),
        || {
            format!(
                "The gripper has stopped, state: {state}. The stop is latched; to open the fingers:\n  \
                 cargo magpie grasp {} --release --clear-faults\n",
                args.port.words()
            )
        },
    )
}
