//! Findings about columns as text, with an unambiguous correction where there is one.

use std::collections::BTreeSet;

use model_export::recordings::{Campaign, Location};

use crate::data_quality::checks::{Found, digits, list};
use crate::data_quality::fix::{Change, Fix, Repair};
use crate::data_quality::model_checks::hypothesis::{self, Hypothesis, Verdict, own_forces};
use crate::data_quality::model_checks::{ModelResiduals, Names, force_name};

/// Description of a hypothesis for one sensor in one recording.
#[derive(Default)]
struct ColumnErrors {
    /// Column name and its error.
    columns: Vec<(String, String)>,
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
    let columns: Vec<(String, String)> =
        errors.iter().flat_map(|errors| errors.columns.clone()).collect();
    let worst = |of: &dyn Fn(&Verdict) -> f64| group.iter().map(of).fold(0.0, f64::max).sqrt();
    let mut message = format!(
        "{} {}: the model leaves {} G as recorded and {} G with this corrected (RMS)",
        sentence(&columns),
        recordings(campaign, group),
        digits(worst(&|verdict| verdict.before)),
        digits(worst(&|verdict| verdict.best.left)),
    );
    let mut fix = None;
    if first.others.is_empty() {
        fix = repair(id, &errors);
        message += match (fix.is_some(), id) {
            (true, "wrong_unit") => "; convert the column",
            (true, _) => "; fix the wiring or the logger, and the recorded columns",
            (false, "wrong_unit") => "; determine its unit and convert it",
            (false, _) => "; identify the columns on the setup",
        };
    } else {
        let other = descriptions(names, first);
        message += &format!(
            "; equivalent is that {}: the data cannot decide, so push on one finger by hand and check the signs",
            list(&other.iter().map(String::as_str).collect::<Vec<_>>())
        );
    }
    let is_force =
        matches!(first.best.hypothesis, Hypothesis::Forces(_) | Hypothesis::ForceUnit(_));
    let file = if is_force { names.force(first.recording) } else { names.hall(first.recording) };
    let place = Location::file(&file).line(1);
    let place = match errors[0].columns.first() {
        Some((column, _)) => place.column(column.as_str()),
        None => place,
    };
    Found::new(place, message).stopping(fix)
}

fn descriptions(names: &Names, verdict: &Verdict) -> Vec<String> {
    let others = verdict.others.iter();
    others.map(|other| sentence(&errors_of(names, verdict, other).columns)).collect()
}

/// Groups columns with the same error.
fn sentence(columns: &[(String, String)]) -> String {
    let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
    for (column, instead) in columns {
        match groups.iter_mut().find(|(other, _)| other == instead) {
            Some((_, names)) if names.contains(&column.as_str()) => {}
            Some((_, names)) => names.push(column),
            None => groups.push((instead, vec![column])),
        }
    }
    let parts = groups.iter().map(|(instead, names)| {
        let instead = match names.len() {
            1 => (*instead).to_owned(),
            _ => several(instead),
        };
        format!("{} {instead}", list(names))
    });
    list(&parts.collect::<Vec<_>>().iter().map(String::as_str).collect::<Vec<_>>())
}

/// Plural form.
fn several(instead: &str) -> String {
    let verbs = [("has ", "have "), ("is ", "are ")];
    let found =
        verbs.iter().find_map(|(one, more)| Some(format!("{more}{}", instead.strip_prefix(one)?)));
    found.unwrap_or_else(|| instead.to_owned())
}

fn recordings(campaign: &Campaign, group: &[Verdict]) -> String {
    let hit: BTreeSet<usize> = group.iter().map(|verdict| verdict.recording).collect();
    if hit.len() == campaign.recordings.len() {
        return "throughout".to_owned();
    }
    let names: Vec<&str> = hit.iter().map(|&i| campaign.recordings[i].name.as_str()).collect();
    format!("in recording{} {}", if names.len() == 1 { "" } else { "s" }, list(&names))
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
    let words = match id {
        "wrong_unit" => "converts the columns",
        "axis_flipped" | "force_flipped" => "negates the columns",
        _ => "restores the order of the columns",
    };
    sure.then(|| Fix { words: words.to_owned(), repairs })
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
            let axes =
                axes.map(|(own, (source, sign))| (force_name(own), force_name(*source), *sign));
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
        let instead = match (to == from, sign < 0.0) {
            (true, false) => continue,
            (true, true) => "has the other sign".to_owned(),
            (false, false) => format!("is recorded as {from}"),
            (false, true) => format!("is recorded as {from}, with the other sign"),
        };
        columns.push((to.clone(), instead));
        repairs.push(Repair {
            file: file.clone(),
            change: Change::Take { to, from, negate: sign < 0.0 },
        });
    }
    ColumnErrors { columns, repairs }
}

fn field_unit(names: &Names, verdict: &Verdict, factor: f64) -> ColumnErrors {
    let raw = names.is_raw(verdict.recording, verdict.sensor);
    let unit = hypothesis::field_unit(factor);
    let instead = match (raw, unit) {
        (true, _) => format!(
            "is {} times the model's field (look at gauss_per_lsb in recording.toml: the sensor's range may be another)",
            digits(1.0 / factor)
        ),
        (false, Some((name, _))) => format!("is in {name}, not in gauss"),
        (false, None) => format!("is {} times the model's field", digits(1.0 / factor)),
    };
    let columns = (0..3).map(|axis| names.field(verdict.recording, verdict.sensor, axis));
    let repairs = match unit.filter(|_| !raw) {
        Some((_, exact)) => converted(names.hall(verdict.recording), columns.clone(), exact),
        None => Vec::new(),
    };
    ColumnErrors { columns: columns.map(|column| (column, instead.clone())).collect(), repairs }
}

fn force_unit(names: &Names, verdict: &Verdict, factors: [f64; 2]) -> ColumnErrors {
    let mut errors = ColumnErrors::default();
    let mut sure = true;
    for ((_, axis), factor) in own_forces(verdict.sensor).into_iter().zip(factors) {
        if factor == 1.0 {
            continue;
        }
        let column = force_name((verdict.sensor, axis));
        let instead = match hypothesis::force_unit(factor) {
            Some((name, exact)) => {
                let file = names.force(verdict.recording);
                errors.repairs.extend(converted(file, [column.clone()].into_iter(), exact));
                format!("is in {name}, not in newtons")
            }
            None => {
                sure = false;
                format!("is {} times the force that the model needs", digits(1.0 / factor))
            }
        };
        errors.columns.push((column, instead));
    }
    if !sure {
        errors.repairs.clear();
    }
    errors
}

fn converted(
    file: std::path::PathBuf,
    columns: impl Iterator<Item = String>,
    factor: f64,
) -> Vec<Repair> {
    columns
        .map(|column| Repair {
            file: file.clone(),
            change: Change::Convert { column, factor, offset: 0.0 },
        })
        .collect()
}
