//! `magpie fit`: base physics fitted to recordings.

pub mod report;

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::ValueEnum;
use model_export::fit::{self, Fits, Options};
use model_export::model_file::{self, ModelFile, Provenance};
use model_export::output::check_output;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::{Campaign, Notice};

use super::clocks::Clocks;
use crate::compare::Finding;
use crate::findings::files::scan;
use crate::{progress, show};

/// Fit the base physics to a campaign and write a model file.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie fit tests/data/clean -o model.toml
  cargo magpie fit my-campaign --base polynomial --degree 5 -o model.toml
  cargo magpie fit tests/data/clean --json | jq '.axes'")]
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
    #[command(flatten)]
    clocks: Clocks,
    /// Seed of the bootstrap behind the error bars.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// What the field is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BaseChoice {
    /// Exact field of the design's magnet, a cylinder or another, on two flexures.
    Cylinder,
    /// Polynomial of the forces, where no geometry is known.
    Polynomial,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.degree.is_some() && args.base == BaseChoice::Cylinder {
        anyhow::bail!("--degree belongs to --base polynomial; the cylinder base has no degree");
    }
    if let Some(path) = &args.output {
        check_output(path, model_file::MARK)?;
    }
    let alignment = args.clocks.alignment()?;
    let options = Options {
        seed: args.seed,
        ..Options::default()
    };
    let campaign = read_campaign(&args.campaign, alignment)?;
    let mut notices: Vec<Notice> = campaign.notices().cloned().collect();
    notices.extend(mistakes(&args.campaign, &notices)?);
    say(&notices);
    let (fits, more) = fit_campaign(&campaign, args.base, args.degree, options)?;
    say(&more);
    notices.extend(more);
    let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
    refuse_copies(&provenance)?;
    let model = ModelFile::of(&campaign, &fits, provenance);
    match args.json {
        true => show::page(&format!("{}\n", report::json(&model, &notices)))?,
        false => show::page(&report::text(&campaign, &model, &fits))?,
    }
    if let Some(path) = &args.output {
        model.write(path)?;
    }
    if !args.json {
        show::page(&match &args.output {
            Some(path) => format!("Written to {}.\n", path.display()),
            None => "Not written: give -o model.toml to keep it.\n".to_owned(),
        })?;
    }
    Ok(())
}

/// What is wrong with the recordings themselves and would end up in the fit; what reading them said
/// already is left out.
fn mistakes(campaign: &Path, known: &[Notice]) -> Result<Vec<Notice>> {
    let looking = progress::bar("looking for mistakes", recording_folders(campaign)?.len());
    let findings = scan(campaign, |_| looking.inc(1))?;
    looking.finish_and_clear();
    let new = |finding: &Finding| {
        // A covariate that stands still does no harm to a fit without it.
        finding.id != "constant_covariate"
            && !known
                .iter()
                .any(|notice| notice.place.file == finding.place.file)
    };
    let found = findings.into_iter().filter(new);
    Ok(found
        .map(|finding| Notice {
            place: finding.place,
            message: format!("{} (`magpie compare` tells more)", finding.message),
        })
        .collect())
}

/// Reads a campaign, with progress.
pub fn read_campaign(folder: &Path, alignment: Alignment) -> Result<Campaign> {
    let reading = progress::bar("reading recordings", recording_folders(folder)?.len());
    let campaign = Campaign::read(folder, alignment, |_| reading.inc(1))?;
    reading.finish_and_clear();
    Ok(campaign)
}

/// Fits a campaign that was read.
pub fn fit_campaign(
    campaign: &Campaign,
    base: BaseChoice,
    degree: Option<u8>,
    options: Options,
) -> Result<(Fits, Vec<Notice>)> {
    let fitting = progress::bar("fitting sensors", campaign.sensors().len());
    let result = match base {
        BaseChoice::Cylinder => fit::campaign::cylinder(campaign, options, |_| fitting.inc(1))?,
        BaseChoice::Polynomial => {
            let degree = degree.map(usize::from);
            (
                fit::campaign::polynomial(campaign, degree, options, |_| fitting.inc(1))?,
                Vec::new(),
            )
        }
    };
    fitting.finish_and_clear();
    Ok(result)
}

/// Says on stderr what a person should know.
pub fn say(notices: &[impl std::fmt::Display]) {
    for notice in notices {
        eprintln!("note: {notice}");
    }
}

/// The same recording twice would be fitted and held out at once.
pub fn refuse_copies(provenance: &Provenance) -> Result<()> {
    for (i, one) in provenance.recordings.iter().enumerate() {
        if let Some(other) = provenance.recordings[..i]
            .iter()
            .find(|r| r.sha256 == one.sha256)
        {
            anyhow::bail!(
                "{}: recordings {} and {} are the same data; remove one, or the held-out errors would not be held out",
                provenance.campaign,
                other.name,
                one.name
            );
        }
    }
    Ok(())
}
