//! `magpie`: see [`host_tools`].

use std::process::ExitCode;

fn main() -> ExitCode {
    host_tools::commands::run(std::env::args_os())
}
