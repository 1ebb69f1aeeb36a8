//! What `add` and `drop` share: the model with other effects, refitted, beside what it was.

pub mod device;
pub mod report;

use std::path::PathBuf;

use anyhow::{Result, bail};
use model_export::effects::Addition;
use model_export::effects::track::OWN;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::joint::JointFit;
use model_export::fit::size::{EffectSize, sizes};
use model_export::model_file::{self, Base, ModelFile, Provenance};
use model_export::output::check_output;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;

use self::device::{Device, Fitted};
use super::clocks::Clocks;
use super::fit::{read_campaign, refuse_copies, say};
use crate::{progress, show};

/// Arguments that both commands take.
#[derive(Debug, clap::Args)]
pub struct Common {
    /// Model file, as `magpie fit` writes it.
    pub model: PathBuf,
    /// Folder of recordings (or one recording) to refit everything on.
    pub campaign: PathBuf,
    /// Where the new model goes; without it nothing is written.
    #[arg(short, long, value_name = "NEW")]
    pub output: Option<PathBuf>,
    /// How the two clocks belong together.
    #[command(flatten)]
    pub clocks: Clocks,
    /// Seed of the bootstrap behind the error bars.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    pub json: bool,
}

/// A model before and after a change of its effects, both refitted on the same recordings.
pub struct Change {
    /// The recordings.
    pub campaign: Campaign,
    /// Effects and fit before.
    pub before: (Vec<Addition>, JointFit),
    /// Effects and fit after.
    pub after: (Vec<Addition>, JointFit),
    /// Sizes of the effects after.
    pub sizes: Vec<EffectSize>,
    /// The new model.
    pub model: ModelFile,
    /// The fall through the device's code; `None` with a base that has no inverse.
    pub device: Option<Device>,
    /// What a person should know.
    pub notices: Vec<String>,
}

/// Reads, refits before and after, prints, writes.
pub fn run(
    common: &Common,
    change: impl Fn(&ModelFile, &[Addition], &Campaign) -> Result<Vec<Addition>>,
) -> Result<()> {
    if let Some(path) = &common.output {
        check_output(path, model_file::MARK)?;
    }
    let model = ModelFile::read(&common.model)?;
    let alignment = common.clocks.alignment()?;
    let options = Options {
        seed: common.seed,
        ..Options::default()
    };
    let campaign = read_campaign(&common.campaign, alignment)?;
    let before = model.additions(&common.model)?;
    let after = beside(&model, change(&model, &before, &campaign)?)?;
    let changed = compute(campaign, &model, before, after, alignment, options)?;
    let text = match common.json {
        true => format!("{}\n", report::json(&changed)),
        false => report::text(&changed),
    };
    show::page(&text)?;
    if let Some(path) = &common.output {
        changed.model.write(path)?;
    }
    if !common.json {
        show::page(&match &common.output {
            Some(path) => format!("Written to {}.\n", path.display()),
            None => "Not written: give -o NEW to keep it.\n".to_owned(),
        })?;
    }
    Ok(())
}

/// Refits a model with the effects `before` and with those `after`.
pub fn compute(
    campaign: Campaign,
    model: &ModelFile,
    before: Vec<Addition>,
    after: Vec<Addition>,
    alignment: Alignment,
    options: Options,
) -> Result<Change> {
    let mut notices: Vec<String> = campaign.notices().map(ToString::to_string).collect();
    let prepared = match model.base {
        Base::Cylinder => Prepared::cylinder(&campaign)?,
        Base::Polynomial => Prepared::polynomial(&campaign, model.degree(), options)?,
    };
    notices.extend(prepared.notices.iter().map(ToString::to_string));
    for effect in &after {
        notices.extend(check(effect, &after, model.base, &campaign)?);
        check_numbers(effect, &prepared)?;
    }
    say(&notices);
    let all: Vec<Addition> = before.iter().chain(&after).cloned().collect();
    let split = prepared.split(&all);
    let fitting = progress::bar("fitting sensors, before and after", 2 * prepared.rows.len());
    let fit = |effects: &[Addition]| prepared.fit(effects, split, options, |_| fitting.inc(1));
    let (old, new) = (fit(&before)?, fit(&after)?);
    fitting.finish_and_clear();
    let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
    refuse_copies(&provenance)?;
    let sides = [(&before, &old), (&after, &new)].map(|(effects, fit)| Fitted { effects, fit });
    let known = notices.len();
    let device = device::judge(
        &campaign,
        &prepared,
        &provenance,
        alignment,
        sides,
        &mut notices,
    )?;
    say(&notices[known..]);
    Ok(Change {
        device,
        sizes: sizes(&new, &after, campaign.recordings.len()),
        model: ModelFile::with_effects(&campaign, &prepared, &new, &after, provenance),
        before: (before, old),
        after: (after, new),
        campaign,
        notices,
    })
}

/// The effects as they act beside the model's base.
fn beside(model: &ModelFile, effects: Vec<Addition>) -> Result<Vec<Addition>> {
    let Some(axes) = model.force_axes() else {
        return Ok(effects);
    };
    let mut all = Vec::new();
    for effect in effects {
        let effect = effect.beside_polynomial(axes);
        if matches!(effect, Addition::Channelwise(_)) && axes == [false; 2] {
            bail!(
                "{} acts through a force on the flexures, and the model takes none",
                effect.name()
            );
        }
        all.push(effect);
    }
    Ok(all)
}

/// Whether these recordings can tell anything of an effect; a notice where they hardly can.
fn check(
    effect: &Addition,
    all: &[Addition],
    base: Base,
    campaign: &Campaign,
) -> Result<Vec<String>> {
    let name = effect.name();
    if base == Base::Polynomial && effect.stage().needs_geometry() {
        bail!(
            "{name} moves or changes the magnet, and a polynomial knows no magnet; use a model with the cylinder base"
        );
    }
    if name == "screw_backlash" && !all.iter().any(|other| other.name() == "neighbour_magnet") {
        bail!(
            "the field feels the opening only through the neighbour's magnet: add neighbour_magnet before {name}, or both together"
        );
    }
    let mut notices = Vec::new();
    for column in effect.needs() {
        let spread = spread(campaign, &column)?;
        if spread == 0.0 {
            notices.push(format!(
                "{column} never moves in these recordings, so {name} cannot be judged from them{}",
                match effect.effect() {
                    Some(effect) => format!(". Record: {}", effect.record),
                    None => String::new(),
                }
            ));
        }
    }
    Ok(notices)
}

/// Refuses a formula that is no number somewhere in these recordings.
fn check_numbers(effect: &Addition, prepared: &Prepared) -> Result<()> {
    let Addition::Expression(formula) = effect else {
        return Ok(());
    };
    let mut tracks = prepared
        .rows
        .iter()
        .flat_map(|rows| rows.parts.iter().map(|part| &part.track));
    match tracks.find_map(|track| formula.no_number(track)) {
        Some(place) => bail!(
            "{}: the formula is no number where {place}; keep it away from divisions by zero and roots of negative numbers",
            formula.name
        ),
        None => Ok(()),
    }
}

/// Peak-to-peak of a covariate over all recordings; an error where one has it not.
fn spread(campaign: &Campaign, column: &str) -> Result<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for recording in &campaign.recordings {
        let temperatures = recording.sensors.values().map(|track| &track.temperature_c);
        let columns: Vec<&Vec<f64>> = match column {
            "temp_c" => temperatures.filter(|t| !t.is_empty()).collect(),
            own if OWN.contains(&own) => return Ok(f64::NAN),
            _ => recording.covariates.get(column).into_iter().collect(),
        };
        if columns.is_empty() {
            let written = if column == "temp_c" {
                "sN_temp_c"
            } else {
                column
            };
            bail!(
                "{}: {written} was not recorded; without it the effect can be neither judged nor undone",
                recording.folder.display()
            );
        }
        for value in columns.into_iter().flatten() {
            (low, high) = (low.min(*value), high.max(*value));
        }
    }
    Ok(high - low)
}

/// The effects of the catalogue and the formulas that a person named.
pub fn named(effects: &[String], formulas: &[Addition]) -> Result<Vec<Addition>> {
    let found = effects
        .iter()
        .map(|name| Ok(Addition::Catalogue(model_export::effects::find(name)?)));
    let mut all = found.collect::<Result<Vec<_>>>()?;
    all.extend_from_slice(formulas);
    for (i, effect) in all.iter().enumerate() {
        if all[..i].contains(effect) {
            bail!("{} was given twice", effect.name());
        }
    }
    Ok(all)
}
