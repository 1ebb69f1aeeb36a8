//! The command `magpie`.
//!
//! - [`cli`]: the commands and their arguments.
//! - [`commands`]: one file each.
//! - [`bench`](mod@bench): a simulated bench that shares no mechanics with the fit.
//! - [`surroundings`]: what the board would know beside its fields.
//! - [`sums`]: statistics of many rows.
//! - [`compare`]: a model beside a measurement.
//! - [`diagnose`]: which effect a model lacks.
//! - [`faults`]: faults thrown at a simulated gripper, and what becomes of it.
//! - [`findings`]: what is wrong with a campaign's recordings.
//! - [`wiring`]: a recording's row as the device's readings.
//! - [`new_folder`]: folders that commands make.
//! - [`lessons`]: recordings as a recurrent network on the device sees them.
//! - [`networks`]: recurrent networks in a replay.
//! - [`board`]: the gripper's board in virtual time.
//! - [`live`]: a gripper watched and recorded while it runs.
//! - [`plant`]: the gripper's drive as physics.
//! - [`drive`]: the firmware's control of the motor on that plant.
//! - [`tare`]: what is told where nothing loads.
//! - [`coverage`]: whether standard deviations mean what they say.
//! - [`foreign`]: how surely the device notices a foreign magnet.
//! - [`replay`]: recorded data through the device's own code.
//! - [`report`]: the page that a comparison leaves to open.
//! - [`table`]: all ways of telling the force side by side.
//! - [`show`]: numbers and tables as people read them.
//! - [`progress`]: what long work shows while it runs.

pub mod bench;
pub mod board;
pub mod cli;
pub mod commands;
pub mod compare;
pub mod coverage;
pub mod diagnose;
pub mod drive;
pub mod faults;
pub mod findings;
pub mod foreign;
pub mod lessons;
pub mod live;
pub mod networks;
pub mod new_folder;
pub mod plant;
pub mod progress;
pub mod replay;
pub mod report;
pub mod show;
pub mod sums;
pub mod surroundings;
pub mod table;
pub mod tare;
pub mod wiring;
