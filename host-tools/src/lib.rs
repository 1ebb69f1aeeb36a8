//! The command `magpie`.
//!
//! - [`cli`], [`commands`], [`terminal`], [`output_dir`]: command line, arguments, output.
//! - [`sim`]: simulated gripper: dataset generator, drivetrain, board in virtual time, closed loop, fault campaigns.
//! - [`device_run`]: recordings through the device's code, row by row.
//! - [`analysis`]: replay, comparison, diagnosis, data quality, benchmark, calibration.
//! - [`host_session`]: protocol state of a host that commands a gripper.
//! - [`device`]: access to a running gripper.
//! - [`report`], [`design_summary`]: HTML reports, and the summary of a sensor design.

pub mod analysis;
pub mod cli;
pub mod commands;
pub mod design_summary;
pub mod device;
pub mod device_run;
pub mod host_session;
pub mod output_dir;
pub mod report;
pub mod sim;
pub mod terminal;
