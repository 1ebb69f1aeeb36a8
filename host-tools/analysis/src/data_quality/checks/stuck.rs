//! Channels without information: `stuck_channel`, `saturated` and `constant_covariate`.

use crate::data_quality::Finding;
use crate::data_quality::checks::{Channel, CheckContext, by_table, digits, list, percent, verb};
use crate::data_quality::scan::Quantity;
use crate::data_quality::scan::channel::Run;
use model_export::effects::CATALOGUE;

/// Minimum number of rows; a shorter recording may be constant by coincidence.
const LEAST_ROWS: u64 = 20;
/// A single run with this share of the rows at the extreme value is not clipping.
const ONE_STAY: f64 = 0.95;
/// Runs that begin within this time in microseconds have one cause.
const TOGETHER_US: f64 = 100_000.0;

/// Fields and forces that do not change, throughout or for a stretch.
pub fn check_stuck_channels(context: &mut CheckContext) {
    let measured: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() || one.column.quantity == Quantity::Force)
        .collect();
    let throughout = |one: &&Channel| one.column.rows >= LEAST_ROWS && one.column.span() == 0.0;
    let constant: Vec<Channel> = measured.iter().filter(throughout).copied().collect();
    for seen in by_table(constant) {
        if seen.is_empty() {
            continue;
        }
        let (whole, some): (Vec<Channel>, Vec<Channel>) =
            seen.iter().partition(|one| context.everywhere(&seen, &one.column.name));
        for (seen, whole) in [(whole, true), (some, false)] {
            if !seen.is_empty() {
                let found = never_changes(context, &seen, whole);
                context.findings.push(found);
                context.explain(&seen);
            }
        }
    }
    let frozen = |one: Channel<'_>| Some(one.column.frozen()?).filter(|run| !is_an_end(&one, run));
    let stretches: Vec<(Channel, Run)> =
        measured.into_iter().filter_map(|one| frozen(one).map(|run| (one, run))).collect();
    for group in together(stretches) {
        let found = frozen_for(context, &group);
        context.findings.push(found);
        let seen: Vec<Channel> = group.iter().map(|(one, _)| *one).collect();
        context.explain(&seen);
    }
}

/// A clipped channel stays at its limit as long as the load does.
fn is_an_end(seen: &Channel, run: &Run) -> bool {
    let at_limit = run.value <= seen.column.limits.0 || run.value >= seen.column.limits.1;
    let cut_off = seen.column.cut_off();
    // Noise splits a run at a limit; a channel that froze at its peak has a single run.
    at_limit
        || cut_off.is_some_and(|(value, rows)| {
            value == run.value && (run.rows as f64) < ONE_STAY * rows as f64
        })
}

fn never_changes(context: &CheckContext, seen: &[Channel], whole: bool) -> Finding {
    let first = seen[0];
    let end = match seen.iter().any(|one| one.column.at_limit.0 > 0) {
        true => ", the end of its range",
        false => "",
    };
    let message = format!(
        "{} {} {}{end} in every row; a working channel shows noise: look for a broken wire, a sensor that was not read, or a column filled by hand{}",
        context.whose(seen),
        verb(seen, "is", "are"),
        digits(first.column.extent.0),
        if whole { "" } else { ", and exclude that recording" }
    );
    Finding { id: "stuck_channel", place: first.at(2), message, stops: whole, fix: None }
}

fn frozen_for(context: &CheckContext, group: &[(Channel, Run)]) -> Finding {
    let (first, run) = group[0];
    let seen: Vec<Channel> = group.iter().map(|(one, _)| *one).collect();
    let message = format!(
        "{} {} constant from {} to {} s, {} rows of the same value ({}), where noise of {} would change nearly every row; look for a loose connector or a sensor that stopped, and cut out this stretch",
        context.whose(&seen),
        verb(&seen, "is", "are"),
        digits(first.table.second(run.from_us)),
        digits(first.table.second(run.to_us)),
        run.rows,
        digits(run.value),
        digits(first.column.noise()),
    );
    Finding { id: "stuck_channel", place: first.at(run.line), message, stops: false, fix: None }
}

/// Groups runs of one recording that begin together.
fn together<'a>(stretches: Vec<(Channel<'a>, Run)>) -> Vec<Vec<(Channel<'a>, Run)>> {
    let mut groups: Vec<Vec<(Channel, Run)>> = Vec::new();
    for (one, run) in stretches {
        let belongs = |group: &&mut Vec<(Channel, Run)>| {
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

/// Fields and forces at the end of their range, or clipped before it.
pub fn check_saturation(context: &mut CheckContext) {
    let measured: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| one.column.quantity.is_field() || one.column.quantity == Quantity::Force)
        .collect();
    for seen in by_table(measured) {
        let (at_limit, others): (Vec<Channel>, Vec<Channel>) =
            seen.iter().partition(|one| one.column.at_limit.0 > 0);
        let cut_off: Vec<Channel> =
            others.into_iter().filter(|one| one.column.cut_off().is_some()).collect();
        let found = at_its_end(context, &at_limit)
            .into_iter()
            .chain(cut_short(context, &cut_off))
            .collect::<Vec<_>>();
        context.findings.extend(found);
        context.explain(&at_limit);
        context.explain(&cut_off);
    }
}

fn at_its_end(context: &CheckContext, seen: &[Channel]) -> Option<Finding> {
    let share = |one: &Channel| one.column.at_limit.0 as f64 / one.column.rows as f64;
    let worst = seen.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    Some(Finding {
        id: "saturated",
        place: worst.at(worst.column.at_limit.1),
        message: format!(
            "{} {} the end of its range, most in {} with {} of the rows; those rows are excluded: widen the gap or reduce the load",
            context.whose(seen),
            verb(seen, "reaches", "reach"),
            worst.column.name,
            percent(share(worst)),
        ),
        stops: false,
        fix: None,
    })
}

fn cut_short(context: &CheckContext, seen: &[Channel]) -> Option<Finding> {
    let rows = |one: &Channel| one.column.cut_off().map_or(0, |(_, rows)| rows);
    let share = |one: &Channel| rows(one) as f64 / one.column.rows as f64;
    let worst = seen.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
    let (value, _) = worst.column.cut_off()?;
    let advice = if value == 0.0 && worst.column.quantity == Quantity::Force {
        "this is correct where the signal only rests at zero, as on a scale; otherwise forces of one sign are lost: adjust the zero of the amplifier"
    } else {
        "look for a limit in the amplifier, the converter or the logger, or reduce the load"
    };
    Some(Finding {
        id: "saturated",
        place: worst.at(2),
        message: format!(
            "{} {} clipped: {} of the rows of {} are exactly {} and none exceeds it, where noise would scatter them; {advice}. These rows are not excluded automatically",
            context.whose(seen),
            verb(seen, "is", "are"),
            percent(share(worst)),
            worst.column.name,
            digits(value),
        ),
        stops: false,
        fix: None,
    })
}

/// A covariate with a spread below this multiple of its white noise counts as constant.
const MOVES: f64 = 1.5;
/// Minimum number of rows for an estimate of the spread.
const MIN_COVARIATE_ROWS: f64 = 20.0;

/// Covariates that do not vary over the whole campaign.
pub fn check_constant_covariates(context: &mut CheckContext) {
    let columns = context.columns();
    let mut names: Vec<&str> = Vec::new();
    for one in &columns {
        let covariate = matches!(one.column.quantity, Quantity::Temperature | Quantity::Covariate);
        if covariate && !names.contains(&one.column.name.as_str()) {
            names.push(&one.column.name);
        }
    }
    let of = |name: &str| -> Vec<Channel> {
        let same = columns.iter().filter(|one| one.column.name == name);
        same.copied().collect()
    };
    let still: Vec<&str> = names.into_iter().filter(|name| is_constant(&of(name))).collect();
    for group in groups(&still) {
        let seen = of(group[0]);
        context.findings.push(Finding {
            id: "constant_covariate",
            place: seen[0].at(2),
            message: message(&group, &group.iter().map(|name| of(name)[0]).collect::<Vec<_>>()),
            stops: false,
            fix: None,
        });
    }
}

/// Groups columns with one cause: the sensors' temperatures, or the opening and the rotor that sets it.
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

/// True where the spread over all recordings does not exceed the noise.
fn is_constant(seen: &[Channel]) -> bool {
    let moments = || seen.iter().map(|one| one.column.moments());
    let rows: f64 = moments().map(|(rows, _, _)| rows).sum();
    let mean = moments().map(|(rows, mean, _)| rows * mean).sum::<f64>() / rows;
    let squares: f64 =
        moments().map(|(rows, own, squares)| squares + rows * (own - mean).powi(2)).sum();
    let noise = seen.iter().map(|one| one.column.noise()).fold(0.0, f64::max);
    // An exactly written constant has no noise.
    let rounding = 1e-9 * mean.abs();
    rows >= MIN_COVARIATE_ROWS && (squares / rows).sqrt() <= (MOVES * noise).max(rounding)
}

fn message(group: &[&str], seen: &[Channel]) -> String {
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
    let then = if lost.is_empty() {
        "effects that depend on it cannot be tested".to_owned()
    } else {
        format!("{} cannot be tested", list(&lost))
    };
    let values = group.iter().zip(seen).map(|(name, one)| {
        let (_, mean, _) = one.column.moments();
        let value = if mean.abs() < one.column.noise() { 0.0 } else { mean };
        format!("{name} at {}", digits(value))
    });
    let values: Vec<String> = values.collect();
    let values: Vec<&str> = values.iter().map(String::as_str).collect();
    format!(
        "no variation above the noise: {} in the whole campaign; {then}; record while it changes, or remove the column if it was not measured",
        list(&values),
    )
}
