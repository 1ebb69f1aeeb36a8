//! `magpie replay`: a campaign through the device's own code.

mod networks;
pub mod report;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use firmware::params;
use model_export::inverse::build::{Built, Variant, build};
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::grbf::Grbf;
use model_export::inverse::quantise::TableSet;
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, name_of, recording_folders};
use model_export::recordings::description::{Description, Design};
use model_export::recordings::raw::RawStream;

use super::clocks::Clocks;
use crate::networks::Networks;
use crate::replay::{Models, RecordingReplay, replay};
use crate::{progress, show};

/// Run every row of a campaign through the code of the gripper, beside the reference.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie replay model.toml tests/data/clean
  cargo magpie replay model.toml my-campaign --network network.safetensors
  cargo magpie replay model.toml tests/data/clean --json | jq '.sensors'")]
pub struct Args {
    /// Model file, as `magpie fit` writes it.
    model: PathBuf,
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    /// Recurrent networks behind the model, as `magpie train` writes them.
    #[arg(long, value_name = "NETWORK")]
    network: Option<PathBuf>,
    #[command(flatten)]
    clocks: Clocks,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let outcome = outcome(
        &args.model,
        &args.campaign,
        args.network.as_deref(),
        args.clocks.alignment()?,
    )?;
    let text = match args.json {
        true => format!("{}\n", report::json(&outcome)),
        false => report::text(&outcome),
    };
    show::page(&text)?;
    Ok(())
}

/// A campaign replayed by one model and, beside it, by simpler ones.
pub struct Outcome {
    /// The fitted radial basis functions.
    pub fitted: Vec<RecordingReplay>,
    /// The best linear model of the same fit.
    pub linear: Vec<RecordingReplay>,
    /// Radial basis functions of the nominal design: the paper's ideal model.
    pub nominal: Vec<RecordingReplay>,
    /// The fitted functions with nothing undone around them, where the model has effects.
    pub uncompensated: Option<Vec<RecordingReplay>>,
    /// The fitted functions without the networks, where there are some.
    pub alone: Option<Vec<RecordingReplay>>,
    /// Names of recordings that the model was fitted to, or a network learned from.
    pub seen: Vec<String>,
    /// Force that each axis is designed for, either way, in newtons.
    pub force_range_n: f64,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// Replays `campaign` by the model at `model`, with the networks at `network` behind it.
pub fn outcome(
    model: &Path,
    campaign: &Path,
    network: Option<&Path>,
    alignment: Alignment,
) -> Result<Outcome> {
    let building = progress::bar("building tables", 2);
    let built = build(model, Variant::Fitted)?;
    let networks = network
        .map(|path| Networks::read(path, &built))
        .transpose()?;
    let Built {
        model: file,
        chosen: fitted,
        compensations,
        left,
        header,
    } = built;
    building.inc(1);
    let nominal = build(model, Variant::Nominal)?.chosen;
    building.finish_and_clear();
    let folders = recording_folders(campaign)?;
    let scale = file.sensor_scale;
    let mut notes = differences(&folders, &file, alignment)?;
    notes.extend(
        left.iter()
            .map(|(effect, why)| format!("{effect} is not undone: {why}")),
    );
    let linear = TableSet::build(
        fitted.tables.id,
        &fitted.linear,
        &header.sensors,
        scale.gauss_per_lsb,
        scale.range_gauss,
    )?;
    let run = |tables: &TableSet,
               float: &[Grbf],
               compensations: &[OwnedCompensation],
               networks: Option<&Networks>| {
        let models = Models {
            numbers: &header.sensors,
            tables,
            compensations,
            design: file.design.as_ref(),
            float,
            gauss_per_lsb: scale.gauss_per_lsb,
            networks,
        };
        replay_all(&folders, models, alignment)
    };
    let alone = |tables: &TableSet, float: &[Grbf], compensations: &[OwnedCompensation]| {
        run(tables, float, compensations, None)
    };
    let replayed = run(
        &fitted.tables,
        &fitted.models,
        &compensations,
        networks.as_ref(),
    )?;
    let sensors = || replayed.iter().flat_map(|recording| &recording.sensors);
    if sensors().count() == 0 {
        bail!(
            "{}: no sensor of the model has its field and both its forces in these recordings",
            campaign.display()
        );
    }
    if sensors().all(|sensor| sensor.axes[0].error.rows() == 0.0) {
        bail!(
            "{}: in no row are a valid estimate and a measured force together; check that force.csv is filled, and the scale and unit of hall.csv",
            campaign.display()
        );
    }
    for number in &header.sensors {
        if !sensors().any(|sensor| sensor.number == *number) {
            notes.push(format!("sensor {number} of the model was not replayed: its field or its forces are not in these recordings"));
        }
    }
    let lacking: u64 = sensors().map(|sensor| sensor.lacking).sum();
    if lacking > 0 {
        notes.push(format!(
            "in {lacking} estimates an effect could not be undone, since the column that it needs was not recorded; the model has {}",
            header.effects.join(", ")
        ));
    }
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    Ok(Outcome {
        linear: alone(&linear, &fitted.linear, &[])?,
        nominal: alone(&nominal.tables, &nominal.models, &[])?,
        uncompensated: match header.effects.is_empty() {
            true => None,
            false => Some(alone(&fitted.tables, &fitted.models, &[])?),
        },
        alone: match networks {
            None => None,
            Some(_) => Some(alone(&fitted.tables, &fitted.models, &compensations)?),
        },
        fitted: replayed,
        seen: seen(&folders, &file, networks.as_ref())?,
        force_range_n: file
            .design
            .as_ref()
            .map_or(params::FORCE_RANGE.value, Design::force_range_n),
        notes,
    })
}

/// Where the recordings are not of the gripper, or not aligned, as the model's were.
fn differences(
    folders: &[PathBuf],
    model: &ModelFile,
    alignment: Alignment,
) -> Result<Vec<String>> {
    let mut notes = Vec::new();
    let (fitted_ms, delay_ms) = (model.provenance.delay_ms, 1e-3 * alignment.delay_us);
    if delay_ms != fitted_ms {
        notes.push(format!(
            "the model was fitted with --delay-ms {fitted_ms}, this replay has {delay_ms}"
        ));
    }
    for folder in folders {
        let (description, _) = Description::read(folder)?;
        same_scale(folder, &description, model)?;
        if description.design != model.design {
            notes.push(format!(
                "{}: [design] is not that of the model: is it the same gripper?",
                folder.display()
            ));
        }
    }
    Ok(notes)
}

/// Refuses a recording on another scale than that which the model's tables are for.
pub fn same_scale(folder: &Path, description: &Description, model: &ModelFile) -> Result<()> {
    let (own, stated) = (model.sensor_scale.gauss_per_lsb, description.gauss_per_lsb);
    if let Some(other) = stated.filter(|other| *other != own) {
        bail!(
            "{}: gauss_per_lsb is {other}, and the model's tables are for {own}; fit these recordings, or correct recording.toml",
            folder.display()
        );
    }
    Ok(())
}

/// Replays one recording after the other, on one core.
pub fn replay_all(
    folders: &[PathBuf],
    models: Models,
    alignment: Alignment,
) -> Result<Vec<RecordingReplay>> {
    let bar = progress::rows("replaying");
    let mut replays = Vec::new();
    for folder in folders {
        let (description, _) = Description::read(folder)?;
        let stream = RawStream::open(folder, &description, alignment)?;
        let before = bar.position();
        replays.push(replay(models, &name_of(folder), stream, |rows| {
            bar.set_position(before + rows)
        })?);
    }
    bar.finish_and_clear();
    Ok(replays)
}

fn seen(
    folders: &[PathBuf],
    model: &ModelFile,
    networks: Option<&Networks>,
) -> Result<Vec<String>> {
    let mut seen = Vec::new();
    for folder in folders {
        let hash = fingerprint(folder)?;
        let mut fitted = model.provenance.recordings.iter();
        let learned = networks.is_some_and(|networks| networks.learned_from(&hash));
        if learned || fitted.any(|recording| recording.sha256 == hash) {
            seen.push(name_of(folder));
        }
    }
    Ok(seen)
}
