//! `coarse_steps`: values lie in steps that hide what the channel could tell.

use model_export::recordings::columns::FieldUnit;

use crate::compare::Finding;
use crate::findings::scan::grid::FEW;
use crate::findings::scan::{ColumnScan, Quantity};

use super::{Desk, Seen, by_table, digits, repeated, verb};

/// Steps this many times the white noise are not smoothed by it. Rounding alone looks like a noise of
/// 0.29 steps, a ratio of 3.5.
const STEPS_OF_NOISE: f64 = 2.0;
/// A column must take this many values before anything is said of their steps.
const LEAST_VALUES: usize = 5;
/// Whole counts must spread over this many steps: a few values may have a divisor by chance.
const LEAST_STEPS: f64 = 10.0;

/// Looks at every column that is no angle and no acceleration.
pub fn judge(desk: &mut Desk) {
    let coarse: Vec<Seen> = desk
        .columns()
        .into_iter()
        .filter(|one| step(one.column).is_some())
        // Samples that are held hide their noise.
        .filter(|one| one.column.quantity.is_field() || !repeated::any(one.table))
        .collect();
    for seen in by_table(coarse) {
        let coarseness = |one: &Seen| step(one.column).unwrap_or(0.0) / one.column.span();
        let worst = seen
            .iter()
            .max_by(|a, b| coarseness(a).total_cmp(&coarseness(b)));
        let Some(worst) = worst else { continue };
        let step = step(worst.column).unwrap_or(0.0);
        let counts = match worst.column.quantity {
            Quantity::Field {
                unit: FieldUnit::Lsb,
                ..
            } => "counts ",
            _ => "",
        };
        let message = format!(
            "{} {} in steps, the coarsest in {}: every value is {} {counts}from the next, {} steps from end to end, which adds an error of {} that no average removes; write more digits, or look for bits lost in a driver",
            desk.whose(&seen),
            verb(&seen, "lies", "lie"),
            worst.column.name,
            digits(step),
            digits(worst.column.span() / step),
            digits(step / 12_f64.sqrt()),
        );
        let place = worst.at(2);
        desk.explain(&seen);
        desk.findings.push(Finding {
            id: "coarse_steps",
            place,
            message,
            stops: false,
            fix: None,
        });
    }
}

/// The step, where it is too coarse.
fn step(column: &ColumnScan) -> Option<f64> {
    let span = column.span();
    match column.quantity {
        Quantity::Field {
            unit: FieldUnit::Lsb,
            ..
        } => {
            let divisor = column.grid.divisor()? as f64;
            (divisor > 1.0 && span >= LEAST_STEPS * divisor).then_some(divisor)
        }
        Quantity::Covariate if column.name != "opening_mm" => None,
        _ => {
            let (distinct, step) = (column.grid.distinct()?, column.grid.step());
            let few = distinct >= LEAST_VALUES && span < FEW as f64 * step;
            (few && step > STEPS_OF_NOISE * column.noise()).then_some(step)
        }
    }
}
