//! `magpie board identify`: measures the motor or the screw of a gripper.

use analysis::numbers;
use anyhow::Result;
use device::{calibration_client, params_client};
use firmware::motor::calibration::CalibrationKind;
use firmware::parameters::schema::id;
use report::text::terminal;
use serde_json::json;

use crate::commands::connection::PortArgs;

/// Measure the motor or the screw of a gripper; THE FINGERS MOVE.
///
/// Once after assembly: without it, motor constants are assumed, and the screw counts as backdrivable: a fault that switches
/// the current off is then expected to drop the part. The gripper must be disabled. `motor` measures windings, phase order,
/// rotor sensor, torque constant, inertia and friction: nothing may be gripped, and the fingers need room. `screw`
/// grips a part with 0.2 N m (2 A and up to 150 N with the assumed motor and screw), takes
/// the current away and observes whether the fingers yield: a rigid part must be between the fingers, at most 20 mm narrower
/// than their opening. Forces, faults and stops end either.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie board identify motor --port /dev/ttyACM0 --save
  cargo magpie board identify screw --can can0 --save         # a rigid part between the fingers")]
pub struct Args {
    /// What to measure.
    #[arg(value_enum)]
    what: Measured,
    #[command(flatten)]
    port: PortArgs,
    /// Save the result with all other parameters of the gripper in its flash.
    #[arg(long)]
    save: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Measured {
    /// Windings, phase order, rotor sensor, torque constant, inertia, friction.
    Motor,
    /// Whether the screw is self-locking.
    Screw,
}

/// Motor parameters as they are shown: identifier, name, unit, units in a count.
const MOTOR: [(u16, &str, &str, f64); 8] = [
    (id::RESISTANCE, "phase resistance", "ohm", 1e-6),
    (id::INDUCTANCE, "phase inductance", "mH", 1e-6),
    (id::POLE_PAIRS, "pole pairs", "", 1.0),
    (id::ROTOR_OFFSET, "offset of the rotor sensor", "turns", 1.0 / 65536.0),
    (id::SWAPPED, "phases V and W swapped (1: yes)", "", 1.0),
    (id::TORQUE_CONSTANT, "torque constant", "N m/A", 1e-6),
    (id::INERTIA, "inertia", "g cm^2", 1e-2),
    (id::DRY_FRICTION, "dry friction", "mN m", 1e-3),
];

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let mut source = args.port.open_given()?;
    eprintln!("warning: the gripper at {} moves: keep hands clear of the fingers", source.name());
    let kind = match args.what {
        Measured::Motor => CalibrationKind::Motor,
        Measured::Screw => CalibrationKind::Screw,
    };
    let locks = args.port.in_session(source.as_mut(), |session| {
        calibration_client::identify(session, kind, args.save)
    })?;
    let saved = if args.save { "saved" } else { "until the next reboot: --save keeps it" };
    if args.what == Measured::Screw {
        let screw = if locks { "self-locking" } else { "backdrivable" };
        return terminal::print_result(
            args.json,
            || json!({ "screw": screw, "saved": args.save }),
            || format!("The screw is {screw} ({saved}).\n"),
        );
    }
    let mut found = Vec::new();
    for (id, name, unit, scale) in MOTOR {
        found.push((name, unit, scale * f64::from(params_client::read(source.as_mut(), id)?)));
    }
    terminal::print_result(
        args.json,
        || {
            let found = found
                .iter()
                .map(|(name, unit, value)| json!({ "name": name, "unit": unit, "value": value }));
            json!({ "motor": found.collect::<Vec<_>>(), "saved": args.save })
        },
        || {
            let lines = found.iter().map(|(name, unit, value)| {
                format!("{name:<34}{} {unit}", numbers::decimal(*value, 4)).trim_end().to_owned()
                    + "\n"
            });
            lines.collect::<String>() + &format!("Measured, and in use ({saved}).\n")
        },
    )
}
