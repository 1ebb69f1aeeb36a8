//! `magpie board key`: the key that a gripper and its hosts share.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use device::session::with_session;
use device::source::Source;
use device::{calibration_client, key_file};
use firmware::protocol::authentication::Key;
use report::text::terminal;
use serde_json::json;

use crate::commands::connection::PortArgs;

/// Create, write or erase the key that a gripper and its hosts share.
///
/// With a key, a gripper accepts commands, parameters, services and calibrations only from hosts that know it. Without one
/// everybody on the bus can move it; `magpie monitor` shows that as "unprotected". Stops need no key. A key is written over the serial line
/// while the button of the board is pressed, or by a host with the present key; a gripper without a key accepts the first one.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie board key new key.txt
  # the first one, or with the button pressed
  cargo magpie board key write key.txt --port /dev/ttyACM0
  cargo magpie board key write new.txt --port /dev/ttyACM0 --key key.txt    # replaces it
  cargo magpie board key erase --port /dev/ttyACM0 --key key.txt")]
pub struct Args {
    #[command(subcommand)]
    action: Action,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Create a file with a random key, readable by its owner only.
    #[command(after_help = "Example:\n  cargo magpie board key new key.txt")]
    New {
        /// File to create; an existing one is never overwritten.
        file: PathBuf,
    },
    /// Write the key of a file to a gripper.
    #[command(after_help = "Example:\n  cargo magpie board key write key.txt --port /dev/ttyACM0")]
    Write {
        /// File with the new key.
        file: PathBuf,
        #[command(flatten)]
        port: PortArgs,
    },
    /// Erase the key of a gripper, which is unprotected then.
    #[command(
        after_help = "Example:\n  cargo magpie board key erase --port /dev/ttyACM0 --key key.txt"
    )]
    Erase {
        #[command(flatten)]
        port: PortArgs,
    },
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let (done, text) = match &args.action {
        Action::New { file } => {
            key_file::create(file)?;
            (json!({ "created": file }), format!("A new key is in {}.\n", file.display()))
        }
        Action::Write { file, port } => {
            let key = key_file::read(file)?;
            let name = change(port, key)?;
            (json!({ "written": file }), format!("{name} has the key of {}.\n", file.display()))
        }
        Action::Erase { port } => {
            let name = change(port, Key::NONE)?;
            (json!({ "erased": name }), format!("{name} has no key: it is unprotected.\n"))
        }
    };
    terminal::print_result(args.json, || done, || text)
}

/// Replaces the key of a gripper; returns the name of its line.
fn change(port: &PortArgs, key: Key) -> Result<String> {
    if port.is_bus() {
        bail!(
            "a key is never sent over a bus, where others could read it: connect the serial line and use --port"
        );
    }
    let mut source = port.open()?.context("give the gripper's serial line: --port PATH")?;
    let credentials = port.credentials()?;
    let source: &mut dyn Source = source.as_mut();
    let is_changed = calibration_client::write_key(source, key)?
        || (credentials.key != Key::NONE
            && with_session(source, credentials, |session| {
                calibration_client::write_key(session, key)
            })?);
    if !is_changed {
        bail!(
            "{}: the gripper has a key: give it with --key FILE, or press the button of its board meanwhile",
            source.name()
        );
    }
    Ok(source.name())
}
