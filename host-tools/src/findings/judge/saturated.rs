//! `saturated`: a channel at the end of its range, or cut off before it.

use crate::compare::Finding;
use crate::findings::scan::Quantity;

use super::{Desk, Seen, by_table, digits, percent, verb};

/// Looks at fields and forces.
pub fn judge(desk: &mut Desk) {
    let measured: Vec<Seen> = desk
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() || one.column.quantity == Quantity::Force)
        .collect();
    for seen in by_table(measured) {
        let (at_limit, others): (Vec<Seen>, Vec<Seen>) =
            seen.iter().partition(|one| one.column.at_limit.0 > 0);
        let cut_off: Vec<Seen> = others
            .into_iter()
            .filter(|one| one.column.cut_off().is_some())
            .collect();
        let found = at_its_end(desk, &at_limit)
            .into_iter()
            .chain(cut_short(desk, &cut_off))
            .collect::<Vec<_>>();
        desk.findings.extend(found);
        desk.explain(&at_limit);
        desk.explain(&cut_off);
    }
}

fn at_its_end(desk: &Desk, seen: &[Seen]) -> Option<Finding> {
    let share = |one: &Seen| one.column.at_limit.0 as f64 / one.column.rows as f64;
    let worst = seen.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    Some(Finding {
        id: "saturated",
        place: worst.at(worst.column.at_limit.1),
        message: format!(
            "{} {} the end of its range, most in {} with {} of the rows; those rows are left out: widen the gap or lower the load",
            desk.whose(seen),
            verb(seen, "reaches", "reach"),
            worst.column.name,
            percent(share(worst)),
        ),
        stops: false,
        fix: None,
    })
}

fn cut_short(desk: &Desk, seen: &[Seen]) -> Option<Finding> {
    let rows = |one: &Seen| one.column.cut_off().map_or(0, |(_, rows)| rows);
    let share = |one: &Seen| rows(one) as f64 / one.column.rows as f64;
    let worst = seen.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    let (value, _) = worst.column.cut_off()?;
    let advice = match value == 0.0 && worst.column.quantity == Quantity::Force {
        true => {
            "that is well where it only rests at zero, as on a scale; else forces of one sign are lost: set the zero of the amplifier anew"
        }
        false => {
            "look for a limit in the amplifier, the converter or the logger, or lower the load"
        }
    };
    Some(Finding {
        id: "saturated",
        place: worst.at(2),
        message: format!(
            "{} {} cut off: {} of the rows of {} are exactly {} and none lies beyond, where noise would scatter them; {advice}. These rows are not left out by themselves",
            desk.whose(seen),
            verb(seen, "is", "are"),
            percent(share(worst)),
            worst.column.name,
            digits(value),
        ),
        stops: false,
        fix: None,
    })
}
