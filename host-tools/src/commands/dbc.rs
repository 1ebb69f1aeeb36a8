//! `magpie dbc`: the messages on the CAN bus, for other tools.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Result;
use firmware::wire::layout::{Direction, Field, Layout};
use firmware::wire::messages::LAYOUTS;
use firmware::wire::{DEFAULT_NODE, PROTOCOL, identifier};
use model_export::output::{check_output, write_output};

use crate::show;

/// How every file that this command writes begins, and no other.
const MARK: &str = "VERSION \"MAGPIE gripper, protocol ";
/// Numbers of nodes that leave the identifiers of the emergency stop free.
const NODES: std::ops::RangeInclusive<i64> = 1..=63;

/// Write the messages on the CAN bus as a `.dbc`, which cantools, SavvyCAN and others read.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie dbc > magpie.dbc
  cargo magpie dbc --node 17 -o right-hand.dbc")]
pub struct Args {
    /// Number of the gripper on the bus: identifiers are 32 times this and up.
    #[arg(long, default_value_t = DEFAULT_NODE, value_parser = clap::value_parser!(u16).range(NODES))]
    node: u16,
    /// Where it goes; without it, to the terminal.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let text = dbc(args.node);
    match &args.output {
        Some(path) => {
            check_output(path, MARK)?;
            write_output(path, text.as_bytes(), MARK)?;
        }
        None => show::page(&text)?,
    }
    Ok(())
}

/// The text of the `.dbc` of a node.
pub fn dbc(node: u16) -> String {
    let (major, minor) = PROTOCOL;
    let mut text = format!("{MARK}{major}.{minor}\"\n\nNS_ :\n\nBS_:\n\nBU_: GRIPPER HOST\n");
    let mut comments = format!("\nCM_ \"Messages of the MAGPIE gripper, node {node}.\";\n");
    let mut periods = String::from(
        "\nBA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 65535;\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n",
    );
    for (layout, number) in LAYOUTS
        .iter()
        .flat_map(|layout| layout.numbers().map(move |n| (layout, n)))
    {
        let id = identifier(node, number);
        let (sender, receiver) = match layout.direction {
            Direction::Out => ("GRIPPER", "HOST"),
            Direction::In => ("HOST", "GRIPPER"),
        };
        let name = match layout.copies {
            1 => layout.name.to_owned(),
            _ => format!("{}{}", layout.name, number - layout.number),
        };
        // Writing to a string cannot fail.
        let _ = write!(text, "\nBO_ {id} {name}: 8 {sender}\n");
        let _ = writeln!(comments, "CM_ BO_ {id} \"{}\";", words(layout.words));
        if layout.period_ms > 0 {
            let _ = writeln!(
                periods,
                "BA_ \"GenMsgCycleTime\" BO_ {id} {};",
                layout.period_ms
            );
        }
        for (signal, select, field) in signals(layout) {
            let _ = writeln!(text, " SG_ {signal}{select} : {} {receiver}", place(field));
            let _ = writeln!(
                comments,
                "CM_ SG_ {id} {signal} \"{}\";",
                words(field.words)
            );
        }
    }
    text + &comments + &periods
}

/// The signals of a message: name, its part in a multiplex, and the field. A multiplexed field is a signal
/// for each value of the first.
fn signals(layout: &'static Layout) -> Vec<(String, String, &'static Field)> {
    let plain = |field: &'static Field| (field.name.to_owned(), String::new(), field);
    match (layout.multiplexed, layout.fields) {
        (true, [first, others @ ..]) => {
            let values = 0..1_u32 << (first.end - first.first);
            let each = values.flat_map(|value| {
                let one = move |field: &'static Field| {
                    (
                        format!("{}{value}", field.name),
                        format!(" m{value}"),
                        field,
                    )
                };
                others.iter().map(one)
            });
            let selector = (first.name.to_owned(), " M".to_owned(), first);
            [selector].into_iter().chain(each).collect()
        }
        _ => layout.fields.iter().map(plain).collect(),
    }
}

/// Bits, scale, range and unit.
fn place(field: &Field) -> String {
    let width = u32::from(field.end - field.first);
    let (least, greatest) = match field.signed {
        true => (-(1_i64 << (width - 1)), (1_i64 << (width - 1)) - 1),
        false => (0, (1_i64 << width) - 1),
    };
    let scaled = |counts: i64| show::plain(counts as f64 * field.scale, 2);
    format!(
        "{}|{width}@1{} ({},0) [{}|{}] \"{}\"",
        field.first,
        if field.signed { '-' } else { '+' },
        field.scale,
        scaled(least),
        scaled(greatest),
        field.unit
    )
}

/// Documentation as one line, without what would end the string.
fn words(text: &str) -> String {
    let line: Vec<&str> = text.split_whitespace().collect();
    line.join(" ").replace('"', "'")
}
