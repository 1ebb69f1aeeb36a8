//! Commands to a gripper on a serial line or CAN bus. The session has its own thread, which no output delays.

use std::io::Write;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::channel;
use std::thread;

use anyhow::{Result, bail};
use device::control::log::LineFormat;
use device::control::outcome::Outcome;
use device::control::session::Session;
use device::control::{Request, SessionOptions};
use device::params_client;
use firmware::config::limits::GripLimits;
use firmware::grip::commands::GripProfile;
use firmware::parameters::schema::id;
use report::text::terminal;
use serde_json::json;

use crate::commands::grasp::args::{Args, Profile};
use crate::commands::interrupt::{end_on_interrupt, interrupted};

fn request(args: &Args) -> Result<Request> {
    if let Some(opening_mm) = args.release {
        return Request::release(opening_mm);
    }
    if args.foot.flatten().is_some() {
        bail!("--foot takes no force with --port or --can");
    }
    if args.foot.is_some() {
        return Ok(Request::Foot(args.contact));
    }
    if let Some(set_n) = args.force {
        let profile = args.profile.map(|profile| match profile {
            Profile::Fragile => GripProfile::Fragile,
            Profile::Normal => GripProfile::Normal,
            Profile::Strong => GripProfile::Strong,
        });
        return Request::force(set_n, profile, args.speed, args.window());
    }
    let Some(opening_mm) = args.position else {
        bail!("--speed without --position is possible in the simulation only");
    };
    Request::position(opening_mm, args.speed, args.uncalibrated)
}

pub(super) fn run(args: &Args) -> Result<()> {
    if args.stop {
        return stop(args);
    }
    let request = request(args)?;
    let mut session = session(args)?;
    let format = match (args.json, args.json_lines) {
        (true, _) => LineFormat::None,
        (false, true) => LineFormat::Json,
        (false, false) => LineFormat::Text,
    };
    // The session has the only sender: its end is that of the lines.
    let (lines, printed) = channel();
    session.log.print_to(lines, format);
    session.log.note(&format!(
        "warning: the gripper at {} moves: keep hands clear of the fingers; Ctrl-C ends the motion and opens a grasp of this \
         command, a second one is an emergency stop",
        session.client.name()
    ));
    let ended = end_on_interrupt()?;
    // A terminal that is paused, or a full pipe, must not delay the commands that keep the gripper alive.
    let outcome = thread::scope(|scope| {
        let control = scope.spawn(|| {
            let outcome = session.run(request);
            ended.store(true, Relaxed);
            outcome
        });
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
    terminal::print(&match format {
        LineFormat::None => format!("{}\n", outcome.json()),
        LineFormat::Json => outcome.result_line(),
        LineFormat::Text => text(args, &outcome),
    })?;
    outcome.error.map_or(Ok(()), Err)
}

fn session(args: &Args) -> Result<Session> {
    let options = SessionOptions {
        home: args.home,
        clear_faults: args.clear_faults,
        hold_s: args.seconds,
        keep: args.keep,
    };
    let mut source = args.port.open_given()?;
    // Older firmware has no such limits; a gripper that does not answer is reported by the session.
    if args.force.is_some_and(|force_n| force_n > f64::from(GripLimits::BENCH_N))
        && params_client::read(source.as_mut(), id::BENCH).is_ok_and(|bench| bench == 1)
    {
        let port = args.port.words();
        bail!(
            "{}: the gripper grips with at most {} N, as its bring-up is not signed off: `cargo magpie board bringup {port}`; \
             to do without, `cargo magpie board parameter bench 0 {port} --save` and restart it",
            source.name(),
            GripLimits::BENCH_N
        );
    }
    Ok(Session::new(source, args.port.credentials()?, options, interrupted()?))
}

/// Result of a session as text; empty after an error, which has its own.
fn text(args: &Args, outcome: &Outcome) -> String {
    if outcome.is_left_gripped {
        eprintln!(
            "note: {} stays gripped; `cargo magpie grasp {} --release` opens the fingers",
            if args.keep { "the object" } else { "an object that was gripped before this command" },
            args.port.words()
        );
    }
    if outcome.error.is_some() { String::new() } else { outcome.text() }
}

/// Stops the gripper; needs no session.
fn stop(args: &Args) -> Result<()> {
    let state = session(args)?.stop()?;
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
