//! The command line: one module for each command; [`args`] and [`connection`] are shared by several.

pub mod args;
pub mod bench;
pub mod benchmark;
pub mod board;
pub mod bringup;
pub mod compare;
pub mod connection;
pub mod dbc;
pub mod demo;
pub mod design;
pub mod diagnose;
pub mod edit_model;
pub mod effects;
pub mod emulate;
pub mod export;
pub mod fault_campaign;
pub mod fit;
pub mod grasp;
pub mod identify;
pub mod import;
pub mod key;
pub mod monitor;
pub mod parameter;
pub mod record;
pub mod replay;
pub mod shell;
pub mod simulate;
pub mod tare;
pub mod train;
pub mod upload;
pub mod workbench;

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use analysis::notes::{ErrorWithNotes, Note};
use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use device::control::result_code::ResultCode;
use firmware::sensors::hall::SENSORS;
use model_export::inverse::build::{DeviceModel, ExportHeader};
use signal_hook::consts::SIGINT;

/// Calibrates Hall-effect force sensors of a robot gripper, diagnoses missing physical effects, and operates the
/// gripper.
#[derive(Debug, Parser)]
#[command(name = "magpie", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Fit(fit::Args),
    Compare(compare::Args),
    Diagnose(diagnose::Args),
    Workbench(workbench::Args),
    Import(import::Args),
    Effects(effects::Args),
    Add(edit_model::AddArgs),
    #[command(alias = "drop")]
    Remove(edit_model::RemoveArgs),
    Export(export::Args),
    Upload(upload::Args),
    Board(board::Args),
    Bringup(bringup::Args),
    Tare(tare::Args),
    Identify(identify::Args),
    Parameter(parameter::Args),
    Key(key::Args),
    Replay(replay::Args),
    Simulate(simulate::Args),
    Train(train::Args),
    Benchmark(benchmark::Args),
    Monitor(monitor::Args),
    Record(record::Args),
    Emulate(emulate::Args),
    Bench(bench::Args),
    Dbc(dbc::Args),
    #[command(alias = "grip")]
    Grasp(grasp::Args),
    Design(design::Args),
    #[command(alias = "faults")]
    FaultCampaign(fault_campaign::Args),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

/// The parser of the command line.
pub fn parser() -> clap::Command {
    Cli::command()
}

/// Runs a command. Errors are printed on stderr as one sentence.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(replace_former_name(arguments)) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    let result = match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Fit(args) => fit::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Diagnose(args) => diagnose::run(&args),
        Command::Workbench(args) => workbench::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Effects(args) => effects::run(&args),
        Command::Add(args) => edit_model::run_add(&args),
        Command::Remove(args) => edit_model::run_remove(&args),
        Command::Export(args) => export::run(&args),
        Command::Upload(args) => upload::run(&args),
        Command::Board(args) => board::run(&args),
        Command::Bringup(args) => bringup::run(&args),
        Command::Tare(args) => tare::run(&args),
        Command::Identify(args) => identify::run(&args),
        Command::Parameter(args) => parameter::run(&args),
        Command::Key(args) => key::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Benchmark(args) => benchmark::run(&args),
        Command::Monitor(args) => monitor::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Emulate(args) => emulate::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Dbc(args) => dbc::run(&args),
        Command::Grasp(args) => grasp::run(&args),
        Command::Design(args) => design::run(&args),
        Command::FaultCampaign(args) => fault_campaign::run(&args),
        Command::Completions(args) => shell::run_completions(&args),
        Command::Man(args) => shell::run_man(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if let Some(error) = error.downcast_ref::<ErrorWithNotes>() {
                print_notes(&error.notes);
            }
            eprintln!("magpie: {error:#}");
            ExitCode::from(ResultCode::of(&error).status())
        }
    }
}

/// Exit status of a process that Ctrl-C ended.
const INTERRUPTED: i32 = ResultCode::Interrupted.status() as i32;

/// A flag that the first Ctrl-C sets; the second ends the process.
fn first_interrupt() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let context = "cannot install the handler for Ctrl-C";
    // In this order: the first one only arms the end.
    signal_hook::flag::register_conditional_shutdown(SIGINT, INTERRUPTED, flag.clone())
        .context(context)?;
    signal_hook::flag::register(SIGINT, flag.clone()).context(context)?;
    Ok(flag)
}

/// Prints notes on stderr.
fn print_notes(notes: &[Note]) {
    for note in notes {
        eprintln!("note: {}", report::text::notes::text(note));
    }
}

/// Refuses a model with an effect that the device never compensates; `command` can override that.
///
/// # Errors
/// There is one; the error has the reason.
fn check_compensated(built: &DeviceModel, command: &str) -> anyhow::Result<()> {
    let remedy = format!(
        "remove it from the model (`cargo magpie remove`), or {command} with --uncompensated"
    );
    analysis::notes::check_compensated(built, &remedy)
}

/// Prints on stderr under which conditions the board compensates the effects of a model.
fn print_conditions(built: &DeviceModel) {
    if let Some(state) = &built.header.valid_from {
        eprintln!(
            "note: the tables hold the gripper's state of {state}: calibrate again after further changes"
        );
    }
    for (effect, conditions) in &built.conditions {
        eprintln!("note: the board compensates {effect} {}", conditions.join("; "));
    }
}

/// States that the board reads sensors that the tables do not have.
fn print_missing_sensors(header: &ExportHeader) {
    let image: Vec<u32> = (0..SENSORS as u32).collect();
    if header.sensors != image {
        eprintln!(
            "note: the board reads sensors {image:?}, these tables have {:?}: it reports the forces of the others as missing",
            header.sensors
        );
    }
}

/// Replaces `train --table`, the former name of `benchmark`.
fn replace_former_name(arguments: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    if arguments.get(1).is_some_and(|command| command == "train")
        && let Some(table) = arguments.iter().position(|argument| argument == "--table")
    {
        arguments.remove(table);
        arguments[1] = "benchmark".into();
    }
    arguments
}
