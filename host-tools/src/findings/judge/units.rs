//! `wrong_unit` of a covariate, where its size alone tells.

use std::f64::consts::{PI, TAU};

use crate::compare::Finding;
use crate::findings::repair::{Change, Fix, Repair};
use crate::findings::scan::{ColumnScan, Quantity, RecordingScan};

use super::{Desk, Seen, digits, verb};

/// Standard gravity in m/s².
const GRAVITY: f64 = 9.806_65;
/// No sensor on a gripper is hotter than this, in degrees Celsius.
const HOTTEST_C: f64 = 120.0;
/// A median above this, in degrees Celsius, is more likely one of a room in Fahrenheit that warms up.
const HOT_C: f64 = 85.0;
/// Temperatures of laboratories in kelvin, with room for a motor.
const KELVIN: std::ops::Range<f64> = 233.0..423.0;
/// Openings below this, in millimetres, that yet move are metres: 0.2 m is the widest gripper's.
const SMALLEST_MM: f64 = 0.2;
/// Openings above this are micrometres: no gripper opens by a metre.
const WIDEST_MM: f64 = 1000.0;
/// Motor currents above this are milliamperes: no gripper's motor takes as many amperes.
const MOST_A: f64 = 200.0;

/// What the values are instead.
#[derive(Clone, Debug, PartialEq)]
struct Misfit {
    found: &'static str,
    wanted: &'static str,
    evidence: String,
    /// Factor and offset into the unit wanted, where they are certain.
    cure: Option<(f64, f64)>,
}

/// Looks at every covariate.
pub fn judge(desk: &mut Desk) {
    let covariates: Vec<Seen> = desk
        .columns()
        .into_iter()
        .filter(|one| {
            matches!(
                one.column.quantity,
                Quantity::Temperature | Quantity::Covariate
            )
        })
        .collect();
    let mut groups: Vec<(Misfit, Vec<Seen>)> = Vec::new();
    for one in covariates {
        let Some(misfit) = misfit(&desk.recordings[one.recording], one.column) else {
            continue;
        };
        let same = |(other, _): &&mut (Misfit, Vec<Seen>)| {
            other.found == misfit.found && other.wanted == misfit.wanted
        };
        match groups.iter_mut().find(same) {
            Some((_, seen)) => seen.push(one),
            None => groups.push((misfit, vec![one])),
        }
    }
    for (misfit, seen) in groups {
        let finding = tell(desk, &misfit, &seen);
        desk.findings.push(finding);
        desk.explain(&seen);
    }
}

fn tell(desk: &Desk, misfit: &Misfit, seen: &[Seen]) -> Finding {
    let Misfit {
        found,
        wanted,
        evidence,
        ..
    } = misfit;
    let fix = misfit.cure.map(|(factor, offset)| Fix {
        words: format!("converts from {found} to {wanted}"),
        repairs: seen
            .iter()
            .map(|one| Repair {
                file: one.table.path.clone(),
                change: Change::Convert {
                    column: one.column.name.clone(),
                    factor,
                    offset,
                },
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
            desk.whose(seen),
            says,
            seen[0].column.name,
        ),
        stops: true,
        fix,
    }
}

fn misfit(recording: &RecordingScan, column: &ColumnScan) -> Option<Misfit> {
    let size = |share: f64| column.sample.size(share).unwrap_or(0.0);
    let misfit = |found, wanted, evidence, cure| {
        Some(Misfit {
            found,
            wanted,
            evidence,
            cure,
        })
    };
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

/// Yaw may have turned several times, in rad: only beside a roll or pitch in degrees is it sure.
fn yaw(recording: &RecordingScan, column: &ColumnScan) -> Option<Misfit> {
    let most = column.sample.size(1.0)?;
    let others = ["roll_rad", "pitch_rad"];
    let sure = recording.table("hall.csv").is_some_and(|hall| {
        let others = others.iter().filter_map(|name| hall.column(name));
        others
            .filter_map(|column| column.sample.size(1.0))
            .any(|most| most > TAU)
    });
    // Beyond a turn in degrees it can only be rad, gone on through many turns.
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

/// All three axes by the size of what they show together: at rest it is gravity.
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
        evidence: format!(
            "part of a vector whose length is {} in the middle",
            digits(norm)
        ),
        cure: Some((factor, 0.0)),
    })
}
