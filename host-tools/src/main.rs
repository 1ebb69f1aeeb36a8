//! `magpie`: see [`host_tools`].

use std::process::ExitCode;

/// Each step of a fit allocates and releases tens of megabytes. The system's allocator returns them each time, and the pages are
/// cleared again: a third of the time of `add` with six effects.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    host_tools::commands::run(std::env::args_os())
}
