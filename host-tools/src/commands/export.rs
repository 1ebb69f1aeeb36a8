//! `magpie export`: writes the device tables as Rust source, or recordings with the device's estimates as MCAP files.

use std::path::{Path, PathBuf};

use analysis::notes::{Note, UncompensatedEffect};
use analysis::progress;
use anyhow::{Result, bail};
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::codegen::{MARK, source_with_networks, tables_source};
use model_export::output::{StagingDir, check_output, check_vacant, write_output};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::in_order;
use model_export::recordings::recording::recording_name;
use rayon::prelude::*;
use serde_json::json;

use crate::commands::args::AlignArgs;
use crate::commands::{check_compensated, print_conditions, print_missing_sensors, print_notes};
use device_run::ReplayModels;
use device_run::mcap::write_recording;
use device_run::networks::NetworkSet;
use report::text::export::{format_tables, to_json, worst_map};
use report::text::terminal;

/// Write the firmware's model tables and report their fixed-point error in newtons.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie export model.toml -o my-tables.rs
  cargo magpie export model.toml --network network.safetensors -o my-tables.rs
  # for Foxglove, PlotJuggler and Python
  cargo magpie export model.toml --mcap my-campaign -o mcap-files
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
    if args.align.alignment()?.delay_us != 0.0 {
        bail!("--delay-ms is of the recordings of --mcap; tables have no reference");
    }
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

/// Writes each recording of a campaign as an MCAP file.
fn write_mcap(args: &Args, campaign: &Path) -> Result<()> {
    check_vacant(&args.output)?;
    let folders = recording_folders(campaign)?;
    let built = build(&args.model, ModelVariant::Fitted)?;
    let networks =
        args.network.as_deref().map(|path| NetworkSet::read(path, &built)).transpose()?;
    let models = ReplayModels { networks: networks.as_ref(), ..ReplayModels::of(&built) };
    let alignment = args.align.alignment()?;
    let draft = StagingDir::new(&args.output, "export")?;
    let bar = progress::progress_bar("writing MCAP files", folders.len());
    let file = |folder: &PathBuf| -> Result<String> {
        let name = format!("{}.mcap", recording_name(folder));
        write_recording(&models, folder, alignment, &draft.path().join(&name))?;
        bar.inc(1);
        Ok(name)
    };
    let files = in_order(folders.par_iter().map(file))?;
    bar.finish_and_clear();
    draft.commit(&args.output)?;
    let written = || {
        let paths = files.iter().map(|name| args.output.join(name).display().to_string());
        let paths: Vec<String> = paths.collect();
        format!(
            "Written to {}: topics /board, /reference and /estimate. Back to a campaign: cargo magpie import --guess {} -o \
             mapping.toml\n",
            paths.join(", "),
            shell_words::join(&paths),
        )
    };
    let json = || json!({ "folder": args.output, "files": files });
    terminal::print_result(args.json, json, written)
}
