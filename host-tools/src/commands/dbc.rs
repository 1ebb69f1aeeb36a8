//! `magpie dev dbc`: writes the CAN messages as a DBC file.

use analysis::numbers;
use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Result;
use device::format::{fault_name, state_name};
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::{PowerState, TaskState, state_code};
use firmware::parameters;
use firmware::protocol::layout::{Direction, MessageLayout, SignalLayout};
use firmware::protocol::messages::LAYOUTS;
use firmware::protocol::session::{op, status};
use firmware::protocol::{DEFAULT_NODE, PROTOCOL_VERSION, frame_id};
use firmware::system::faults::Fault;
use model_export::output::write_same;

use crate::commands::args::ForceArg;
use report::text::terminal;

/// First line of every file of this command, which identifies it.
const MARK: &str = "VERSION \"MAGPIE gripper, protocol ";
/// Node numbers whose identifiers do not collide with the emergency stop.
const NODES: std::ops::RangeInclusive<i64> = 1..=63;

/// Write the CAN messages as a DBC file (for cantools, SavvyCAN and other tools).
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie dev dbc > magpie.dbc
  cargo magpie dev dbc --node 17 -o right-hand.dbc")]
pub struct Args {
    /// Node number of the gripper: identifiers start at 32 times this number.
    #[arg(long, default_value_t = DEFAULT_NODE, value_parser = clap::value_parser!(u16).range(NODES))]
    node: u16,
    /// DBC file to write [default: stdout].
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArg,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let text = dbc(args.node);
    match &args.output {
        Some(path) => write_same(path, text.as_bytes(), args.force.overwrite())?,
        None => terminal::print(&text)?,
    }
    Ok(())
}

/// DBC text of a node.
pub fn dbc(node: u16) -> String {
    let (major, minor) = PROTOCOL_VERSION;
    let mut text = format!("{MARK}{major}.{minor}\"\n\nNS_ :\n\nBS_:\n\nBU_: GRIPPER HOST\n");
    let mut comments = format!("\nCM_ \"Messages of the MAGPIE gripper, node {node}.\";\n");
    let mut values = String::from("\n");
    let mut periods = String::from(
        "\nBA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 65535;\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n",
    );
    for (layout, number) in
        LAYOUTS.iter().flat_map(|layout| layout.numbers().map(move |n| (layout, n)))
    {
        let id = frame_id(node, number);
        let (sender, receiver) = match layout.direction {
            Direction::Out => ("GRIPPER", "HOST"),
            Direction::In => ("HOST", "GRIPPER"),
        };
        let name = match layout.instances {
            1 => layout.name.to_owned(),
            _ => format!("{}{}", layout.name, number - layout.number),
        };
        // Writing to a string cannot fail.
        let _ = write!(text, "\nBO_ {id} {name}: 8 {sender}\n");
        let _ = writeln!(comments, "CM_ BO_ {id} \"{}\";", one_line(layout.description));
        if layout.period_ms > 0 {
            let _ = writeln!(periods, "BA_ \"GenMsgCycleTime\" BO_ {id} {};", layout.period_ms);
        }
        for (signal, select, field) in signals(layout) {
            let _ = writeln!(text, " SG_ {signal}{select} : {} {receiver}", signal_format(field));
            let comment = one_line(&comment(layout.name, field));
            let _ = writeln!(comments, "CM_ SG_ {id} {signal} \"{comment}\";");
            let names = value_names(layout.name, field.name);
            if !names.is_empty() {
                let names = names.iter().map(|(value, name)| format!(" {value} \"{name}\""));
                let _ = writeln!(values, "VAL_ {id} {signal}{} ;", names.collect::<String>());
            }
        }
    }
    text + &comments + &periods + &values
}

/// Description of a signal; of one with a bit for each fault or flag, with their order.
fn comment(message: &str, field: &SignalLayout) -> String {
    let bits = match (message, field.name) {
        ("Heartbeat", "faults") => {
            let bits = Fault::ALL.iter().enumerate();
            let bits = bits.map(|(bit, fault)| format!("{bit} {}", fault_name(*fault)));
            format!("Bits: {}.", bits.collect::<Vec<_>>().join(", "))
        }
        ("Command", "flags") => format!(
            "Bits: {:#04x} move without believed forces (uncalibrated); of a grip, {:#04x} profile (0 normal, 1 fragile, 2 \
             strong), {:#04x} width window (n: 2^(n-1) mm on either side of the position), {:#04x} fast until close to the \
             window; {:#04x} ground contact on a line; {:#04x} toggled to execute a repeated command again.",
            flag::UNCALIBRATED,
            flag::PROFILE,
            flag::WINDOW,
            flag::FAST,
            flag::LINE,
            flag::AGAIN
        ),
        _ => String::new(),
    };
    format!("{} {bits}", field.description)
}

/// Names of constants with these values.
fn named<const N: usize>(names: [(u8, &str); N]) -> Vec<(u16, String)> {
    names.map(|(value, name)| (value.into(), name.to_owned())).into()
}

/// Names of a signal's values; empty for a number.
fn value_names(message: &str, signal: &str) -> Vec<(u16, String)> {
    match (message, signal) {
        ("Service" | "ServiceReply", "op") => named([
            (op::CLEAR_FAULTS, "clear faults"),
            (op::TARE, "tare"),
            (op::SAVE, "save"),
            (op::REBOOT, "reboot"),
            (op::ARM, "arm"),
            (op::VERSION, "version"),
            (op::COMMAND, "refused command"),
            (op::MEASURE, "measure"),
            (op::UPLOAD, "upload"),
            (op::FINISH_UPLOAD, "finish upload"),
            (op::DESCRIPTION, "description"),
            (op::END, "end session"),
            (op::OPEN, "open session"),
            (op::WRITE_KEY, "write key"),
            (op::ERASE_KEY, "erase key"),
            (op::RENEW, "renew session"),
        ]),
        ("ServiceReply", "status") => named([
            (status::DONE, "done"),
            (status::CHALLENGE, "challenge"),
            (status::REFUSED, "refused"),
            (status::FAULTY, "prevented by a fault"),
            (status::ARMED, "armed"),
            (status::FAILED, "failed"),
            (status::UNKNOWN, "unknown operation"),
            (status::GRIPPING, "gripping"),
            (status::UNAUTHENTICATED, "unauthenticated"),
            (status::NOT_PRESENT, "not present"),
        ]),
        ("ParamRequest" | "ParamReply", "op") => {
            named([(parameters::op::READ, "read"), (parameters::op::WRITE, "write")])
        }
        ("ParamReply", "status") => named([
            (parameters::status::DONE, "done"),
            (parameters::status::UNKNOWN, "unknown parameter"),
            (parameters::status::OUT_OF_RANGE, "out of range"),
            (parameters::status::ARMED, "armed"),
            (parameters::status::NO_SUCH_OP, "unknown operation"),
            (parameters::status::READ_ONLY, "read only"),
            (parameters::status::UNAUTHENTICATED, "unauthenticated"),
        ]),
        ("Heartbeat" | "GripStatus", "object") => named([
            (0, "moving"),
            (1, "contact while opening"),
            (2, "contact while closing"),
            (3, "at position"),
        ]),
        ("FaultEvent", "active") => named([(0, "cleared"), (1, "set")]),
        ("Force", "model") => named([(0, "ideal model"), (1, "network")]),
        ("Heartbeat", "state") => {
            let powers = PowerState::ALL.iter().filter(|state| **state != PowerState::Enabled);
            let powers = powers.map(|power| *power as u8);
            let tasks = TaskState::ALL.iter().map(|task| state_code(PowerState::Enabled, *task));
            powers.chain(tasks).map(|code| (code.into(), state_name(code))).collect()
        }
        ("FaultEvent", "code") => {
            Fault::ALL.iter().map(|fault| (*fault as u16, fault_name(*fault))).collect()
        }
        ("Command", "mode") => named([
            (mode::DISABLE, "disable"),
            (mode::ENABLE, "enable"),
            (mode::HOME, "home"),
            (mode::MOVE, "move"),
            (mode::GRIP, "grip"),
            (mode::RELEASE, "release"),
            (mode::STOP, "stop"),
            (mode::FOOT, "foot"),
            (mode::LEAVE, "leave foot"),
        ]),
        _ => Vec::new(),
    }
}

/// The signals of a message: name, multiplex marker and field. A multiplexed field gives one signal for each
/// value of the selector (the first field).
fn signals(layout: &'static MessageLayout) -> Vec<(String, String, &'static SignalLayout)> {
    let plain = |field: &'static SignalLayout| (field.name.to_owned(), String::new(), field);
    match (layout.multiplexed, layout.signals) {
        (true, [first, others @ ..]) => {
            let values = 0..1_u32 << (first.end_bit - first.first_bit);
            let each = values.flat_map(|value| {
                let one = move |field: &'static SignalLayout| {
                    (format!("{}{value}", field.name), format!(" m{value}"), field)
                };
                others.iter().map(one)
            });
            let selector = (first.name.to_owned(), " M".to_owned(), first);
            [selector].into_iter().chain(each).collect()
        }
        _ => layout.signals.iter().map(plain).collect(),
    }
}

/// Bits, scale, range and unit of a signal.
fn signal_format(field: &SignalLayout) -> String {
    let width = u32::from(field.end_bit - field.first_bit);
    let (min, max) = if field.signed {
        (-(1_i64 << (width - 1)), (1_i64 << (width - 1)) - 1)
    } else {
        (0, (1_i64 << width) - 1)
    };
    let scaled = |counts: i64| numbers::decimal(counts as f64 * field.scale, 4);
    format!(
        "{}|{width}@1{} ({},0) [{}|{}] \"{}\"",
        field.first_bit,
        if field.signed { '-' } else { '+' },
        field.scale,
        scaled(min),
        scaled(max),
        field.unit
    )
}

/// Text on one line, without double quotes.
fn one_line(text: &str) -> String {
    let line: Vec<&str> = text.split_whitespace().collect();
    line.join(" ").replace('"', "'")
}
