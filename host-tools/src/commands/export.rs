//! `magpie dev export`: writes the device tables as Rust source, or recordings with the device's estimates as MCAP files.

use std::path::{Path, PathBuf};

use analysis::notes::{Note, UncompensatedEffect};
use analysis::replay::bags::write_bags;
use anyhow::{Result, bail};
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::model_file::TABLES_MARK;
use model_export::output::Output;
use serde_json::json;

use crate::commands::args::{AlignArgs, ForceArg};
use crate::commands::output::{
    check_compensated, print_conditions, print_missing_sensors, print_notes,
};
use device_run::networks::{NetworkSet, tables_source};
use report::text::export::{format_tables, to_json, worst_map};
use report::text::terminal;

/// Write the firmware's model tables and report their fixed-point error in newtons.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie dev export model.toml -o my-tables.rs
  cargo magpie dev export model.toml --network network.safetensors -o my-tables.rs
  # for Foxglove, PlotJuggler and Python
  cargo magpie dev export model.toml --mcap my-campaign -o mcap-files
  MAGPIE_TABLES=my-tables.rs cargo image")]
pub struct Args {
    /// Model file written by `magpie fit`.
    model: PathBuf,
    /// Write the recordings of this campaign with the device's estimates instead: one MCAP file each, in the folder PATH.
    #[arg(long, value_name = "CAMPAIGN", conflicts_with_all = ["nominal", "uncompensated"])]
    mcap: Option<PathBuf>,
    #[command(flatten)]
    align: AlignArgs,
    /// Rust source file to write; with --mcap, a folder that does not exist yet.
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArg,
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
    if let Some(campaign) = &args.mcap {
        return write_mcap(args, campaign);
    }
    let variant = if args.nominal { ModelVariant::Nominal } else { ModelVariant::Fitted };
    if args.align.given_ms()?.is_some() {
        bail!("--delay-ms is of the recordings of --mcap; tables have no reference");
    }
    let built = build(&args.model, variant)?;
    let (inputs, overwrite) = (built.model.inputs(), args.force.overwrite());
    let output = Output::check(&args.output, TABLES_MARK, inputs, overwrite)?;
    built.check_sensors(&args.model)?;
    if !args.uncompensated {
        check_compensated(&built, "export")?;
    }
    let networks =
        args.network.as_deref().map(|path| NetworkSet::read(path, &built)).transpose()?;
    let source = tables_source(&built, networks.as_ref())?;
    output.write(source.as_bytes())?;
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

/// Writes each recording of a campaign as an MCAP file.
fn write_mcap(args: &Args, campaign: &Path) -> Result<()> {
    args.force.check_folder(&args.output)?;
    let (network, delay_ms) = (args.network.as_deref(), args.align.given_ms()?);
    let (files, note) = write_bags(&args.model, network, campaign, &args.output, delay_ms)?;
    print_notes(note.as_slice());
    let written = || {
        let paths: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
        format!(
            "Written to {}: topics /board, /reference and /estimate. Back to a campaign: cargo magpie import --guess {} -o \
             mapping.toml\n",
            paths.join(", "),
            shell_words::join(&paths),
        )
    };
    let json = || json!({ "files": files });
    terminal::print_result(args.json, json, written)
}
