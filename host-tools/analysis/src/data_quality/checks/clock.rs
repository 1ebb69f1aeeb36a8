//! Timestamps and rows.

use crate::data_quality::checks::{Channel, CheckContext, Found, digits, list, percent};
use crate::data_quality::fix::{Change, Fix, Repair};
use crate::data_quality::scan::column::Quantity;
use crate::data_quality::scan::{Repeats, TableScan};
use model_export::recordings::Location;

/// Timestamps that decrease, an error for the readers.
pub fn backwards<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    context.tables().into_iter().filter_map(|(_, table)| fall(table)).collect()
}

fn fall<'a>(table: &TableScan) -> Option<Found<'a>> {
    let clock = &table.clock;
    let (line, before, after) = clock.first_fall?;
    let times = match clock.falls {
        1 => "once".to_owned(),
        n => format!("{n} times"),
    };
    let sortable = clock.can_be_sorted();
    let advice = match (sortable, clock.copies) {
        (true, 0) => "sorting by time fixes it: look for a logger that mixes up its buffers",
        (true, _) => {
            "some rows are duplicates: sorting by time and removing the duplicates fixes it; look for a logger that sends a buffer twice"
        }
        (false, _) => {
            "too many rows to sort safely: split the recording here if the clock was reset, or remove the rows with a wrong time"
        }
    };
    let message = format!(
        "the clock runs backwards {times}, first here from {before} to {after} us, and {} of {} rows are earlier than one before them; {advice}",
        clock.late, clock.rows
    );
    let mut repairs = vec![Change::SortRows];
    if clock.copies > 0 {
        repairs.push(Change::DropCopies);
    }
    let fix = sortable.then(|| fix(table, "puts the rows in order of time", repairs));
    let place = Location::file(&table.path).line(line).column("t_us");
    Some(Found::new(place, message).stopping(fix))
}

/// Rows with the time of the previous row, an error for the readers.
pub fn duplicates<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let ordered = context.tables().into_iter().filter(|(_, table)| table.clock.falls == 0);
    ordered.filter_map(|(_, table)| copies(table)).collect()
}

fn copies<'a>(table: &TableScan) -> Option<Found<'a>> {
    let clock = &table.clock;
    let (copies, clashes) = (clock.copies, clock.clashes);
    let rows = |count: u64| match count {
        1 => "1 row has".to_owned(),
        n => format!("{n} rows have"),
    };
    let message = match (copies, clashes) {
        (0, 0) => return None,
        (_, 0) => format!(
            "{} the time of the previous row, first here, and identical cells; remove them and look for a logger that writes a row twice",
            rows(copies)
        ),
        (0, _) => format!(
            "{} the time of the previous row, first here, but different cells, so the correct row is unknown: look for a clock that is too coarse, or for two merged streams",
            rows(clashes)
        ),
        _ => format!(
            "{} the time of the previous row, first here: {copies} with identical cells, {clashes} with different ones, of which the correct row is unknown",
            rows(copies + clashes)
        ),
    };
    let fix = (clashes == 0)
        .then(|| fix(table, "removes rows that are exact duplicates", vec![Change::DropCopies]));
    let place = Location::file(&table.path).line(clock.first_copy).column("t_us");
    Some(Found::new(place, message).stopping(fix))
}

fn fix(table: &TableScan, words: &str, changes: Vec<Change>) -> Fix {
    let repair = |change| Repair { file: table.path.clone(), change };
    Fix { words: words.to_owned(), repairs: changes.into_iter().map(repair).collect() }
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
    let message = format!(
        "{} in the clock {}, {} of the total time; the longest here, from {} s on: {} ms where rows are {} ms apart. Rows next to a gap are excluded; look for lost transfers or a blocked logger",
        match gaps {
            1 => "1 gap".to_owned(),
            n => format!("{n} gaps"),
        },
        context.recordings_in(hit.iter().map(|(recording, _)| *recording)),
        percent(lost_s / span_s),
        digits(worst.second(from_us)),
        digits(1e-3 * step_us),
        digits(1e-3 * worst.clock.period_us),
    );
    Some(Found::new(Location::file(&worst.path).line(line).column("t_us"), message))
}

/// Repeated rows below this share are harmless.
const NOTICEABLE: f64 = 0.01;
/// Minimum ratio of the observed to the expected share of repeated rows.
const BEYOND_CHANCE: f64 = 10.0;

/// Sensors that are read less often than rows are written.
pub fn repeated_samples<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let hit: Vec<(usize, &TableScan, &Repeats)> = context
        .tables()
        .into_iter()
        .filter(|(_, table)| !context.has("stuck_channel", table))
        .flat_map(|(recording, table)| {
            let sensors = table.repeats.iter();
            sensors
                .filter(|repeats| has_repeats(table, repeats))
                .map(move |repeats| (recording, table, repeats))
        })
        .collect();
    let worst = hit.iter().max_by(|(_, _, a), (_, _, b)| a.share().total_cmp(&b.share()));
    let Some((_, worst, repeats)) = worst else { return Vec::new() };
    let mut sensors: Vec<u32> = hit.iter().map(|(_, _, repeats)| repeats.sensor).collect();
    sensors.sort_unstable();
    sensors.dedup();
    let whose = if sensors.len() == worst.repeats.len() {
        "of every sensor".to_owned()
    } else {
        let names: Vec<String> = sensors.iter().map(|sensor| format!("s{sensor}")).collect();
        format!("of {}", list(&names.iter().map(String::as_str).collect::<Vec<_>>()))
    };
    let rate_hz = 1e6 / worst.clock.period_us * (1.0 - repeats.share());
    let message = format!(
        "{} of the rows repeat the previous field {whose} {}, where noise alone gives {}: the sensors are read less often than rows are written, about {} times a second. Averages then contain fewer independent samples than rows, and the field is delayed by half the repetition; read the sensors once per row, or write one row per sample",
        percent(repeats.share()),
        context.recordings_in(hit.iter().map(|(recording, _, _)| *recording)),
        percent(repeats.by_chance()),
        digits(rate_hz),
    );
    vec![Found::new(Location::file(&worst.path).line(repeats.line), message)]
}

/// True where noise should have changed the axes of a sensor in many rows but did not.
fn has_repeats(table: &TableScan, repeats: &Repeats) -> bool {
    let noisy = table.columns.iter().any(|column| {
        let own =
            matches!(column.quantity, Quantity::Field { sensor, .. } if sensor == repeats.sensor);
        own && column.is_noisy()
    });
    let share = repeats.share();
    noisy && share > NOTICEABLE && share > BEYOND_CHANCE * repeats.by_chance()
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
