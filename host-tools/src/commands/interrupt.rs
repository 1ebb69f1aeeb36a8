//! How Ctrl-C and SIGTERM end a command.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use device::control::result_code::ResultCode;
use signal_hook::consts::{SIGINT, SIGTERM};

/// Exit status of a process that Ctrl-C ended.
pub const INTERRUPTED: i32 = ResultCode::Interrupted.status() as i32;

/// A flag that the first Ctrl-C sets; the second ends the process.
pub fn first_interrupt() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let context = "cannot install the handler for Ctrl-C";
    // In this order: the first one only arms the end.
    signal_hook::flag::register_conditional_shutdown(SIGINT, INTERRUPTED, flag.clone())
        .context(context)?;
    signal_hook::flag::register(SIGINT, flag.clone()).context(context)?;
    Ok(flag)
}

/// A flag that is set by Ctrl-C (SIGINT) or SIGTERM.
pub fn interrupted() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, flag.clone())
            .context("cannot install the handler for Ctrl-C")?;
    }
    Ok(flag)
}

/// A flag after which Ctrl-C or SIGTERM ends the process.
pub fn end_on_interrupt() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, INTERRUPTED, flag.clone())
            .context("cannot install the handler for Ctrl-C")?;
    }
    Ok(flag)
}
