//! Timestamps and rows.

use crate::data_quality::checks::{Channel, CheckContext, Found};
use crate::data_quality::evidence::Evidence;
use crate::data_quality::fix::{Change, Fix, FixKind, Repair};
use crate::data_quality::scan::column::{ColumnScan, Quantity};
use crate::data_quality::scan::{Repeats, TableScan};
use model_export::recordings::Location;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Timestamps that decrease, an error for the readers.
pub fn backwards<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    context.tables().into_iter().filter_map(|(_, table)| fall(table)).collect()
}

fn fall<'a>(table: &TableScan) -> Option<Found<'a>> {
    let clock = &table.clock;
    let (line, before, after) = clock.first_fall?;
    let sortable = clock.can_be_sorted();
    let evidence = Evidence::ClockBackwards {
        falls: clock.falls,
        before_us: before,
        after_us: after,
        late: clock.late,
        rows: clock.rows,
        copies: clock.copies,
        sortable,
    };
    let mut repairs = vec![Change::SortRows];
    if clock.copies > 0 {
        repairs.push(Change::DropCopies);
    }
    let fix = sortable.then(|| fix(table, FixKind::SortRows, repairs));
    let place = Location::file(&table.path).line(line).column("t_us");
    Some(Found::new(place, evidence).stopping(fix))
}

/// Rows with the time of the previous row, an error for the readers.
pub fn duplicates<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let ordered = context.tables().into_iter().filter(|(_, table)| table.clock.falls == 0);
    ordered.filter_map(|(_, table)| copies(table)).collect()
}

fn copies<'a>(table: &TableScan) -> Option<Found<'a>> {
    let clock = &table.clock;
    let (copies, clashes) = (clock.copies, clock.clashes);
    if copies + clashes == 0 {
        return None;
    }
    let evidence = Evidence::DuplicateRows { identical: copies, different: clashes };
    let fix =
        (clashes == 0).then(|| fix(table, FixKind::RemoveDuplicates, vec![Change::DropCopies]));
    let place = Location::file(&table.path).line(clock.first_copy).column("t_us");
    Some(Found::new(place, evidence).stopping(fix))
}

fn fix(table: &TableScan, kind: FixKind, changes: Vec<Change>) -> Fix {
    let repair = |change| Repair { file: table.path.clone(), change };
    Fix { kind, repairs: changes.into_iter().map(repair).collect() }
}

/// Least sampling period in microseconds of loggers of sensors and load cells (assumed); below, the unit of the clock is probably
/// wrong.
const MIN_PERIOD_US: f64 = 20.0;
/// The same of their largest, unless the other table of the recording is as slow: a point by point measurement.
const MAX_PERIOD_US: f64 = 2e6;
/// Ratio of the lengths of both tables from which one of their clocks is in another unit.
const OTHER_UNIT: f64 = 30.0;

/// Sampling periods that no logger of forces has.
pub fn units<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    ["hall.csv", "force.csv"].into_iter().filter_map(|name| unit_of(context, name)).collect()
}

fn unit_of<'a>(context: &CheckContext<'a>, name: &str) -> Option<Found<'a>> {
    let tables = context.tables();
    let is_longer = |recording: usize, table: &TableScan| {
        let mut others = tables.iter().filter(|(of, other)| *of == recording && other.name != name);
        others.any(|(_, other)| table.clock.span_s() > OTHER_UNIT * other.clock.span_s())
    };
    let is_hit = |(recording, table): &&(usize, &TableScan)| {
        let period_us = table.clock.period_us;
        let is_slow = || period_us > MAX_PERIOD_US && is_longer(*recording, table);
        table.name == name && period_us > 0.0 && (period_us < MIN_PERIOD_US || is_slow())
    };
    let hit: Vec<_> = tables.iter().filter(is_hit).collect();
    let (_, first) = hit.first()?;
    let evidence = Evidence::ClockUnit {
        recordings: context.recordings_in(hit.iter().map(|(recording, _)| *recording)),
        period_us: first.clock.period_us,
        duration_s: first.clock.span_s(),
    };
    Some(Found::new(Location::file(&first.path).column("t_us"), evidence))
}

/// Timestamp steps far above the sampling period.
pub fn gaps<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    ["hall.csv", "force.csv"].into_iter().filter_map(|name| gaps_of(context, name)).collect()
}

fn gaps_of<'a>(context: &CheckContext<'a>, name: &str) -> Option<Found<'a>> {
    let hit: Vec<(usize, &TableScan)> = context
        .tables()
        .into_iter()
        .filter(|(_, table)| table.name == name && table.clock.gaps > 0)
        .filter(|(_, table)| !context.has("clock_backwards", table))
        .collect();
    let longest =
        hit.iter().max_by(|(_, a), (_, b)| a.clock.longest.0.total_cmp(&b.clock.longest.0));
    let (_, worst) = longest?;
    let gaps: u64 = hit.iter().map(|(_, table)| table.clock.gaps).sum();
    let lost_s: f64 = hit.iter().map(|(_, table)| 1e-6 * table.clock.lost_us).sum();
    let span_s: f64 = hit.iter().map(|(_, table)| table.clock.span_s()).sum();
    let (step_us, line, from_us) = worst.clock.longest;
    let evidence = Evidence::ClockGaps {
        gaps,
        recordings: context.recordings_in(hit.iter().map(|(recording, _)| *recording)),
        lost: lost_s / span_s,
        from_s: worst.second(from_us),
        longest_ms: 1e-3 * step_us,
        period_ms: 1e-3 * worst.clock.period_us,
    };
    Some(Found::new(Location::file(&worst.path).line(line).column("t_us"), evidence))
}

/// Repeated rows below this share are harmless.
const NOTICEABLE: f64 = 0.01;
/// Minimum ratio of the observed to the expected share of repeated rows.
const BEYOND_CHANCE: f64 = 10.0;

/// Sensors that are read less often than rows are written.
pub fn repeated_samples<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let mut groups: BTreeMap<Vec<u32>, Vec<(usize, &TableScan, &Repeats)>> = BTreeMap::new();
    for (recording, table) in context.tables() {
        if context.recordings[recording].is_table_of_settings || context.has("stuck_channel", table)
        {
            continue;
        }
        let own = table.repeats.iter().filter(|repeats| has_repeats(table, repeats));
        let mut sensors: Vec<u32> = own.clone().map(|repeats| repeats.sensor).collect();
        sensors.sort_unstable();
        groups.entry(sensors).or_default().extend(own.map(|repeats| (recording, table, repeats)));
    }
    groups.iter().filter_map(|(sensors, hit)| repeated(context, sensors, hit)).collect()
}

/// Of the recordings in which these sensors have repeated samples.
fn repeated<'a>(
    context: &CheckContext<'a>,
    sensors: &[u32],
    hit: &[(usize, &TableScan, &Repeats)],
) -> Option<Found<'a>> {
    let worst = hit.iter().max_by(|(_, _, a), (_, _, b)| a.share().total_cmp(&b.share()));
    let (_, worst, repeats) = worst?;
    let is_all = sensors.len() == worst.repeats.len();
    let evidence = Evidence::RepeatedSamples {
        sensors: (!is_all).then(|| sensors.to_vec()),
        recordings: context.recordings_in(hit.iter().map(|(recording, _, _)| *recording)),
        share: repeats.share(),
        by_chance: by_chance(worst, repeats),
        rate_hz: 1e6 / worst.clock.period_us * (1.0 - repeats.share()),
    };
    Some(Found::new(Location::file(&worst.path).line(repeats.line), evidence))
}

/// True where noise should have changed the axes of a sensor in many rows but did not.
fn has_repeats(table: &TableScan, repeats: &Repeats) -> bool {
    let share = repeats.share();
    axes(table, repeats).any(ColumnScan::is_noisy)
        && share > NOTICEABLE
        && share > BEYOND_CHANCE * by_chance(table, repeats)
}

fn axes<'a>(table: &'a TableScan, repeats: &Repeats) -> impl Iterator<Item = &'a ColumnScan> {
    let number = repeats.sensor;
    table.columns.iter().filter(
        move |column| matches!(column.quantity, Quantity::Field { sensor, .. } if sensor == number),
    )
}

/// Share of rows that repeat the one before by chance. Of several axes each shows it in the rows in which another one changed; of one
/// axis it is the probability that two values with its noise are rounded to the same step.
fn by_chance(table: &TableScan, repeats: &Repeats) -> f64 {
    let mut axes = axes(table, repeats);
    match (axes.next(), axes.next()) {
        (Some(only), None) => only.grid.step() / (2.0 * PI.sqrt() * only.noise()),
        _ => repeats.by_chance(),
    }
}

/// True where any sensor of the table has repeated samples.
pub fn any(table: &TableScan) -> bool {
    table.repeats.iter().any(|repeats| has_repeats(table, repeats))
}

/// True for an axis of a sensor with repeated samples.
pub fn hits(seen: &Channel) -> bool {
    let Quantity::Field { sensor, .. } = seen.column.quantity else {
        return false;
    };
    let own = seen.table.repeats.iter().find(|repeats| repeats.sensor == sensor);
    own.is_some_and(|repeats| has_repeats(seen.table, repeats))
}
