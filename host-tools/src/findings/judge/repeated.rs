//! `repeated_samples`: the clock goes on and the fields do not.

use model_export::recordings::Place;

use crate::compare::Finding;
use crate::findings::scan::TableScan;

use super::{Desk, digits, percent};

/// Fewer repeated rows than this share do no harm.
const NOTICEABLE: f64 = 0.01;
/// ... and they must be this many times what chance gives.
const BEYOND_CHANCE: f64 = 10.0;

/// Looks at the board's tables.
pub fn judge(desk: &mut Desk) {
    let hit: Vec<(usize, &TableScan)> = desk
        .tables()
        .into_iter()
        .filter(|(_, table)| table.name == "hall.csv" && repeats(table))
        .filter(|(_, table)| !desk.has("stuck_channel", table))
        .collect();
    let share = |table: &TableScan| table.repeats.share();
    let worst = hit
        .iter()
        .max_by(|(_, a), (_, b)| share(a).total_cmp(&share(b)));
    let Some((_, worst)) = worst else { return };
    let rate_hz = 1e6 / worst.clock.period_us * (1.0 - share(worst));
    let message = format!(
        "{} of the rows repeat every field of the row before {}, where chance gives {}: the sensors are read less often than rows are written, about {} times a second. Averages then hold fewer samples than they seem to; read the sensors once a row, or write a row once a sample",
        percent(share(worst)),
        desk.recordings_in(hit.iter().map(|(recording, _)| *recording)),
        percent(worst.repeats.by_chance()),
        digits(rate_hz),
    );
    let place = Place::file(&worst.path).line(worst.repeats.line);
    desk.findings.push(Finding {
        id: "repeated_samples",
        place,
        message,
        stops: false,
        fix: None,
    });
}

/// True where noise should have changed the fields of many rows, and did not.
pub fn repeats(table: &TableScan) -> bool {
    let mut fields = table
        .columns
        .iter()
        .filter(|column| column.quantity.is_field());
    let share = table.repeats.share();
    share > NOTICEABLE
        && share > BEYOND_CHANCE * table.repeats.by_chance()
        && fields.any(|column| column.is_noisy())
}
