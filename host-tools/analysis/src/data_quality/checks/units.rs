//! `wrong_unit` of a covariate, detected from its magnitude.

use std::f64::consts::{PI, TAU};

use crate::data_quality::Finding;
use crate::data_quality::fix::repair::{Change, Fix, Repair};
use crate::data_quality::scan::{ColumnScan, Quantity, RecordingScan};

use crate::data_quality::checks::{Channel, CheckContext, digits, verb};

/// Standard gravity in m/s².
const GRAVITY: f64 = 9.806_65;
/// Highest plausible sensor temperature in degrees Celsius.
const HOTTEST_C: f64 = 120.0;
/// A median above this, in degrees Celsius, is more likely a room temperature in Fahrenheit.
const HOT_C: f64 = 85.0;
/// Plausible temperatures in kelvin, including a warm motor.
const KELVIN: std::ops::Range<f64> = 233.0..423.0;
/// Openings below this, in millimetres, that vary are metres: the widest gripper opens 0.2 m.
const SMALLEST_MM: f64 = 0.2;
/// Openings above this are micrometres.
const WIDEST_MM: f64 = 1000.0;
/// Motor currents above this are milliamperes.
const MOST_A: f64 = 200.0;

/// Detected unit of the values.
#[derive(Clone, Debug, PartialEq)]
struct Misfit {
    found: &'static str,
    wanted: &'static str,
    evidence: String,
    /// Factor and offset to the expected unit, where unambiguous.
    cure: Option<(f64, f64)>,
}

/// Magnitudes of all covariates.
pub fn check_units(context: &mut CheckContext) {
    let covariates: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| matches!(one.column.quantity, Quantity::Temperature | Quantity::Covariate))
        .collect();
    let mut groups: Vec<(Misfit, Vec<Channel>)> = Vec::new();
    for one in covariates {
        let Some(misfit) = misfit(&context.recordings[one.recording], one.column) else {
            continue;
        };
        let same = |(other, _): &&mut (Misfit, Vec<Channel>)| {
            other.found == misfit.found && other.wanted == misfit.wanted
        };
        match groups.iter_mut().find(same) {
            Some((_, seen)) => seen.push(one),
            None => groups.push((misfit, vec![one])),
        }
    }
    for (misfit, seen) in groups {
        let finding = finding(context, &misfit, &seen);
        context.findings.push(finding);
        context.explain(&seen);
    }
}

fn finding(context: &CheckContext, misfit: &Misfit, seen: &[Channel]) -> Finding {
    let Misfit { found, wanted, evidence, .. } = misfit;
    let fix = misfit.cure.map(|(factor, offset)| Fix {
        words: format!("converts from {found} to {wanted}"),
        repairs: seen
            .iter()
            .map(|one| Repair {
                file: one.table.path.clone(),
                change: Change::Convert { column: one.column.name.clone(), factor, offset },
            })
            .collect(),
    });
    let says = match fix {
        Some(_) => verb(seen, "is", "are"),
        None => verb(seen, "seems to be", "seem to be"),
    };
    Finding {
        id: "wrong_unit",
        place: seen[0].at(2),
        message: format!(
            "{} {} in {found}, not in {wanted}: {} is {evidence}; convert the column",
            context.whose(seen),
            says,
            seen[0].column.name,
        ),
        stops: true,
        fix,
    }
}

fn misfit(recording: &RecordingScan, column: &ColumnScan) -> Option<Misfit> {
    let size = |share: f64| column.sample.size(share).unwrap_or(0.0);
    let misfit = |found, wanted, evidence, cure| Some(Misfit { found, wanted, evidence, cure });
    let up_to = || format!("up to {}", digits(size(1.0)));
    match column.name.as_str() {
        "roll_rad" | "pitch_rad" if size(1.0) > TAU => {
            misfit("degrees", "rad", up_to(), Some((PI / 180.0, 0.0)))
        }
        "yaw_rad" if size(1.0) > TAU => yaw(recording, column),
        "opening_mm" if size(1.0) > WIDEST_MM => misfit("um", "mm", up_to(), Some((1e-3, 0.0))),
        "opening_mm" if size(1.0) < SMALLEST_MM && column.span() > 0.0 => {
            misfit("m", "mm", up_to(), Some((1e3, 0.0)))
        }
        "motor_iq_a" if size(0.95) > MOST_A => misfit("mA", "A", up_to(), Some((1e-3, 0.0))),
        name if name.starts_with("accel_") => acceleration(recording),
        _ if column.quantity == Quantity::Temperature => temperature(column),
        _ => None,
    }
}

/// Yaw in rad may exceed one turn: it is unambiguous only if roll or pitch are in degrees too.
fn yaw(recording: &RecordingScan, column: &ColumnScan) -> Option<Misfit> {
    let most = column.sample.size(1.0)?;
    let others = ["roll_rad", "pitch_rad"];
    let sure = recording.table("hall.csv").is_some_and(|hall| {
        let others = others.iter().filter_map(|name| hall.column(name));
        others.filter_map(|column| column.sample.size(1.0)).any(|most| most > TAU)
    });
    // Beyond a turn in degrees it can only be continuous rad.
    (sure || most <= 360.0).then(|| Misfit {
        found: "degrees",
        wanted: "rad",
        evidence: format!("up to {}", digits(most)),
        cure: sure.then_some((PI / 180.0, 0.0)),
    })
}

fn temperature(column: &ColumnScan) -> Option<Misfit> {
    let median = column.sample.median()?;
    let (found, cure) = match median {
        t if t <= HOT_C => return None,
        t if t <= HOTTEST_C => ("degrees Fahrenheit", None),
        t if KELVIN.contains(&t) => ("kelvin", Some((1.0, -273.15))),
        _ => ("another unit", None),
    };
    Some(Misfit {
        found,
        wanted: "degrees Celsius",
        evidence: format!("{} in the middle", digits(median)),
        cure,
    })
}

/// All three axes by the magnitude of the vector: at rest it is gravity.
fn acceleration(recording: &RecordingScan) -> Option<Misfit> {
    let norm = recording.table("hall.csv")?.acceleration.median()?;
    let (found, factor) = match norm {
        n if (0.8..1.25).contains(&n) => ("g", GRAVITY),
        n if (800.0..1250.0).contains(&n) => ("thousandths of g", 1e-3 * GRAVITY),
        _ => return None,
    };
    Some(Misfit {
        found,
        wanted: "m/s2",
        evidence: format!("part of a vector whose length is {} in the middle", digits(norm)),
        cure: Some((factor, 0.0)),
    })
}
