//! `magpie demo`: from raw recordings to forces by the gripper's own code, and to the effect that is missing,
//! as a short story.

mod story;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use firmware::params;
use model_export::fit::Options;
use model_export::fit::score::pooled_rms;
use model_export::inverse::build::{Variant, build};
use model_export::inverse::emit::{MARK, source};
use model_export::model_file::{ModelFile, Provenance};
use model_export::output::write_output;
use model_export::recordings::align::Alignment;

use super::fit::{BaseChoice, fit_campaign, read_campaign};
use super::{export, fit, replay};
use crate::{progress, show};

/// The whole story on one campaign: fit, judge, find what is missing, add it, watch the error fall.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie demo
  cargo magpie demo tests/data/friction -o friction-story")]
pub struct Args {
    /// Folder of recordings; without it, a small campaign that comes with the project.
    campaign: Option<PathBuf>,
    /// Folder for the models, the tables and the report that the demo writes.
    #[arg(short, long, value_name = "FOLDER", default_value = "magpie-demo")]
    output: PathBuf,
}

/// The campaign of the demo, in the checkout that this tool was built from.
pub(super) const CAMPAIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/demo");

/// The story takes the two clocks to agree.
const ALIGNMENT: Alignment = Alignment { delay_us: 0.0 };

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let folder = args.campaign.as_deref().unwrap_or(Path::new(CAMPAIGN));
    let mut campaign = read_campaign(folder, ALIGNMENT)?;
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("{} cannot be made", args.output.display()))?;
    let model_path = args.output.join("model.toml");
    let tables_path = args.output.join("tables.rs");

    if campaign.recordings.len() < 3 {
        bail!(
            "{} has {} recordings: the story needs three, one of which is put aside",
            folder.display(),
            campaign.recordings.len()
        );
    }
    let held_out = campaign.recordings.pop().context("no recording")?;
    show::page(&format!(
        "1. The recordings. {} recordings of a gripper on a (simulated) bench, {:.0} s each: {} Hall sensors at\n\
         1 kHz, and the force on each by a reference at 100 Hz. Recording {} is put aside: nothing is fitted\n\
         to it.\n\n",
        campaign.recordings.len() + 1,
        campaign.duration_s() / campaign.recordings.len() as f64,
        campaign.sensors().len(),
        held_out.name,
    ))?;

    let options = Options::default();
    let (fits, _) = fit_campaign(&campaign, BaseChoice::Cylinder, None, options)?;
    let provenance = Provenance::of(&campaign, ALIGNMENT.delay_us, options)?;
    let model = ModelFile::of(&campaign, &fits, provenance);
    model.write(&model_path)?;
    show::page(&format!(
        "2. The fit. Magnet, gap, flexures and misalignment of each sensor, from field and reference.\n\n{}\n{}{}\n{}\n",
        fit::report::parameters(&model),
        fit::report::scores(&campaign, &model),
        fit::report::verdict(&model),
        what_it_means(&model),
    ))?;

    let building = progress::bar("building tables", 1);
    let built = build(&model_path, Variant::Fitted)?;
    building.finish_and_clear();
    write_output(&tables_path, source(&built).as_bytes(), MARK)?;
    show::page(&format!(
        "3. The inverse. From three fields to two forces, in integers, as the {} Hz loop of the gripper\n\
         computes it.\n\n{}\n",
        params::SENSE_RATE.value,
        export::report(&built.chosen, &built.header),
    ))?;

    let outcome = replay::outcome(&model_path, &held_out.folder, None, ALIGNMENT)?;
    show::page(&format!(
        "4. The judgement. Recording {}, which the fit has not seen, row by row through the device's own code.\n\n{}\n{}\n{}",
        held_out.name,
        replay::report::forces(&outcome),
        replay::report::beside(&outcome),
        "",
    ))?;
    let options = Options::default();
    story::rest(&story::Told {
        folder,
        campaign: &campaign,
        held_out: &held_out.folder,
        model: &model,
        model_path: &model_path,
        before: &outcome,
        output: &args.output,
        options,
    })?;
    show::page(&closing(&args.output))?;
    Ok(())
}

/// Which axis errs most, and what that means for the forces.
fn what_it_means(model: &ModelFile) -> String {
    let axes = || model.sensors.iter().flat_map(|sensor| &sensor.held_out);
    let of = |letter: &str| {
        pooled_rms(
            axes()
                .filter(|axis| axis.axis == letter)
                .map(|axis| axis.rms_g),
        )
    };
    let (across, along) = (of("x").hypot(of("z")), of("y"));
    if along > 2.0 * across {
        return format!(
            "Something that the fit does not know moves the field along the gap ({along:.1} G, against {across:.1} G in the\n\
             plane of motion). The forces are read in the plane, so they suffer less, as step 4 shows.\n"
        );
    }
    String::new()
}

fn closing(output: &Path) -> String {
    let tables = output.join("tables.rs");
    format!(
        "Everything is in {}:\n\
         models to read, tables.rs for the firmware, report.html for a browser.\n\
         An image with the tables:   MAGPIE_TABLES={} cargo image\n\
         Your own recordings:        cargo magpie fit YOUR-CAMPAIGN -o model.toml\n\
         What they lack:             cargo magpie diagnose model.toml YOUR-CAMPAIGN -o report.html\n",
        output.display(),
        tables.display(),
    )
}
