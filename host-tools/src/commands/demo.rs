//! `magpie demo`: from raw recordings to forces by the gripper's own code, as a short story.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use firmware::params;
use model_export::effects::{Addition, find};
use model_export::fit::Options;
use model_export::fit::score::pooled_rms;
use model_export::inverse::build::{Variant, build};
use model_export::inverse::emit::{MARK, source};
use model_export::model_file::{ModelFile, Provenance};
use model_export::output::write_output;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;

use super::fit::{BaseChoice, fit_campaign};
use super::{change, export, fit, replay};
use crate::{progress, show};

/// Raw recordings to forces, on a small campaign that comes with the project.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie demo
  cargo magpie demo -o somewhere")]
pub struct Args {
    /// Folder for the model and the tables that the demo writes.
    #[arg(short, long, value_name = "FOLDER", default_value = "magpie-demo")]
    output: PathBuf,
}

/// The campaign of the demo, in the checkout that this tool was built from.
const CAMPAIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/demo");

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let folder = Path::new(CAMPAIGN);
    let alignment = Alignment { delay_us: 0.0 };
    let reading = progress::bar("reading recordings", 3);
    let mut campaign = Campaign::read(folder, alignment, |_| reading.inc(1))
        .context("the demo's recordings lie in the project's checkout (tests/data/demo)")?;
    reading.finish_and_clear();
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("{} cannot be made", args.output.display()))?;
    let model_path = args.output.join("model.toml");
    let tables_path = args.output.join("tables.rs");

    let held_out = campaign
        .recordings
        .pop()
        .context("the demo's campaign is empty")?;
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
    let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
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

    let outcome = replay::outcome(&model_path, &held_out.folder, alignment)?;
    show::page(&format!(
        "4. The judgement. Recording {}, which the fit has not seen, row by row through the device's own code.\n\n{}\n{}\n{}",
        held_out.name,
        replay::report::forces(&outcome),
        replay::report::beside(&outcome),
        "",
    ))?;
    let better_path = args.output.join("better.toml");
    better(campaign, &model, &held_out.folder, &outcome, &better_path)?;
    show::page(&closing(&better_path, &tables_path))?;
    Ok(())
}

/// The effect that the demo's campaign lacks.
const MISSING: &str = "neighbour_magnet";

/// Adds the missing effect and replays the recording that was put aside once more.
fn better(
    campaign: Campaign,
    model: &ModelFile,
    held_out: &Path,
    before: &replay::Outcome,
    path: &Path,
) -> Result<()> {
    let effect = find(MISSING)?;
    let alignment = Alignment { delay_us: 0.0 };
    let added = vec![Addition::Catalogue(effect)];
    let change = change::compute(
        campaign,
        model,
        Vec::new(),
        added,
        alignment,
        Options::default(),
    )?;
    change.model.write(path)?;
    let after = replay::outcome(path, held_out, alignment)?;
    show::page(&format!(
        "5. The missing effect: {MISSING}.\n\n{}\n{}\n{}{}\
         The recording that was put aside, by the device's code: {:.3} N -> {:.3} N RMSE over all forces.\n\n",
        show::paragraph(effect.physics),
        change::report::effects(&change),
        change::report::summary(&change),
        show::paragraph(&change::report::verdict(&change)),
        replay::report::rmse_n(&before.fitted),
        replay::report::rmse_n(&after.fitted),
    ))?;
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

fn closing(model: &Path, tables: &Path) -> String {
    format!(
        "Written: {} (to read), {} (for the firmware).\n\
         Try others:                 cargo magpie effects\n\
         An image with the tables:   MAGPIE_TABLES={} cargo image\n\
         Your own recordings:        cargo magpie fit YOUR-CAMPAIGN -o model.toml\n",
        model.display(),
        tables.display(),
        tables.display(),
    )
}
