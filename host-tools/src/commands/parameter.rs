//! `magpie board parameter`: lists and sets the parameters of a gripper.

use anyhow::{Context, Result, bail};
use device::{calibration_client, params_client};
use firmware::parameters::schema::{PARAMETERS, Parameter, ValueRange};
use report::text::terminal;
use serde_json::json;

use crate::commands::connection::PortArgs;

/// List the parameters of a gripper, or set one.
///
/// A new value is in effect at once, unless its description says otherwise, and until the next reboot; --save keeps it.
/// Parameters that affect motion cannot be set while a host is armed.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie board parameter --port /dev/ttyACM0
  cargo magpie board parameter node 17 --port /dev/ttyACM0 --save     # the second gripper on a bus
  cargo magpie board parameter lead 1 --port /dev/ttyACM0 --save      # the coarse screw")]
pub struct Args {
    /// Parameter to show or set [default: list all].
    name: Option<String>,
    /// New value.
    #[arg(requires = "name", allow_hyphen_values = true)]
    value: Option<i32>,
    #[command(flatten)]
    port: PortArgs,
    /// Save all parameters of the gripper in its flash.
    #[arg(long)]
    save: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// In the description of parameters that are read at boot only.
const AT_BOOT: &str = "takes effect at the next boot";

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let mut source = args.port.open_given()?;
    let shown: Vec<&Parameter> = match &args.name {
        None => PARAMETERS.iter().collect(),
        Some(name) => vec![find(name)?],
    };
    if let (Some(value), Some(parameter)) = (args.value, shown.first())
        && !parameter.range.contains(value)
    {
        bail!("{} {value}: possible is {}", parameter.name, range_text(&parameter.range));
    }
    if let (Some(_), false, Some(parameter)) = (args.value, args.save, shown.first())
        && parameter.description.contains(AT_BOOT)
    {
        bail!(
            "{}: a new value takes effect at the next boot, until which only --save keeps it: give --save",
            parameter.name
        );
    }
    if args.value.is_some() || args.save {
        args.port.in_session(source.as_mut(), |session| {
            if let (Some(value), Some(parameter)) = (args.value, shown.first()) {
                params_client::write(session, parameter.id, value)?;
            }
            if args.save { calibration_client::save(session) } else { Ok(()) }
        })?;
    }
    let mut rows = Vec::new();
    for parameter in shown {
        rows.push((parameter, params_client::read(source.as_mut(), parameter.id)?));
    }
    terminal::print_result(
        args.json,
        || {
            let rows = rows.iter().map(|(parameter, value)| {
                json!({
                    "name": parameter.name,
                    "value": value,
                    "unit": parameter.unit,
                    "default": parameter.default,
                    "range": range_text(&parameter.range),
                    "description": parameter.description,
                })
            });
            json!({ "parameters": rows.collect::<Vec<_>>(), "saved": args.save })
        },
        || {
            let mut table =
                terminal::table(["parameter", "value", "unit", "possible", "description"]);
            for (parameter, value) in &rows {
                table.add_row([
                    parameter.name,
                    &value.to_string(),
                    parameter.unit,
                    &range_text(&parameter.range),
                    parameter.description,
                ]);
            }
            format!("{table}\n")
        },
    )
}

fn find(name: &str) -> Result<&'static Parameter> {
    let names: Vec<&str> = PARAMETERS.iter().map(|parameter| parameter.name).collect();
    let found = PARAMETERS.iter().find(|parameter| parameter.name == name);
    found.with_context(|| {
        format!("there is no parameter \"{name}\"; possible: {}", names.join(", "))
    })
}

fn range_text(range: &ValueRange) -> String {
    match range {
        ValueRange::Between(min, max) => format!("{min} to {max}"),
        ValueRange::OneOf(values) => {
            let values: Vec<String> = values.iter().map(i32::to_string).collect();
            values.join(", ")
        }
    }
}
