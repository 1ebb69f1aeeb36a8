//! `outlier`: single rows that stand far away from both neighbours.

use crate::compare::Finding;

use super::{Desk, Seen, digits};

/// Standard deviations of the noise: chance never gives as many.
const FAR: f64 = 20.0;

/// Looks at the fields.
pub fn judge(desk: &mut Desk) {
    let spikes = |one: &Seen| {
        let noise = one.column.spikes.noise()?;
        // Rounding may hide the noise; a single step is no outlier.
        let height = FAR * noise.max(0.3 * one.column.grid.step());
        one.column.spikes.above(height).map(|found| (found, noise))
    };
    let seen: Vec<Seen> = desk
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() && spikes(one).is_some())
        .collect();
    let height = |one: &Seen| spikes(one).map_or(0.0, |((_, most, _), noise)| most / noise);
    let worst = seen.iter().max_by(|a, b| height(a).total_cmp(&height(b)));
    let Some(worst) = worst else { return };
    let Some(((_, most, line), noise)) = spikes(worst) else {
        return;
    };
    let rows: u64 = seen.iter().filter_map(spikes).map(|((n, _, _), _)| n).sum();
    let message = format!(
        "{}: {} away from both neighbours by more than {FAR} times the noise; the greatest here, in {}, by {} G where the noise is {} G. Look for disturbed transfers, and take these rows out: an average spreads them",
        desk.whose(&seen),
        match rows {
            1 => "1 value stands".to_owned(),
            n => format!("{n} values stand"),
        },
        worst.column.name,
        digits(most * worst.column.scale),
        digits(noise * worst.column.scale),
    );
    let place = worst.at(line);
    desk.explain(&seen);
    desk.findings.push(Finding {
        id: "outlier",
        place,
        message,
        stops: false,
        fix: None,
    });
}
