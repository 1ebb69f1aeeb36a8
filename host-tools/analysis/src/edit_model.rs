//! A model refitted with other effects: the error before and after.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, anyhow, bail};
use model_export::effects::catalogue::{NEIGHBOUR_MAGNET, SCREW_BACKLASH};
use model_export::effects::excitation::{BUILT_IN_COVARIATES, source_column};
use model_export::effects::expression::ParameterRange;
use model_export::effects::{EffectTerm, Expression};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::effect_size::{EffectSize, effect_sizes};
use model_export::fit::joint::JointFit;
use model_export::input::MAX_EFFECTS;
use model_export::inverse::device_support::{DeviceSupport, device_support};
use model_export::model_file::{self, BaseKind, ModelFile, Provenance};
use model_export::output::{Output, Overwrite};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;

use crate::compare::ForceError;
use crate::compare::campaign_reader::check_distinct;
use crate::compare::force_errors::held_out_forces;
use crate::model::Model;
use crate::notes::{MissingForces, Note, UncompensatedEffect, collect};
use crate::progress;

/// A model before and after an edit of its effects, both refitted on the same recordings.
pub struct ModelEdit {
    /// The recordings.
    pub campaign: Campaign,
    pub before: (Vec<EffectTerm>, JointFit),
    pub after: (Vec<EffectTerm>, JointFit),
    /// Magnitudes of the effects after.
    pub sizes: Vec<EffectSize>,
    pub model: ModelFile,
    /// Held-out force errors before and after; `None` if the base has no inverse or an effect no compensation.
    pub force: Option<[ForceError; 2]>,
    /// Whether the device compensates the effects after.
    pub device: Vec<DeviceSupport>,
    /// Effects that the device does not compensate.
    pub uncompensated: Vec<UncompensatedEffect>,
    /// Notes on the recordings and on the effects.
    pub notes: Vec<Note>,
}

/// Refits a model with its effects and with the effects `after`.
pub fn refit(
    campaign: Campaign,
    model: &Model,
    after: Vec<EffectTerm>,
    alignment: Alignment,
    options: FitOptions,
) -> Result<ModelEdit> {
    collect(|notes| {
        let before = model.effects.clone();
        let prepared = model.file.fit_setup(&campaign, options)?;
        let constant = check_effects(&after, model.file.base, &campaign, &prepared)?;
        let notices = campaign.notices().chain(&prepared.notices);
        notes.extend(notices.cloned().map(Note::Recording).chain(constant));
        notes.extend(Note::other_design(&campaign, &model.file));
        notes.extend(Note::other_delay(&model.path, &model.file, alignment));
        let all: Vec<EffectTerm> = before.iter().chain(&after).cloned().collect();
        let split = prepared.split(&all);
        let bar =
            progress::progress_bar("fitting sensors, before and after", 2 * prepared.rows.len());
        let fit = |effects: &[EffectTerm]| prepared.fit(effects, split, options, |_| bar.inc(1));
        let (old, mut new) = (fit(&before)?, fit(&after)?);
        prepared.search_profiles(&mut new, &after);
        bar.finish_and_clear();
        let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
        let sources = provenance.recordings.iter();
        check_distinct(&provenance.campaign, sources.clone().map(|r| (&*r.name, &*r.sha256)))?;
        notes.extend(Note::other_recordings(
            &model.file,
            sources.map(|recording| &*recording.sha256),
        ));
        let bar = progress::progress_bar("replaying, before and after", 1);
        let fits = [(&old, before.as_slice()), (&new, after.as_slice())];
        let forces =
            held_out_forces((&campaign, &[]), &prepared, &fits, alignment, false, options)?;
        bar.finish_and_clear();
        let mut forces = forces.into_iter();
        let mut next = || forces.next().unwrap_or_default();
        let (before_n, after_n) = (next(), next());
        let missing = before_n.none.as_ref().or(after_n.none.as_ref());
        match missing {
            Some(MissingForces::NotCompensable(why)) => {
                notes.push(Note::NotCompensable(why.clone()));
            }
            Some(why @ (MissingForces::NotInvertible(_) | MissingForces::NotRepresentable(_))) => {
                notes.push(Note::NoForces(why.clone()));
            }
            _ => {}
        }
        let written = ModelFile::with_effects(&campaign, &prepared, &new, &after, provenance);
        let force = before_n.error.zip(after_n.error);
        Ok(ModelEdit {
            force: force.map(|(before, after)| [before, after]),
            uncompensated: after_n.uncompensated,
            sizes: effect_sizes(&new, &after, campaign.recordings.len()),
            device: device_support(&written, &after),
            model: ModelFile { inverse: after_n.shape, ..written },
            before: (before, old),
            after: (after, new),
            campaign,
            notes: std::mem::take(notes),
        })
    })
}

/// The effects of a model without those of these names and with `added`.
///
/// # Errors
/// The model does not have an effect to remove, or has one to add.
pub fn edited_effects(
    model: &Model,
    added: Vec<EffectTerm>,
    removed: &[String],
) -> Result<Vec<EffectTerm>> {
    let (before, place) = (&model.effects, model.path.display());
    let names: Vec<&str> = before.iter().map(EffectTerm::name).collect();
    if let Some(missing) = removed.iter().find(|removed| !names.contains(&removed.as_str())) {
        let available = if names.is_empty() { "no effects".to_owned() } else { names.join(", ") };
        bail!("{place}: the model has no effect {missing}; it has {available}");
    }
    if let Some(present) = added.iter().find(|effect| names.contains(&effect.name())) {
        bail!("{place}: the model already has {}", present.name());
    }
    let kept = before.iter().filter(|effect| !removed.iter().any(|name| name == effect.name()));
    Ok(kept.cloned().chain(added).collect())
}

/// The file of a model that is edited. Its inputs are the recordings, and the effects before and after: an edit may replace the
/// model that it reads.
///
/// # Errors
/// The path holds another file, or the recordings cannot be read.
pub fn edited_output(
    path: &Path,
    model: &Model,
    after: &[EffectTerm],
    campaign: &Campaign,
    overwrite: Overwrite,
) -> Result<Output> {
    let recordings = campaign.recordings.iter().map(|one| one.sha256().map(str::to_owned));
    let mut inputs = recordings.collect::<Result<Vec<_>, _>>()?;
    inputs.extend(model.effects.iter().chain(after).map(|effect| effect.name().to_owned()));
    Ok(Output::check(path, model_file::SIGNATURE, inputs, overwrite)?)
}

/// Parses formulas over these columns; each receives the ranges of the parameters that it contains.
///
/// # Errors
/// A formula is invalid, or no formula contains the parameter of a range.
pub fn parse_formulas(
    formulas: &[String],
    ranges: &[ParameterRange],
    columns: &[String],
) -> Result<Vec<EffectTerm>> {
    let contains = |formula: &str, range: &ParameterRange| {
        let separator = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        formula.split(separator).any(|name| name == range.name)
    };
    for range in ranges {
        if !formulas.iter().any(|formula| contains(formula, range)) {
            bail!("the range of {}: no formula has such a name", range.name);
        }
    }
    let parse = |formula: &String| {
        let own = ranges.iter().filter(|range| contains(formula, range));
        let own: Vec<ParameterRange> = own.cloned().collect();
        let effect =
            Expression::parse(formula, &own, columns).map_err(|error| anyhow!("{error}"))?;
        Ok(EffectTerm::Expression(Arc::new(effect)))
    };
    if formulas.len() > MAX_EFFECTS {
        bail!("there are {} --expr, and the limit is {MAX_EFFECTS}", formulas.len());
    }
    formulas.iter().map(parse).collect()
}

/// Checks that effects are defined and identifiable on these recordings; returns a note for each constant covariate.
pub(crate) fn check_effects(
    effects: &[EffectTerm],
    base: BaseKind,
    campaign: &Campaign,
    prepared: &FitSetup,
) -> Result<Vec<Note>> {
    let mut notes = Vec::new();
    for effect in effects {
        notes.extend(check_identifiable(effect, effects, base, campaign)?);
        check_defined(effect, prepared)?;
    }
    Ok(notes)
}

/// Checks that an effect is identifiable from these recordings; returns a note for each constant covariate.
fn check_identifiable(
    effect: &EffectTerm,
    all: &[EffectTerm],
    base: BaseKind,
    campaign: &Campaign,
) -> Result<Vec<Note>> {
    let name = effect.name();
    if base == BaseKind::Polynomial && effect.stage().needs_geometry() {
        bail!(
            "{name} moves or changes the magnet, but a polynomial has no magnet; use a model with the cylinder base"
        );
    }
    if base == BaseKind::Polynomial && effect.is_function_of_force() {
        bail!(
            "{name} depends on the forces alone, and a polynomial of the forces contains it; fit with a larger --degree"
        );
    }
    if name == SCREW_BACKLASH.id && !all.iter().any(|other| other.name() == NEIGHBOUR_MAGNET.id) {
        bail!(
            "the opening affects the field only through the neighbour's magnet: add neighbour_magnet before {name}, or both together"
        );
    }
    let mut notes = Vec::new();
    for column in effect.needs() {
        if peak_to_peak(campaign, &column)? == 0.0 {
            notes.push(Note::ConstantCovariate {
                column,
                effect: name.to_owned(),
                record: effect.effect().map(|effect| effect.record),
            });
        }
    }
    Ok(notes)
}

/// Fails if a formula is undefined (NaN or infinite) at a row of these recordings.
fn check_defined(effect: &EffectTerm, prepared: &FitSetup) -> Result<()> {
    let EffectTerm::Expression(formula) = effect else {
        return Ok(());
    };
    let mut tracks =
        prepared.rows.iter().flat_map(|rows| rows.parts.iter().map(|part| &part.track));
    match tracks.find_map(|track| formula.first_undefined(track)) {
        Some(place) => bail!(
            "{}: the formula is undefined where {place}; avoid divisions by zero and roots of negative numbers",
            formula.name
        ),
        None => Ok(()),
    }
}

/// Peak-to-peak value of a covariate over all recordings (NaN for computed columns); an error if one lacks it.
fn peak_to_peak(campaign: &Campaign, column: &str) -> Result<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for recording in &campaign.recordings {
        let temperatures = recording.sensors.values().map(|track| &track.temperature_c);
        let columns: Vec<&Vec<f64>> = match column {
            "temp_c" => temperatures.filter(|t| !t.is_empty()).collect(),
            own if BUILT_IN_COVARIATES.contains(&own) => return Ok(f64::NAN),
            _ => {
                let force = recording.force(column).map(|force| &force.newtons);
                recording.covariates.get(source_column(column)).or(force).into_iter().collect()
            }
        };
        if columns.is_empty() {
            let header = if column == "temp_c" { "sN_temp_c" } else { column };
            bail!(
                "{}: {header} was not recorded; without it the effect can be neither identified nor compensated",
                recording.folder.display()
            );
        }
        for value in columns.into_iter().flatten() {
            (low, high) = (low.min(*value), high.max(*value));
        }
    }
    Ok(high - low)
}

/// Catalogue effects by name, then `formulas`; fails on duplicates.
pub fn find_effects(effects: &[String], formulas: &[EffectTerm]) -> Result<Vec<EffectTerm>> {
    let catalogue =
        effects.iter().map(|name| Ok(EffectTerm::Catalogue(model_export::effects::find(name)?)));
    let mut all = catalogue.collect::<Result<Vec<_>>>()?;
    all.extend_from_slice(formulas);
    for (i, effect) in all.iter().enumerate() {
        if all[..i].iter().any(|other| other.name() == effect.name()) {
            bail!("{} was given twice", effect.name());
        }
    }
    Ok(all)
}
