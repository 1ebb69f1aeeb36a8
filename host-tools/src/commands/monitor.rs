//! `magpie monitor`: live display of a running gripper.

use std::io::{ErrorKind, IsTerminal, Write, stdout};
use std::net::SocketAddr;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use anyhow::Result;
use firmware::protocol::session::op;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};

use crate::commands::connection::{GripperArgs, parse_seconds, print_unprotected};
use crate::commands::interrupt::interrupted;
use device::foxglove::FoxgloveServer;
use device::reader::{ReaderEvent, SourceReader};
use device::session::check_protocol;
use device::source::{ConnectionLost, SILENCE};
use device::state::GripperState;
use device::{format, view};
use firmware::protocol::host_session::service;

/// Display forces, faults and load of a running gripper.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie monitor --port /dev/ttyACM0
  cargo magpie monitor --can can0 --node 16
  cargo magpie monitor --can 127.0.0.1:29536    # cargo magpie dev emulate or socketcand
  cargo magpie monitor --virtual    # without hardware
  cargo magpie monitor --virtual --unplug 2@5 --seconds 10 | cat
  cargo magpie monitor --port /dev/ttyACM0 --json | jq '.sensors[0].fx_n'
  # for Foxglove: open ws://127.0.0.1:8765, import the layout host-tools/foxglove/gripper.json
  cargo magpie monitor --port /dev/ttyACM0 --foxglove

On a terminal it draws a live view (q quits), otherwise it prints one line per second. --json prints ten objects \
per second: newtons, seconds since the start of the command (time_s) and of the board (board_s). Standard \
deviations are present if a network runs on the gripper.")]
pub struct Args {
    #[command(flatten)]
    gripper: GripperArgs,
    /// End after this time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Serve readings, estimates, covariates and state to Foxglove too, over its WebSocket protocol, at this address
    /// [default: 127.0.0.1:8765]; the topics are those of `record --mcap`.
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    foxglove: Option<SocketAddr>,
    /// Host name or origin that may connect too, such as gripper.lab or `https://foxglove.lab`; may be given several times. Without
    /// it these are this machine, the address that it listens on, and Foxglove.
    #[arg(long, value_name = "NAME", requires = "foxglove")]
    foxglove_allow: Vec<String>,
    /// Print one JSON object per line on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Periods of the live view, of JSON objects and of lines.
const DRAW_S: f64 = 0.05;
const OBJECT_S: f64 = 0.1;
const LINE_S: f64 = 1.0;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let mut source = args.gripper.open()?;
    // Requests the version; a listen-only connection still receives data.
    let _ = source.send(service(op::VERSION, 0));
    let name = source.name();
    let mut server = args
        .foxglove
        .map(|at| FoxgloveServer::start(&name, at, &args.foxglove_allow))
        .transpose()?;
    if let (Some(server), Some(at)) = (&server, args.foxglove) {
        eprintln!("Foxglove: open the connection ws://{}:{}", at.ip(), server.port());
    }
    let hearing = SourceReader::start(source);
    let end_s = args.seconds.unwrap_or(f64::INFINITY);
    let result = match (args.json, stdout().is_terminal()) {
        (true, _) => watch(&hearing, &mut server, end_s, OBJECT_S, |state, now_s| {
            print(&format::state_json(state, now_s).to_string())
        }),
        (false, true) => {
            let mut terminal = ratatui::try_init()?;
            let result = watch(&hearing, &mut server, end_s, DRAW_S, |state, now_s| {
                draw(&mut terminal, &name, state, now_s)
            });
            ratatui::restore();
            result
        }
        (false, false) => {
            print(&format::status_header())?;
            watch(&hearing, &mut server, end_s, LINE_S, |state, now_s| {
                print(&format::status_line(state, now_s))
            })
        }
    };
    let ended_s = hearing.elapsed_s();
    hearing.stop()?;
    let state = result?;
    if state.received_s.is_none() {
        return Err(ConnectionLost::unreachable(&name).into());
    }
    if state.is_unprotected() && !args.json {
        print_unprotected(&name);
    }
    if let Some(lost) = format::loss_line(&state) {
        eprintln!("lost: {lost}");
    }
    if let Some(stranger) = format::stranger_line(&state) {
        eprintln!("note: {stranger}");
    }
    if state.received_s.is_some_and(|received_s| ended_s - received_s > SILENCE.as_secs_f64()) {
        return Err(ConnectionLost::silent(&name).into());
    }
    Ok(())
}

/// Publishes packets on the `server`, and calls `show` periodically until the time limit, Ctrl-C, `show` returning false, or the end of the stream.
fn watch(
    hearing: &SourceReader,
    server: &mut Option<FoxgloveServer>,
    end_s: f64,
    period_s: f64,
    mut show: impl FnMut(&GripperState, f64) -> Result<bool>,
) -> Result<GripperState> {
    let interrupted = interrupted()?;
    let mut state = GripperState::default();
    let mut due_s = period_s;
    loop {
        let now_s = hearing.elapsed_s();
        if now_s >= due_s {
            due_s += period_s * ((now_s - due_s) / period_s + 1.0).floor();
            if !show(&state, now_s)? {
                return Ok(state);
            }
        }
        if now_s >= end_s || interrupted.load(Relaxed) {
            return Ok(state);
        }
        let wait_s = (due_s.min(end_s) - now_s).clamp(0.0, 0.1);
        match hearing.news.recv_timeout(Duration::from_secs_f64(wait_s)) {
            Ok(ReaderEvent::Packets { at_s, packets, broken }) => {
                state.lost.broken = broken;
                for packet in &packets {
                    state.update(at_s, packet);
                    if let Some(server) = server {
                        server.publish(at_s, packet, &state)?;
                    }
                }
                check_protocol(&state)?;
            }
            Ok(ReaderEvent::Failed(error)) => return Err(error),
            Ok(ReaderEvent::Ended) | Err(RecvTimeoutError::Disconnected) => {
                show(&state, hearing.elapsed_s())?;
                return Ok(state);
            }
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Prints a line; false if the pipe is closed.
fn print(line: &str) -> Result<bool> {
    let mut out = stdout().lock();
    match writeln!(out, "{line}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        result => Ok(result.map(|()| true)?),
    }
}

/// Draws the live view; false if the user quits.
fn draw(
    terminal: &mut DefaultTerminal,
    name: &str,
    state: &GripperState,
    now_s: f64,
) -> Result<bool> {
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
