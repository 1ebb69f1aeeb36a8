//! `stuck_channel`: a field or a force that does not change, throughout or for a stretch.

use crate::compare::Finding;
use crate::findings::scan::Quantity;
use crate::findings::scan::runs::Run;

use super::{Desk, Seen, by_table, digits, verb};

/// A recording shorter than this many rows may well hold one value only.
const LEAST_ROWS: u64 = 20;
/// A single stay that holds this share of the rows at the extreme value is no limit.
const ONE_STAY: f64 = 0.95;
/// Stretches that begin within this time of each other in microseconds have one cause.
const TOGETHER_US: f64 = 100_000.0;

/// Looks at fields and forces.
pub fn judge(desk: &mut Desk) {
    let measured: Vec<Seen> = desk
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() || one.column.quantity == Quantity::Force)
        .collect();
    let throughout = |one: &&Seen| one.column.rows >= LEAST_ROWS && one.column.span() == 0.0;
    let constant: Vec<Seen> = measured.iter().filter(throughout).copied().collect();
    for seen in by_table(constant) {
        if seen.is_empty() {
            continue;
        }
        let (whole, some): (Vec<Seen>, Vec<Seen>) = seen
            .iter()
            .partition(|one| desk.everywhere(&seen, &one.column.name));
        for (seen, whole) in [(whole, true), (some, false)] {
            if !seen.is_empty() {
                let found = never_changes(desk, &seen, whole);
                desk.findings.push(found);
                desk.explain(&seen);
            }
        }
    }
    let frozen = |one: Seen<'_>| Some(one.column.frozen()?).filter(|run| !is_an_end(&one, run));
    let stretches: Vec<(Seen, Run)> = measured
        .into_iter()
        .filter_map(|one| frozen(one).map(|run| (one, run)))
        .collect();
    for group in together(stretches) {
        let found = frozen_for(desk, &group);
        desk.findings.push(found);
        let seen: Vec<Seen> = group.iter().map(|(one, _)| *one).collect();
        desk.explain(&seen);
    }
}

/// A channel that is cut off stays at its end for as long as the load does.
fn is_an_end(seen: &Seen, run: &Run) -> bool {
    let at_limit = run.value <= seen.column.limits.0 || run.value >= seen.column.limits.1;
    let cut_off = seen.column.cut_off();
    // Noise breaks the stay at a limit into several; a channel that hung at its peak stays once.
    at_limit
        || cut_off.is_some_and(|(value, rows)| {
            value == run.value && (run.rows as f64) < ONE_STAY * rows as f64
        })
}

fn never_changes(desk: &Desk, seen: &[Seen], whole: bool) -> Finding {
    let first = seen[0];
    let end = match seen.iter().any(|one| one.column.at_limit.0 > 0) {
        true => ", the end of its range",
        false => "",
    };
    let message = format!(
        "{} {} {}{end} in every row; a live channel shows its noise: look for a broken wire, a sensor that was not read, or a column filled by hand{}",
        desk.whose(seen),
        verb(seen, "is", "are"),
        digits(first.column.extent.0),
        match whole {
            true => "",
            false => ", and leave that recording out",
        }
    );
    Finding {
        id: "stuck_channel",
        place: first.at(2),
        message,
        stops: whole,
        fix: None,
    }
}

fn frozen_for(desk: &Desk, group: &[(Seen, Run)]) -> Finding {
    let (first, run) = group[0];
    let seen: Vec<Seen> = group.iter().map(|(one, _)| *one).collect();
    let message = format!(
        "{} {} still from {} to {} s, {} rows of the same value ({}), where noise of {} would change it in nearly every row; look for a loose plug or a sensor that hung, and cut the stretch out",
        desk.whose(&seen),
        verb(&seen, "stands", "stand"),
        digits(first.table.second(run.from_us)),
        digits(first.table.second(run.to_us)),
        run.rows,
        digits(run.value),
        digits(first.column.noise()),
    );
    Finding {
        id: "stuck_channel",
        place: first.at(run.line),
        message,
        stops: false,
        fix: None,
    }
}

/// Stretches of one recording that begin together.
fn together<'a>(stretches: Vec<(Seen<'a>, Run)>) -> Vec<Vec<(Seen<'a>, Run)>> {
    let mut groups: Vec<Vec<(Seen, Run)>> = Vec::new();
    for (one, run) in stretches {
        let belongs = |group: &&mut Vec<(Seen, Run)>| {
            let (other, first) = group[0];
            other.table.path == one.table.path && (first.from_us - run.from_us).abs() < TOGETHER_US
        };
        match groups.iter_mut().find(belongs) {
            Some(group) => group.push((one, run)),
            None => groups.push(vec![(one, run)]),
        }
    }
    groups
}
