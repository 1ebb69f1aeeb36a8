//! `magpie board tare`: defines the present forces of a gripper as zero.

use anyhow::Result;
use device::calibration_client;
use report::text::terminal;
use serde_json::json;

use crate::commands::connection::PortArgs;

/// Define the present forces of an unloaded gripper as zero.
///
/// The gripper must be disabled, at rest and without anything between or at the fingers: a constant load cannot be told from an
/// offset. Networks and disturbance detection use the forces before the tare.
///
/// Without --save the tare lasts until the next reboot. A saved one belongs to the calibration that ran: repeat it after an
/// upload, which does not change it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie board tare --port /dev/ttyACM0
  cargo magpie board tare --can can0 --save         # kept over a reboot")]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    /// Nothing is gripped, although both fingers report a closing force.
    #[arg(long)]
    unloaded: bool,
    /// Save the tare with all other parameters of the gripper in its flash.
    #[arg(long)]
    save: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let mut source = args.port.open_given()?;
    args.port.in_session(source.as_mut(), |session| {
        calibration_client::tare(session, args.unloaded, args.save)
    })?;
    terminal::print_result(
        args.json,
        || json!({ "tared": true, "saved": args.save }),
        || {
            let until = if args.save { "saved" } else { "until the next reboot" };
            format!("The present forces are zero ({until}).\n")
        },
    )
}
