//! The command `magpie`: [`commands`] has a file for each command.
//!
//! Crates below it, each using only earlier ones:
//!
//! - `emulator`: the chip, executing the firmware's image.
//! - `device-run`: recordings through the device's code, row by row.
//! - `sim`: simulated gripper: campaigns, drivetrain, board in virtual time, closed loop, faults.
//! - `analysis`: replay, comparison, diagnosis, data quality, training.
//! - `report`: results as text, tables and HTML pages.
//! - `device`: access to a running gripper.

/// Prints a line on stderr. Unlike the standard macro it goes on where nobody reads the line: a closed pipe must end neither a
/// recording nor the control of a gripper.
macro_rules! eprintln {
    ($($part:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($part)*);
    }};
}

pub mod commands;
