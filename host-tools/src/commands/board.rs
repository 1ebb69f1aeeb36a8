//! `magpie board`: shows which calibration runs on a gripper, and what was measured of its drive; commands that configure it.

use std::time::{Duration, Instant};

use anyhow::Result;
use device::calibration_client::{self, RunningCalibration};
use device::format::state_name;
use device::params_client;
use device::source::Source;
use device::state::GripperState;
use firmware::estimator::Validity;
use firmware::parameters::schema::{counter, id};
use report::text::terminal;
use serde_json::json;

use crate::commands::connection::PortArgs;
use crate::commands::{bringup, identify, key, parameter, tare};

/// Show calibration and state; tare, measure, set parameters and key; bring a board up.
///
/// Without a command: hash, campaign, date and effects of the calibration, what it cannot compensate at present, and whether motor
/// and screw were measured.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "\
Examples:
  cargo magpie board --port /dev/ttyACM0
  cargo magpie board --can can0 --json
  cargo magpie board tare --port /dev/ttyACM0"
)]
pub struct Args {
    #[command(subcommand)]
    command: Option<BoardCommand>,
    #[command(flatten)]
    port: PortArgs,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum BoardCommand {
    Bringup(bringup::Args),
    Tare(tare::Args),
    Identify(identify::Args),
    Parameter(parameter::Args),
    Key(key::Args),
}

/// Time in which the gripper sends the forces of all sensors.
const FORCES: Duration = Duration::from_millis(300);
/// Limit of the wait for a heartbeat, with a margin for slow emulations.
const HEARTBEAT: Duration = Duration::from_secs(3);

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    match &args.command {
        Some(BoardCommand::Bringup(args)) => bringup::run(args),
        Some(BoardCommand::Tare(args)) => tare::run(args),
        Some(BoardCommand::Identify(args)) => identify::run(args),
        Some(BoardCommand::Parameter(args)) => parameter::run(args),
        Some(BoardCommand::Key(args)) => key::run(args),
        None => show(args),
    }
}

fn show(args: &Args) -> Result<()> {
    let mut source = args.port.open_given()?;
    let running = calibration_client::running(source.as_mut())?;
    let state = observe(source.as_mut())?;
    let incomplete = incomplete_sensors(&state);
    let is_commissioned = params_client::read(source.as_mut(), id::COMMISSIONED)? == 1;
    let screw = match params_client::read(source.as_mut(), id::SELF_LOCKING)? {
        1 => "self-locking",
        2 => "backdrivable",
        _ => "unknown",
    };
    let is_on_bench = params_client::read(source.as_mut(), id::BENCH)? == 1;
    let [chip, options, reset] = [counter::CHIP, counter::OPTION_BYTES, counter::RESET_CAUSE]
        .map(|id| params_client::read(source.as_mut(), id).map(|value| value as u32));
    let [chip, options, reset] = [chip?, options?, reset?];
    terminal::print_result(
        args.json,
        || {
            json!({
                "bench": is_on_bench,
                "chip": format!("{chip:08x}"),
                "option_bytes": format!("{options:08x}"),
                "reset_flags": format!("{reset:08x}"),
                "calibration": running,
                "missing_inputs": incomplete,
                "motor": if is_commissioned { "measured" } else { "assumed" },
                "screw": screw,
                "state": state.heartbeat.map(|latest| state_name(latest.value.state)),
                "stopped": state.is_stopped(),
                "unprotected": state.heartbeat.map(|latest| latest.value.unprotected),
            })
        },
        || {
            text(&running, &incomplete)
                + &drive_text(is_commissioned, is_on_bench, screw)
                + &format!(
                    "chip         {chip:08x}, option bytes {options:08x}, reset flags {reset:08x}\n"
                )
                + key_text(&state)
                + &state_text(&state)
        },
    )
}

fn drive_text(is_commissioned: bool, is_on_bench: bool, screw: &str) -> String {
    let motor = if is_commissioned {
        "measured"
    } else {
        "assumed constants, not measured (`cargo magpie board identify motor`)"
    };
    let screw = match screw {
        "unknown" => "unknown, treated as backdrivable (`cargo magpie board identify screw`)",
        known => known,
    };
    let limits = if is_on_bench {
        "of the bench: 2 A, 10 mm/s, 20 N (`cargo magpie board bringup`)"
    } else {
        "of the gripper"
    };
    format!("motor        {motor}\nscrew        {screw}\nlimits       {limits}\n")
}

fn state_text(state: &GripperState) -> String {
    let Some(beat) = &state.heartbeat else { return String::new() };
    let stopped = match beat.value.stopped {
        true => "; a stop is latched (`cargo magpie grasp` with --clear-faults)",
        false => "",
    };
    format!("state        {}{stopped}\n", state_name(beat.value.state))
}

fn key_text(state: &GripperState) -> &'static str {
    match state.heartbeat {
        Some(latest) if latest.value.unprotected => {
            "key          none: everybody on the bus can move the gripper (`cargo magpie board key --help`)\n"
        }
        Some(_) => "key          stored\n",
        None => "key          unknown: no heartbeat\n",
    }
}

/// Observes the gripper until it has sent all forces and a heartbeat.
fn observe(source: &mut dyn Source) -> Result<GripperState> {
    let mut state = GripperState::default();
    let begun = Instant::now();
    while begun.elapsed() < if state.heartbeat.is_some() { FORCES } else { HEARTBEAT } {
        let mut packets = Vec::new();
        if !source.receive(&mut packets)? {
            break;
        }
        let now_s = begun.elapsed().as_secs_f64();
        packets.iter().for_each(|packet| state.update(now_s, packet));
    }
    Ok(state)
}

/// Sensors whose forces are at present not compensated for an effect, for lack of an input.
fn incomplete_sensors(state: &GripperState) -> Vec<usize> {
    let sensors = state.sensors.iter().enumerate();
    sensors
        .filter(|(_, sensor)| sensor.validity == Validity::MissingInputs)
        .map(|(number, _)| number)
        .collect()
}

fn text(running: &RunningCalibration, incomplete: &[usize]) -> String {
    let mut text = running.text();
    if !incomplete.is_empty() {
        let sensors: Vec<String> = incomplete.iter().map(usize::to_string).collect();
        let conditions = running.description.iter().flat_map(|known| &known.conditions);
        let possible: Vec<&str> = conditions.map(|(effect, _)| effect.as_str()).collect();
        text += &format!(
            "now          not compensated at sensor {}: {}\n",
            sensors.join(", "),
            if possible.is_empty() {
                "an effect, for lack of an input".to_owned()
            } else {
                format!("{}, for lack of an input (conditions above)", possible.join(" or "))
            }
        );
    }
    text
}
