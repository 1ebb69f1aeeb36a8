//! From a model and a campaign to a [`Comparison`].

use crate::compare::attribution::{Attributor, RankedCovariate};
use crate::compare::bootstrap_bands::BlockBootstrap;
use crate::compare::campaign_reader::CampaignReader;
use crate::compare::checked_campaign::CheckedCampaign;
use crate::compare::cv_plan::CvPlan;
use crate::compare::field_errors::{FieldEvaluation, SensorEvaluation, evaluate_fields};
use crate::compare::force_errors::{ForceEvaluation, ForceTrace, Recordings, evaluate_forces};
use crate::compare::pure_error::{drift_at_rest, pure_error};
use crate::compare::residual_table::{ResidualTable, error_unit, residual_map, worst_intervals};
use crate::compare::{
    Attribution, Comparison, ComparisonProvenance, EffectOrigin, FieldAxisErrors, NoiseFloor, Trace,
};
use crate::data_quality::finding::Finding;
use crate::model::Model;
use crate::noise_floor::NoiseSummary;
use crate::notes::{Note, collect};
use crate::parameters::ParameterTable;
use anyhow::{Result, bail};
use model_export::effects::EffectTerm;
use model_export::effects::excitation::source_column;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::JointFit;
use model_export::model_file::ModelFile;
use model_export::recordings::Location;
use model_export::recordings::columns::Axis;
use model_export::recordings::noise::autocorrelation_rows;
use std::borrow::Cow;
use std::path::Path;

/// Minimum length of a bootstrap block in seconds.
const MIN_BLOCK_S: f64 = 1.0;

/// A fit of a model's effects to all recordings of a campaign, cross-validated as a comparison does.
pub struct ModelRefit {
    /// Rows and base models.
    pub setup: FitSetup,
    pub fit: JointFit,
    /// Held-out errors of the forces, where they were computed with traces.
    pub forces: Option<ForceEvaluation>,
}

/// Compares a model, and a baseline on the same rows, with a campaign. `refit` is a fit of the model to all of its recordings, if
/// known.
///
/// # Errors
/// A recording cannot be read, or model and recordings do not match.
pub fn compare_checked(
    model: &Model,
    baseline: Option<&Model>,
    checked: &CheckedCampaign,
    mut refit: Option<ModelRefit>,
    options: FitOptions,
) -> Result<Comparison> {
    let Some(source) = checked.distinct()? else {
        return Ok(Comparison {
            model: model.path.display().to_string(),
            campaign: checked.folder.display().to_string(),
            findings: checked.findings.clone(),
            ..Comparison::default()
        });
    };
    collect(|notes| {
        let forces = refit.as_mut().and_then(|refit| refit.forces.take());
        let fit = refit.as_ref().map(|refit| (&refit.setup, &refit.fit));
        let of_baseline = baseline.map_or(&[][..], |baseline| &baseline.effects[..]);
        let how = (&checked.findings[..], options);
        let mut comparison = evaluate(model, source, fit, forces, of_baseline, how, notes)?;
        if let Some(baseline) = baseline {
            let evaluated = evaluate(baseline, source, None, None, &model.effects, how, notes)?;
            comparison.other = Some(Box::new(evaluated));
        }
        comparison.findings.clone_from(&checked.findings);
        comparison.notes = std::mem::take(notes);
        Ok(comparison)
    })
}

/// Evaluates one model on checked recordings. `fit` is a fit of it to all of them and `forces` its held-out errors, if known;
/// `compared` are the effects of the model that it is compared with ([`CvPlan::new`]).
///
/// # Errors
/// A recording cannot be read, or model and recordings do not match.
pub(crate) fn evaluate(
    model: &Model,
    source: &CampaignReader,
    fit: Option<(&FitSetup, &JointFit)>,
    forces: Option<ForceEvaluation>,
    compared: &[EffectTerm],
    (findings, options): (&[Finding], FitOptions),
    notes: &mut Vec<Note>,
) -> Result<Comparison> {
    let Model { path, file, effects } = model;
    notes.extend(Note::other_delay(path, file, source.alignment));
    let plan = CvPlan::new(model, source, fit, compared, options)?;
    let mut fields = evaluate_fields(&plan, source, notes)?;
    // A finding covers its column in all recordings; notices of that column are not repeated.
    let is_reported = |place: &Location| {
        let same = |of: &Location| {
            of.file.file_name() == place.file.file_name() && of.column == place.column
        };
        findings.iter().any(|finding| same(&finding.place))
    };
    let unreported = fields.notices.iter().filter(|notice| !is_reported(&notice.location));
    notes.extend(unreported.cloned().map(Note::Recording));
    let known = forces.filter(|forces| {
        plan.is_of_known_fit && file.inverse.is_none_or(|shape| forces.shape == Some(shape))
    });
    let device = match known {
        Some(forces) => forces,
        None => {
            let recordings = Recordings {
                alignment: source.alignment,
                origins_s: &fields.origins_s,
                offsets: &[],
                read: &|place| source.read(place),
            };
            evaluate_forces(&plan, recordings, fields.traces.len())?
        }
    };
    add_forces(&mut fields.traces, device.traces);
    let columns: Vec<ResidualTable> = fields
        .sensors
        .iter_mut()
        .map(|sensor| std::mem::replace(&mut sensor.columns, ResidualTable::new(0, &[])))
        .collect();
    let axes = axes(&fields, &columns);
    check_finite(path, &axes, effects)?;
    notes.extend(other_gripper(&axes));
    let mut without_estimate: Vec<u32> = device
        .errors
        .iter()
        .filter(|force| force.error.rms.is_nan())
        .map(|force| force.sensor)
        .collect();
    without_estimate.dedup();
    notes.extend(without_estimate.into_iter().map(|sensor| Note::NoValidEstimate { sensor }));
    notes.extend(effects.iter().flat_map(|effect| without_column(effect, &columns)));
    let correlation_s = correlation_s(&columns);
    let columns: Vec<ResidualTable> = columns.into_iter().map(ResidualTable::in_newtons).collect();
    let block_s = (3.0 * correlation_s).max(MIN_BLOCK_S);
    let locator = Attributor::new(&columns, block_s);
    let ranked = locator.rank();
    let names: Vec<String> = source.names.iter().map(|named| named.name.clone()).collect();
    let comparison = Comparison {
        model: path.display().to_string(),
        campaign: source.folder.display().to_string(),
        validation: Some(plan.validation.clone()),
        axes,
        forces: device.errors,
        origins: EffectOrigin::of(&file.effects),
        no_forces: device.none,
        located: located(&columns, &locator, &ranked, block_s, options.seed),
        not_recorded: not_recorded(&columns),
        map: match ranked.as_slice() {
            [first, second, ..] => residual_map(&columns, first.covariate, second.covariate),
            _ => None,
        },
        worst: worst_intervals(&columns, &names, &fields.spans_s),
        correlation_s,
        noise: NoiseSummary::of(fields.noise.iter()),
        parameters: ParameterTable::of(file),
        traces: fields.traces,
        histograms: device.histograms,
        provenance: Some(provenance(file, &plan, block_s, options)),
        ..Comparison::default()
    };
    Ok(comparison)
}

/// Adds the forces over time to the fields of the same sensor and recording.
fn add_forces(traces: &mut [Trace], forces: Vec<ForceTrace>) {
    for of in forces {
        let is_same = |one: &&mut Trace| one.recording == of.recording && one.sensor == of.sensor;
        if let Some(trace) = traces.iter_mut().find(is_same) {
            trace.force = of.force;
        }
    }
}

/// Checks that the model gives a field in every row.
fn check_finite(path: &Path, axes: &[FieldAxisErrors], effects: &[EffectTerm]) -> Result<()> {
    let Some(axis) = axes.iter().find(|axis| !axis.error.rms.is_finite()) else { return Ok(()) };
    let names: Vec<&str> = effects.iter().map(EffectTerm::name).collect();
    let of_effects = match names.as_slice() {
        [] => String::new(),
        names => format!(" and its effects ({})", names.join(", ")),
    };
    bail!(
        "{}: the model gives no number for the field of sensor {} along {}: a parameter of this sensor{of_effects} has a value that it cannot have, such as a length or a time of zero; correct it, or fit again",
        path.display(),
        axis.sensor,
        axis.axis.letter()
    )
}

/// Constant difference of most channels, in noise floors, from which a model is probably that of another gripper. The bias that an
/// effect leaves is as large on one axis only.
const OTHER_GRIPPER_FLOORS: f64 = 20.0;

/// A note if most channels have a large constant difference.
fn other_gripper(axes: &[FieldAxisErrors]) -> Option<Note> {
    let floors = axes.iter().map(|axis| axis.error.mean.abs() / axis.floor.total);
    let mut floors: Vec<f64> = floors.filter(|floors| *floors > OTHER_GRIPPER_FLOORS).collect();
    floors.sort_by(f64::total_cmp);
    let is_most = 2 * floors.len() > axes.len();
    is_most.then(|| Note::OtherGripper { floors: floors[floors.len() / 2] })
}

/// A note for each column of an effect that no recording has.
fn without_column(effect: &EffectTerm, sensors: &[ResidualTable]) -> Vec<Note> {
    let is_recorded = |name: &str| {
        let mut columns = sensors.iter().filter_map(|sensor| sensor.column(name));
        columns.any(|column| column.values.iter().any(|value| value.is_finite()))
    };
    let needs = effect.needs();
    let missing = needs.iter().map(|need| source_column(need)).filter(|need| !is_recorded(need));
    let note = |column: &str| Note::EffectWithoutColumn {
        effect: effect.name().to_owned(),
        column: column.to_owned(),
    };
    missing.map(note).collect()
}

fn axes(fields: &FieldEvaluation, columns: &[ResidualTable]) -> Vec<FieldAxisErrors> {
    let of_sensor = |(sensor, columns): (&SensorEvaluation, &ResidualTable)| {
        let (replicates, slow) = (pure_error(columns), drift_at_rest(columns));
        let axis = |(i, axis): (usize, Axis)| {
            let error = sensor.errors[i].statistics();
            let rows = sensor.errors[i].rows().max(1.0);
            let part = |of: usize| (sensor.floor[of][i] / rows).max(0.0).sqrt();
            let total = part(0).hypot(part(2));
            FieldAxisErrors {
                sensor: sensor.sensor,
                axis,
                error,
                floor: NoiseFloor {
                    white: part(0),
                    quantisation: part(1),
                    reference: part(2),
                    slow: slow.map(|slow| slow[i]),
                    replicates: replicates.map(|replicates| replicates[i]),
                    total,
                },
                explainable: (error.rms.powi(2) - total.powi(2)).max(0.0).sqrt(),
            }
        };
        Axis::ALL.into_iter().enumerate().map(axis).collect::<Vec<_>>()
    };
    fields.sensors.iter().zip(columns).flat_map(of_sensor).collect()
}

/// Descriptions of the covariates that no recording has.
fn not_recorded(sensors: &[ResidualTable]) -> Vec<Cow<'static, str>> {
    let all = sensors.first().map_or(&[][..], |sensor| &sensor.covariates).iter();
    let is_missing = |name: &str| {
        let mut columns = sensors.iter().filter_map(|sensor| sensor.column(name));
        columns.all(|column| column.values.iter().all(|value| value.is_nan()))
    };
    let missing = all.filter(|column| !column.of.is_derived() && is_missing(&column.of.name));
    missing.map(|column| column.of.words.clone()).collect()
}

fn located(
    columns: &[ResidualTable],
    locator: &Attributor,
    ranked: &[RankedCovariate],
    block_s: f64,
    seed: u64,
) -> Vec<Attribution> {
    let bands = BlockBootstrap::new(columns, block_s, seed);
    let one = |found: &RankedCovariate| {
        let covariate = &columns.first()?.covariates[found.covariate].of;
        let binning = locator.binnings[found.covariate].as_ref()?;
        Some(Attribution {
            covariate: covariate.name.clone(),
            words: covariate.words.clone(),
            unit: covariate.unit,
            share: found.share,
            alone: found.alone,
            chosen: found.chosen,
            error_unit: error_unit(columns),
            sensors: columns.iter().map(|sensor| sensor.sensor).collect(),
            bins: bands.bins(columns, binning),
        })
    };
    ranked.iter().filter_map(one).collect()
}

/// Maximum integrated autocorrelation time over all channels, in seconds.
pub fn correlation_s(columns: &[ResidualTable]) -> f64 {
    let of_channel = |sensor: &ResidualTable, axis: usize| {
        let (mut sum, mut rows, mut at) = (0.0, 0.0, 0);
        for chunk in sensor.recording.chunk_by(|a, b| a == b) {
            let range = at..at + chunk.len();
            at = range.end;
            let time_s = &sensor.time_s[range.clone()];
            let span_s = time_s.last().zip(time_s.first()).map_or(0.0, |(to, from)| to - from);
            let values: Vec<f64> = sensor.residual[range].iter().map(|r| r[axis]).collect();
            sum += autocorrelation_rows(&values) * span_s;
            rows += chunk.len() as f64;
        }
        sum / f64::max(rows, 1.0)
    };
    let channels = columns.iter().flat_map(|sensor| [0, 1, 2].map(|axis| of_channel(sensor, axis)));
    channels.fold(0.0, f64::max)
}

fn provenance(
    model: &ModelFile,
    plan: &CvPlan,
    block_s: f64,
    options: FitOptions,
) -> ComparisonProvenance {
    let fitted = &model.provenance;
    let recordings = plan.recordings.iter().map(|r| (r.named.name.clone(), r.named.sha256.clone()));
    ComparisonProvenance {
        fitted_campaign: fitted.campaign.clone(),
        fitted_recordings: fitted.recordings.len(),
        fitted_rows: fitted.rows,
        fitted_by: fitted.tool.clone(),
        effects: model.effects.iter().map(|effect| effect.name.clone()).collect(),
        block_s,
        seed: options.seed,
        sensor_scale: model.sensor_scale,
        recordings: recordings.collect(),
    }
}
