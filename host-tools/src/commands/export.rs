//! `magpie export`: writes the device tables as Rust source.

use std::path::PathBuf;

use analysis::notes::{Note, UncompensatedEffect};
use anyhow::Result;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::codegen::{MARK, source_with_networks, tables_source};
use model_export::output::{check_output, write_output};

use crate::commands::{check_compensated, print_conditions, print_missing_sensors, print_notes};
use device_run::networks::NetworkSet;
use report::text::export::{format_tables, to_json, worst_map};
use report::text::terminal;

/// Write the firmware's model tables and report their fixed-point error in newtons.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie export model.toml -o my-tables.rs
  cargo magpie export model.toml --network network.safetensors -o my-tables.rs
  MAGPIE_TABLES=my-tables.rs cargo image")]
pub struct Args {
    /// Model file written by `magpie fit`.
    model: PathBuf,
    /// Rust source file to write.
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
    /// Recurrent networks to run after the model, written by `magpie train`.
    #[arg(long, value_name = "NETWORK", conflicts_with = "nominal")]
    network: Option<PathBuf>,
    /// Invert the nominal design (the paper's ideal model) instead of the fitted parameters.
    #[arg(long)]
    nominal: bool,
    /// Export although the device never compensates an effect of the model: the forces keep its error.
    #[arg(long)]
    uncompensated: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let variant = if args.nominal { ModelVariant::Nominal } else { ModelVariant::Fitted };
    check_output(&args.output, MARK)?;
    let built = build(&args.model, variant)?;
    if !args.uncompensated {
        check_compensated(&built, "export")?;
    }
    let networks =
        args.network.as_deref().map(|path| NetworkSet::read(path, &built)).transpose()?;
    let source = match &networks {
        None => tables_source(&built),
        Some(set) => source_with_networks(&built, &set.file.networks, &set.packed)?,
    };
    write_output(&args.output, source.as_bytes(), MARK)?;
    let uncompensated = UncompensatedEffect::of(&built).map(Note::Uncompensated);
    print_notes(&uncompensated.collect::<Vec<_>>());
    print_conditions(&built);
    let DeviceModel { model, chosen, header, .. } = built;
    print_missing_sensors(&header);
    terminal::print_result(
        args.json,
        || to_json(&chosen, &header),
        || {
            format_tables(&chosen, &header)
                + &worst_map(&model, &chosen, &header)
                + &networks.as_ref().map_or_else(String::new, NetworkSet::description)
                + &format!("Written to {}.\n", args.output.display())
        },
    )
}
