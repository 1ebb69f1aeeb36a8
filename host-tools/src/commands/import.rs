//! `magpie import`: converts measurement tables to a campaign with a mapping file.

use std::path::PathBuf;

use analysis::import::import_campaign;
use anyhow::Result;
use model_export::output::write_same;
use model_export::recordings::guess;

use crate::commands::args::ForceArg;
use crate::commands::output::print_notes;
use report::text::import::{format_import, format_proposal, proposal_json, to_json};
use report::text::terminal;

/// Convert measurement tables to a campaign with a mapping file.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  # proposes a mapping: check it
  cargo magpie import --guess run1.csv run2.csv run3.csv -o mapping.toml
  cargo magpie import mapping.toml run1.csv run2.csv run3.csv -o my-campaign
  # ROS 2 bags and MCAP files, as these folders or .mcap
  cargo magpie import --guess bag1 bag2 -o mapping.toml
  cargo magpie import tests/data/eflesh_normal.mapping.toml run1.csv run2.csv run3.csv -o eflesh

A mapping file:
  description = \"what was recorded\"
  one_clock = true                  # the sources share one running clock; else starts_s = [0, 60]
  [hall]
  clock = { from = \"t_sensor_s\", unit = \"s\" }
  columns = [ { from = \"bx0_uT\", unit = \"uT\", to = \"s0_x_gauss\" } ]
  [force]
  # added: where the two clocks differ; from_first_row = true: each begins anew with a recording
  clock = { from = \"t_state_s\", unit = \"s\", offset_s = -338.99 }
  columns = [ { from = \"weight_g\", unit = \"g\", to = \"f0_z_n\", scale = -1, missing = -1 } ]
  [design]                          # of the sensor, if known; else fit with --base polynomial
  gap_mm = 2.0                      # from the magnet's face to the Hall element, unloaded
  stiffness_x_n_per_mm = 100.0      # lateral (grasping)
  stiffness_z_n_per_mm = 100.0      # longitudinal
  # largest force of each axis, either sign; the tables of the device cover it
  force_range_n = 250.0
  magnet = { shape = \"cylinder\", diameter_mm = 4.0, length_mm = 3.0, remanence_t = 1.3, axis = \"y\" }
In a bag a column is topic.field, as in \"/finger0/mag.magnetic_field.x\", with the clock \"/finger0/mag.header.stamp\" or \
\"/finger0/mag.log_time\" in ns. There is a row for each message of the clock's topic; other topics are joined by time. \
For separate files of the two sides, give each side `file = \"NAME\"` and pass folders as sources.")]
pub struct Args {
    /// Mapping of the source columns.
    #[arg(required_unless_present = "guess")]
    mapping: Option<PathBuf>,
    /// One file (or folder) for each recording, in order.
    #[arg(required_unless_present = "guess")]
    sources: Vec<PathBuf>,
    /// Write a mapping file proposed from the names and values of these files (or folders of two files), to be checked.
    #[arg(long, value_name = "SOURCE", num_args = 1.., conflicts_with_all = ["mapping", "sources"])]
    guess: Vec<PathBuf>,
    /// Folder of the new campaign, which must not exist yet, or file of the proposed mapping.
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArg,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let Some(mapping) = &args.mapping else {
        return propose(args);
    };
    args.force.check_folder(&args.output)?;
    let imported = import_campaign(mapping, &args.sources, &args.output)?;
    print_notes(&imported.notes);
    if let Some(error) = &imported.fit_error {
        eprintln!("note: a fit will refuse these recordings: {error}");
    }
    terminal::print_result(
        args.json,
        || to_json(&imported),
        || format_import(&imported, mapping, &args.output),
    )
}

/// Writes a proposed mapping.
fn propose(args: &Args) -> Result<()> {
    let proposal = guess::propose(&args.guess)?;
    write_same(&args.output, proposal.text.as_bytes(), args.force.overwrite())?;
    terminal::print_result(
        args.json,
        || proposal_json(&proposal, &args.output),
        || format_proposal(&proposal, &args.output, &args.guess),
    )
}
