//! The commands and their arguments.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::commands::{
    add, compare, dbc, demo, design, diagnose, drop, effects, emulate, export, faults, fit, grip,
    import, monitor, record, replay, simulate, train,
};

/// Turns four Hall sensors in a robot gripper into forces one can trust, and tells which piece of
/// physics the model still lacks.
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
    Import(import::Args),
    Effects(effects::Args),
    Add(add::Args),
    Drop(drop::Args),
    Export(export::Args),
    Replay(replay::Args),
    Simulate(simulate::Args),
    Train(train::Args),
    Monitor(monitor::Args),
    Record(record::Args),
    Emulate(emulate::Args),
    Dbc(dbc::Args),
    Grip(grip::Args),
    Design(design::Args),
    Faults(faults::Args),
}

/// Runs one command; errors go to stderr as one sentence.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    let result = match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Fit(args) => fit::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Diagnose(args) => diagnose::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Effects(args) => effects::run(&args),
        Command::Add(args) => add::run(&args),
        Command::Drop(args) => drop::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Monitor(args) => monitor::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Emulate(args) => emulate::run(&args),
        Command::Dbc(args) => dbc::run(&args),
        Command::Grip(args) => grip::run(&args),
        Command::Design(args) => design::run(&args),
        Command::Faults(args) => faults::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("magpie: {error:#}");
            ExitCode::FAILURE
        }
    }
}
