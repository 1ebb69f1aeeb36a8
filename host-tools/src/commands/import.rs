//! `magpie import`: converts measurement tables to a campaign with a mapping file.

use std::path::PathBuf;

use analysis::notes::Note;
use analysis::progress;
use anyhow::Result;
use model_export::recordings::align::Alignment;
use model_export::recordings::{Campaign, import};
use serde_json::json;

use crate::commands::print_notes;
use report::text::terminal;

/// Convert measurement tables to a campaign with a mapping file (columns, units, scale, clocks).
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie import tests/data/eflesh_normal.mapping.toml run1.csv run2.csv run3.csv -o eflesh

A mapping file:
  description = \"what was recorded\"
  one_clock = true                  # the sources share one running clock
  [hall]
  clock = { from = \"t_sensor_s\", unit = \"s\" }
  columns = [ { from = \"bx0_uT\", unit = \"uT\", to = \"s0_x_gauss\" } ]
  [force]
  clock = { from = \"t_state_s\", unit = \"s\" }
  columns = [ { from = \"weight_g\", unit = \"g\", to = \"f0_z_n\", scale = -1, missing = -1 } ]
For separate files of the two sides, give each side `file = \"NAME\"` and pass folders as sources.")]
pub struct Args {
    /// Mapping of the source columns.
    mapping: PathBuf,
    /// One file (or folder) for each recording, in order.
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// Folder of the new campaign; must not exist yet.
    #[arg(short, long, value_name = "CAMPAIGN")]
    output: PathBuf,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let bar = progress::progress_bar("importing", args.sources.len());
    let (imported, notices) =
        import::import(&args.mapping, &args.sources, &args.output, |_| bar.inc(1))?;
    bar.finish_and_clear();
    print_notes(&notices.into_iter().map(Note::Recording).collect::<Vec<_>>());
    if args.json {
        let recordings = imported.iter().map(|recording| {
            let (hall, force, measured) = recording.rows;
            json!({ "folder": recording.folder, "hall_rows": hall, "force_rows": force, "measured_rows": measured })
        });
        terminal::print(&format!(
            "{}\n",
            json!({ "campaign": args.output, "recordings": recordings.collect::<Vec<_>>() })
        ))?;
        return Ok(());
    }
    let campaign = Campaign::read(&args.output, Alignment { delay_us: 0.0 }, |_| ())?;
    let mut table = terminal::table([
        "recording",
        "start s",
        "length s",
        "sensors",
        "board rows",
        "reference rows",
        "rows with force",
    ]);
    for (recording, imported) in campaign.recordings.iter().zip(&imported) {
        let ends = recording.time_s.first().zip(recording.time_s.last());
        let (hall, force, measured) = imported.rows;
        table.add_row([
            imported.folder.display().to_string(),
            format!("{:.1}", recording.description.start_s),
            format!("{:.1}", ends.map_or(0.0, |(first, last)| last - first)),
            recording.sensors.len().to_string(),
            hall.to_string(),
            force.to_string(),
            measured.to_string(),
        ]);
    }
    terminal::right_align(&mut table, 1);
    let base = if campaign.design().is_some() { "" } else { " --base polynomial" };
    let next = format!("Next: cargo magpie fit {:?}{base} -o model.toml", args.output);
    terminal::print(&format!("{table}\n{next}\n"))?;
    Ok(())
}
