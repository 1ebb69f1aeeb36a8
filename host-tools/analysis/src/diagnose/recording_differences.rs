//! Differences between recordings as findings: a reference whose zero was set again, another offset of the field, another place of
//! a magnet. They come before any effect of time: those would follow the steps from recording to recording.

use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::{FitSetup, SEARCH_ROWS};
use model_export::fit::recording_differences::{
    DifferenceCause, PlaceChange, RecordingDifference, place_changes, recording_differences,
};
use model_export::fit::score_test::{CandidateScore, ScoreTest};
use model_export::model_file::ModelFile;
use model_export::recordings::columns::{Axis, force_column_name};
use model_export::recordings::csv_table::table_path;
use model_export::recordings::{Campaign, Location, Recording};
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::compare::AT_FLOOR;
use crate::data_quality::evidence::{Evidence, RecordingOffset};
use crate::data_quality::finding::Finding;
use crate::data_quality::fix::{Fix, FixKind, Repair};
use crate::diagnose::candidates::candidates;
use crate::diagnose::fitted_model::FittedModel;
use crate::model::Model;
use crate::replay::corrections::RecordingOffsets;

/// Identifier of the findings.
pub const ID: &str = "recording_difference";

/// Length in seconds of the blocks of the effects' score test, whose significance is not used.
const BLOCK_S: f64 = 1.0;
/// Fraction by which the squared error with a difference must be lower than with effects, for it to be the cause instead of them.
pub const CLEAR: f64 = 0.02;

/// What differs between the recordings of a campaign.
pub struct Differences {
    pub findings: Vec<Finding>,
    /// What is subtracted from each recording.
    pub offsets: Vec<RecordingOffsets>,
}

/// Whether a difference of the magnets' places is all that the model does not explain: it is then the cause, and not what other
/// effects make of it.
pub fn explains_all([_, with]: [f64; 2]) -> bool {
    with <= AT_FLOOR
}

impl Differences {
    /// Names of what differs.
    pub fn causes(&self) -> Vec<String> {
        let causes = self.findings.iter().filter_map(|finding| match &finding.evidence {
            Evidence::RecordingDifference { cause, .. } => Some(cause.name().to_owned()),
            _ => None,
        });
        causes.collect()
    }

    /// The fits showed that no effect explains as much.
    pub fn set_uncontested(&mut self) {
        for finding in &mut self.findings {
            if let Evidence::RecordingDifference { effects, .. } = &mut finding.evidence {
                effects.clear();
            }
        }
    }
}

/// Differences, and the campaign without them.
pub struct Found {
    pub differences: Differences,
    /// The campaign without those of a zero, and of a place that explains all.
    pub corrected: Campaign,
    /// Effects that explain as much as the differences do.
    pub rivals: Vec<EffectTerm>,
}

/// Differences of a campaign's recordings next to `fitted`; `None` where there are none, or where the model does not fit the campaign
/// better without them. `setup` has its rows, `model` is the file with the base of `fitted`.
pub fn find(
    campaign: &Campaign,
    model: &ModelFile,
    (setup, fitted): (&FitSetup, &FittedModel),
    options: FitOptions,
) -> Option<Found> {
    let values: Vec<Vec<f64>> =
        fitted.fit.sensors.iter().map(|sensor| sensor.values.clone()).collect();
    let (testable, _) = candidates(campaign, Some(model), &fitted.effects, &[]);
    let sample = setup.sampled(SEARCH_ROWS);
    let around = ScoreTest::new(&sample, &fitted.effects, &fitted.fit, BLOCK_S);
    // An event at an instant has more coefficients than the difference, and says less.
    let (scored, scores): (Vec<&EffectTerm>, Vec<CandidateScore>) = testable
        .par_iter()
        .filter(|candidate| !candidate.is_event())
        .filter_map(|candidate| Some((candidate, around.score(candidate)?)))
        .unzip();
    let found = recording_differences(&sample, &fitted.effects, &values, &scores);
    let rivals: Vec<EffectTerm> =
        found.first()?.candidates.iter().map(|&place| scored[place].clone()).collect();
    let offsets = offsets(&found, setup, campaign.recordings.len());
    let mut corrected = campaign.clone();
    corrected.recordings.iter_mut().zip(&offsets).for_each(|(one, of)| correct(one, of));
    let is_place = |one: &&RecordingDifference| {
        one.cause == DifferenceCause::MagnetPlace && explains_all(one.floors)
    };
    let place = found.iter().find(is_place);
    for change in place.iter().flat_map(|one| place_changes(setup, &fitted.effects, &values, one)) {
        move_magnet(&mut corrected.recordings[change.recording], &change);
    }
    let is_corrected =
        place.is_some() || offsets.iter().any(|of_recording| !of_recording.is_empty());
    if !is_corrected && !rivals.is_empty() {
        return None;
    }
    if is_corrected {
        let without = model.fit_setup(&corrected, options).ok()?.sampled(SEARCH_ROWS);
        let error = |setup: &FitSetup| {
            let fit = FittedModel::without_validation(setup, fitted.effects.clone(), options);
            fit.ok().map(|fit| fit.fitted_mean_square())
        };
        if error(&without)? >= error(&sample)? {
            return None;
        }
    }
    let findings = found.iter().map(|one| finding(campaign, one, &rivals)).collect();
    Some(Found { differences: Differences { findings, offsets }, corrected, rivals })
}

/// Findings of [`find`] next to a model, which is fitted to a sample of the campaign's rows; none where these do not determine it.
pub fn next_to(campaign: &Campaign, model: &Model, options: FitOptions) -> Vec<Finding> {
    let setup = model.file.fit_setup(campaign, options);
    let found = setup.ok().and_then(|setup| {
        let sample = setup.sampled(SEARCH_ROWS);
        let fitted =
            FittedModel::without_validation(&sample, model.effects.clone(), options).ok()?;
        find(campaign, &model.file, (&setup, &fitted), options)
    });
    let found = found.filter(|found| found.rivals.is_empty());
    found.map_or_else(Vec::new, |found| found.differences.findings)
}

/// Offsets of each recording; the place of a magnet is none.
fn offsets(
    found: &[RecordingDifference],
    setup: &FitSetup,
    recordings: usize,
) -> Vec<RecordingOffsets> {
    let mut all = vec![RecordingOffsets::new(); recordings];
    for difference in found {
        for one in &difference.differences {
            let Some(offsets) = all.get_mut(one.recording) else { continue };
            match difference.cause {
                DifferenceCause::ReferenceZero => {
                    let place = usize::from(one.axis == Axis::Z);
                    offsets.entry(one.sensor).or_default().reference_n[place] += one.value;
                }
                DifferenceCause::FieldZero => {
                    let rows = setup.rows.iter().find(|rows| rows.sensor == one.sensor);
                    let turned = Vector3::ith(one.axis as usize, one.value);
                    let field = rows.map_or(turned, |rows| rows.orientation.to_sensor(turned));
                    let sum = &mut offsets.entry(one.sensor).or_default().field_g;
                    (0..3).for_each(|axis| sum[axis] += field[axis]);
                }
                DifferenceCause::MagnetPlace => {}
            }
        }
    }
    all
}

/// Removes the offsets from a recording in memory.
fn correct(recording: &mut Recording, offsets: &RecordingOffsets) {
    for (sensor, offset) in offsets {
        for (axis, offset_n) in [Axis::X, Axis::Z].into_iter().zip(offset.reference_n) {
            if let Some(force) = recording.forces.get_mut(&(*sensor, axis)) {
                force.newtons.iter_mut().for_each(|newtons| *newtons -= offset_n);
            }
        }
        if let Some(sensor) = recording.sensors.get_mut(sensor) {
            for field in &mut sensor.field_g {
                (0..3).for_each(|axis| field[axis] -= offset.field_g[axis]);
            }
        }
    }
}

/// Removes what another place of a magnet changes from the fitted rows of a recording in memory.
fn move_magnet(recording: &mut Recording, change: &PlaceChange) {
    let Some(sensor) = recording.sensors.get_mut(&change.sensor) else { return };
    let mut changes = change.rows.iter().peekable();
    for (time_s, field_g) in recording.time_s.iter().zip(&mut sensor.field_g) {
        let Some((_, change_g)) = changes.next_if(|(of, _)| of == time_s) else { continue };
        (0..3).for_each(|axis| field_g[axis] -= change_g[axis]);
    }
}

fn finding(
    campaign: &Campaign,
    difference: &RecordingDifference,
    rivals: &[EffectTerm],
) -> Finding {
    let RecordingDifference { cause, differences, equivalent, floors, .. } = difference;
    let offsets = differences.iter().map(|one| RecordingOffset {
        recording: campaign.recordings[one.recording].name.clone(),
        quantity: quantity(*cause, one.sensor, one.axis),
        value: one.value,
        std_error: one.std_error,
    });
    let repairs = differences.iter().filter(|_| *cause == DifferenceCause::ReferenceZero);
    let repairs: Vec<Repair> = repairs
        .filter_map(|one| {
            let folder = &campaign.recordings[one.recording].folder;
            let column = force_column_name((one.sensor, one.axis));
            let file = table_path(folder, "force.csv").ok()?;
            Some(Repair::convert(&file, &column, 1.0, -one.value))
        })
        .collect();
    Finding {
        id: ID,
        place: Location::file(&campaign.folder),
        evidence: Evidence::RecordingDifference {
            cause: *cause,
            reference: campaign.recordings[0].name.clone(),
            unit: cause.unit(),
            offsets: offsets.collect(),
            equivalent: equivalent.clone(),
            effects: rivals.iter().map(|rival| rival.name().to_owned()).collect(),
            floors: *floors,
        },
        stops: false,
        fix: (!repairs.is_empty()).then_some(Fix { kind: FixKind::AlignZeros, repairs }),
    }
}

/// Name of what differs.
fn quantity(cause: DifferenceCause, sensor: u32, axis: Axis) -> String {
    let letter = axis.letter();
    match cause {
        DifferenceCause::ReferenceZero => force_column_name((sensor, axis)),
        DifferenceCause::FieldZero => format!("B{letter} of sensor {sensor}"),
        DifferenceCause::MagnetPlace => format!("the magnet of sensor {sensor} along {letter}"),
    }
}
