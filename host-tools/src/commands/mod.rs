//! The command line: one module for each command; [`args`], [`connection`], [`interrupt`] and [`output`] are shared by several.

pub mod args;
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
pub mod fit;
pub mod grasp;
pub mod identify;
pub mod import;
pub mod interrupt;
pub mod key;
pub mod monitor;
pub mod output;
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

use analysis::notes::ErrorWithNotes;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use device::control::result_code::ResultCode;

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
    Import(import::Args),
    Fit(fit::Args),
    Compare(compare::Args),
    Diagnose(diagnose::Args),
    Add(edit_model::AddArgs),
    Remove(edit_model::RemoveArgs),
    Replay(replay::Args),
    Train(train::Args),
    Workbench(workbench::Args),
    Simulate(simulate::Args),
    Board(board::Args),
    Upload(upload::Args),
    Record(record::Args),
    Monitor(monitor::Args),
    Grasp(grasp::Args),
    Design(design::Args),
    #[command(hide = true)]
    Effects(effects::Args),
    #[command(
        subcommand,
        hide = true,
        about = "Commands for developers",
        arg_required_else_help = true
    )]
    Dev(DevCommand),
}

#[derive(Debug, Subcommand)]
enum DevCommand {
    Export(export::Args),
    Emulate(emulate::Args),
    Dbc(dbc::Args),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

/// Groups of the list of commands.
const GROUPS: [(&str, &[&str]); 4] = [
    (
        "Analyse data",
        &[
            "demo",
            "import",
            "fit",
            "compare",
            "diagnose",
            "add",
            "remove",
            "replay",
            "train",
            "workbench",
        ],
    ),
    ("Simulate", &["simulate"]),
    ("Operate a gripper", &["board", "upload", "record", "monitor", "grasp"]),
    ("Design a sensor", &["design"]),
];

/// Former name of a command, and its group now.
const MOVED: [(&str, &str); 10] = [
    ("bringup", "board"),
    ("identify", "board"),
    ("key", "board"),
    ("parameter", "board"),
    ("tare", "board"),
    ("completions", "dev"),
    ("dbc", "dev"),
    ("emulate", "dev"),
    ("export", "dev"),
    ("man", "dev"),
];

/// Former name of a command that became an acceptance run, and this run.
const ACCEPTANCE_RUNS: [(&str, &str); 3] = [
    ("bench", "calibration"),
    ("benchmark", "force-estimators"),
    ("fault-campaign", "fault-campaign"),
];

/// The parser of the command line.
pub fn parser() -> clap::Command {
    let cli = Cli::command();
    let mut list = String::new();
    for (heading, names) in GROUPS {
        list += &format!("{heading}:\n");
        for command in names.iter().filter_map(|name| cli.find_subcommand(name)) {
            let about = command.get_about().map(ToString::to_string).unwrap_or_default();
            list += &format!("  {:<10} {about}\n", command.get_name());
        }
        list.push('\n');
    }
    list += "magpie effects: the catalogue of physical effects. magpie dev: commands for developers.\n\
             magpie COMMAND --help: options and examples of a command.";
    cli.help_template("{about-with-newline}\n{usage-heading} {usage}{after-help}").after_help(list)
}

/// Runs a command. Errors are printed on stderr as one sentence.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let mut arguments: Vec<OsString> = arguments.into_iter().collect();
    let is_first = |name: &str| arguments.get(1).is_some_and(|argument| argument == name);
    if let Some((name, run)) = ACCEPTANCE_RUNS.into_iter().find(|(name, _)| is_first(name)) {
        eprintln!("magpie: `{name}` is now an acceptance run: cargo acceptance {run}");
        return ExitCode::from(USAGE_ERROR);
    }
    if let Some((name, group)) = MOVED.into_iter().find(|(name, _)| is_first(name)) {
        eprintln!("note: `magpie {name}` is now `magpie {group} {name}`");
        arguments.insert(1, group.into());
    }
    let matches = parser().try_get_matches_from(arguments);
    let cli = match matches.and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    match execute(&cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if let Some(error) = error.downcast_ref::<ErrorWithNotes>() {
                output::print_notes(&error.notes);
            }
            eprintln!("magpie: {error:#}");
            ExitCode::from(ResultCode::of(&error).status())
        }
    }
}

fn execute(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Demo(args) => demo::run(args),
        Command::Import(args) => import::run(args),
        Command::Fit(args) => fit::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Diagnose(args) => diagnose::run(args),
        Command::Add(args) => edit_model::run_add(args),
        Command::Remove(args) => edit_model::run_remove(args),
        Command::Replay(args) => replay::run(args),
        Command::Train(args) => train::run(args),
        Command::Workbench(args) => workbench::run(args),
        Command::Simulate(args) => simulate::run(args),
        Command::Board(args) => board::run(args),
        Command::Upload(args) => upload::run(args),
        Command::Record(args) => record::run(args),
        Command::Monitor(args) => monitor::run(args),
        Command::Grasp(args) => grasp::run(args),
        Command::Design(args) => design::run(args),
        Command::Effects(args) => effects::run(args),
        Command::Dev(DevCommand::Export(args)) => export::run(args),
        Command::Dev(DevCommand::Emulate(args)) => emulate::run(args),
        Command::Dev(DevCommand::Dbc(args)) => dbc::run(args),
        Command::Dev(DevCommand::Completions(args)) => shell::run_completions(args, parser()),
        Command::Dev(DevCommand::Man(args)) => shell::run_man(args, parser()),
    }
}

/// Exit status of wrong arguments, as of the parser.
const USAGE_ERROR: u8 = 2;
