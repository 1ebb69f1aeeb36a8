//! Findings about columns, with an unambiguous correction where there is one.

use std::collections::BTreeSet;

use model_export::recordings::{Campaign, Location};

use crate::data_quality::checks::Found;
use crate::data_quality::evidence::{ColumnError, Evidence, RecordingSet};
use crate::data_quality::fix::{Change, Fix, FixKind, Repair};
use crate::data_quality::model_checks::hypothesis::{self, Hypothesis, Verdict, own_forces};
use crate::data_quality::model_checks::{ModelResiduals, Names};
use model_export::recordings::columns::force_column_name;

/// Column errors of a hypothesis for one sensor in one recording.
#[derive(Default)]
struct ColumnErrors {
    columns: Vec<(String, ColumnError)>,
    /// Corrections; empty where ambiguous.
    repairs: Vec<Repair>,
}

/// Column errors with this identifier, each over all its sensors and recordings.
pub fn column_errors<'a>(residuals: &ModelResiduals<'a>, id: &str) -> Vec<Found<'a>> {
    let groups = residuals.column_errors.iter().filter(|group| group[0].id() == id);
    groups.map(|group| describe(residuals.campaign, &residuals.names, id, group)).collect()
}

fn describe<'a>(campaign: &Campaign, names: &Names, id: &str, group: &[Verdict]) -> Found<'a> {
    let errors: Vec<ColumnErrors> =
        group.iter().map(|verdict| errors_of(names, verdict, &verdict.best.hypothesis)).collect();
    let first = &group[0];
    let worst = |of: &dyn Fn(&Verdict) -> f64| group.iter().map(of).fold(0.0, f64::max).sqrt();
    let others = first.others.iter();
    let evidence = Evidence::ColumnErrors {
        columns: errors.iter().flat_map(|errors| errors.columns.clone()).collect(),
        recordings: recordings(campaign, group),
        before_g: worst(&|verdict| verdict.before),
        after_g: worst(&|verdict| verdict.best.left),
        alternatives: others.map(|other| errors_of(names, first, other).columns).collect(),
        is_unit: id == "wrong_unit",
    };
    let fix = if first.others.is_empty() { repair(id, &errors) } else { None };
    let is_force =
        matches!(first.best.hypothesis, Hypothesis::Forces(_) | Hypothesis::ForceUnit(_));
    let file = if is_force { names.force(first.recording) } else { names.hall(first.recording) };
    let place = Location::file(&file).line(1);
    let place = match errors[0].columns.first() {
        Some((column, _)) => place.column(column.as_str()),
        None => place,
    };
    Found::new(place, evidence).stopping(fix)
}

fn recordings(campaign: &Campaign, group: &[Verdict]) -> RecordingSet {
    let hit = group.iter().map(|verdict| verdict.recording);
    RecordingSet::of(hit, campaign.recordings.iter().map(|recording| &recording.name))
}

/// Corrections of all columns, if none is lost.
fn repair(id: &str, errors: &[ColumnErrors]) -> Option<Fix> {
    let repairs: Vec<Repair> = errors.iter().flat_map(|errors| errors.repairs.clone()).collect();
    let files: BTreeSet<_> = repairs.iter().map(|repair| repair.file.clone()).collect();
    let keeps_all = files.iter().all(|file| {
        let ends = |of: &dyn Fn(&Change) -> Option<String>| -> Vec<String> {
            let own = repairs.iter().filter(|repair| repair.file == *file);
            let mut ends: Vec<String> = own.filter_map(|repair| of(&repair.change)).collect();
            ends.sort();
            ends
        };
        let to = ends(&|change| match change {
            Change::Take { to, .. } => Some(to.clone()),
            _ => None,
        });
        let from = ends(&|change| match change {
            Change::Take { from, .. } => Some(from.clone()),
            _ => None,
        });
        to == from
    });
    let sure = keeps_all && errors.iter().all(|errors| !errors.repairs.is_empty());
    let kind = match id {
        "wrong_unit" => FixKind::ConvertColumns,
        "axis_flipped" | "force_flipped" => FixKind::NegateColumns,
        _ => FixKind::ReorderColumns,
    };
    sure.then_some(Fix { kind, repairs })
}

fn errors_of(names: &Names, verdict: &Verdict, hypothesis: &Hypothesis) -> ColumnErrors {
    match hypothesis {
        Hypothesis::Axes(turned) => {
            let name = |axis: usize| names.field(verdict.recording, verdict.sensor, axis);
            let axes = (0..3).map(|axis| (name(axis), name(turned.from[axis]), turned.sign[axis]));
            exchanged(names.hall(verdict.recording), axes)
        }
        Hypothesis::OfSensor(other) => {
            let own = |axis: usize| names.field(verdict.recording, verdict.sensor, axis);
            let theirs = |axis: usize| names.field(verdict.recording, *other, axis);
            let axes = (0..3).map(|axis| (own(axis), theirs(axis), 1.0));
            exchanged(names.hall(verdict.recording), axes)
        }
        Hypothesis::Forces(sources) => {
            let axes = own_forces(verdict.sensor).into_iter().zip(sources);
            let axes = axes.map(|(own, (source, sign))| {
                (force_column_name(own), force_column_name(*source), *sign)
            });
            exchanged(names.force(verdict.recording), axes)
        }
        Hypothesis::FieldUnit(factor) => field_unit(names, verdict, *factor),
        Hypothesis::ForceUnit(factors) => force_unit(names, verdict, *factors),
    }
}

/// Exchanged columns: recorded name, correct name, sign.
fn exchanged(
    file: std::path::PathBuf,
    axes: impl Iterator<Item = (String, String, f64)>,
) -> ColumnErrors {
    let (mut columns, mut repairs) = (Vec::new(), Vec::new());
    for (to, from, sign) in axes {
        let negated = sign < 0.0;
        let error = match (to == from, negated) {
            (true, false) => continue,
            (true, true) => ColumnError::OtherSign,
            (false, _) => ColumnError::RecordedAs { column: from.clone(), negated },
        };
        columns.push((to.clone(), error));
        repairs.push(Repair {
            file: file.clone(),
            change: Change::Take { to, from, negate: negated },
        });
    }
    ColumnErrors { columns, repairs }
}

fn field_unit(names: &Names, verdict: &Verdict, factors: [f64; 3]) -> ColumnErrors {
    let raw = names.is_raw(verdict.recording, verdict.sensor);
    let mut errors = ColumnErrors::default();
    for (axis, factor) in factors.into_iter().enumerate().filter(|(_, factor)| *factor != 1.0) {
        let column = names.field(verdict.recording, verdict.sensor, axis);
        let error = match hypothesis::field_unit(factor).filter(|_| !raw) {
            Some((name, exact)) => {
                let file = names.hall(verdict.recording);
                errors.repairs.push(Repair::convert(&file, &column, exact, 0.0));
                ColumnError::FieldUnit(name)
            }
            None => ColumnError::FieldFactor { factor: 1.0 / factor, in_counts: raw },
        };
        errors.columns.push((column, error));
    }
    errors
}

fn force_unit(names: &Names, verdict: &Verdict, factors: [f64; 2]) -> ColumnErrors {
    let mut errors = ColumnErrors::default();
    let mut sure = true;
    for ((_, axis), factor) in own_forces(verdict.sensor).into_iter().zip(factors) {
        if factor == 1.0 {
            continue;
        }
        let column = force_column_name((verdict.sensor, axis));
        let error = match hypothesis::force_unit(factor) {
            Some((name, exact)) => {
                let file = names.force(verdict.recording);
                errors.repairs.push(Repair::convert(&file, &column, exact, 0.0));
                ColumnError::ForceUnit(name)
            }
            None => {
                sure = false;
                ColumnError::ForceFactor(1.0 / factor)
            }
        };
        errors.columns.push((column, error));
    }
    if !sure {
        errors.repairs.clear();
    }
    errors
}
