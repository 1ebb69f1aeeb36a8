//! `repeated_samples`: the clock goes on and a sensor does not.

use model_export::recordings::Place;

use crate::compare::Finding;
use crate::findings::scan::repeats::Repeats;
use crate::findings::scan::{Quantity, TableScan};

use super::{Desk, Seen, digits, list, percent};

/// Fewer repeated rows than this share do no harm.
const NOTICEABLE: f64 = 0.01;
/// ... and they must be this many times what chance gives.
const BEYOND_CHANCE: f64 = 10.0;

/// Looks at the board's tables.
pub fn judge(desk: &mut Desk) {
    let hit: Vec<(usize, &TableScan, &Repeats)> = desk
        .tables()
        .into_iter()
        .filter(|(_, table)| !desk.has("stuck_channel", table))
        .flat_map(|(recording, table)| {
            let sensors = table.repeats.iter();
            sensors
                .filter(|repeats| is_held(table, repeats))
                .map(move |repeats| (recording, table, repeats))
        })
        .collect();
    let worst = hit
        .iter()
        .max_by(|(_, _, a), (_, _, b)| a.share().total_cmp(&b.share()));
    let Some((_, worst, repeats)) = worst else {
        return;
    };
    let mut sensors: Vec<u32> = hit.iter().map(|(_, _, repeats)| repeats.sensor).collect();
    sensors.sort_unstable();
    sensors.dedup();
    let whose = match sensors.len() == worst.repeats.len() {
        true => "of every sensor".to_owned(),
        false => {
            let names: Vec<String> = sensors.iter().map(|sensor| format!("s{sensor}")).collect();
            format!(
                "of {}",
                list(&names.iter().map(String::as_str).collect::<Vec<_>>())
            )
        }
    };
    let rate_hz = 1e6 / worst.clock.period_us * (1.0 - repeats.share());
    let message = format!(
        "{} of the rows repeat the field {whose} in the row before {}, where chance gives {}: the sensors are read less often than rows are written, about {} times a second. Averages then hold fewer samples than they seem to, and the field comes late by half of what it is held; read the sensors once a row, or write a row once a sample",
        percent(repeats.share()),
        desk.recordings_in(hit.iter().map(|(recording, _, _)| *recording)),
        percent(repeats.by_chance()),
        digits(rate_hz),
    );
    let place = Place::file(&worst.path).line(repeats.line);
    desk.findings.push(Finding {
        id: "repeated_samples",
        place,
        message,
        stops: false,
        fix: None,
    });
}

/// True where noise should have changed the axes of a sensor in many rows, and did not.
fn is_held(table: &TableScan, repeats: &Repeats) -> bool {
    let noisy = table.columns.iter().any(|column| {
        let own =
            matches!(column.quantity, Quantity::Field { sensor, .. } if sensor == repeats.sensor);
        own && column.is_noisy()
    });
    let share = repeats.share();
    noisy && share > NOTICEABLE && share > BEYOND_CHANCE * repeats.by_chance()
}

/// True where any sensor of the table is held.
pub fn any(table: &TableScan) -> bool {
    table.repeats.iter().any(|repeats| is_held(table, repeats))
}

/// True for an axis of a sensor that is held.
pub fn hits(seen: &Seen) -> bool {
    let Quantity::Field { sensor, .. } = seen.column.quantity else {
        return false;
    };
    let own = seen
        .table
        .repeats
        .iter()
        .find(|repeats| repeats.sensor == sensor);
    own.is_some_and(|repeats| is_held(seen.table, repeats))
}
