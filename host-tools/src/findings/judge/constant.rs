//! `constant_covariate`: a covariate that never moved, so that nothing can be said of what hangs on it.

use model_export::effects::CATALOGUE;

use crate::compare::Finding;
use crate::findings::scan::Quantity;

use super::{Desk, Seen, digits, list};

/// A covariate whose spread is below this many times its own white noise does not move.
const MOVES: f64 = 1.5;
/// Fewer rows than this tell nothing of a spread.
const LEAST_ROWS: f64 = 20.0;

/// Looks at covariates over the whole campaign.
pub fn judge(desk: &mut Desk) {
    let columns = desk.columns();
    let mut names: Vec<&str> = Vec::new();
    for one in &columns {
        let covariate = matches!(
            one.column.quantity,
            Quantity::Temperature | Quantity::Covariate
        );
        if covariate && !names.contains(&one.column.name.as_str()) {
            names.push(&one.column.name);
        }
    }
    let of = |name: &str| -> Vec<Seen> {
        let same = columns.iter().filter(|one| one.column.name == name);
        same.copied().collect()
    };
    let still: Vec<&str> = names.into_iter().filter(|name| stands(&of(name))).collect();
    for group in groups(&still) {
        let seen = of(group[0]);
        desk.findings.push(Finding {
            id: "constant_covariate",
            place: seen[0].at(2),
            message: message(
                &group,
                &group.iter().map(|name| of(name)[0]).collect::<Vec<_>>(),
            ),
            stops: false,
            fix: None,
        });
    }
}

/// Columns with one cause: the sensors' temperatures, and the opening with the rotor that sets it.
fn groups<'a>(still: &[&'a str]) -> Vec<Vec<&'a str>> {
    let kind = |name: &str| match name {
        "motor_angle_rad" if still.contains(&"opening_mm") => "opening_mm".to_owned(),
        name if name.ends_with("_temp_c") => "temp_c".to_owned(),
        name => name.to_owned(),
    };
    let mut groups: Vec<Vec<&str>> = Vec::new();
    for name in still {
        match groups.iter_mut().find(|group| kind(group[0]) == kind(name)) {
            Some(group) => group.push(name),
            None => groups.push(vec![name]),
        }
    }
    groups
}

/// True where the values of all recordings together spread no more than their noise.
fn stands(seen: &[Seen]) -> bool {
    let moments = || seen.iter().map(|one| one.column.moments());
    let rows: f64 = moments().map(|(rows, _, _)| rows).sum();
    let mean = moments().map(|(rows, mean, _)| rows * mean).sum::<f64>() / rows;
    let squares: f64 = moments()
        .map(|(rows, own, squares)| squares + rows * (own - mean).powi(2))
        .sum();
    let noise = seen
        .iter()
        .map(|one| one.column.noise())
        .fold(0.0, f64::max);
    // A value that is written exactly needs no noise to be the same.
    let rounding = 1e-9 * mean.abs();
    rows >= LEAST_ROWS && (squares / rows).sqrt() <= (MOVES * noise).max(rounding)
}

fn message(group: &[&str], seen: &[Seen]) -> String {
    let needed = |name: &str, column: &str| {
        name == column || (name == "temp_c" && column.ends_with("_temp_c"))
    };
    let lost: Vec<&str> = CATALOGUE
        .iter()
        .filter(|effect| {
            let mut needs = effect.needs.iter();
            needs.any(|need| needed(need, group[0]))
        })
        .map(|effect| effect.id)
        .collect();
    let then = match lost.is_empty() {
        true => "nothing that hangs on it can be judged".to_owned(),
        false => format!("{} cannot be judged", list(&lost)),
    };
    let stands = group.iter().zip(seen).map(|(name, one)| {
        let (_, mean, _) = one.column.moments();
        let value = if mean.abs() < one.column.noise() {
            0.0
        } else {
            mean
        };
        format!("{name} at {}", digits(value))
    });
    let stands: Vec<String> = stands.collect();
    let stands: Vec<&str> = stands.iter().map(String::as_str).collect();
    format!(
        "nothing but noise moves it: the whole campaign has {}; {then}; record while it changes, or leave the column out if it was not measured",
        list(&stands),
    )
}
