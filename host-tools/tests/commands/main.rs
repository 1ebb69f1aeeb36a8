//! The command line of `magpie` and the commands without a campaign of their own in `tests/data`.

mod bounded_input;
mod command_line;
mod dbc;
mod design;
mod disturbance;
mod generated_text;
mod grasp;
mod other_protocol;
mod readme_tutorial;
mod session_rules;
mod simulate;
#[cfg(unix)]
mod tutorials;
#[cfg(unix)]
mod workbench;
#[cfg(unix)]
mod workbench_import;
#[path = "../workdir/mod.rs"]
mod workdir;
