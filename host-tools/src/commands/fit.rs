//! `magpie fit`: base physics fitted to recordings.

mod report;

use std::path::PathBuf;

use anyhow::Result;
use clap::ValueEnum;
use model_export::fit::{self, Options};
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::align::Alignment;
use model_export::recordings::{Campaign, Notice};

use crate::{progress, show};

/// Fit the base physics to a campaign and write a model file.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  magpie fit recordings/clean -o model.toml
  magpie fit my-campaign --base polynomial --degree 5 -o model.toml
  magpie fit recordings/clean --json | jq '.axes'")]
pub struct Args {
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    /// Where the model goes; without it nothing is written.
    #[arg(short, long, value_name = "MODEL")]
    output: Option<PathBuf>,
    /// What the field is computed from.
    #[arg(long, value_enum, default_value = "cylinder")]
    base: BaseChoice,
    /// Degree of the polynomial base; chosen by held-out error if not given.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=9))]
    degree: Option<u8>,
    /// Delay of the reference's clock: added to its times before the fields are averaged around them.
    #[arg(
        long,
        value_name = "MS",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    delay_ms: f64,
    /// Seed of the bootstrap behind the error bars.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BaseChoice {
    /// Exact cylinder magnet on two flexures; needs the nominal [design].
    Cylinder,
    /// Polynomial of the forces, where no geometry is known.
    Polynomial,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.degree.is_some() && args.base == BaseChoice::Cylinder {
        anyhow::bail!("--degree belongs to --base polynomial; the cylinder base has no degree");
    }
    if !args.delay_ms.is_finite() {
        anyhow::bail!("--delay-ms must be a finite number of milliseconds");
    }
    let alignment = Alignment {
        delay_us: args.delay_ms * 1e3,
    };
    let options = Options {
        seed: args.seed,
        ..Options::default()
    };
    let reading = progress::bar("reading recordings", 0);
    let campaign = Campaign::read(&args.campaign, alignment, |_| reading.inc(1))?;
    reading.finish_and_clear();

    let fitting = progress::bar("fitting sensors", campaign.sensors().len());
    let (fits, fit_notices) = match args.base {
        BaseChoice::Cylinder => fit::campaign::cylinder(&campaign, options, |_| fitting.inc(1))?,
        BaseChoice::Polynomial => {
            let degree = args.degree.map(usize::from);
            (
                fit::campaign::polynomial(&campaign, degree, options, |_| fitting.inc(1))?,
                Vec::new(),
            )
        }
    };
    fitting.finish_and_clear();

    let notices: Vec<Notice> = campaign.notices().cloned().chain(fit_notices).collect();
    let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
    let model = ModelFile::of(&campaign, &fits, provenance);
    for notice in &notices {
        eprintln!("note: {notice}");
    }
    if let Some(path) = &args.output {
        model.write(path)?;
    }
    if args.json {
        show::page(&format!("{}\n", report::json(&model, &notices)))?;
    } else {
        let written = match &args.output {
            Some(path) => format!("Written to {}.\n", path.display()),
            None => "Not written: give -o model.toml to keep it.\n".to_owned(),
        };
        show::page(&(report::text(&campaign, &model, &fits) + &written))?;
    }
    Ok(())
}
