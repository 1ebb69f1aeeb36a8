//! `magpie monitor`: a gripper watched while it runs.

use std::io::{ErrorKind, IsTerminal, Write, stdout};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use anyhow::{Result, bail};
use firmware::session::op;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};

use super::live::{Gripper, check_language, interrupted, parse_seconds};
use crate::live::hearing::{Hearing, News};
use crate::live::session::service;
use crate::live::state::State;
use crate::live::{json, view, words};

/// Watch a gripper while it runs: forces, faults, load.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie monitor --port /dev/ttyACM0
  cargo magpie monitor --can can0 --node 16
  cargo magpie monitor --can 127.0.0.1:29536    # of magpie emulate, or socketcand
  cargo magpie monitor --virtual    # without hardware
  cargo magpie monitor --virtual --unplug 2@5 --seconds 10 | cat
  cargo magpie monitor --port /dev/ttyACM0 --json | jq '.sensors[0].fx_n'

On a terminal it draws; q ends it. Otherwise it prints a line a second. --json prints an object ten times a
second: newtons, seconds since it began (time_s) and since the board's start (board_s). A standard deviation
is told where a network runs on the gripper.")]
pub struct Args {
    #[command(flatten)]
    gripper: Gripper,
    /// End after this time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Print one JSON object a line on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Time between two drawings, objects and lines.
const DRAW_S: f64 = 0.05;
const OBJECT_S: f64 = 0.1;
const LINE_S: f64 = 1.0;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let mut source = args.gripper.open()?;
    // It answers with what it runs; where it cannot be asked it is still heard.
    let _ = source.say(service(op::VERSION, 0));
    let name = source.name();
    let hearing = Hearing::start(source);
    let end_s = args.seconds.unwrap_or(f64::INFINITY);
    let result = match (args.json, stdout().is_terminal()) {
        (true, _) => watch(&hearing, end_s, OBJECT_S, |state, now_s| {
            print(&json::object(state, now_s).to_string())
        }),
        (false, true) => {
            let mut terminal = ratatui::try_init()?;
            let result = watch(&hearing, end_s, DRAW_S, |state, now_s| {
                draw(&mut terminal, &name, state, now_s)
            });
            ratatui::restore();
            result
        }
        (false, false) => {
            print(&words::head())?;
            watch(&hearing, end_s, LINE_S, |state, now_s| {
                print(&words::line(state, now_s))
            })
        }
    };
    hearing.stop()?;
    let state = result?;
    if state.heard_s.is_none() {
        bail!(
            "{name}: nothing was heard; is it this line or bus, is the board supplied, and does its firmware run?"
        );
    }
    if let Some(lost) = words::lost(&state) {
        eprintln!("lost: {lost}");
    }
    Ok(())
}

/// Shows the state every so often until the time is over, somebody has seen enough, or nothing more comes.
fn watch(
    hearing: &Hearing,
    end_s: f64,
    every_s: f64,
    mut show: impl FnMut(&State, f64) -> Result<bool>,
) -> Result<State> {
    let interrupted = interrupted()?;
    let mut state = State::default();
    let mut due_s = every_s;
    loop {
        let now_s = hearing.elapsed_s();
        if now_s >= due_s {
            due_s += every_s * ((now_s - due_s) / every_s + 1.0).floor();
            if !show(&state, now_s)? {
                return Ok(state);
            }
        }
        if now_s >= end_s || interrupted.load(Relaxed) {
            return Ok(state);
        }
        let wait_s = (due_s.min(end_s) - now_s).clamp(0.0, 0.1);
        match hearing.news.recv_timeout(Duration::from_secs_f64(wait_s)) {
            Ok(News::Heard {
                at_s,
                packets,
                broken,
            }) => {
                state.lost.broken = broken;
                packets.iter().for_each(|packet| state.take(at_s, packet));
                check_language(&state)?;
            }
            Ok(News::Failed(error)) => return Err(error),
            Ok(News::Ended) | Err(RecvTimeoutError::Disconnected) => {
                show(&state, hearing.elapsed_s())?;
                return Ok(state);
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Prints a line; false where nobody reads any more.
fn print(line: &str) -> Result<bool> {
    let mut out = stdout().lock();
    match writeln!(out, "{line}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        result => Ok(result.map(|()| true)?),
    }
}

/// Draws; false where somebody has seen enough.
fn draw(terminal: &mut DefaultTerminal, name: &str, state: &State, now_s: f64) -> Result<bool> {
    terminal.draw(|frame| view::draw(frame, name, state, now_s))?;
    while event::poll(Duration::ZERO)? {
        if let Event::Key(key) = event::read()? {
            let ended = match key.code {
                KeyCode::Char('q') | KeyCode::Esc => true,
                KeyCode::Char('c') => key.modifiers.contains(KeyModifiers::CONTROL),
                _ => false,
            };
            if ended {
                return Ok(false);
            }
        }
    }
    Ok(true)
}
