//! `clock_gap`: rows are missing.

use model_export::recordings::Place;

use crate::compare::Finding;
use crate::findings::scan::TableScan;

use super::{Desk, digits, percent};

/// Looks for steps of the clock that are far too long.
pub fn judge(desk: &mut Desk) {
    for name in ["hall.csv", "force.csv"] {
        let hit: Vec<(usize, &TableScan)> = desk
            .tables()
            .into_iter()
            .filter(|(_, table)| table.name == name && table.clock.gaps > 0)
            .filter(|(_, table)| !desk.has("clock_backwards", table))
            .collect();
        let longest = hit
            .iter()
            .max_by(|(_, a), (_, b)| a.clock.longest.0.total_cmp(&b.clock.longest.0));
        let Some((_, worst)) = longest else { continue };
        let gaps: u64 = hit.iter().map(|(_, table)| table.clock.gaps).sum();
        let lost_s: f64 = hit
            .iter()
            .map(|(_, table)| 1e-6 * table.clock.lost_us)
            .sum();
        let span_s: f64 = hit.iter().map(|(_, table)| table.clock.span_s()).sum();
        let (step_us, line, from_us) = worst.clock.longest;
        let message = format!(
            "{} in the clock {}, {} of the time in all; the longest here, from {} s on: {} ms where rows are {} ms apart. Rows that lean on a gap are left out; look for lost transfers or a blocked logger",
            match gaps {
                1 => "1 gap".to_owned(),
                n => format!("{n} gaps"),
            },
            desk.recordings_in(hit.iter().map(|(recording, _)| *recording)),
            percent(lost_s / span_s),
            digits(worst.second(from_us)),
            digits(1e-3 * step_us),
            digits(1e-3 * worst.clock.period_us),
        );
        desk.findings.push(Finding {
            id: "clock_gap",
            place: Place::file(&worst.path).line(line).column("t_us"),
            message,
            stops: false,
            fix: None,
        });
    }
}
